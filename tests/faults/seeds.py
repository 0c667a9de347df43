"""Sound files and messages of every kind, small, made by the program itself: what the damage begins with."""

from __future__ import annotations

import functools
import hashlib
import io
import json
import math
import operator
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "session"), str(ROOT / "tests" / "import")]

import foreign_containers  # noqa: E402
from foreign_session import session  # noqa: E402
from rehearsal import Rehearsal  # noqa: E402

from highside.bench.session import plans  # noqa: E402
from highside.bench.session.plans import Limits  # noqa: E402
from highside.calibration.record import CalibrationRecord, Environment, SolveRequest, build_record, solve_poses  # noqa: E402
from highside.calibration.signature import FILE, SigningKey  # noqa: E402
from highside.codec import tool  # noqa: E402
from highside.codec.frame import CanFrame  # noqa: E402
from highside.config.drift import DriftSettings  # noqa: E402
from highside.config.watch import WatchSettings  # noqa: E402
from highside.physics.gravity import gravity_direction  # noqa: E402
from highside.recording.candump import format_candump  # noqa: E402
from highside.recording.table import PoseTable, Recording  # noqa: E402
from highside.recording.wire import encode_header, encode_record  # noqa: E402
from highside.rotation import Compensation, CurveMethod, FitOptions, Samples, Validity, fit  # noqa: E402
from highside.service.drift_stage import DriftStage  # noqa: E402
from highside.service.saved_drift import DriftFile, Stamp  # noqa: E402
from highside.service.saved_watch import SavedWatch, WatchFile  # noqa: E402
from highside.service.watch_stage import Watched, WatchStage  # noqa: E402

PUBLISHED = (
    b'{"tool": "t1", "seq": 17, "t": 1790000000.25, "t_mono": 12.5, "inc_deg": 31.25, "inc_std_deg": 0.01,'
    b' "tf_deg": 120.5, "tf_std_deg": 0.02, "g_total": 1.0002, "temp_c": 41.5, "cal_id": "0123abcd", "zone": "high",'
    b' "flags": ["g_total"], "historical": false}',
    b'{"seq": 3, "t": 1790000000.25, "inc_deg": 31.25, "azi_deg": null, "duration_s": 12.0, "accepted": true,'
    b' "cal_id": null, "flags": []}',
)
SERVICE = b"""
[tool]
id = "t1"
serial = "7"
[link]
kind = "serial"
port = "/dev/ttyUSB0"
baud = 115200
[codec]
name = "delimited"
axes = "x-y-z"
delimiter = ","
columns = 12
select = { column = 0, equals = "3" }
time = [{ column = 1 }, { column = 2, divide_by_column = 3 }]
time_wrap_s = 86400
[codec.fields]
ax_g = { column = 4, scale = 1e-4 }
ay_g = { column = 5, scale = 1e-4 }
az_g = { column = 6, scale = 1e-4 }
counts = { column = 7 }
[pipeline]
output_rate_hz = 2.5
[survey]
still_s = 10.0
[site]
latitude_deg = 52.0
gravity_mps2 = 9.81
[drift]
azimuth_deg = 120.0
[watch]
threshold = 40.0
random_walk_g = 1e-5
[mqtt]
host = "127.0.0.1"
[mqtt.outbox]
commit_interval_s = 0.1
[[wits]]
kind = "tcp_server"
port = 5001
[metrics]
port = 9100
"""
SERVICE_PLAIN = b"""
[tool]
id = "t1"
[link]
kind = "socketcan"
interface = "can0"
[codec]
name = "dbc"
[service]
state_dir = "state"
"""
DRIFT_COMMANDS = (
    b'{"id":"1","command":"align","azimuth_deg":12.5,"std_deg":0.5}',
    b'{"id":"abc","command":"connection","seconds":60}',
    b'{"id":"x-9","command":"reset_heading"}',
    b'{"id":"2","command":"restart"}',
)
WATCH_COMMANDS = (b'{"id":"1","command":"restart"}', b'{"id":"b-2","command":"acknowledge"}')
SESSION_COMMANDS = (
    b'{"name":"start","request_id":"r1","operator":"Alice"}',
    b'{"name":"redo","request_id":"r2","operator":"Alice","pose":"3","note":"again"}',
    b'{"name":"activate","request_id":"r3","operator":"Bob","confirm":"0123456789ab"}',
    b'{"name":"abort","request_id":"r4","operator":"Bob"}',
)
DBC = (
    b'VERSION ""\nNS_ :\nBS_:\nBU_: A B\n'
    b'BO_ 256 ACC: 8 A\n SG_ X : 0|16@1- (0.001,0) [-32|32] "g" B\n SG_ Y : 23|16@0- (1e-3,-0.5) [0|0] "g" B\n'
    b' SG_ Z : 32|32@1- (1,0) [0|0] "g" B\n'
    b'BO_ 2147484000 MUX: 64 A\n SG_ M M : 0|4@1+ (1,0) [0|15] "" B\n SG_ P m0 : 8|12@1+ (2,1) [0|100] "" B\n'
    b' SG_ Q m1 : 8|12@1+ (2,1) [0|100] "" B\n'
    b'CM_ SG_ 256 X "along the tool";\nBA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;\n'
    b'BA_DEF_DEF_ "GenMsgCycleTime" 0;\nBA_ "GenMsgCycleTime" BO_ 256 10;\n'
    b'VAL_ 256 X 0 "none" 1 "some" ;\nSIG_VALTYPE_ 256 Z : 1;\nSG_MUL_VAL_ 2147484000 P M 0-0, 2-3;\n'
)


def _poses() -> dict[str, list[float]]:
    rng = np.random.default_rng(24)
    inc, tf = np.repeat([30.0, 90.0, 150.0], 8), np.tile(np.arange(0.0, 360.0, 45.0), 3)
    g = gravity_direction(np.deg2rad(inc), np.deg2rad(tf)) + 1e-5 * rng.standard_normal((3, 24))
    columns = {"inc_ref_deg": inc, "tf_ref_deg": tf, "ax": g[0], "ay": g[1], "az": g[2], "n": np.full(24, 100.0)}
    columns |= {f"std_a{axis}": np.full(24, 1e-4) for axis in "xyz"}
    return {name: values.tolist() for name, values in columns.items()}


@cache
def record() -> CalibrationRecord:
    """A calibration of 24 poses."""
    poses, request = _poses(), SolveRequest("conventional")
    return build_record(
        tool_id="t1",
        serial="7",
        request=request,
        result=solve_poses(poses, request).result,
        pose_columns=poses,
        raw_sha256="0" * 64,
        raw_name="poses.csv",
        environment=Environment(bench="simulated", temp_c=25.0),
        now_s=1_795_000_000.0,
    )


@cache
def compensations() -> tuple[bytes, ...]:
    """Three curves (harmonics, a polynomial with the rate, a network) together, then one by one."""
    theta = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
    error = 20.0 * np.sin(theta) + 0.1 * np.random.default_rng(1).standard_normal(180)
    samples = Samples.build(theta, error, 0.1 * (1.0 + np.floor(theta / 1.6)))
    curves = {
        "inclination": fit(samples, CurveMethod.HARMONICS2, FitOptions(), held_out=False),
        "toolface": fit(samples, CurveMethod.POLYNOMIAL9, FitOptions(rate_terms=1), held_out=False),
        "heading": fit(samples, CurveMethod.NETWORK, FitOptions(), held_out=False),
    }
    sets = (curves, *({name: curve} for name, curve in curves.items()))
    return tuple(Compensation(one, Validity(40.0), "turns.csv", "0" * 64).to_json().encode() for one in sets)


def drift_stage() -> DriftStage:
    """A stage that has seen a tool at rest for 30 s."""
    stage = DriftStage(DriftSettings(azimuth_deg=60.0), 52.0, first_start=True)
    rng = np.random.default_rng(3)
    for i in range(300):
        stage.add(*(0.001 * rng.standard_normal(3)).tolist())
        stage.close(0.1 * i, 1000.0 + 0.1 * i, (0.2, 0.1, 0.97))
    return stage


@cache
def drift_state() -> bytes:
    """What such a stage keeps."""
    state = drift_stage().saved()
    assert state is not None
    return DriftFile(tool="t1", stamp=Stamp.now(synced=True), state=state).model_dump_json().encode()


def watch_stage(saved: SavedWatch | None = None) -> WatchStage:
    """A stage that has seen a tool at rest and turning, at 40 and 50 deg."""
    stage = WatchStage(WatchSettings(), Watched(record(), 1.0, 1e-4), saved)
    if saved is not None:
        return stage
    rng = np.random.default_rng(4)
    for k, inc_deg in enumerate((40.0, 50.0)):
        for at, lasts, rate in ((0.0, 60.0, 0.0), (120.0, 90.0, 1.0)):
            for t in np.arange(0.0, lasts, 0.1):
                tf = 0.4 + rate * t
                noise = 1e-4 * rng.standard_normal(3)
                s, c = math.sin(math.radians(inc_deg)), math.cos(math.radians(inc_deg))
                f = (s * math.cos(tf) + noise[0], s * math.sin(tf) + noise[1], c + noise[2])
                stage.add(1800.0 * k + at + float(t), 0.0, 0.0, -math.degrees(rate))
                stage.close(1800.0 * k + at + float(t), 1000.0 + t, f, 25.0)
    stage.finish()
    while stage.waiting:
        stage.take_result(stage.core.take(stage.waiting.popleft()))
    return stage


@cache
def watch_state() -> bytes:
    """What such a stage keeps."""
    stage = watch_stage()
    file = WatchFile(tool="t1", stamp=Stamp.now(synced=True), said=stage.said.to_dict(), state=stage.saved())
    return file.model_dump_json().encode()


@cache
def toolface_log() -> bytes:
    lines = [
        {"t": 1.79e9 + i, "offset_deg": 10.0 * i, "author": "Ann", "note": "scribe", "previous_deg": 0.0}
        for i in range(4)
    ]
    return b"".join(json.dumps(line).encode() + b"\n" for line in lines)


@cache
def surveys(count: int = 12) -> bytes:
    lines = [
        {"seq": i, "t": 1.79e9 + 600.0 * i, "inc_deg": 12.0, "tf_deg": 30.0 * i, "g_total": 1.0 + 1e-4 * i,
         "g_error_std_mg": 0.1, "cal_id": "c1", "reasons": [], "temp_c": 20.0 + i,
         "g_error_mg": 0.1 * i, "g_noise_mg": 0.02, "accepted": True}
        for i in range(count)
    ]  # fmt: skip
    return b"".join(json.dumps(line).encode() + b"\n" for line in lines)


def watched() -> bytes:
    """A result of a watch that is a tool model too."""
    names = [f"b_{i}" for i in "xyz"] + [f"S_{i}{j}" for i in "xyz" for j in "xyz"]
    terms = ["ABXY-TI1S", "ABXY-TI2S", "ABZ", "ASXY-TI1S", "ASXY-TI2S", "ASXY-TI3S", "ASZ"]
    document = {
        "cal_id": record().id,
        "parameters": {name: {"value": 1e-4, "std": 1e-5} for name in names},
        "terms": [{"name": name, "value": 0.004} for name in terms],
    }
    return json.dumps(document).encode()


def watch_said() -> bytes:
    """What a watch says when one name alone departs: `propose` makes a record of it."""
    said = watch_stage().said.to_dict()
    size = {"value": 8e-4, "std": 5e-5, "low": 7e-4, "high": 9e-4, "unit": "g"}
    claim = {"effect": "bias_step", "parameter": "b_x", "parameters": {"b_x": size}, "equivalence_class": ["b_x"]}
    claim |= {
        "since_s": 0.0,
        "since_low_s": 0.0,
        "since_high_s": 600.0,
        "alarm_s": 600.0,
        "evidence": 90.0,
        "error": None,
    }
    said["parameters"]["b_x"]["value"] = 8e-4
    return json.dumps(said | {"verdict": "departs", "claims": [claim]}).encode()


DEPTHS = "".join(["seq,md_m\n", *(f"{i},{30.0 * i + 10.5}\n" for i in range(12))]).encode()
"""of the same surveys"""


def starts() -> bytes:
    """Of a service that was killed three times in the last minutes."""
    now = Stamp.now(synced=False)
    ends = [{"boot_s": now.boot_s - 10.0 * i, "how": "killed, without a word"} for i in range(3)]
    return json.dumps({"format": "highside.starts/1", "boot_id": now.boot_id, "running": True, "ends": ends}).encode()


def known_time() -> bytes:
    """The clock followed a reference a minute ago."""
    now = Stamp.now(synced=True)
    kept = {"format": "highside.clock/1", "wall_s": 1.79e9, "boot_id": now.boot_id, "boot_s": now.boot_s - 60.0}
    return json.dumps(kept).encode()


SIGNED = b"<html>a certificate</html>"


@cache
def _key() -> SigningKey:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    return SigningKey(Ed25519PrivateKey.from_private_bytes(bytes(range(32))), "Ann of the laboratory")


@cache
def trusted_keys() -> bytes:
    return f"# those we trust\n{_key().public_line}\n".encode()


@cache
def signature() -> bytes:
    """What stands in a `.sig` beside `SIGNED`."""
    made = _key().sign(FILE, hashlib.sha256(SIGNED).hexdigest(), "2026-11-22T10:00:00Z")
    return json.dumps(made.to_dict(), indent=1).encode()


PROFILE = b"""rate_hz = 100.0
axes = "xyz"
units = ["m/s2", "rad/s"]
[map]
t_s = "timestamp:s"
ax_g = "accel_x [m/s^2]"
ay_g = "accel_y [m/s^2]"
az_g = "accel_z [m/s^2]"
gx_dps = "none"
"""


@cache
def foreign_csv() -> bytes:
    """As another program writes it: its own names and units, times with a date."""
    lines = ["timestamp,accel_x [m/s^2],accel_y [m/s^2],accel_z [m/s^2],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s]"]
    for i in range(12):
        x, z = 9.81 * math.sin(0.3 + 0.05 * i), 9.81 * math.cos(0.3 + 0.05 * i)
        lines.append(f"{0.01 * i:.3f},{x:.4f},0.12,{z:.4f},0.001,{0.05 + 0.001 * i:.4f},0")
    return "\n".join(lines).encode() + b"\n"


@cache
def foreign_poses() -> bytes:
    """A spreadsheet of a turntable: angles and mean readings, no time."""
    lines = ["incl [deg];toolface [deg];x [mg];y [mg];z [mg];std_ax;std_ay;std_az;n;remark"]
    for inc in (20, 60, 110):
        for tf in (45, 135, 225, 315):
            s, c = math.sin(math.radians(inc)), math.cos(math.radians(inc))
            x, y = s * math.cos(math.radians(tf)), s * math.sin(math.radians(tf))
            lines.append(f"{inc};{tf};{1e3 * x:.2f};{1e3 * y:.2f};{1e3 * c:.2f};0.1;0.1;0.2;40;ok".replace(".", ","))
    return "\n".join(lines).encode() + b"\n"


def _summed(line: bytes) -> bytes:
    """A line as VectorNav writes it: with the sum of its bytes."""
    return b"$%s*%02X\r\n" % (line, functools.reduce(operator.xor, line))


FOREIGN = (
    foreign_csv(),
    foreign_csv().replace(b",", b";").replace(b".", b","),
    b"\n".join(
        b"%s,%s" % (b"2026-07-12T18:00:%02d.%03dZ" % divmod(100 * i, 1000) if i else b"time", line.partition(b",")[2])
        for i, line in enumerate(foreign_csv().splitlines())
    ),
    foreign_poses(),
    _summed(b"VNYMR,+010.071,+000.278,-002.026,+00.0,+00.0,+00.0,-00.344,-00.049,-09.790,+00.0,-00.0,+00.0") * 6,
)


CATALOGUE = b"uri,tool,date,kind\na.csv,tool-1,2026-11-01,poses\nb.csv.gz,tool-2,2026-11-02,poses\n"


@cache
def parquets() -> tuple[bytes, ...]:
    """A recording as Parquet in the ways that programs write it: pages of both versions, packed and not."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    n = 300
    columns = {"t_s": np.arange(n) * 0.01, "ax_g": np.full(n, 0.1), "ay_g": np.full(n, 0.2), "az_g": np.full(n, 0.97)}
    table = pa.table(columns | {"pose": np.arange(n) // 30})
    ways: tuple[dict[str, Any], ...] = (
        {},
        {"compression": "zstd", "data_page_version": "2.0", "row_group_size": 100},
        {"compression": "none", "use_dictionary": False, "write_statistics": False},
        {"compression": "gzip", "write_page_index": True},
    )
    made = []
    for way in ways:
        out = io.BytesIO()
        pq.write_table(table, out, **way)
        made.append(out.getvalue())
    return tuple(made)


def containers() -> tuple[bytes, ...]:
    """One file of each form that `highside import` reads and that is no text."""
    names = (
        "pandas_parquet", "arrow_feather", "numpy_archive", "matlab_structure", "hdf5_units", "px4_ulog",
        "ardupilot_bin", "ros1_bag", "ros2_mcap", "foxglove_json", "protobuf_mcap", "ros2_db3", "excel_xlsx",
    )  # fmt: skip
    return tuple(getattr(foreign_containers, name)(session(n=60)) for name in names)


@cache
def journal() -> bytes:
    """A whole session of four poses."""
    plan = plans.balance_plan([12.0], Limits(std_error_g=3e-5, min_hold_s=1.5, max_hold_s=4.0))
    return Rehearsal(plan, rate_hz=10.0).run().journal


@cache
def recording() -> bytes:
    t = np.arange(12) * 0.1
    columns = {"t_s": t, "ax_g": np.sin(t), "ay_g": np.cos(t), "az_g": 0.5 + 0.0 * t, "temp_c": np.full(12, math.nan)}
    columns["temp_c"][3] = 20.5
    return Recording(columns | {"seq": np.arange(12.0)}, {"remark": ("a", 'b "quoted", c') * 6}).as_csv().encode()


@cache
def recording_plain() -> bytes:
    t = np.arange(20) * 0.1
    return Recording({"t_s": t, "ax_g": np.sin(t), "ay_g": np.cos(t), "az_g": 0.0 * t}).as_csv().encode()


@cache
def poses() -> bytes:
    return PoseTable({name: np.array(values) for name, values in _poses().items()}).as_csv().encode()


@cache
def wire() -> bytes:
    """Segments with frames of the tool."""
    frames = [tool.encode(i, i * 1e-3, (0.1, 0.2, 0.97), temp_c=20.0) for i in range(12)]
    meta = {"tool": "t1", "codec": "tool", "link": {"kind": "serial", "port": "/dev/ttyUSB0"}}
    return encode_header(meta) + b"".join(encode_record((1.0 + 0.01 * i, 1.79e9, f)) for i, f in enumerate(frames))


@cache
def candump() -> bytes:
    rng = np.random.default_rng(5)
    frames = [CanFrame(1.79e9 + 0.01 * i, 0.0, 0x100 + i, rng.bytes(8), i % 3 == 0) for i in range(20)]
    return "".join(format_candump(frame, "can0") for frame in frames).encode()


class Texts:
    """JSON texts of the values that damaged versions of a document share with it: written once, found by identity, at
    every depth; only what is on the way to a damage is written anew."""

    def __init__(self, shared: Iterable[Any], *, sort_keys: bool = False) -> None:
        self._sorted = sort_keys
        self._of: dict[int, tuple[Any, str]] = {}
        for value in shared:
            self._keep(value)

    def __call__(self, value: Any) -> str:
        known = self._of.get(id(value))
        if known is not None:
            return known[1]
        inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        if not any(isinstance(held, dict | list) for held in inside):
            return json.dumps(value, separators=(",", ":"), sort_keys=self._sorted)
        if isinstance(value, dict):
            items = sorted(value.items()) if self._sorted else value.items()
            return "{" + ",".join([f"{json.dumps(name)}:{self(held)}" for name, held in items]) + "}"
        return "[" + ",".join([self(held) for held in value]) + "]"

    def _keep(self, value: Any) -> None:
        if isinstance(value, dict | list):
            for held in value.values() if isinstance(value, dict) else value:
                self._keep(held)
            self._of[id(value)] = (value, self(value))


class SignedAgain:
    """Writes damaged versions of a document with the hash of what they say now as their id: as whoever tampers with
    one would do."""

    def __init__(self, document: dict[str, Any]) -> None:
        self._texts = Texts(document.values(), sort_keys=True)

    def __call__(self, document: Any) -> bytes:
        if not isinstance(document, dict):
            return json.dumps(document).encode()
        named = sorted((name, value) for name, value in document.items() if name != "id")
        body = ",".join(f"{json.dumps(name)}:{self._texts(value)}" for name, value in named)
        return f'{{"id":"{hashlib.sha256(f"{{{body}}}".encode()).hexdigest()}",{body}}}'.encode()


class ChainedAgain:
    """Writes damaged versions of a journal's lines with hashes that follow from one another."""

    def __init__(self, lines: list[Any]) -> None:
        self._texts = Texts(lines)

    def __call__(self, lines: Any) -> bytes:
        if not isinstance(lines, list):
            return b"{}\n"
        out, chain = [], ""
        for line in lines:
            text = self._texts(line if isinstance(line, dict) else {"d": line})
            chain = hashlib.sha256((chain + text).encode("ascii", "replace")).hexdigest()[:16]
            out.append(f'{text[:-1]},"h":"{chain}"}}\n'.encode("ascii"))
        return b"".join(out)
