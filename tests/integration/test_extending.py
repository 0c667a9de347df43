"""The recipes of docs/extending.md, followed to the letter: the page's own blocks of code, installed and used."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from broker import Mosquitto
from daemon import HIGHSIDE, Pty, Subscriber, running, wait_for

from highside.attitude.block import attitude_block
from highside.codec.tool import encode
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState

pytestmark = pytest.mark.slow

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"
_BLOCK = re.compile(r"^```(\w+)\n(?:# )?([\w./-]+\.\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(title: str) -> dict[str, str]:
    """The blocks of one recipe by the file that their first line names."""
    found = re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert found, f"the page has no recipe {title!r}"
    return {name: text for _, name, text in _BLOCK.findall(found[1])}


def patched(recipe: dict[str, str], into: Path) -> Path:
    """A copy of the sources with a recipe's new files and diffs in it, each hunk at the one place that it names."""
    shutil.copytree(PAGE.parents[1] / "src" / "highside", into / "highside", ignore=shutil.ignore_patterns("*.pyc"))
    for name, diff in recipe.items():
        path = into / Path(name).relative_to("src")
        if not path.exists():
            path.write_text(diff)
            continue
        text = path.read_text()
        for hunk in diff.split("@@\n"):
            lines = hunk.splitlines()
            before, after = ("\n".join(line[1:] for line in lines if line[0] in kept) for kept in (" -", " +"))
            assert text.count(before) == 1, f"{name} has not one place with:\n{before}"
            text = text.replace(before, after)
        path.write_text(text)
    return into


def install(source: Path, into: Path) -> None:
    """The package in `source` built and installed, without any index, in a folder that a path may name."""
    subprocess.run(
        [Path(sys.executable).with_name("uv"), "pip", "install", "-q", "--python", sys.executable, "--offline",
         "--no-deps", "--no-build-isolation", "--target", into, source],
        check=True, timeout=120,
    )  # fmt: skip


def highside(*arguments: object, path: Path) -> subprocess.CompletedProcess[str]:
    """A command, with the folder `path` of packages installed beside highside."""
    return subprocess.run(
        [HIGHSIDE, *map(str, arguments)], capture_output=True, text=True, timeout=120, env=environment(path)
    )


def environment(path: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(path)}


@pytest.fixture(scope="module")
def rig_sensors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of the codec's recipe, installed."""
    source, into = tmp_path_factory.mktemp("rig-sensors"), tmp_path_factory.mktemp("installed")
    for name, text in blocks("A codec").items():
        (source / name).write_text(text)
    install(source, into)
    return into


@pytest.fixture(scope="module")
def rig_methods(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package of the method's recipe, installed."""
    source, into = tmp_path_factory.mktemp("rig-methods"), tmp_path_factory.mktemp("installed")
    for name, text in blocks("A calibration method").items():
        (source / name).write_text(text)
    install(source, into)
    return into


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path_factory.mktemp("broker")) as mosquitto:
        yield mosquitto


def packet(kind: int, *values: int) -> bytes:
    """A WitMotion packet as the sensor's maker describes it, not by the recipe's code."""
    body = bytes((0x55, kind)) + struct.pack("<4h", *values)
    return body + bytes((sum(body) & 0xFF,))


def stream(readings: int) -> bytes:
    """A sensor that lies at I = 90, its y axis up: acceleration, rates, angles, again and again."""
    out = b""
    for k in range(readings):
        out += packet(0x51, k % 7 - 3, 2048 + k % 5, 12, 2510) + packet(0x52, 3, -4, k % 11, 0)
        out += packet(0x53, 1, 2, 3, 4)
    return out


def configuration(folder: Path, port: str, broker_port: int, *, codec: str = "witmotion") -> Path:
    path = folder / "highside.toml"
    path.write_text(
        f'[tool]\nid = "t1"\n[link]\nkind = "serial"\nport = "{port}"\n[codec]\nname = "{codec}"\n'
        f'[mqtt]\nport = {broker_port}\n[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.2\n'
    )
    return path


def test_codec_of_the_recipe_reads_a_real_line_and_the_books_balance(
    tmp_path: Path, rig_sensors: Path, broker: Mosquitto
) -> None:
    subscriber, line = Subscriber(broker.port), Pty()
    path = configuration(tmp_path, line.path, broker.port)
    # noise before, a packet damaged, an acceleration whose rates were lost, and a piece at the end
    damaged = bytearray(packet(0x51, 0, 2048, 0, 2500))
    damaged[4] ^= 0x10
    wire = b"\x00\x13U" + stream(300) + bytes(damaged) + packet(0x51, 0, 2048, 0, 2500) + stream(300) + b"\x55\x51\x01"
    try:
        with running(path, env=environment(rig_sensors)) as daemon:
            wait_for(
                lambda: (health := subscriber.latest("health")) and health["link"]["opens"], 30, "the link", daemon
            )
            for start in range(0, len(wire), 97):
                line.write_all(wire[start : start + 97])
                time.sleep(0.002)

            def counted() -> dict[str, dict[str, int]] | None:
                health = subscriber.latest("health")
                return health if health and health["codec"]["bytes_in"] == len(wire) else None

            health = wait_for(counted, 30, "all bytes", daemon)
            assert daemon.terminate() == 0, daemon.log
    finally:
        line.close()
        subscriber.close()
    codec = health["codec"]
    assert (codec["frames_good"], codec["frames_part"], codec["frames_ignored"]) == (600, 601, 600)
    assert codec["frames_bad"] >= 1
    assert codec["bytes_framed"] == 1201 * 11
    assert health["monitor"]["received"] == 600
    assert health["balance"] == {"bytes": True, "frames": True, "messages": True}
    assert not [alarm for alarm in health["alarms"] if alarm.startswith("balance")]
    attitude = subscriber.payloads("attitude")[-1]
    assert attitude["inc_deg"] == pytest.approx(90.0, abs=0.5)
    # what the daemon kept of the wire, decoded offline
    (kept,) = sorted((tmp_path / "state").rglob("*.hsw*"))[:1]
    out = tmp_path / "readings.csv"
    done = highside("decode", kept, "--codec", "witmotion", "-o", out, "--json", path=rig_sensors)
    assert done.returncode == 0, done.stderr
    counts = json.loads(done.stdout)
    assert (counts["frames_good"], counts["rows"], counts["balanced"]) == (600, 600, True)
    assert len(out.read_text().splitlines()) == 601


def test_every_command_finds_the_codec_of_the_recipe(tmp_path: Path, rig_sensors: Path) -> None:
    config = configuration(tmp_path, "/dev/ttyUSB0", 1883)
    done = highside("check", config, path=rig_sensors)
    assert done.returncode == 0, done.stderr
    assert "codec witmotion" in done.stdout
    config.write_text(config.read_text().replace('name = "witmotion"', 'name = "witmotion"\naxis = "xyz"'))
    done = highside("check", config, path=rig_sensors)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "codec.axis: is not a known field; did you mean 'axes'?" in done.stderr
    schema = json.loads(highside("schema", "--config", path=rig_sensors).stdout)
    assert "witmotion" in schema["$defs"]["Settings"]["properties"]["codec"]["discriminator"]["mapping"]
    # without the package installed the name means nothing
    done = highside("decode", config, "--codec", "witmotion", "-o", tmp_path / "x.csv", path=tmp_path)
    assert (done.returncode, done.stderr) == (
        2, "highside: --codec: no codec 'witmotion'; allowed: dbc, delimited, tool, vn100\n"
    )  # fmt: skip


def test_detect_finds_the_codec_of_the_recipe(rig_sensors: Path) -> None:
    line, stop = Pty(), threading.Event()
    os.set_blocking(line.master, False)

    def talk() -> None:
        data = stream(20)
        while not stop.wait(0.02):
            try:
                os.write(line.master, data)
            except BlockingIOError:
                continue
            except OSError:
                # the port is closed between two rates
                continue

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        done = highside("detect", "--port", line.path, "--baud", 115200, "--seconds", 0.6, "--json", path=rig_sensors)
    finally:
        stop.set()
        thread.join()
        line.close()
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)
    assert (found["codec"], found["baud"]) == ("witmotion", 115200)
    assert found["share"] > 0.5


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("raise RuntimeError('no licence\\nfor this host')\n", "RuntimeError: no licence for this host"),
        ("import there_is_no_such_module\n", "ModuleNotFoundError: No module named 'there_is_no_such_module'"),
        ("CODEC = 7\n", "it is no subclass of highside.codec.registry.CodecTable"),
        ("import sys\nsys.exit(3)\n", "SystemExit: 3"),
        ("from highside.codec.vn100 import CODEC\n", "its field `name` must be Literal['broken']"),
        (
            "from typing import Literal\nfrom highside.codec.registry import CodecTable\n"
            "class CODEC(CodecTable):\n    name: Literal['broken']\n",
            "it has no method `build` that makes the decoder",
        ),
    ],
)
def test_broken_package_is_one_line_and_stops_only_those_who_use_it(tmp_path: Path, text: str, says: str) -> None:
    into = tmp_path / "installed"
    info = into / "broken_sensors-0.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-sensors\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text("[highside.codecs]\nbroken = broken_sensors:CODEC\n")
    (into / "broken_sensors.py").write_text(text)
    config = configuration(tmp_path, "/dev/ttyUSB0", 1883, codec="tool")
    done = highside("check", config, path=into)
    assert done.returncode == 0, done.stderr
    assert done.stderr == f"note: the codec 'broken' of the installed package broken-sensors 0.1 is omitted: {says}\n"
    config = configuration(tmp_path, "/dev/ttyUSB0", 1883, codec="broken")
    for arguments in (("run", "--config", config), ("decode", config, "--codec", "broken", "-o", tmp_path / "x.csv")):
        done = highside(*arguments, path=into)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
        assert "codec" in done.stderr
        assert f"the codec 'broken' of the installed package broken-sensors 0.1 cannot be used: {says}" in done.stderr


FAILING = """
from typing import Literal
from highside.codec.registry import CodecTable
from highside.codec.tool import ToolCodec

class Decoder(ToolCodec):
    def receive(self, data, t_mono=0.0):
        frames = super().receive(data, t_mono)
        if b"\\xee\\xee\\xee" in data:
            raise KeyError("no such\\npacket")
        return frames

class CODEC(CodecTable):
    name: Literal["broken"]
    def build(self):
        return Decoder()
"""


def test_a_decoder_that_raises_costs_what_it_was_given_and_is_one_line(tmp_path: Path, broker: Mosquitto) -> None:
    """In the service the link goes on, the books balance and an alarm stands; offline it is a refusal in one line."""
    into = tmp_path / "installed"
    info = into / "broken_sensors-0.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-sensors\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text("[highside.codecs]\nbroken = broken_sensors:CODEC\n")
    (into / "broken_sensors.py").write_text(FAILING)
    subscriber, line = Subscriber(broker.port), Pty()
    first, last = (
        b"".join(encode(k, k / 100.0, (0.1, 0.2, 0.97)) for k in some) for some in (range(50), range(50, 99))
    )
    bad = b"\xee\xee\xee"

    def reported(condition: Callable[[dict[str, Any]], bool], what: str) -> dict[str, Any]:
        return wait_for(lambda: (h := subscriber.latest("health")) and condition(h) and h, 30, what, daemon)

    try:
        config = configuration(tmp_path, line.path, broker.port, codec="broken")
        with running(config, env=environment(into)) as daemon:
            reported(lambda health: health["link"]["opens"] == 1, "the link")
            line.write_all(first)
            reported(lambda health: health["monitor"]["good"] == 50, "the frames before")
            for count in range(1, 4):
                line.write_all(bad)
                reported(lambda health, count=count: health["codec"]["faults"] == count, "the fault")
            line.write_all(last)
            health = reported(lambda health: health["monitor"]["good"] == 99, "the frames behind")
            assert daemon.terminate() == 0, daemon.log
    finally:
        line.close()
        subscriber.close()
    assert "decoder_failed" in health["alarms"]
    assert health["balance"] == {"bytes": True, "frames": True, "messages": True}
    assert (health["codec"]["bytes_junk"], health["codec"]["bytes_framed"]) == (9, len(first) + len(last))
    assert "Traceback" not in daemon.log
    (said,) = [text for text in daemon.log.splitlines() if "its decoder failed" in text]
    assert "codec broken: its decoder failed (KeyError: 'no such\\npacket')" in said
    wire = tmp_path / "wire.bin"
    wire.write_bytes(first + bad)
    done = highside("decode", wire, "--codec", "broken", "-o", tmp_path / "x.csv", path=into)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert "the decoder of codec 'broken' failed on it (KeyError" in done.stderr
    assert not (tmp_path / "x.csv").exists()


def test_channel_of_the_recipe_stands_in_the_messages(tmp_path: Path, broker: Mosquitto) -> None:
    recipe = blocks("A published channel")
    assert len(recipe) == 2
    path = patched(recipe, tmp_path / "src")
    subscriber, line = Subscriber(broker.port), Pty()
    try:
        with running(configuration(tmp_path, line.path, broker.port, codec="tool"), env=environment(path)) as daemon:
            wait_for(
                lambda: (health := subscriber.latest("health")) and health["link"]["opens"], 40, "the link", daemon
            )
            for k in range(200):
                line.write_all(encode(k, k / 100.0, (0.3, 0.4, 0.8660254)))
            attitude = wait_for(lambda: subscriber.latest("attitude"), 20, "an attitude", daemon)
            assert daemon.terminate() == 0, daemon.log
    finally:
        line.close()
        subscriber.close()
    assert attitude["g_cross"] == pytest.approx(0.5, abs=1e-7)
    members = list(attitude)
    assert members.index("g_cross") == members.index("cal_id") + 1
    assert members[-1] == "historical"
    schemas = json.loads(highside("schema", path=path).stdout)
    assert "sin I" in schemas["attitude"]["properties"]["g_cross"]["description"]


def pose_table(path: Path, knocked_g: float) -> tuple[Path, np.ndarray]:
    """A table of 24 poses of a sensor, one of them knocked; and the sensor's matrix."""
    random = np.random.default_rng(5)
    sensor, offset_g, noise_g = np.eye(3) + 3e-3 * random.standard_normal((3, 3)), np.array([1e-3, -2e-3, 5e-4]), 1e-5
    inc, tf = (
        grid.ravel() for grid in np.meshgrid((5.0, 40.0, 90.0, 120.0, -30.0, -90.0), (45.0, 135.0, 225.0, 315.0))
    )
    a = sensor @ gravity_direction(np.deg2rad(inc), np.deg2rad(tf)) + offset_g[:, None]
    a += noise_g * random.standard_normal(a.shape)
    a[0, 7] += knocked_g
    lines = ["inc_ref_deg,tf_ref_deg,ax,ay,az,n,std_ax,std_ay,std_az"]
    lines += [f"{inc[k]},{tf[k]},{a[0, k]!r},{a[1, k]!r},{a[2, k]!r},100,1e-4,1e-4,1e-4" for k in range(inc.size)]
    path.write_text("\n".join(lines).replace("np.float64(", "").replace(")", "") + "\n")
    return path, sensor


def test_method_of_the_recipe_solves_and_its_record_reads_back(tmp_path: Path, rig_methods: Path) -> None:
    poses, sensor = pose_table(tmp_path / "poses.csv", knocked_g=5e-3)
    errors = {}
    for method in ("huber", "conventional"):
        record = tmp_path / f"{method}.json"
        done = highside("calibrate", "solve", poses, "--method", method, "--tool", "t", "-o", record, path=rig_methods)
        assert done.returncode == 0, done.stderr
        # read back where the method's package is not installed
        done = highside("calibrate", "show", record, "--json", path=tmp_path)
        assert done.returncode == 0, done.stderr
        content = json.loads(record.read_text())
        assert (content["request"]["method"], content["result"]["method"]) == (method, method)
        parameters = content["result"]["zones"][0]["parameters"]
        matrix = np.array(parameters["values"][:9]).reshape(3, 3)
        errors[method] = np.abs(matrix - sensor).max()
    # what a method is for: the knocked pose spoils the plain least squares, and not this one
    assert errors["huber"] < 3e-5
    assert errors["conventional"] > 10.0 * errors["huber"]
    done = highside("calibrate", "show", tmp_path / "huber.json", "--recompute", path=rig_methods)
    assert done.returncode == 0, done.stderr
    applied = tmp_path / "corrected.csv"
    readings = tmp_path / "readings.csv"
    readings.write_text("ax_g,ay_g,az_g\n0.35,0.35,0.87\n")
    done = highside("calibrate", "apply", tmp_path / "huber.json", readings, "-o", applied, path=tmp_path)
    assert done.returncode == 0, done.stderr


def test_method_of_the_recipe_is_compared_and_named_like_ours(tmp_path: Path, rig_methods: Path) -> None:
    poses, _ = pose_table(tmp_path / "poses.csv", knocked_g=0.0)
    program = (
        "import csv, sys; from highside.calibration.comparison import compare\n"
        "from highside.calibration.method import SolveRequest\n"
        "rows = list(csv.DictReader(open(sys.argv[1])))\n"
        "columns = {name: [float(row[name]) for row in rows] for name in rows[0]}\n"
        "found = compare(columns, SolveRequest('joint'))\n"
        "print([(one.method, one.refused) for one in found.outcomes])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, poses], capture_output=True, text=True, check=True, env=environment(rig_methods)
    )
    assert done.stdout == "[('conventional', ''), ('balance', ''), ('joint', ''), ('huber', '')]\n"
    done = highside("calibrate", "solve", poses, "--method", "hubert", "-o", tmp_path / "x.json", path=rig_methods)
    assert (done.returncode, done.stderr) == (
        2, "highside: --method: method 'hubert' is none of conventional, balance, joint, huber\n"
    )  # fmt: skip


def test_transport_of_the_recipe_brings_readings_and_says_what_is_wrong(tmp_path: Path, broker: Mosquitto) -> None:
    path = patched(blocks("A transport"), tmp_path / "src")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    config = configuration(tmp_path, "", broker.port, codec="tool")
    config.write_text(config.read_text().replace('kind = "serial"\nport = ""', f'kind = "udp"\nport = {port}'))
    subscriber = Subscriber(broker.port)
    try:
        with (
            running(config, env=environment(path)) as daemon,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
        ):
            wait_for(
                lambda: (health := subscriber.latest("health")) and health["link"]["opens"], 40, "the link", daemon
            )
            for k in range(200):
                sender.sendto(encode(k, k / 100.0, (0.3, 0.4, 0.8660254)), ("127.0.0.1", port))
                time.sleep(0.001)
            health = wait_for(
                lambda: (now := subscriber.latest("health")) and now["codec"]["frames_good"] == 200 and now,
                20, "all readings", daemon,
            )  # fmt: skip
            assert daemon.terminate() == 0, daemon.log
    finally:
        subscriber.close()
    assert all(health["balance"].values())
    assert health["link"]["state"] == "up"
    assert subscriber.payloads("attitude")[-1]["inc_deg"] == pytest.approx(30.0, abs=0.01)
    # a port that another holds: one line, the service does not start
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", port))
        done = highside("run", "--config", config, path=path)
    assert (done.returncode, "Traceback" in done.stderr) == (2, False)
    assert f"udp 127.0.0.1:{port}: " in done.stderr
    config.write_text(config.read_text().replace(f"port = {port}", "port = 70000"))
    done = highside("check", config, path=path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "link.port" in done.stderr


def test_broken_method_is_one_line_and_stops_only_those_who_use_it(tmp_path: Path) -> None:
    into = tmp_path / "installed"
    info = into / "broken_methods-0.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-methods\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text("[highside.methods]\nbroken = broken_methods:METHOD\n")
    (into / "broken_methods.py").write_text("METHOD = 1 / 0\n")
    poses, _ = pose_table(tmp_path / "poses.csv", knocked_g=0.0)
    named = "the calibration method 'broken' of the installed package broken-methods 0.1"
    out = tmp_path / "record.json"
    done = highside("calibrate", "solve", poses, "--method", "conventional", "-o", out, path=into)
    assert done.returncode == 0, done.stderr
    assert done.stderr == f"note: {named} is omitted: ZeroDivisionError: division by zero\n"
    out.unlink()
    done = highside("calibrate", "solve", poses, "--method", "broken", "-o", out, path=into)
    assert (done.returncode, out.exists()) == (2, False)
    assert done.stderr.splitlines()[1:] == [
        "highside: --method: the method 'broken' of the installed package broken-methods 0.1 cannot be used:"
        " ZeroDivisionError: division by zero; fix or remove that package"
    ]


def test_reference_of_the_recipe_gives_the_attitudes(tmp_path: Path) -> None:
    recipe = blocks("A kind of reference")
    assert len(recipe) == 2
    path = patched(recipe, tmp_path / "src")
    (tmp_path / "truth.toml").write_text(
        '[sensor]\nbias_g = [1.2e-3, -0.8e-3, 1.5e-3]\n[effects]\nincluded = ["quadratic", "reading_noise"]\n'
        "[effects.quadratic]\nk2_x = 4e-4\n[effects.reading_noise]\ndensity_ug = 60\n[motion]\n"
        'kind = "poses"\ninclinations_deg = [10, 35, 60, 85, 110]\n'
        "toolfaces_deg = [0, 45, 90, 135, 180, 225, 270, 315]\n"
        "hold_s = 5\nrow_s = 0.1\nmove_s = 4\nrecord_moves = true\n"
    )
    known, recording = tmp_path / "known.toml", tmp_path / "session.csv"
    known.write_text('[sensor]\nfree = ["bias", "scale", "misalignment"]\n')
    done = highside("simulate", tmp_path / "truth.toml", "-o", recording, "--seed", "2", path=path)
    assert done.returncode == 0, done.stderr
    rows = np.genfromtxt(recording, delimiter=",", names=True)
    master = gravity_direction(np.radians(rows["inc_ref_deg"]), np.radians(rows["tf_ref_deg"]))
    master += 1e-5 * np.random.default_rng(1).standard_normal(master.shape)
    names = "t_s,ax_g,ay_g,az_g"
    with_master = np.column_stack([*(rows[name] for name in names.split(",")), *master])
    header = names + ",master_ax_g,master_ay_g,master_az_g"
    np.savetxt(tmp_path / "m.csv", with_master, "%.17g", ",", header=header, comments="")
    arguments = ("diagnose", tmp_path / "m.csv", "--model", known, "--out", tmp_path / "report")
    done = highside(*arguments, path=path)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "report" / "diagnosis.json").read_text())
    (claim,) = found["claims"]
    assert (found["verdict"], claim["effect"]) == ("named", "quadratic")
    k2_x = claim["parameters"]["k2_x"]
    assert k2_x["low"] < 4e-4 < k2_x["high"] < k2_x["low"] + 1e-4
    # without the recipe nothing says where the tool was
    done = highside(*arguments, path=tmp_path)
    assert done.returncode == 2 and "nothing says where the tool was" in done.stderr


def visits(effects: dict[str, dict[str, float]], path: Path) -> None:
    """A recording of seven fixtures, each visited eight times while it grows warm and cold again."""
    rng = np.random.default_rng(5)
    inc, tf = attitude_block(rng.standard_normal((3, 7)))
    fixture = np.concatenate([rng.permutation(7) for _ in range(8)])
    t_s, temp_c = 30.0 * np.arange(56), 40 + 20 * np.sin(np.arange(56) / 9.0)
    state = ChainState.build(inc[fixture], tf[fixture], t_s=t_s, temp_c=temp_c)
    mean = ForwardModel.of({"bias": {"b_x": 1e-3, "b_y": -2e-3}, **effects}).predict(state)
    accel = np.repeat(mean, 50, axis=1) + 4e-4 * rng.standard_normal((3, 56 * 50))
    times = (t_s[:, None] + np.arange(50) / 50).reshape(-1)
    rows = np.column_stack([times, *accel, np.repeat(temp_c, 50), np.repeat(fixture, 50)])
    np.savetxt(path, rows, "%.17g", ",", header="t_s,ax_g,ay_g,az_g,temp_c,fixture", comments="")


def test_reference_of_the_recipe_with_its_own_noise_needs_no_attitude(tmp_path: Path) -> None:
    recipe = blocks("A reference with its own noise")
    assert len(recipe) == 2
    path = patched(recipe, tmp_path / "src")
    known, recording = tmp_path / "known.toml", tmp_path / "visits.csv"
    known.write_text('[sensor]\nfree = ["bias", "scale", "misalignment"]\n')
    arguments = ("diagnose", recording, "--model", known, "--out", tmp_path / "report")
    for effects in ({}, {"temperature_bias": {"bt_x": 2e-5}}):
        visits(effects, recording)
        done = highside(*arguments, path=path)
        assert done.returncode == 0, done.stderr
        found = json.loads((tmp_path / "report" / "diagnosis.json").read_text())
        assert found["verdict"] == ("named" if effects else "nothing_left_out")
    (claim,) = found["claims"]
    bt_x = claim["parameters"]["bt_x"]
    assert claim["effect"] == "temperature_bias" and bt_x["low"] < 2e-5 < bt_x["high"] < bt_x["low"] + 4e-6
    lacking = {entry["effect"]: entry["why"] for entry in found["not_testable"]}
    assert "the same at every return" in lacking["quadratic"]
    # without the recipe nothing says where the tool was
    done = highside(*arguments, path=tmp_path)
    assert done.returncode == 2 and "nothing says where the tool was" in done.stderr
