"""Containers made to fill the memory, to hang or to end the process: refused in one line before they do."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.parquet as parquet
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as RosWriter
from rosbags.typesys import Stores, get_typestore
from scipy.io import loadmat, savemat

from highside.errors import InputError
from highside.importing.core.wishes import Wishes
from highside.importing.files import open_foreign, refuse_open
from highside.reading.arrays import npy_array
from highside.reading.columnar import arrow_columns, mcap_messages, parquet_columns
from highside.reading.hdf5_heaps import refuse_endless_heaps
from highside.reading.mat5 import mat5_arrays
from highside.reading.parquet_size import group_bytes, row_groups
from highside.reading.row_groups import GROUP_BYTES, RowGroups

MATLAB = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x100) + b"IM"


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def array(kind: int, shape: tuple[int, ...], rest: bytes, name: bytes = b"a") -> bytes:
    head = element(6, struct.pack("<II", kind, 0)) + element(5, struct.pack(f"<{len(shape)}i", *shape))
    return element(14, head + element(1, name) + rest)


def nested(depth: int) -> bytes:
    """A cell in a cell, `depth` times."""
    parts = [array(6, (1, 1), element(9, bytes(8)))]
    size = len(parts[0])
    for _ in range(depth):
        head = element(6, struct.pack("<II", 1, 0)) + element(5, struct.pack("<ii", 1, 1)) + element(1, b"a")
        parts.append(struct.pack("<II", 14, size + len(head)) + head)
        size += len(parts[-1])
    return b"".join(reversed(parts))


def packed(content: bytes) -> bytes:
    small = zlib.compress(content)
    return struct.pack("<II", 15, len(small)) + small


def npy(described: object, shape: tuple[int, ...], content: bytes) -> bytes:
    head = repr({"descr": described, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + content


def mcap(
    messages: list[bytes],
    packing: CompressionType = CompressionType.ZSTD,
    schema: tuple[str, str, bytes] = ("s", "jsonschema", b"{}"),
    encoding: str = "json",
) -> bytes:
    out = io.BytesIO()
    writer = Writer(out, compression=packing)
    writer.start(profile="", library="own")
    number = writer.register_schema(*schema)
    channel = writer.register_channel(schema_id=number, topic="/imu", message_encoding=encoding)
    for k, message in enumerate(messages):
        writer.add_message(channel, log_time=k, publish_time=k, data=message)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def as_parquet(table: pa.Table) -> bytes:
    out = io.BytesIO()
    parquet.write_table(table, out)
    return out.getvalue()


def as_arrow(table: pa.Table, packing: str) -> bytes:
    out = io.BytesIO()
    feather.write_feather(table, out, compression=packing)
    return out.getvalue()


def long_text(rows: int) -> pa.Table:
    """A text of a million letters, which stands once in the file and in each row."""
    index = pa.array(np.zeros(rows, dtype=np.int32))
    return pa.table({"t_s": np.arange(rows) / 10.0, "note": pa.DictionaryArray.from_arrays(index, ["x" * 1_000_000])})


@pytest.mark.parametrize("packing", [False, True])
def test_matlab_arrays_are_those_that_the_reference_library_reads(packing: bool) -> None:
    rng = np.random.default_rng(1)
    inner = {"y": np.float32([1, 2]), "n": "text", "deeper": {"z": rng.normal(size=(3, 2))}}
    values = {
        "a": rng.normal(size=(50, 3)), "whole": np.arange(300).reshape(100, 3), "f3": rng.normal(size=(2, 3, 4)),
        "u8": np.array([2**63], dtype=np.uint64), "b": np.array([True, False]), "number": 5.0, "text": "hello",
        "complex": np.array([1 + 2j]), "cells": np.array([1, "a"], dtype=object), "s": {"x": rng.normal(size=7),
        "in": inner},
    }  # fmt: skip
    out = io.BytesIO()
    savemat(out, values, do_compression=packing, oned_as="column")
    got, reference = mat5_arrays(out.getvalue(), where="x.mat"), loadmat(io.BytesIO(out.getvalue()))
    assert set(got) == {"a", "whole", "f3", "u8", "b", "number", "s.x", "s.in.y", "s.in.deeper.z"}
    for name in set(got) & set(reference):
        np.testing.assert_array_equal(got[name], reference[name])
        assert got[name].dtype == reference[name].dtype
    within = reference["s"]["in"][0, 0]
    np.testing.assert_array_equal(got["s.in.y"], within["y"][0, 0])
    np.testing.assert_array_equal(got["s.in.deeper.z"], within["deeper"][0, 0]["z"][0, 0])


MATLAB_FILES = {
    "200,000 cells, one in the other": nested(200_000),
    "the same, packed": packed(nested(200_000)),
    "300 million cells": array(1, (300_000_000, 1), b""),
    "300 million structures": array(2, (300_000_000, 1), element(5, struct.pack("<i", 8)) + element(1, b"")),
    "more values than it has": array(6, (2**31 - 1, 2**31 - 1), element(9, bytes(16))),
    "negative sizes": array(6, (-5, -5), element(9, bytes(200))),
    "longer than the file": struct.pack("<II", 14, 0xFFFFFFF0) + bytes(100),
    "150 MB of zeros": packed(array(6, (150_000_000 // 8, 1), element(9, bytes(150_000_000)))),
    "a structure without names": array(2, (1, 1), element(5, struct.pack("<i", 0)) + element(1, b"")),
    "an opaque object": array(17, (1, 1), element(1, b"MCOS") + element(1, b"table")),
}
ALONE = """
import resource, sys
from pathlib import Path
from highside.errors import InputError
from highside.importing.core.wishes import Wishes
from highside.importing.files import open_foreign, refuse_open
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    open_foreign(Path(sys.argv[1]), Wishes())
except InputError as error:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before, error)
"""


def refused_alone(path: Path) -> tuple[int, str]:
    """KiB and the line of a process of its own: what ends a process must not end the tests."""
    process = subprocess.run([sys.executable, "-c", ALONE, str(path)], capture_output=True, text=True, timeout=100)
    assert process.returncode == 0, (process.returncode, process.stderr[-500:])
    memory, said = process.stdout.split(" ", 1)
    return int(memory), said.rstrip("\n")


@pytest.mark.parametrize("name", MATLAB_FILES)
def test_a_matlab_file_neither_ends_the_process_nor_fills_the_memory(name: str, tmp_path: Path) -> None:
    path = tmp_path / "hostile.mat"
    path.write_bytes(MATLAB + MATLAB_FILES[name])
    memory, said = refused_alone(path)
    assert "hostile.mat" in said
    assert said.isprintable()
    # its library, its arrays' and what came out until it was refused
    assert memory < 250_000


def test_an_arrow_file_is_weighed_before_it_is_unpacked(tmp_path: Path) -> None:
    """2 GB of zeros in a file of 1 MB; and what is packed as recordings are is read."""
    path = tmp_path / "hostile.arrow"
    feather.write_feather(pa.table({"t_s": np.zeros(250_000_000)}), path, compression="zstd")
    assert path.stat().st_size < 2_000_000
    memory, said = refused_alone(path)
    assert "expands to more than" in said
    assert memory < 150_000
    rng = np.random.default_rng(1)
    table = pa.table(
        {"t_s": np.arange(1e5) / 100, "n": [f"{k % 7}" for k in range(100_000)], "ax": rng.normal(size=100_000)}
    )
    for packing in ("zstd", "lz4", "uncompressed"):
        found = {column.name: column for column in arrow_columns(as_arrow(table, packing), where="x")}
        np.testing.assert_array_equal(found["ax"].numbers, table["ax"].to_numpy())
        assert found["n"].texts == tuple(table["n"].to_pylist())


@pytest.mark.parametrize(
    ("read", "write"),
    [(parquet_columns, as_parquet), (arrow_columns, lambda table: as_arrow(table, "uncompressed"))],
    ids=["Parquet", "Arrow"],
)
def test_a_text_that_stands_once_in_the_file_stands_once_in_the_memory(
    read: Callable[..., list[object]], write: Callable[[pa.Table], bytes]
) -> None:
    data = write(long_text(20_000))
    assert len(data) < 3_000_000
    with pytest.raises(InputError, match="expands to more than"):
        read(data, where="x")
    # a category that each row names is no such thing
    names = pa.DictionaryArray.from_arrays(pa.array([0, 1, None] * 10_000, pa.int32()), ["left", "right"])
    rng = np.random.default_rng(1)
    data = write(pa.table({"t_s": rng.normal(size=30_000), "side": names, "plain": ["a", "b", None] * 10_000}))
    found = {column.name: column for column in read(data, where="x")}  # type: ignore[attr-defined]
    assert found["side"].texts == ("left", "right", "") * 10_000  # type: ignore[attr-defined]
    assert found["plain"].texts == ("a", "b", "") * 10_000  # type: ignore[attr-defined]


def test_values_that_an_arrow_file_only_claims_to_have_are_refused() -> None:
    def written(column: pa.Array) -> bytes:
        out = io.BytesIO()
        with pa.ipc.new_file(out, pa.schema([("n", column.type)])) as writer:
            writer.write_batch(pa.RecordBatch.from_arrays([column], ["n"]))
        return out.getvalue()

    sound = written(pa.array(["ab", "cd"]))
    assert arrow_columns(sound, where="x")[0].texts == ("ab", "cd")
    offsets = struct.pack("<iii", 0, 2, 4)
    assert sound.count(offsets) == 1
    beyond = sound.replace(offsets, struct.pack("<iii", 0, 2, 1 << 30))
    no_text = sound.replace(b"abcd", b"\xff\xfe\xff\xfe")
    late = written(pa.array([2**62] * 2, pa.timestamp("s")))
    for data in (beyond, no_text, late):
        with pytest.raises(InputError, match="x: is a damaged Arrow file"):
            arrow_columns(data, where="x")


def test_a_column_that_asks_for_more_memory_than_there_is_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def asks(_file: parquet.ParquetFile) -> pa.Table:
        raise pa.ArrowMemoryError("malloc of size 8589934592 failed")

    out = io.BytesIO()
    parquet.write_table(pa.table({"t_s": [0.0, 1.0]}), out)
    monkeypatch.setattr(parquet.ParquetFile, "read", asks)
    with pytest.raises(InputError, match="x: needs more memory than there is, or is a damaged Parquet file"):
        parquet_columns(out.getvalue(), where="x")


@pytest.mark.parametrize("packing", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def test_an_mcap_file_is_weighed_before_it_is_unpacked(packing: CompressionType) -> None:
    sound = mcap([b'{"t_s": %d}' % k for k in range(100)], packing)
    assert len(list(mcap_messages(sound, where="x"))) == 100
    if packing is CompressionType.NONE:
        return
    data = mcap([b'{"x": "' + b"a" * 1_000_000 + b'"}'] * 100, packing)
    with pytest.raises(InputError, match="expands to more than"):
        list(mcap_messages(data, where="x"))
    # a chunk's header need not tell what is in it
    first = data.index(b"\x06", 8) + 1 + 8 + 16
    said = data[first : first + 8]
    lying = data.replace(said, (1000).to_bytes(8, "little"))
    with pytest.raises(InputError, match="is a damaged MCAP file"):
        list(mcap_messages(lying, where="x"))


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (b'{"t_s": %d}' % 10**400, "is too large"),
        (
            b'{"t_s": {"sec": %d, "nsec": 5}, "n": "x"}' % 10**20,
            "is too large",
        ),
        ('{"t_s": "²"}'.encode(), "no column is a time|no acceleration|accelerations|lacks an axis"),
        (b'{"t_s": "--5"}', "no column is a time|no acceleration|accelerations|lacks an axis"),
        (b'{"t_s": "9999999999999999999"}', "no column is a time|no acceleration|accelerations|lacks an axis"),
        (b'{"t_s": %d}' % 10**30, "is too large"),
    ],
)
def test_numbers_in_messages_that_have_no_64_bits_are_no_defect(message: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(mcap([message] * 20))
    with pytest.raises(InputError, match=said):
        refuse_open(open_foreign(path, Wishes()), accepted=True)


@pytest.mark.parametrize(
    "data",
    [npy("<f8", (1,) * 100, bytes(8)), npy("<f8", (-2, -3), bytes(56)), npy("<f8", (-1,), bytes(47))],
    ids=["100 dimensions", "negative sizes", "no whole number of values"],
)
def test_an_array_of_a_shape_that_there_is_none_of_is_refused(data: bytes) -> None:
    with pytest.raises(InputError, match=r"x: is no NumPy array"):
        npy_array(data, where="x")


def test_texts_that_are_none_in_unicode_are_marked(tmp_path: Path) -> None:
    path = tmp_path / "x.npy"
    rows = b"".join(
        struct.pack("<ddddd", k / 10, 0.0, 0.0, 1.0, k) + b"\xff\xfea\0" + b"\xff\xff\xff\x7f" for k in range(60)
    )
    numbers = [(name, "<f8") for name in ("t_s", "ax_g", "ay_g", "az_g", "n")]
    path.write_bytes(npy([*numbers, ("bytes", "S4"), ("letters", "<U1")], (60,), rows))
    columns = {column.name: column for column in open_foreign(path, Wishes()).table.columns}
    assert columns["bytes"].texts == ("��a",) * 60
    assert columns["letters"].texts == ("�",) * 60


def test_a_log_of_a_million_sensors_is_refused_and_a_field_named_as_the_head_is_one(tmp_path: Path) -> None:
    def described(name: bytes, letters: bytes, labels: bytes, number: int, length: int) -> bytes:
        return (
            b"\xa3\x95\x80"
            + bytes([number, length])
            + name.ljust(4, b"\0")
            + letters.ljust(16, b"\0")
            + labels.ljust(64, b"\0")
        )

    head = described(b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns", 128, 89)
    path = tmp_path / "x.bin"
    rows = b"".join(b"\xa3\x95\x81" + struct.pack("<QI", k, k) for k in range(100_000))
    path.write_bytes(head + described(b"IMU", b"QI", b"TimeUS,I", 129, 15) + rows)
    with pytest.raises(InputError, match="IMU numbers 100000 sensors"):
        open_foreign(path, Wishes())
    path.write_bytes(head + described(b"IMU", b"QI", b"TimeUS,head", 129, 15) + rows)
    with pytest.raises(InputError, match="named us, which gives"):
        refuse_open(open_foreign(path, Wishes()), accepted=True)


def test_a_message_described_as_two_thousand_million_texts_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    described = ("own/msg/X", "ros2msg", b"string[2000000000] a\n")
    path.write_bytes(mcap([b"\0\1\0\0" + bytes(40)] * 3, schema=described, encoding="cdr"))
    with pytest.raises(InputError, match="is described with arrays of 2000000000"):
        open_foreign(path, Wishes())


def test_a_name_that_no_file_may_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        open_foreign(tmp_path / ("x" * 300), Wishes())


def _hdf5(path: Path, write: Callable[[h5py.File], object]) -> Path:
    with h5py.File(path, "w") as file:
        write(file)
    return path


@pytest.mark.parametrize(
    ("number", "size"), [(0, 0), (0, 1 << 40), (1, (1 << 64) - 8)], ids=["stays", "beyond", "backwards"]
)
def test_an_hdf5_heap_without_an_end_is_refused(number: int, size: int, tmp_path: Path) -> None:
    # the library goes through it for ever, where no alarm of Python reaches it
    path = _hdf5(tmp_path / "x.h5", _with_units)
    data = path.read_bytes()
    refuse_endless_heaps(data, where="x.h5")
    first = data.index(b"GCOL") + 16
    path.write_bytes(data[:first] + struct.pack("<HHIQ", number, 1, 0, size) + data[first + 16 :])
    with pytest.raises(InputError, match=r"x\.h5: is a damaged HDF5 file \(the heap at byte \d+ has no end\)"):
        open_foreign(path, Wishes())


def _with_units(file: h5py.File) -> None:
    file.create_dataset("ax", data=np.arange(64.0)).attrs["units"] = "g"


HDF5_FILES: dict[str, tuple[Callable[[h5py.File], object], str]] = {
    "1 TB that was never written": (
        lambda file: file.create_dataset("t", shape=(10**11,), chunks=(10**6,), dtype="f8"),
        "expands to more than",
    ),
    "240 MB that was never written": (
        lambda file: file.create_dataset("t", shape=(30_000_000,), chunks=(10**6,), dtype="f8"),
        "expands to more than 200 times",
    ),
    "groups within groups": (lambda file: file.create_dataset("g/" * 100 + "t", data=[1.0, 2.0]), "64 deep"),
    "5,000 groups": (lambda file: [file.create_group(f"g{k}") for k in range(5000)], "more than 4096 objects"),
}


@pytest.mark.parametrize("name", HDF5_FILES)
def test_an_hdf5_file_is_weighed_before_it_is_unpacked(name: str, tmp_path: Path) -> None:
    write, said = HDF5_FILES[name]
    with pytest.raises(InputError, match=said):
        open_foreign(_hdf5(tmp_path / "x.h5", write), Wishes())


def workbook(edit: Callable[[str, bytes], bytes]) -> bytes:
    book = openpyxl.Workbook()
    sheet = book.worksheets[0]
    for row in (["t_s", "ax_g", "ay_g", "az_g"], *([k / 10, 0.1, 0.2, 0.97] for k in range(50))):
        sheet.append(row)
    made, out = io.BytesIO(), io.BytesIO()
    book.save(made)
    with zipfile.ZipFile(made) as source, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in source.namelist():
            archive.writestr(name, edit(name, source.read(name)))
    return out.getvalue()


def test_a_workbook_of_ten_thousand_sheets_and_a_number_of_400_digits_are_refused(tmp_path: Path) -> None:
    def sheets(name: str, content: bytes) -> bytes:
        if name != "xl/workbook.xml":
            return content
        begin, end = content.index(b"<sheets>") + len(b"<sheets>"), content.index(b"</sheets>")
        one = content[begin:end]
        many = b"".join(one.replace(b'name="Sheet"', b'name="S%d"' % k) for k in range(10_000))
        return content[:begin] + many + content[end:]

    path = tmp_path / "x.xlsx"
    path.write_bytes(workbook(sheets))
    with pytest.raises(InputError, match="more than 255 sheets"):
        open_foreign(path, Wishes())
    path.write_bytes(workbook(lambda _, content: content.replace(b"<v>0.97</v>", b"<v>1" + b"0" * 400 + b"</v>", 1)))
    with pytest.raises(InputError, match="row 2: az_g: is too large a number"):
        open_foreign(path, Wishes())


def test_a_ulog_of_types_in_types_is_refused(tmp_path: Path) -> None:
    def message(kind: str, content: bytes) -> bytes:
        return struct.pack("<HB", len(content), ord(kind)) + content

    head = b"ULog\x01\x12\x35\x01" + bytes(8)
    types = [b"a%d:uint64_t timestamp;a%d[1000] x;" % (k, k + 1) for k in range(8)]
    last = message("F", b"a8:uint64_t timestamp;float x;") + message("A", b"\0\0\0a0") + message("D", bytes(14))
    path = tmp_path / "x.ulg"
    for described in (types, [b"a0:uint64_t timestamp;a0 x;"], [b"a0:uint64_t timestamp;float[2000000000] x;"]):
        path.write_bytes(head + b"".join(message("F", one) for one in described) + last)
        with pytest.raises(InputError, match=r"fields, or of types|is a damaged ULog file"):
            open_foreign(path, Wishes())


def test_a_bag_is_unpacked_in_pieces_that_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "x.bag"
    bag = RosWriter(path)
    bag.set_compression(RosWriter.CompressionFormat.BZ2)
    with bag:
        store = get_typestore(Stores.ROS1_NOETIC)
        text = bag.add_connection("/text", "std_msgs/msg/String", typestore=store)
        message = store.types["std_msgs/msg/String"](data="a" * 40_000_000)
        bag.write(text, 1, store.serialize_ros1(message, "std_msgs/msg/String"))
    assert path.stat().st_size < 100_000
    with pytest.raises(InputError, match="expands to more than 200 times"):
        open_foreign(path, Wishes())


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("dictionary", [False, True])
def test_pages_of_a_parquet_file_are_counted_by_their_headers(version: str, dictionary: bool) -> None:
    table = pa.table({"t_s": np.arange(50_000) * 0.01, "pose": np.arange(50_000) // 1000})
    out = io.BytesIO()
    parquet.write_table(
        table,
        out,
        use_dictionary=dictionary,
        data_page_version=version,
        data_page_size=10_000,
        row_group_size=20_000,
        compression="zstd",
    )
    data = out.getvalue()
    meta = parquet.read_metadata(io.BytesIO(data))
    groups = row_groups(lambda at, size: data[at : at + size], len(data))
    assert meta.num_row_groups == len(groups) == 3
    for k, group in enumerate(groups):
        said = meta.row_group(k).total_byte_size  # with the headers of the pages
        assert group.stated_bytes == said
        for j, pages in enumerate(group.columns):
            column = meta.row_group(k).column(j)
            begin = column.dictionary_page_offset if column.has_dictionary_page else column.data_page_offset
            assert (pages.begin, pages.size, pages.values) == (begin, column.total_compressed_size, column.num_values)
        counted = group_bytes(group, lambda at, size: data[at : at + size])
        assert 0.8 * said < counted < said
    with pytest.raises(ValueError, match="no end"):
        group_bytes(
            groups[2], lambda at, size: data[: meta.row_group(2).column(0).data_page_offset + 3][at : at + size]
        )


def varint(number: int, size: int = 0) -> bytes:
    """A number of Thrift's compact protocol, in `size` bytes if that is more than it needs."""
    raw, out = number << 1, bytearray()
    while raw >= 0x80 or len(out) + 1 < size:
        out.append(raw & 0x7F | 0x80)
        raw >>= 7
    return bytes(out) + bytes([raw])


def long_page(size: int) -> bytes:
    """A Parquet file of one text, whose metadata say that it has a few bytes; its page says how many."""
    out = io.BytesIO()
    parquet.write_table(
        pa.table({"t": ["x" * size]}), out, use_dictionary=False, compression="zstd", write_statistics=False
    )
    data = out.getvalue()
    body = struct.unpack("<I", data[-8:-4])[0] + 8
    said = varint(parquet.read_metadata(io.BytesIO(data)).row_group(0).total_byte_size)
    footer = data[-body:].replace(said, varint(100, len(said)))
    patched = data[:-body] + footer
    assert parquet.read_metadata(io.BytesIO(patched)).row_group(0).total_byte_size == 100
    return patched


def test_a_page_that_is_longer_than_the_metadata_say_is_not_unpacked(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    data = long_page(GROUP_BYTES + 1)
    path = tmp_path / "long.parquet"
    path.write_bytes(data)

    def opened(*_: object, **__: object) -> None:
        raise AssertionError("it was unpacked")

    monkeypatch.setattr(parquet, "ParquetFile", opened)
    with pytest.raises(InputError, match="expands to more than"):
        parquet_columns(data, where="long.parquet")
    with pytest.raises(InputError, match="has a row group of 268"):
        RowGroups.of(path)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a file that cannot be read at its beginning")
def test_a_disk_that_fails_is_said_of_the_file_that_was_read() -> None:
    with pytest.raises(InputError, match="/proc/self/mem: cannot be read: Input/output error"):
        RowGroups.of(Path("/proc/self/mem"))
