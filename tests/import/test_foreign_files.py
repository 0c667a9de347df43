"""Files of 32 programs: read right after at most one answer, or refused with the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from foreign_files import FILES
from foreign_session import Session, session
from foreign_texts import ForeignFile

import highside
from highside.errors import InputError

ACCEL, RATES = ("ax_g", "ay_g", "az_g"), ("gx_dps", "gy_dps", "gz_dps")


def wrong(found: highside.Recording, s: Session, file: ForeignFile, *, beginning: bool = False) -> list[str]:
    """The columns that are not what was recorded; `beginning`: up to the row before the last one that was read."""
    last = found.n - 1 if beginning else None
    s = s.rows(np.arange(s.n)[:last])
    blocks = {"t_s": (s.t_s - s.t_s[0] + found.t_s[0], 1.1e-3)}
    blocks |= {name: (s.accel_g[k], file.coarse[0]) for k, name in enumerate(ACCEL)}
    blocks |= {name: (s.rate_dps[k], file.coarse[1]) for k, name in enumerate(RATES)}
    blocks |= {"inc_ref_deg": (s.inc_deg, 1e-6), "tf_ref_deg": (s.tf_deg, 1e-6), "temp_c": (s.temp_c, 0.06)}
    if not beginning and found.n != s.n:
        return [f"{found.n} rows"]
    return [
        name
        for name, (true, coarse) in blocks.items()
        if found.has(name) and not np.allclose(found[name][:last], true, rtol=0, atol=coarse)
    ]


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_read_right_after_one_answer_or_refused_with_the_reason(tmp_path: Path, name: str) -> None:
    file = FILES[name]
    path = tmp_path / name
    path.write_bytes(file.write(session()))
    if file.refused:
        for accept in (False, True):
            with pytest.raises(InputError, match=file.refused):
                highside.import_recording(path, accept=accept)
        return
    if file.answer:
        # it is asked, not taken
        with pytest.raises(InputError, match=r"; .*(accept=True|rate_hz=|mapping=)"):
            highside.import_recording(path)
    found = highside.import_recording(path, **file.answer)
    assert not wrong(found, session(), file)
    wanted = {"a": ACCEL, "g": RATES, "r": ("inc_ref_deg", "tf_ref_deg")}
    assert all(found.has(target) for letter in file.columns for target in ("t_s", *wanted[letter]))


def test_there_are_as_many_programs_as_the_pages_say() -> None:
    assert len(FILES) >= 25
    assert len({file.tool for file in FILES.values()}) >= 25
    read = [file for file in FILES.values() if not file.refused]
    assert len(read) >= 25
    # most of them without a question about more than what rests on values
    assert sum(file.answer in ({}, {"accept": True}) for file in read) >= len(read) - 3
