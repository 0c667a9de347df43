"""The one reader: what it bounds, what it refuses, what it names, and what it lets through."""

from __future__ import annotations

import gzip
import os
import socket
import subprocess
import time
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from pydantic import BaseModel

from highside.bench.journal_file import JournalFile
from highside.calibration.signature import new_key
from highside.codec.can_dbc import compile_dbc
from highside.config.bench import load_bench
from highside.config.mqtt import MqttSettings, TlsSettings
from highside.config.settings import load
from highside.config.web import WebTable
from highside.errors import InputError, Refused
from highside.reading import (
    check_dbc,
    csv_header,
    decode_text,
    files,
    open_binary,
    parse_json,
    parse_json_lines,
    parse_message,
    parse_toml,
    read_bytes,
    text_member,
)
from highside.recording.calibration_store import read_record
from highside.recording.files import set_aside
from highside.recording.keys import read_key, read_trusted_keys, sign_file
from highside.recording.table import Recording, Table, read_recording
from highside.recording.wire import read_segments
from highside.rotation.compensation import Compensation
from highside.service import saved_drift
from highside.service.broker_client import check_secrets
from highside.service.rig.surveys import SurveyLog, trend_of
from highside.service.rig.toolface import ToolfaceLog


@pytest.fixture(autouse=True)
def limits_as_shipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "_allowed", files.MAX_FILE_BYTES)
    monkeypatch.setattr(files, "_configured", False)


def zeros(path: Path, count: int) -> Path:
    """A gzip file of `count` zeros, which packs 1,030 times."""
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    with path.open("wb") as file:
        for _ in range(count // (1 << 20)):
            file.write(packer.compress(bytes(1 << 20)))
        file.write(packer.flush())
    return path


# --- files ---------------------------------------------------------------------------------------------------------


def test_a_file_made_to_fill_the_memory_is_refused_before_it_does(tmp_path: Path) -> None:
    bomb = zeros(tmp_path / "bomb.csv.gz", 3 << 30 >> 3)
    assert bomb.stat().st_size < 500_000
    tracemalloc.start()
    begin = time.process_time()
    with pytest.raises(InputError, match=r"bomb.csv.gz: expands to more than 200 times its size.*--max-bytes"):
        read_bytes(bomb)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 << 20
    assert time.process_time() - begin < 10.0


def test_what_packs_well_is_read(tmp_path: Path) -> None:
    lines = "".join(f"{i * 0.01:.2f},0.123456,0.0,1.0\n" for i in range(1_000_000))
    path = tmp_path / "still.csv.gz"
    path.write_bytes(gzip.compress(lines.encode(), 9))
    assert read_bytes(path) == lines.encode()


def test_the_total_is_bounded_and_the_user_may_raise_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, packed = tmp_path / "plain", zeros(tmp_path / "packed", 24 << 20)
    plain.write_bytes(bytes(4097))
    monkeypatch.setattr(files, "_allowed", 4096)
    with pytest.raises(InputError, match="plain: has more than 4 KiB; if it is meant so: highside --max-bytes"):
        read_bytes(plain)
    with pytest.raises(InputError, match="packed: expands to more than 4 KiB"):
        read_bytes(packed)
    files.allow_bytes(files.size("25M"))
    assert len(read_bytes(packed)) == 24 << 20


def test_a_file_is_in_the_memory_once_and_one_that_is_too_long_not_at_all(tmp_path: Path) -> None:
    long, whole = tmp_path / "long", tmp_path / "whole"
    with long.open("wb") as file:
        file.truncate(10 << 30)  # of nothing: it takes no room on the disk
    whole.write_bytes(bytes(range(256)) * (32 << 12))
    packed = tmp_path / "packed.gz"
    packed.write_bytes(gzip.compress(os.urandom(32 << 20), 1))

    def peak(read: Callable[[], object]) -> int:
        tracemalloc.start()
        try:
            read()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    def refused() -> None:
        with pytest.raises(InputError, match="long: has more than 2 GiB; if it is meant so: highside --max-bytes"):
            read_bytes(long)

    assert peak(refused) < 1 << 20
    for path in (whole, packed):
        assert 32 << 20 <= peak(lambda path=path: read_bytes(path)) < 44 << 20  # type: ignore[misc]


@pytest.mark.parametrize(
    ("text", "count"), [("1", 1), ("8G", 8 << 30), ("20 m", 20 << 20), ("4KiB", 4096), ("3MB", 3 << 20)]
)
def test_sizes(text: str, count: int) -> None:
    assert files.size(text.replace(" ", "")) == count


@pytest.mark.parametrize("text", ["", "G", "-1", "1.5G", "x", "9" * 30, "٣"])
def test_no_sizes(text: str) -> None:
    with pytest.raises(InputError, match="is no size"):
        files.size(text)


def test_a_source_without_an_end_ends_at_the_limit() -> None:
    child = subprocess.Popen(["cat", "/dev/zero"], stdout=subprocess.PIPE)
    assert child.stdout is not None
    try:
        with pytest.raises(InputError, match="has more than 1 MiB"):
            read_bytes(Path(f"/dev/fd/{child.stdout.fileno()}"), max_bytes=1 << 20)
    finally:
        child.stdout.close()
        child.kill()
        child.wait()


def test_a_pipe_of_the_shell_is_read_whole() -> None:
    """As in `highside decode <(zcat session.gz)`: slowly written, too."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        packed = gzip.compress(b"t_s\n1\n")
        os.write(write, packed[:9])
        time.sleep(0.3)
        os.write(write, packed[9:])
        os._exit(0)
    os.close(write)
    assert read_bytes(Path(f"/dev/fd/{read}")) == b"t_s\n1\n"
    os.waitpid(child, 0)
    os.close(read)


def special(folder: Path, kind: str) -> Path:
    """What is no file, where a file is expected."""
    place = folder / kind
    if kind == "pipe":
        os.mkfifo(place)
    elif kind == "link to a pipe":
        os.mkfifo(folder / "behind")
        place.symlink_to(folder / "behind")
    elif kind == "folder":
        place.mkdir()
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(place))
    else:
        return Path("/dev/zero")
    return place


SAYS = {
    "pipe": "is a named pipe, not a file",
    "link to a pipe": "is a named pipe, not a file",
    "folder": "is a directory, not a file",
    "socket": "is a socket, not a file",
    "device": "is a device, not a file",
}
FILE_READERS: dict[str, Callable[[Path], object]] = {
    "bytes": read_bytes,
    "stream": open_binary,
    "as it is": files.open_file,
    "named": lambda path: files.read_named(path, "field"),
    "configuration": load,
    "bench configuration": load_bench,
    "key": read_key,
    "trusted keys": read_trusted_keys,
    "record": read_record,
    "recording": read_recording,
    "segments": lambda path: list(read_segments(path)),
    "password": lambda path: MqttSettings(username="tool", password_file=path).read_password(),
    "authorities": lambda path: check_secrets(MqttSettings(tls=TlsSettings(ca=path))),
    "journal": JournalFile.reopen,
    "signed file": lambda path: sign_file(path, new_key("a"), now_s=0.0),
    "token": lambda path: WebTable(token_file=path).read_token(),
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("kind", SAYS)
@pytest.mark.parametrize("reader", FILE_READERS)
def test_what_is_no_file_is_refused_in_one_line_without_waiting(tmp_path: Path, kind: str, reader: str) -> None:
    place = special(tmp_path, kind)
    if reader == "token" and kind != "device":
        place.chmod(0o600)
    begin = time.monotonic()
    with pytest.raises(InputError) as caught:
        FILE_READERS[reader](place)
    assert time.monotonic() - begin < 5.0
    said = str(caught.value)
    assert str(place) in said
    assert "\n" not in said
    if reader not in ("signed file", "token", "journal"):  # these look at the place in their own way first
        assert SAYS[kind] in said, said


@pytest.mark.parametrize("name", ["absent", "folder", "a\0b", "x" * 300, "a\ud800b"])
def test_what_cannot_be_opened_is_named(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError) as caught:
        open_binary(tmp_path / name)
    assert str(caught.value).isprintable()


def test_a_damaged_gzip_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "x.gz"
    path.write_bytes(gzip.compress(os.urandom(5000))[:3000])
    with pytest.raises(InputError, match=r"x\.gz: is a damaged gzip file"):
        read_bytes(path)


def test_damaged_files_are_set_aside_under_names_of_their_own(tmp_path: Path) -> None:
    names = set()
    for _ in range(3):
        (tmp_path / "drift.json").write_text("{")
        aside = set_aside(tmp_path / "drift.json")
        assert aside is not None
        assert aside.name.startswith("drift.json.damaged-2")
        names.add(aside.name)
    assert len(names) == 3
    assert set_aside(tmp_path / "drift.json") is None


# --- texts ---------------------------------------------------------------------------------------------------------


def test_encodings() -> None:
    assert decode_text(b"\xef\xbb\xbft_s") == "t_s"
    for data, says in (
        ("t_s".encode("utf-16"), "is UTF-16 text; save it as UTF-8"),
        (b"a\nb\xff", "line 2: is not text; a CSV file in UTF-8 is expected"),
        (b"a\nb\0\n", "line 2: holds a NUL character"),
        (b"\xed\xa0\x80", "line 1: is not text"),
    ):
        with pytest.raises(InputError, match=says):
            decode_text(data, expected="CSV file")


DEEP = "[" * 100_000
DIGITS = "9" * 5000


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"a": NaN}', "NaN is not a number"),
        ("[-Infinity]", "-Infinity is not a number"),
        ("1e999", "the number 1e999 is too large"),
        (DIGITS, "of 5000 characters is too large"),
        (f"[{'9' * 30}]", "is too large"),
        (f"[-{DIGITS}]", "is too large"),
        (DEEP, "brackets nested deeper than 64"),
        ('{"a":' * 50_000, "brackets nested deeper than 64"),
        ("[" * 65 + "]" * 65, "brackets nested deeper than 64"),
        (r'{"id": "\ud800"}', "half of a surrogate pair"),
        (r'{"\udfff": 1}', "half of a surrogate pair"),
        ('{"a": 1, "a": 2}', "the key 'a' is given twice"),
        ('{"a": 1\n "b"', "line 2 column 2"),
        ("", "line 1 column 1"),
    ],
)
def test_json_that_no_reader_can_use_is_refused_by_name(text: str, says: str) -> None:
    for data in (text, text.encode()):
        with pytest.raises(InputError) as caught:
            parse_json(data, where="x.json", remedy="mend it")
        assert str(caught.value).startswith("x.json: is not valid JSON (")
        assert says in str(caught.value)
        assert str(caught.value).endswith("; mend it")
        assert len(str(caught.value)) < 200


def test_json_that_is_sound_is_what_json_says() -> None:
    text = '{"a": [1, -2.5e-3, true, null, "x\\ud83d\\ude00\\u00e9"], "b": {"c": 18446744073709551615}, "d": -0.0}'
    assert parse_json(text) == {"a": [1, -2.5e-3, True, None, "x😀é"], "b": {"c": 2**64 - 1}, "d": 0.0}
    assert parse_json(b"\xef\xbb\xbf" + text.encode()) == parse_json(text)
    assert parse_json("[" * 64 + "]" * 64) is not None


def test_text_that_a_lenient_decoder_made_is_refused() -> None:
    with pytest.raises(InputError, match="surrogates not allowed"):
        parse_json(b'"\xff"'.decode("utf-8", "surrogateescape"))


def test_a_document_is_bounded() -> None:
    with pytest.raises(InputError, match="longer than 1 KiB"):
        parse_json(b" " * 1025, max_bytes=1024)


def test_lines_are_named() -> None:
    lines = parse_json_lines(b'{"a":1}\n\n[2]\n{', where="log.jsonl")
    assert next(lines) == (1, {"a": 1})
    assert next(lines) == (3, [2])
    with pytest.raises(InputError, match=r"log\.jsonl: line 4: is not valid JSON"):
        next(lines)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"a = {DIGITS}", "thousands of digits"),
        (f"a = {'9' * 30}", "a: the number is too large"),
        ("[x]\na = [1, {b = nan}]", "x.a.b: nan is not a finite number"),
        ("a = -inf", "a: -inf is not a finite number"),
        ("a = 1e999", "a: inf is not a finite number"),
        (f"a = {DEEP}", "nested too deep"),
        ("a." * 20_000 + "a = 1", "line 1: is not valid TOML: a key of more than 64 parts"),
        ("[" + "a . " * 20_000 + "a]", "a key of more than 64 parts"),
        ('x = 1\n"a"."b,c".' + "'d'." * 20_000 + "a = 1", "line 2: is not valid TOML: a key of more than 64 parts"),
        ('a = "x\\u0000y"', "a: holds a NUL character"),
        ("a = 1\na = 2", "Cannot overwrite a value"),
        (f"a = {'[' * 65}{']' * 65}", "nested too deep"),
    ],
)
def test_toml_that_no_field_can_hold_is_refused_by_name(text: str, says: str) -> None:
    begin = time.process_time()
    with pytest.raises(InputError) as caught:
        parse_toml(text.encode(), where="x.toml")
    assert str(caught.value).startswith("x.toml")
    assert says in str(caught.value)
    assert time.process_time() - begin < 2.0


def test_toml_that_is_sound_is_read() -> None:
    numbers = ", ".join(["0.5"] * 200)
    text = f'# {"." * 200}\na = [{numbers}] # {"x." * 100}\nb = "{"x." * 100}"\nc.d.e = 1979-05-27\n[f.g]\nh = -5\n'
    tables = parse_toml(text.encode())
    assert len(tables["a"]) == 200
    assert tables["f"] == {"g": {"h": -5}}


class Message(BaseModel):
    id: str
    value: float


def test_a_message_says_which_field_and_the_id_of_a_wrong_one_is_reported() -> None:
    assert parse_message(Message, b'{"id": "1", "value": 2}') == Message(id="1", value=2.0)
    with pytest.raises(InputError, match="value: Field required"):
        parse_message(Message, b'{"id": "1"}')
    for data, message in (
        (b'{"id": "7", "value": "x"}', "7"),
        (b'{"id": 7}', "7"),
        (b'{"value": NaN, "id": "ab-1"}', "ab-1"),
        (b'{"id": "ab-1", "value": 5', "ab-1"),
        (b'{"id": "\\ud800"}', ""),
        (b'{"id": ["x"]}', ""),
        (b"\xff", ""),
    ):
        assert text_member(data, "id") == message


# --- tables --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ("t_s,ax\rb,c", "line 1: a carriage return stands inside the line; end lines with line feeds"),
        ("t_s," + "a" * 200_000, "line 1: the header is not readable as CSV: field larger than field limit"),
        (",".join(f"c{i}" for i in range(100_000)), "line 1: the header names more than 4096 columns"),
        ("a" * 3_000_000, "names more than 4096 columns, or has no end"),
    ],
)
def test_a_header_that_is_none_is_refused_by_name(header: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        csv_header(header, where="x.csv")


def test_a_time_that_is_a_text_is_called_a_text(tmp_path: Path) -> None:
    path = tmp_path / "iso.csv"
    path.write_text("t_s,ax_g\n0,0.1\n2026-11-22T10:00:00Z,0.2\n")
    says = r"iso\.csv: line 3: t_s: is a text \('2026-11-22T10:00:00Z'\), seconds are expected"
    with pytest.raises(InputError, match=says):
        Table.read(path).require("t_s")
    path.write_text("t_s,ax_g\n2026-11-22T10:00:00Z,0.2\n")
    with pytest.raises(InputError, match=says.replace("3", "2", 1)):
        read_recording(path)


def test_utf16_of_a_spreadsheet_is_called_so(tmp_path: Path) -> None:
    path = tmp_path / "excel.csv"
    path.write_bytes("t_s,ax_g\n0,1\n".encode("utf-16"))
    with pytest.raises(InputError, match=r"excel\.csv: is UTF-16 text; save it as UTF-8"):
        Recording.read(path)


# --- DBC files -----------------------------------------------------------------------------------------------------

HEAD = 'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n'


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (' SG_ x : 62|4294967295@1+ (1,0) [0|0] "" A', "line 4: a signal of 4294967295 bits, its message has at"),
        (' SG_ x : 62 |\n 4294967295 @1+ (1,0) [0|0] "" A', "line 4: a signal of 4294967295 bits"),
        (' SG_ x : 62|// | 1@\n4294967295@1+ (1,0) [0|0] "" A', "line 4: a signal of 4294967295 bits"),
        (' SG_ x : 0|65@1+ (1,0) [0|0] "" A', "a signal of 65 bits"),
        (' SG_ x : -5|16@1+ (1,0) [0|0] "" A', "a signal that begins at bit -5"),
        (' SG_ x : 0|-5@1+ (1,0) [0|0] "" A', "a signal of -5 bits"),
        (' SG_ x : 4294967295|8@1+ (1,0) [0|0] "" A', "begins at bit 4294967295"),
        (' SG_ x : 0|8@1+ (1e309,0) [0|0] "" A', "the number 1e309 is too large"),
        (f' SG_ x : 0|8@1+ ({"9" * 310},0) [0|0] "" A', "the number 9999999999999999999999999999999999999999..."),
        (f' SG_ x : 0|8@1+ ({"9" * 5000},0) [0|0] "" A', "is too large"),
        ("BO_ 2 N: 4294967295 A", "line 4: a message of 4294967295 bytes"),
        ("BO_ 2 N: 64 A\n SG_ x : 0|513@1+ (1,0) [0|0] \"\" A", "a signal of 513 bits, its message has at most 512"),
        ('BA_ "GenMsgCycleTime" BO_ 1 1e99999999;', "the number 1e99999999 is too large"),
        ("SG_MUL_VAL_ 1 x m 0-4294967295;", "the range 0-4294967295 has too many values"),
        ("SG_MUL_VAL_ 1 x m 0-0, -513591-3;", "SG_MUL_VAL_ without message, signal, multiplexer and ranges"),
        ("SG_MUL_VAL_ 1 x m 0 4294967295;", "SG_MUL_VAL_ without message, signal, multiplexer and ranges"),
        ("SG_MUL_VAL_ 1 x m +0-4294967295;", "SG_MUL_VAL_ without message, signal, multiplexer and ranges"),
    ],
)  # fmt: skip
def test_a_size_that_no_bus_has_is_refused_before_anything_is_built_of_it(line: str, says: str) -> None:
    compile_dbc(HEAD)  # imports the library
    tracemalloc.start()
    begin = time.process_time()
    with pytest.raises(InputError) as caught:
        compile_dbc(HEAD + line + "\n", where="car.dbc")
    assert str(caught.value).startswith("car.dbc: line ")
    assert says in str(caught.value)
    assert tracemalloc.get_traced_memory()[1] < 32 << 20
    tracemalloc.stop()
    assert time.process_time() - begin < 2.0


def test_what_real_dbc_files_say_is_let_through() -> None:
    text = HEAD + (
        ' SG_ x : 0|64@1- (1e-3,-1.7976931348623157E+308) [-3.4E+038|3.4E+038] "9|99999@ 1e999" A\n'
        f'BO_ 2147484000 FD: 64 A\n SG_ y : 0|512@1+ (1,0) [0|0] "" A\nBO_ 3 J: 1785 A\n SG_ z : 0|1600@1+ (1,0) [0|'
        f'{2**63}] "" A\nCM_ "commit 3e4567 of 0-4294967295; SG_ q : 1|99999@";\n'
    )
    check_dbc(text, where="car.dbc")
    messages = compile_dbc(text)
    assert set(messages["M"].signals) == {"x"}
    assert set(messages["FD"].signals) == {"y"}
    # a text of 200 bytes is no number
    assert not messages["J"].signals


# --- what the service keeps ----------------------------------------------------------------------------------------

HOSTILE = {
    "NaN": b'{"schema":"highside.rotation/1","id":"x","unit":"arcmin","a":NaN}',
    "nested": DEEP.encode(),
    "nested objects": b'{"a":' * 50_000,
    "NUL": bytes(300),
    "torn": b'{"schema":"highside.rotation/1","id":"x","un',
    "digits": b'{"schema":"highside.rotation/1","id":"x","a":' + b"9" * 5000 + b"}",
    "surrogate": b'{"schema":"highside.rotation/1","id":"\\ud800"}',
    "text": b"azimuth 12",
    "other JSON": b"[1, 2]",
}


@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_file_of_the_service_is_an_error_with_a_name(tmp_path: Path, content: bytes) -> None:
    """Whatever is in them; nothing but the program's own errors leaves the loaders."""
    with pytest.raises((InputError, Refused), match=r"rotor\.json"):
        Compensation.from_json(content, where="rotor.json")
    (tmp_path / "drift.json").write_bytes(content)
    with pytest.raises(Refused, match=r"drift\.json: is no saved drift state"):
        saved_drift.read(tmp_path / "drift.json", "t1", saved_drift.Stamp.now(synced=False))
    (tmp_path / "toolface.jsonl").write_bytes(content + b"\n")
    with pytest.raises(InputError, match=r"toolface\.jsonl: line 1: is no toolface setting"):
        ToolfaceLog(tmp_path).current()
    log = SurveyLog(tmp_path / "surveys.jsonl")
    log.path.write_bytes(content + b'\n{"cal_id":"c","reasons":[{}]}\n{"cal_id":"c","reasons":[],"t":"x"}\n')
    trend_of(log.recent(), "c").as_dict()
    assert log.damaged_lines >= 2
    (tmp_path / "wire.hsw").write_bytes(b"HSWIRE1\n" + content + b"\n")
    with pytest.raises(InputError, match=r"wire\.hsw"):
        list(read_segments(tmp_path / "wire.hsw"))


def test_a_directory_in_place_of_a_file_is_named(tmp_path: Path) -> None:
    for name in ("drift.json", "toolface.jsonl", "surveys.jsonl"):
        (tmp_path / name).mkdir()
    with pytest.raises((InputError, Refused), match="is a directory"):
        saved_drift.read(tmp_path / "drift.json", "t1", saved_drift.Stamp.now(synced=False))
    with pytest.raises(InputError, match="is a directory"):
        ToolfaceLog(tmp_path).current()
    assert SurveyLog(tmp_path / "surveys.jsonl").recent() == []
