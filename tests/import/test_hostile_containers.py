"""What a damaged container says of itself binds nobody: sizes, names of fields, descriptions that change on the way."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
from foreign_containers import ardupilot_bin, ardupilot_text, ros1_bag
from foreign_session import session

import highside
from highside.errors import InputError

MEBI = 1 << 20
HUGE = struct.pack("<I", 0xFFFFFFF0)
"""the length of something, in a file of 30 kB: 4 GiB"""


def memory_at_most(path: Path, message: str) -> int:
    """Bytes that it takes to refuse a file so."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=message):
            highside.import_recording(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("what", ["header of the bag", "header of a connection", "size of a chunk"])
def test_a_bag_that_claims_gibibytes_takes_no_more_memory_than_it_has(tmp_path: Path, what: str) -> None:
    data = bytearray(ros1_bag(session()))
    index = struct.unpack_from("<Q", data, data.index(b"index_pos=") + len(b"index_pos="))[0]
    chunk = data.index(b"op=\x05") - 8
    length = struct.unpack_from("<I", data, chunk)[0]
    place = {"header of the bag": 13, "header of a connection": index, "size of a chunk": chunk + 4 + length}[what]
    data[place : place + 4] = HUGE
    (tmp_path / "x.bag").write_bytes(data)
    assert memory_at_most(tmp_path / "x.bag", r"is a damaged ROS bag file") < 64 * MEBI


def test_a_field_without_a_name_makes_no_table_of_a_dataflash_log(tmp_path: Path) -> None:
    whole = ardupilot_bin(session())
    (tmp_path / "whole.bin").write_bytes(whole)
    assert highside.import_recording(tmp_path / "whole.bin").n == session().n
    for without in (b"TimeUS,I,,GyrY,GyrZ,AccX,AccY,AccZ,T", b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccX,AccZ,T"):
        label = b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T"
        assert label in whole
        (tmp_path / "x.bin").write_bytes(whole.replace(label, without.ljust(len(label), b"\0")))
        with pytest.raises(InputError, match="holds no message of a known type"):
            highside.import_recording(tmp_path / "x.bin")


def test_fields_named_like_those_of_the_reader_are_read(tmp_path: Path) -> None:
    """A label may be any text: `0` and `head` too."""
    s = session()
    label = b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T"
    named = ardupilot_bin(s).replace(label, b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,0")
    (tmp_path / "x.bin").write_bytes(named)
    np.testing.assert_allclose(highside.import_recording(tmp_path / "x.bin").accel(), s.accel_g, rtol=0, atol=1e-6)


def test_a_text_log_whose_fields_are_described_twice_or_not_named_is_read_or_refused(tmp_path: Path) -> None:
    s = session()
    lines = ardupilot_text(s).decode().split("\n")
    again = "FMT, 130, 40, IMU, Qf, TimeUS,GyrX"
    (tmp_path / "again.log").write_text("\n".join([*lines[:40], again, *lines[40:]]))
    assert highside.import_recording(tmp_path / "again.log").n == s.n
    (tmp_path / "twice.log").write_text("\n".join([lines[0], lines[1].replace("GyrY", "GyrX"), *lines[2:]]))
    with pytest.raises(InputError, match=r"line 2: is a damaged ArduPilot file \(IMU has a field without a name"):
        highside.import_recording(tmp_path / "twice.log")


HISTOGRAM = """
import sys
from pathlib import Path
import highside
from highside.errors import InputError
from highside.reading.row_groups import RowGroups

for read in (highside.import_recording, RowGroups.of):
    try:
        print("read", read(Path(sys.argv[1])))
    except InputError as error:
        print(error)
"""


def test_parquet_metadata_that_contradict_the_schema_do_not_end_the_process(tmp_path: Path) -> None:
    """Asked for the metadata of such a column, pyarrow 26 calls `std::terminate`."""
    s = session()
    out = io.BytesIO()
    columns = {"t": s.t_s, **{f"a{axis}_g": values for axis, values in zip("xyz", s.accel_g, strict=True)}}
    parquet.write_table(pa.table({name: pa.array(values) for name, values in columns.items()}), out)
    sound = out.getvalue()
    optional, required = b"\x15\x0a\x25\x02\x18\x01t", b"\x15\x0a\x25\x00\x18\x01t"
    assert sound.count(optional) == 1
    path = tmp_path / "x.parquet"
    path.write_bytes(sound.replace(optional, required))
    # in a process of its own, which is what it ended
    done = subprocess.run([sys.executable, "-c", HISTOGRAM, str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{path}: is a damaged Parquet file (Definition level histogram size mismatch")
