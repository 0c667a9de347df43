"""Every parser of files and messages, given an input as the program gives it: through a file where it reads files.

A parser returns whether it accepted the input; it raises HighsideError for one that it refuses. What it accepts is
used, too, as far as its owner would at once: a calibration corrects, a journal is replayed, a codec decodes.
"""

from __future__ import annotations

import ast
import hashlib
import json
import logging
import math
import os
import random
import shutil
import tempfile
from collections.abc import Callable, Coroutine, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import seeds
from mutate import Document, damaged, damaged_gzip

from highside.api.iscwsa import error_model
from highside.api.survey_list import list_surveys
from highside.api.surveys import analyse_surveys
from highside.bench.mqtt import FAILED, SessionMqtt
from highside.bench.session.commands import Origin
from highside.bench.session.driver import SessionDriver
from highside.bench.session.journal import read_journal
from highside.bench.session.snapshot import Command, Reply, SessionState
from highside.calibration.record import correction_from_record, parse_record
from highside.calibration.signature import parse_trusted_keys
from highside.codec.can_dbc import compile_dbc
from highside.config.bench import load_bench
from highside.config.certificate import load_certificate_fields
from highside.config.codecs import codec_from_file
from highside.config.model import load_model
from highside.config.mqtt import MqttSettings
from highside.config.settings import load, parse_overrides, validate
from highside.fleet.archive import row_of as archive_row_of
from highside.fleet.archive import table_of as archive_table_of
from highside.fleet.catalogue import catalogue_of
from highside.importing import profiles
from highside.importing.core.wishes import Wishes
from highside.importing.files import open_foreign
from highside.importing.joins import Joins, carry_out
from highside.link.replay import events
from highside.reading.row_groups import RowGroups
from highside.recording.calibration_store import CalibrationStore, read_record
from highside.recording.candump import read_candump
from highside.recording.keys import check_file, read_trusted_keys
from highside.recording.table import read_poses, read_recording
from highside.recording.wire import detect_kind, read_segments
from highside.rotation.compensation import Compensation
from highside.rotation.live import LiveCompensation
from highside.service import clock, saved_drift, saved_watch
from highside.service.damage import DamageLog
from highside.service.drift_keeper import DriftKeeper, DriftParts
from highside.service.known_time import KnownTime
from highside.service.rig.surveys import SurveyLog, trend_of
from highside.service.rig.toolface import ToolfaceLog
from highside.service.starts import StartLog
from highside.service.watch_keeper import WatchKeeper, WatchParts
from highside.service.watch_said import message as watch_message
from highside.watch.proposal import propose, read_outcome

Make = Callable[[random.Random], bytes]
TOP = seeds.ROOT / "src" / "highside"


@dataclass(frozen=True)
class Parser:
    """`make` gives a damaged input, `parse` says whether it was accepted."""

    name: str
    make: Make
    parse: Callable[[bytes], bool]
    sound: tuple[bytes, ...]
    """inputs without damage, which must be accepted"""
    modules: tuple[str, ...] = ()
    """files and folders below `src/highside` that hold what reads it, besides `READING` and `EVERYWHERE`"""

    @cached_property
    def code(self) -> str:
        """Which state of the code it is: the first digits of the SHA-256 of its modules."""
        return code_of((*READING, *self.modules))


def code_of(modules: Sequence[str]) -> str:
    """Hash of what the Python files of these modules do, and of what damages the inputs."""
    files = [Path(__file__).with_name("mutate.py"), *files_of(modules)]
    return hashlib.sha256("\0".join(what_it_does(path) for path in files).encode()).hexdigest()[:12]


def files_of(modules: Sequence[str]) -> list[Path]:
    """The files of modules and folders below `src/highside`, each once."""
    files: dict[Path, None] = {}
    for name in modules:
        place = TOP / name
        files |= dict.fromkeys(sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")])
    return list(files)


@cache
def what_it_does(path: Path) -> str:
    """A Python file without what changes nothing in what it does: comments, docstrings, how its lines are broken."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [inner for inner in node.body if not _is_text(inner)] or [ast.Pass()]
    return ast.unparse(tree)


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def reached(*entries: str, within: tuple[str, ...]) -> tuple[str, ...]:
    """The modules that these import, wherever in the file, and those import in turn, as far as they are in the folders
    `within`; the entries themselves among them."""
    found: dict[str, None] = dict.fromkeys(entries)
    waiting = list(entries)
    while waiting:
        for name in _imports(waiting.pop()):
            if name not in found and name.partition("/")[0] in within:
                found[name] = None
                waiting.append(name)
    return tuple(sorted(found))


def _imports(module: str) -> Iterator[str]:
    """Modules of the package that a file imports, as paths below `src/highside`."""
    for node in ast.walk(ast.parse((TOP / f"{module}.py").read_text())):
        names = []
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("highside"):
            names = [str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            place = name.removeprefix("highside").strip(".").replace(".", "/")
            if place and (TOP / f"{place}.py").is_file():
                yield place
            elif place and (TOP / place / "__init__.py").is_file():
                yield f"{place}/__init__"


def of(*inputs: bytes, damage: Callable[[bytes, random.Random], bytes] = damaged) -> Make:
    return lambda rng: damage(rng.choice(inputs), rng)


def of_document(document: Any, write: Callable[[Any], bytes]) -> Make:
    """Damage by the structure of a document, written again as its owner would write it."""
    made = Document(document)
    return lambda rng: write(made.damaged(rng))


def signed_again(*documents: bytes) -> Make:
    """Damage by the structure, under an id that fits: one of the documents, by chance."""
    parsed = [json.loads(document) for document in documents]
    makes = [of_document(document, seeds.SignedAgain(document)) for document in parsed]
    return lambda rng: rng.choice(makes)(rng)


def chained_again(journal: bytes) -> Make:
    """Damage by the structure of a journal, its hashes made anew."""
    lines = [json.loads(line) for line in journal.splitlines()]
    for line in lines:
        del line["h"]
    return of_document(lines, seeds.ChainedAgain(lines))


def damaged_parquet(data: bytes, rng: random.Random) -> bytes:
    """Damage to the pages, or to the metadata behind them under a length that fits, in turn."""
    if rng.random() < 0.4:
        return damaged(data, rng)
    length = int.from_bytes(data[-8:-4], "little")
    metadata = damaged(data[-8 - length : -8], rng)
    return data[: -8 - length] + metadata + len(metadata).to_bytes(4, "little") + data[-4:]


class Bench:
    """A folder for the files, and everything that lives longer than one input."""

    def __init__(self) -> None:
        # in memory where there is such a place: a file is written for each input
        memory = Path("/dev/shm")
        self.folder = Path(tempfile.mkdtemp(dir=memory if os.access(memory, os.W_OK) else None))
        logging.disable(logging.CRITICAL)
        shutil.copy(seeds.ROOT / "config" / "highside.dbc", self.folder / "highside.dbc")
        self.replies: list[bytes] = []
        self.calibration = self.put(seeds.record().to_json().encode(), "cal.json")
        self.keeper = self._keeper()
        self.watch_keeper = self._watch_keeper()

    def close(self) -> None:
        shutil.rmtree(self.folder)
        logging.disable(logging.NOTSET)

    def put(self, data: bytes, name: str) -> Path:
        path = self.folder / name
        path.write_bytes(data)
        return path

    # --- configuration -----------------------------------------------------------------------------------------

    def service_toml(self, data: bytes) -> bool:
        load(self.put(data, "service.toml"))
        return True

    def bench_toml(self, data: bytes) -> bool:
        load_bench(self.put(data, "bench.toml"))
        return True

    def certificate_toml(self, data: bytes) -> bool:
        load_certificate_fields(self.put(data, "certificate.toml"))
        return True

    def model_toml(self, data: bytes) -> bool:
        load_model(self.put(data, "model.toml"))
        return True

    def codec_toml(self, data: bytes) -> bool:
        codec_from_file(self.put(data, "codec.toml"), "delimited").build()
        return True

    def override(self, data: bytes) -> bool:
        parse_overrides([data.decode("utf-8", "surrogateescape")])
        return True

    def dbc(self, data: bytes) -> bool:
        messages = compile_dbc(data.decode("cp1252", errors="replace"), where="car.dbc")
        payload = bytes(range(1, 65))
        for message in messages.values():
            numbers = message.numbers(payload)
            for signal in message.signals.values():
                signal.extract(*numbers)
        return True

    # --- records and state -------------------------------------------------------------------------------------

    def record(self, data: bytes) -> bool:
        correction_from_record(read_record(self.put(data, "record.json"))).correct((0.1, 0.2, 0.97))
        return True

    def activation(self, data: bytes) -> bool:
        store = self.folder / "store"
        (store / "activations").mkdir(parents=True, exist_ok=True)
        (store / "activations" / "00000001.json").write_bytes(data)
        (store / "records").mkdir(exist_ok=True)
        CalibrationStore(store).history()
        return True

    def compensation(self, data: bytes) -> bool:
        found = Compensation.from_json(data, where="rotor.json")
        LiveCompensation(found)
        return True

    def drift_state(self, data: bytes) -> bool:
        saved_drift.read(self.put(data, "drift.json"), "t1", saved_drift.Stamp.now(synced=True))
        return True

    def watch_state(self, data: bytes) -> bool:
        """What is accepted is gone on with."""
        saved = saved_watch.read(self.put(data, "watch.json"), "t1", saved_watch.Stamp.now(synced=True))
        assert saved is not None
        stage = seeds.watch_stage(saved)
        watch_message(stage, 1.79e9).model_dump_json()
        stage.health()
        return True

    def toolface(self, data: bytes) -> bool:
        self.put(data, "toolface.jsonl")
        ToolfaceLog(self.folder).current()
        return True

    def surveys(self, data: bytes) -> bool:
        log = SurveyLog(self.put(data, "surveys.jsonl"))
        trend_of(log.recent(), "c1").as_dict()
        return log.damaged_lines == 0

    def surveys_analysed(self, data: bytes) -> bool:
        analyse_surveys(self.put(data, "kept.jsonl")).to_dict()
        return True

    def watched_error_model(self, data: bytes) -> bool:
        """What a watch left, and a tool model: the same bytes as both."""
        path = self.put(data, "watch.json")
        made = error_model(self.calibration, watch=path)
        made.save(self.folder / "model.json", into=path)
        return True

    def watch_said(self, data: bytes) -> bool:
        """What a watch said, to the record that it proposes."""
        made = propose(seeds.record(), read_outcome(data, "watch.json"), now_s=1.79e9)
        return parse_record(made.to_json()).id == made.id

    def survey_join(self, data: bytes) -> bool:
        """Depths beside sound surveys."""
        kept = self.put(seeds.surveys(), "kept.jsonl")
        list_surveys(kept, depths=self.put(data, "depths.csv")).table.as_csv()
        return True

    def starts(self, data: bytes) -> bool:
        """A damaged file tells nothing, and is replaced."""
        self.put(data, "starts.json")
        log = StartLog(self.folder)
        log.begin()
        log.as_dict()
        log.end("as a test")
        return log.alarm

    def known_time(self, data: bytes) -> bool:
        self.put(data, "clock.json")
        known = KnownTime(self.folder)
        return math.isfinite(known.present(clock.now()).surely_s)

    def trusted_keys(self, data: bytes) -> bool:
        read_trusted_keys(self.put(data, "trusted.pub"))
        return True

    def signature(self, data: bytes) -> bool:
        signed = self.put(seeds.SIGNED, "signed.html")
        self.put(data, "signed.html.sig")
        check_file(signed, parse_trusted_keys(seeds.trusted_keys().decode()))
        return True

    def journal(self, data: bytes) -> bool:
        read_journal(data, where="session.jsonl").ledger()
        return True

    # --- recordings --------------------------------------------------------------------------------------------

    def recording(self, data: bytes) -> bool:
        read_recording(self.put(data, "recording.csv"))
        return True

    def parquet(self, data: bytes) -> bool:
        """As a whole, and as a long one that is read row group by row group."""
        path = self.put(data, "recording.parquet")
        groups = RowGroups.of(path)
        for _ in groups.batches(groups.names) if groups is not None else ():
            pass
        read_recording(path)
        return True

    def pose_table(self, data: bytes) -> bool:
        read_poses(self.put(data, "poses.csv"))
        return True

    def wire(self, data: bytes) -> bool:
        path = self.put(data, "wire.hsw")
        detect_kind(path)
        reader = read_segments(path)
        for _ in reader:
            pass
        for _ in events(path):
            pass
        return reader.torn_bytes == 0

    def candump(self, data: bytes) -> bool:
        reader = read_candump(self.put(data, "can.log"))
        for _ in reader:
            pass
        return reader.torn_bytes == 0 and reader.bad_lines == 0

    def import_profile(self, data: bytes) -> bool:
        before = os.environ.get("XDG_CONFIG_HOME")
        os.environ["XDG_CONFIG_HOME"] = str(self.folder)
        try:
            place = profiles.place("bench")
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(data)
            profile = profiles.load("bench")
        finally:
            del os.environ["XDG_CONFIG_HOME"]
            if before is not None:
                os.environ["XDG_CONFIG_HOME"] = before
        assert profile is not None
        return self._imported(seeds.foreign_csv(), profile.wishes)

    def import_csv(self, data: bytes) -> bool:
        # lines of VectorNav have no time
        return self._imported(data, Wishes(rate_hz=100.0 if data.startswith(b"$VN") else None))

    def import_container(self, data: bytes) -> bool:
        return self._imported(data, Wishes())

    def catalogue(self, data: bytes) -> bool:
        catalogue_of(str(self.put(data, "catalogue.csv")))
        return True

    def _imported(self, data: bytes, wishes: Wishes) -> bool:
        carry_out(open_foreign(self.put(data, "foreign.csv"), wishes), (), Joins())
        return True

    # --- commands ----------------------------------------------------------------------------------------------

    def _keeper(self) -> DriftKeeper:
        settings = validate({"tool": {"id": "t1"}, "link": {"kind": "simulated"}, "codec": {"name": "tool"}}, where="x")
        parts = DriftParts(settings, seeds.drift_stage())
        return DriftKeeper(
            self.folder, lambda reply, _done: self.replies.append(reply), lambda _: None, lambda: parts, DamageLog()
        )

    def _watch_keeper(self) -> WatchKeeper:
        settings = validate({"tool": {"id": "t1"}, "link": {"kind": "simulated"}, "codec": {"name": "tool"}}, where="x")
        parts = WatchParts(settings, seeds.watch_stage())
        said = lambda _: lambda _: None  # noqa: E731
        return WatchKeeper(
            self.folder, lambda reply, _done: self.replies.append(reply), said, lambda: parts, DamageLog()
        )

    def archived(self, data: bytes) -> bool:
        """A message of a tool, to the row of a table."""
        found = archive_row_of("highside/t1/attitude", data)
        assert found is not None
        return bool(archive_table_of([found[1]]).num_rows == 1)

    def drift_command(self, data: bytes) -> bool:
        self.replies.clear()
        self.keeper.on_command(data, retained=False)
        assert len(self.replies) == 1, f"{len(self.replies)} replies"
        reply = json.loads(self.replies[0])
        # the keeper answers for faults of its own, too
        assert reply["ok"] or "see the " not in reply["error"], reply["error"]
        return bool(reply["ok"])

    def watch_command(self, data: bytes) -> bool:
        self.replies.clear()
        self.watch_keeper.on_command(data, retained=False)
        assert len(self.replies) == 1, f"{len(self.replies)} replies"
        reply = json.loads(self.replies[0])
        assert reply["ok"] or "see the " not in reply["error"], reply["error"]
        return bool(reply["ok"])

    def session_command(self, data: bytes) -> bool:
        face = SessionMqtt(_Driver(), MqttSettings(), tool_id="t1")
        reply: Reply = _at_once(face._obey(data, retained=False))
        assert reply.reason != FAILED, reply.text
        json.loads(reply.model_dump_json())
        return reply.accepted


class _Driver(SessionDriver):
    """Takes every command."""

    def snapshot(self) -> Any:
        return _Now()

    async def command(self, command: Command, origin: Origin = Origin.HERE) -> Reply:
        return Reply(
            request_id=command.request_id, accepted=True, text=command.operator, state=SessionState.IDLE, seq=1
        )


class _Now:
    state, seq = SessionState.IDLE, 1


def _at_once(work: Coroutine[Any, Any, Any]) -> Any:
    """The result of a coroutine that waits for nothing."""
    try:
        work.send(None)
    except StopIteration as end:
        return end.value
    raise AssertionError("it waits")


PACKED = ("expansion", "arrow_size", "mcap_size", "parquet_size", "mat5", "hdf5_heaps")
EVERYWHERE = ("errors", "printable", "service/clock", "service/quiet_log", "special")
"""What each parser's code uses and that reads nothing: how errors and log lines are worded, what time it is, and what
is asked at any import (of scipy)."""
READING = tuple(f"reading/{name}" for name in ("documents", "files", "texts"))
CONFIG = ("reading/config_table", "codec/registry")
SERVICE_CONFIG = (
    *CONFIG,
    *reached("config/settings", within=("config",)),
    *(f"codec/{name}" for name in ("axes", "dbc", "delimited")),
    *("link/base", "link/serial", "link/replay", "calibration/rolling_bias"),
)
BENCH_CONFIG = (*CONFIG, *reached("config/bench", within=("config",)), "codec/axes", "link/base", "link/serial")
STORE = ("recording/calibration_store", "recording/files", "recording/locks")
CORRECTING = reached("calibration/record", "calibration/correction", within=("calibration", "attitude"))
CALIBRATION = (*CORRECTING, *STORE)
TABLES = (
    "recording/table",
    "recording/columns",
    "recording/of_another",
    "reading/table",
    "reading/columnar",
    "reading/arrays",
)
ROTATION = ("rotation", "attitude/angles")
RIG = ("service/rig/surveys", "service/rig/toolface")
SURVEYS = ("recording/kept_surveys", "reading/messages", "api/surveys", "watch")
KEYS = ("recording/keys", "calibration/signature")
IMPORT = ("importing", "codec/axes", *TABLES)
CONTAINERS = (*IMPORT, *(f"reading/{name}" for name in PACKED))
FLEET = ("fleet/catalogue", "reading/table")
SESSION = ("bench/mqtt", "bench/session", "reading/messages", "reading/config_table")
DRIFT = (
    "reading/messages",
    *(f"service/{name}" for name in ("saved_drift", "drift_keeper", "drift_stage", "commands")),
)
WATCH = (
    *("reading/messages", "watch", "config/watch"),
    *(
        f"service/{name}"
        for name in ("saved_watch", "watch_keeper", "watch_said", "watch_stage", "watch_messages", "commands")
    ),
    *("service/saved_drift", *CORRECTING),
)
WATCH_STATE = (*WATCH, "reading/config_table")
DRIFT_COMMAND = (*DRIFT, "gyro", "attitude/quaternion", "config/drift", "service/messages")
CERTIFICATE_CONFIG = (*CONFIG, *reached("config/certificate", within=("config",)))
MODEL_CONFIG = (*CONFIG, *reached("config/model", within=("config",)), "physics")
CODEC_CONFIG = (*CONFIG, *reached("config/codecs", within=("config",)), "codec")
DEPTHS = (*TABLES, "recording/survey_list", "recording/kept_surveys", "api/survey_list", "reading/messages")
ERROR_MODEL = (*reached("api/iscwsa", within=("calibration", "watch", "attitude")), *STORE)
STARTS = ("service/starts", "service/saved_drift", "recording/files")


def all_parsers(bench: Bench) -> Sequence[Parser]:
    """In the order of the table."""
    config = seeds.ROOT / "config"
    bench_files = [(config / name).read_bytes() for name in ("bench.toml", "bench-simulated.toml")]
    models = [(config / f"model-{name}.toml").read_bytes() for name in ("bench", "known", "rotation")]
    fields = (config / "certificate.toml").read_bytes()
    codec = (config / "multi_imu-mapping.toml").read_bytes()
    shipped = (config / "highside.toml").read_bytes()
    services = (seeds.SERVICE_PLAIN, shipped, seeds.SERVICE)
    dbcs = (seeds.DBC, (config / "highside.dbc").read_bytes())
    kept = tuple(seeds.surveys(count) for count in (1, 3, 12))
    record, compensations = seeds.record().to_json().encode(), seeds.compensations()
    override = (b"mqtt.port=1883", b'tool.id="x"', b"codec.columns={ax=1}")
    entry = {"number": 1, "tool": "t1", "record": "0" * 64, "action": "activate", "at": "2026-11-22T10:00:00Z"}
    activation = json.dumps(entry | {"undoes": None}).encode()
    journal, containers = seeds.journal(), seeds.containers()
    watched, said, parquets = seeds.watched(), seeds.watch_said(), seeds.parquets()
    return (
        Parser("service TOML", of(*services), bench.service_toml, services, SERVICE_CONFIG),
        Parser("bench TOML", of(*bench_files), bench.bench_toml, tuple(bench_files), BENCH_CONFIG),
        Parser("certificate TOML", of(fields), bench.certificate_toml, (fields,), CERTIFICATE_CONFIG),
        Parser("model TOML", of(*models), bench.model_toml, tuple(models), MODEL_CONFIG),
        Parser("codec TOML", of(codec), bench.codec_toml, (codec,), CODEC_CONFIG),
        Parser("--set", of(*override), bench.override, override, SERVICE_CONFIG),
        Parser("DBC text", of(*dbcs), bench.dbc, dbcs, ("codec/can_dbc", "reading/dbc")),
        Parser("calibration record", of(record), bench.record, (record,), CALIBRATION),
        Parser("record, hashed again", signed_again(record), bench.record, (record,), CALIBRATION),
        Parser("activation", of(activation), bench.activation, (activation,), (*STORE, "calibration/record")),
        Parser("compensation", of(compensations[0]), bench.compensation, compensations, ROTATION),
        Parser("compensation, hashed again", signed_again(*compensations), bench.compensation, compensations, ROTATION),
        Parser("drift state", of(seeds.drift_state()), bench.drift_state, (seeds.drift_state(),), DRIFT),
        Parser(
            "drift state, by structure",
            of_document(json.loads(seeds.drift_state()), lambda d: json.dumps(d).encode()),
            bench.drift_state,
            (seeds.drift_state(),),
            DRIFT,
        ),
        Parser("watch state", of(seeds.watch_state()), bench.watch_state, (seeds.watch_state(),), WATCH_STATE),
        Parser(
            "watch state, by structure",
            of_document(json.loads(seeds.watch_state()), lambda d: json.dumps(d).encode()),
            bench.watch_state,
            (seeds.watch_state(),),
            WATCH_STATE,
        ),
        Parser(
            "toolface log", of(seeds.toolface_log()), bench.toolface, (seeds.toolface_log(),), ("service/rig/toolface",)
        ),
        Parser("surveys", of(seeds.surveys()), bench.surveys, (seeds.surveys(),), RIG),
        Parser("surveys, analysed", of(*kept), bench.surveys_analysed, kept, SURVEYS),
        Parser("survey depths", of(seeds.DEPTHS), bench.survey_join, (seeds.DEPTHS,), DEPTHS),
        Parser("watch and tool model", of(watched), bench.watched_error_model, (watched,), ERROR_MODEL),
        Parser("watch said", of(said), bench.watch_said, (said,), ("watch/proposal", "watch/parameters", *CALIBRATION)),
        Parser(
            "watch said, by structure",
            of_document(json.loads(said), lambda d: json.dumps(d).encode()),
            bench.watch_said,
            (said,),
            ("watch/proposal", "watch/parameters", *CALIBRATION),
        ),
        Parser("starts of the service", of(seeds.starts()), bench.starts, (seeds.starts(),), STARTS),
        Parser("known time", of(seeds.known_time()), bench.known_time, (seeds.known_time(),), ("service/known_time",)),
        Parser("trusted keys", of(seeds.trusted_keys()), bench.trusted_keys, (seeds.trusted_keys(),), KEYS),
        Parser("signature", of(seeds.signature()), bench.signature, (seeds.signature(),), KEYS),
        Parser("journal", of(journal), bench.journal, (journal,), SESSION),
        Parser("journal, chained again", chained_again(journal), bench.journal, (journal,), SESSION),
        Parser(
            "recording CSV",
            of(seeds.recording(), seeds.recording_plain()),
            bench.recording,
            (seeds.recording(), seeds.recording_plain()),
            TABLES,
        ),
        Parser("recording CSV.gz", of(seeds.recording_plain(), damage=damaged_gzip), bench.recording, (), TABLES),
        Parser(
            "recording Parquet",
            of(*parquets, damage=damaged_parquet),
            bench.parquet,
            parquets,
            (*TABLES, "reading/row_groups", "reading/parquet_size", "reading/expansion"),
        ),
        Parser("pose table", of(seeds.poses()), bench.pose_table, (seeds.poses(),), TABLES),
        Parser(
            "import CSV", of(*seeds.FOREIGN), bench.import_csv, (seeds.foreign_csv(), seeds.foreign_poses()), IMPORT
        ),
        Parser("import containers", of(*containers), bench.import_container, containers, CONTAINERS),
        Parser("fleet catalogue", of(seeds.CATALOGUE), bench.catalogue, (seeds.CATALOGUE,), FLEET),
        Parser("archived message", of(*seeds.PUBLISHED), bench.archived, seeds.PUBLISHED, ("fleet/archive",)),
        Parser("import profile", of(seeds.PROFILE), bench.import_profile, (seeds.PROFILE,), IMPORT),
        Parser(
            ".hsw",
            of(seeds.wire()),
            bench.wire,
            (seeds.wire(),),
            ("recording/wire", "recording/candump", "link/replay"),
        ),
        Parser("candump", of(seeds.candump()), bench.candump, (seeds.candump(),), ("recording/candump",)),
        Parser(
            "drift/command", of(*seeds.DRIFT_COMMANDS), bench.drift_command, seeds.DRIFT_COMMANDS[:1], DRIFT_COMMAND
        ),
        Parser("watch/command", of(*seeds.WATCH_COMMANDS), bench.watch_command, seeds.WATCH_COMMANDS[:1], WATCH),
        Parser(
            "session/command",
            of(*seeds.SESSION_COMMANDS),
            bench.session_command,
            seeds.SESSION_COMMANDS,
            (*SESSION, "config/mqtt", "service/replies"),
        ),
    )
