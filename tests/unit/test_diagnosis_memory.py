"""Memory of a diagnosis: what is kept, what is made anew or read back, with the same answer; and a bound by row."""

from __future__ import annotations

import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from highside.arrays import Array
from highside.diagnosis.core.observed import Observed
from highside.diagnosis.laws import families, on_channels
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import groups_of
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.policy import LAW_EVIDENCE
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.search import Search
from highside.diagnosis.rows import scratch
from highside.diagnosis.rows.design import ChainDesign
from highside.diagnosis.rows.policy import DESIGN
from highside.physics.forward import ForwardModel
from studies.giant_recording import MODEL, written
from tests.unit.test_diagnosis_long import FREE, STRONG, recording, turning
from tests.unit.test_laws_search import offset_of_temp, problem, session

FURTHER = pytest.mark.further


def _nothing_kept(patched: pytest.MonkeyPatch) -> None:
    for module in (families, on_channels):
        patched.setattr(module, "LAW_EVIDENCE", replace(LAW_EVIDENCE, kept=0, raw=0))


def _law_problem() -> LawProblem:
    state = session(5)
    readings = ForwardModel.of({}).predict(state) + offset_of_temp(state)
    return problem(state, readings + 2e-5 * np.random.default_rng(5).standard_normal(readings.shape))[1]


def _summary(found: Found) -> tuple[float, list[str], list[float]]:
    return found.evidence, [t.group.label for t in found.terms], list(found.gains)


def test_a_search_that_keeps_no_columns_finds_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    posed = replace(_law_problem(), jitter=None)
    kept = _summary(Search(posed).run())
    _nothing_kept(monkeypatch)
    anew = _summary(Search(posed).run())
    assert kept[1]
    assert kept[1] == anew[1]
    np.testing.assert_allclose(anew[0], kept[0], rtol=1e-11)
    np.testing.assert_allclose(anew[2], kept[2], rtol=1e-9)


@pytest.mark.parametrize("kind", ["white", "remembers", "mixes"])
def test_gains_are_the_same_from_columns_made_anew_in_a_part_of_the_memory(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    posed = _law_problem()
    noise = LawNoise.floor_alone(posed)
    if kind == "mixes":
        noise = replace(noise, jitter=np.array([1e-5, 1e-5]))
    elif kind == "remembers":
        noise = replace(noise, share=np.full(3, 0.5), length=np.full(3, 300.0))
    groups = groups_of(posed)

    def scored() -> tuple[Array, int]:
        tracemalloc.start()
        found = Whitened(Families(posed, groups), Whitener(posed, noise), posed.residual).scores([])[0]
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found, peak

    kept, much = scored()
    _nothing_kept(monkeypatch)
    anew, little = scored()
    np.testing.assert_allclose(anew, kept, rtol=1e-9)
    # of white noise sums over channels are kept, and no column
    assert little < (1.0 if kind == "white" else 0.6) * much


def test_inner_products_of_one_shape_of_noise_serve_noises_of_all_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever was looked at before: the factor of each channel, another shape on one of them, laws beside it."""
    _nothing_kept(monkeypatch)
    posed = replace(_law_problem(), jitter=None)
    groups = groups_of(posed)
    floor = LawNoise.floor_alone(posed)
    level = replace(floor, share=np.array([0.0, 2.0, 0.0]), length=np.array([1.0, 300.0, 1.0]))
    noises = [
        floor,
        replace(floor, factor=np.array([1.0, 3.0, 1.7])),
        replace(level, factor=np.array([2.0, 1.2, 1.0])),
        replace(level, ladder=np.array([0.5, 0.0, 0.0])),
        floor,
    ]
    shared = Families(posed, groups)
    chosen = [LawTerm(groups[3], Prior(1e-8, 3.0)), LawTerm(groups[-2], Prior(1e-8, 3.0))]
    for noise in noises:
        for terms in (chosen[:1], chosen):
            again = Whitened(shared, Whitener(posed, noise), posed.residual)
            anew = Whitened(Families(posed, groups), Whitener(posed, noise), posed.residual)
            np.testing.assert_allclose(again.scores(terms)[0], anew.scores(terms)[0], rtol=1e-9, atol=1e-9)
            does = again.left_of(terms, [0])
            np.testing.assert_array_equal(again.may_reproduce(does), anew.may_reproduce(does))


def test_a_design_is_the_same_with_columns_in_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    turned = recording(STRONG, turning(25.0))
    whole = ChainDesign(turned, ForwardModel.of({}), FREE)
    monkeypatch.setattr(scratch, "DESIGN", replace(DESIGN, in_memory=0))
    filed = ChainDesign(turned, ForwardModel.of({}), FREE)
    part = slice(3000, 4000)
    for one, other in zip(whole.functions(part), filed.functions(part), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_residual_by_runs_is_that_of_the_whole() -> None:
    turned = recording(STRONG, turning(25.0), gyros=True)
    model = ForwardModel.of({**STRONG, "bandwidth_lag": {"tau": 3e-3}})
    whole = Observed(turned.state, turned.readings).residual(model)
    parts = Observed(turned.state, turned.readings, by_parts=True).residual(model)
    np.testing.assert_allclose(parts, whole, rtol=0, atol=1e-13)


DIAGNOSED = """
import json, sys
from pathlib import Path
from dataclasses import replace
import highside
from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.rotation import lines

# spectra of up to a million rows are made at once: here of fewer, so that what is left grows with the rows or does not
lines.LINES_POLICY = replace(lines.LINES_POLICY, most_rows=1 << 16)
found = highside.diagnose(
    sys.argv[1], sys.argv[2], run_by_run=sys.argv[3] == "run by run", method=ProcedureParts.without("laws")
)
peak = int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
print(peak * 1024, *[claim.effect for claim in found.claims])
"""
"""a diagnosis without laws as a process of its own: the most bytes that it had at any time, and claims"""

MOST_BYTES_MORE = {"in the memory": 330_000_000, "run by run": 128 << 20}
"""from 100,000 to 400,000 rows, three channels. Source: 214 to 275 MB in five runs, and run by run 14 to 67 MB in a
dozen, as the peaks of threads fall together and the allocator keeps what was freed; where all columns of the design
were kept in the memory it was 1,280 bytes a row, 384 MB. What still grows there are blocks, up to a thousand."""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc/self/status (Linux)")
@pytest.mark.parametrize("way", [pytest.param("in the memory", marks=FURTHER), "run by run"])
def test_rows_of_a_long_recording_take_little_memory_each(way: str, tmp_path: Path) -> None:
    few, many = 100_000, 400_000
    model = tmp_path / "model.toml"
    model.write_text(MODEL)

    def taken(rows: int) -> int:
        given = [str(written(rows, tmp_path)), str(model), way]
        done = subprocess.run([sys.executable, "-c", DIAGNOSED, *given], capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, done.stderr
        size, *claims = done.stdout.split()
        assert claims == ["lever_arm"]
        return int(size)

    assert taken(many) - taken(few) < MOST_BYTES_MORE[way]
