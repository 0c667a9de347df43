"""The watch in the service: a tool on a pty, `highside run`, a real mosquitto, a shock that leaves an offset.

The tool's time runs many times faster than ours: stands of a rest and a turn, half an hour apart, in a few seconds.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
import threading
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from broker import Mosquitto, free_port
from daemon import HIGHSIDE, Daemon, Operator, Pty, Subscriber, running, wait_for
from prometheus_client.parser import text_string_to_metric_families

import highside
from highside.arrays import Array
from highside.codec.tool import encode
from highside.recording.calibration_store import CalibrationStore
from highside.service.messages import AttitudeMessage
from highside.service.watch_messages import WatchHistory, WatchMessage, WatchReply
from tests.unit.watch_frames import poses_of_a_good_tool, rows_of_a_well

pytestmark = pytest.mark.slow

STANDS, STEP_AT, STEP_G = 30, 6, 2e-3
"""while the hole builds from 5 to 85 deg: a spread of inclinations names what departs"""
RATE_HZ = 25
ROWS = 150 * RATE_HZ
"""of a stand"""
HOLDS, AGAIN = 8, 4
"""stands under the proposal, and under the record of before after it was taken back"""
LATER = HOLDS + AGAIN


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    with Mosquitto(tmp_path / "broker") as mosquitto:
        yield mosquitto


@pytest.fixture(scope="module")
def well() -> dict[str, Array]:
    step = {"step_g": (STEP_G, 0.0, 0.0), "step_at": STEP_AT}
    return rows_of_a_well(3, stands=STANDS, inclinations_deg=(5.0, 85.0), rate_hz=RATE_HZ, **step)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def longer_well(well: dict[str, Array]) -> dict[str, Array]:
    """The same tool goes on, its offset where the shock left it, while the inclination falls to 25 deg again."""
    on = rows_of_a_well(3, stands=LATER, inclinations_deg=(85.0, 25.0), rate_hz=RATE_HZ, step_g=(STEP_G, 0.0, 0.0))
    on["t_s"] = on["t_s"] + 1800.0 * STANDS
    return {name: np.concatenate([well[name], on[name]]) for name in well}


@pytest.fixture(scope="module")
def calibration() -> highside.Calibration:
    return highside.calibrate(poses_of_a_good_tool(1), "joint", tool="HS-1", temp_c=25.0)


@pytest.fixture
def store(tmp_path: Path, calibration: highside.Calibration) -> Path:
    folder = tmp_path / "calibrations"
    CalibrationStore(folder).activate(calibration.record, now_s=1.7e9)
    return folder


class Tool:
    """Sends the rows of a well over a pty, stand by stand; where the offset steps, the readings of a shock too."""

    def __init__(self, rows: dict[str, Array], rows_a_stand: int = ROWS) -> None:
        self.pty = Pty()
        self._rows_a_stand = rows_a_stand
        self.sent = self.shocks = 0
        self._rows = rows
        self._t = 0.0

    def stands(self, first: int, stop: int) -> None:
        data = bytearray()
        for k in range(first * self._rows_a_stand, stop * self._rows_a_stand):
            if k == STEP_AT * ROWS:
                # beyond the range in which readings are believed, a moment before the stand
                data += self._frame(float(self._rows["t_s"][k]) - 0.05, (25.0, 0.1, 1.0), (0.0, 0.0, 0.0))
                self.shocks += 1
            a = [float(self._rows[name][k]) for name in ("ax_g", "ay_g", "az_g")]
            w = [float(self._rows[name][k]) for name in ("gx_dps", "gy_dps", "gz_dps")]
            data += self._frame(float(self._rows["t_s"][k]), a, w)
        writer = threading.Thread(target=self.pty.write_all, args=(bytes(data),))
        writer.start()
        writer.join(120.0)
        assert not writer.is_alive()

    def _frame(self, t_s: float, a: Any, w: Any) -> bytes:
        self.sent += 1
        return encode(self.sent - 1, t_s, a, gyro_dps=w, temp_c=25.0)


@pytest.fixture
def tool(well: dict[str, Array]) -> Iterator[Tool]:
    made = Tool(well)
    yield made
    made.pty.close()


def config(folder: Path, tool: Tool, broker: Mosquitto, store: Path, extra: str = "") -> Path:
    path = folder / "highside.toml"
    path.write_text(
        f'[tool]\nid = "HS-1"\n[link]\nkind = "serial"\nport = "{tool.pty.path}"\nstale_after_s = 0.0\n'
        f'[codec]\nname = "tool"\n'
        f'[pipeline]\noutput_rate_hz = 0.5\naveraging_s = 1.0\n[calibration]\nstore = "{store}"\n'
        f"[site]\ngravity_mps2 = 9.81\n[mqtt]\nport = {broker.port}\n[recorder]\nenabled = false\n"
        f"[watch]\ninterval_s = 0.1\nsave_interval_s = 0.2\n{extra}"
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.2\n'
    )
    return path


def watch(ear: Subscriber) -> WatchMessage | None:
    found = ear.latest("watch")
    return None if found is None else WatchMessage.model_validate(found)


def after(ear: Subscriber, daemon: Daemon, stills: int, turns: int) -> WatchMessage:
    """What is said when so much has been used."""

    def enough() -> WatchMessage | None:
        said = watch(ear)
        return said if said is not None and said.stills >= stills and said.turns >= turns else None

    found = wait_for(enough, 60.0, f"{stills} rests and {turns} turns", daemon)
    assert isinstance(found, WatchMessage)
    return found


def alarms(ear: Subscriber) -> list[str]:
    health = ear.latest("health")
    return [] if health is None else list(health["alarms"])


def flagged(ear: Subscriber) -> list[bool]:
    return ["calibration_departs" in AttitudeMessage.model_validate(one).flags for one in ear.payloads("attitude")]


def in_force(ear: Subscriber) -> str | None:
    health = ear.latest("health")
    return None if health is None else health["calibration"]["cal_id"]


def reload(daemon: Daemon, ear: Subscriber, cal_id: str) -> None:
    """SIGHUP, and wait until that record is in force."""
    daemon.process.send_signal(signal.SIGHUP)
    wait_for(lambda: in_force(ear) == cal_id, 20.0, f"record {cal_id[:12]} in force", daemon)


def highside_says(*arguments: object, status: int = 0) -> str:
    done = subprocess.run(
        [str(HIGHSIDE), *map(str, arguments)], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == status, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


def saved_stills(file: Path) -> int:
    return int(json.loads(file.read_text())["state"]["facts"]["stills"])


def is_whole(file: Path) -> bool:
    try:
        return bool(json.loads(file.read_text()))
    except ValueError:
        return False


def acknowledged_on_disk(file: Path) -> bool:
    return bool(json.loads(file.read_text())["state"]["acknowledged"])


def test_a_shock_that_leaves_an_offset_is_said_flagged_and_outlives_a_kill(
    tmp_path: Path, broker: Mosquitto, tool: Tool, store: Path
) -> None:
    path = config(tmp_path, tool, broker, store)
    ear = Subscriber(broker.port)
    operator = Operator(broker.port, "highside/HS-1/watch", ear, WatchReply)
    try:
        with running(path) as daemon:
            first = wait_for(lambda: watch(ear), 60.0, "the first word of the watch", daemon)
            assert first.verdict == "learning"
            assert first.began == "began from the record"
            tool.stands(0, STEP_AT)
            said = after(ear, daemon, STEP_AT, STEP_AT - 1)
            assert said.verdict == "holds"
            assert next(one["verdict"] for one in ear.payloads("watch")) == "learning"
            assert "calibration_departs" not in alarms(ear)
            assert not any(flagged(ear))
            refused = operator.say(daemon, command="acknowledge")
            assert not refused.ok
            assert "nothing departs (holds)" in str(refused.error)

            tool.stands(STEP_AT, STEP_AT + 4)
            said = after(ear, daemon, STEP_AT + 4, STEP_AT + 3)
            assert said.verdict == "departs"
            (claim,) = said.claims
            assert "b_x" in claim.equivalence_class
            size = said.parameters["b_x"] if claim.parameter != "b_x" else claim
            assert abs((size.size if size is claim else size.value) - STEP_G) < 4.0 * size.std  # type: ignore[union-attr]
            assert claim.error is not None
            assert np.hypot(claim.error.inc_deg, claim.error.tf_sin_inc_deg) > 0.05
            assert said.advice
            wait_for(lambda: "calibration_departs" in alarms(ear), 10.0, "the alarm", daemon)
            tool.stands(STEP_AT + 4, STEP_AT + 5)
            wait_for(lambda: any(flagged(ear)[-75:]), 20.0, "attitudes at rest with the flag", daemon)
            said = after(ear, daemon, STEP_AT + 5, STEP_AT + 4)
            (claim,) = said.claims
            assert operator.say(daemon, command="acknowledge").ok
            wait_for(lambda: "calibration_departs" not in alarms(ear), 10.0, "the end of the alarm", daemon)
            # nothing is lost
            health = ear.latest("health")
            assert health is not None
            assert health["monitor"]["received"] == tool.sent
            assert health["monitor"]["out_of_range"] == tool.shocks == 1
            assert health["monitor"]["gap"] == 0
            assert all(health["balance"].values())
            assert health["watch"]["dropped"] == 0
            wait_for(lambda: acknowledged_on_disk(tmp_path / "state" / "watch.json"), 10.0, "a saved state", daemon)
            daemon.kill()
        seqs = [one["seq"] for one in ear.payloads("attitude")]
        assert seqs == list(range(seqs[0], seqs[0] + len(seqs)))

        ear.drain()
        mark = len(ear.payloads("watch"))
        with running(path) as daemon:
            wait_for(lambda: len(ear.payloads("watch")) > mark, 60.0, "the watch after the kill", daemon)
            again = watch(ear)
            assert again is not None
            assert again.began.startswith("taken up again, ")
            assert (again.verdict, again.stills) == ("departs", said.stills)
            assert again.claims[0].acknowledged
            assert again.claims[0].size == claim.size
            assert operator.say(daemon, command="restart").ok
            wait_for(lambda: (now := watch(ear)) and now.verdict == "learning" and not now.stills, 10.0, "a new begin")
            daemon.process.send_signal(signal.SIGTERM)
            assert daemon.process.wait(10.0) == 0
    finally:
        operator.close()
        ear.close()


@pytest.mark.timeout(300)
def test_a_person_puts_the_proposal_in_force_and_takes_it_back_while_the_service_runs(
    tmp_path: Path, broker: Mosquitto, longer_well: dict[str, Array], calibration: highside.Calibration, store: Path
) -> None:
    """Learning, holds, departs; proposed, activated, holds under it; rolled back, departs again. Nothing is lost."""
    tool = Tool(longer_well)
    path = config(tmp_path, tool, broker, store)
    state, proposed = tmp_path / "state" / "watch.json", tmp_path / "proposed.json"
    ear = Subscriber(broker.port)
    first = calibration.record.id
    try:
        with running(path) as daemon:
            wait_for(lambda: watch(ear), 60.0, "the first word of the watch", daemon)
            # too soon: nothing is proposed, and nothing written
            tool.stands(0, STEP_AT)
            assert after(ear, daemon, STEP_AT, STEP_AT - 1).verdict == "holds"
            wait_for(lambda: state.exists() and saved_stills(state) == STEP_AT, 10.0, "a saved state", daemon)
            refused = highside_says("watch", "propose", state, "--store", store, "-o", proposed, status=2)
            assert "nothing departs (holds)" in refused
            # one rest may be noise; the turn after it, which ends with the next stand, tells
            tool.stands(STEP_AT, STEP_AT + 1)
            said = after(ear, daemon, STEP_AT + 1, STEP_AT)
            assert (said.verdict, said.undecided) == ("learning", 1)
            tool.stands(STEP_AT + 1, STEP_AT + 2)
            said = after(ear, daemon, STEP_AT + 2, STEP_AT + 1)
            assert said.verdict == "departs"
            assert len(said.claims[0].equivalence_class) > 1
            wait_for(lambda: saved_stills(state) == STEP_AT + 2, 10.0, "a saved state", daemon)
            refused = highside_says("watch", "propose", state, "--store", store, "-o", proposed, status=2)
            assert "not told apart by the attitudes seen" in refused
            assert not proposed.exists()

            # the build of the hole names it
            tool.stands(STEP_AT + 2, STANDS)
            said = after(ear, daemon, STANDS, STANDS - 1)
            (claim,) = said.claims
            assert (claim.effect, claim.parameter, claim.equivalence_class) == ("bias_step", "b_x", ["b_x"])
            # of the present attitude, at rest: what an offset of x does there
            assert claim.error is not None
            assert said.toolface_deg is not None
            assert said.inclination_deg is not None
            tf, inc = np.radians(said.toolface_deg), np.radians(said.inclination_deg)
            does = np.degrees(claim.size) * np.array([np.cos(inc) * np.cos(tf), -np.sin(tf)])
            assert [claim.error.inc_deg, claim.error.tf_sin_inc_deg] == pytest.approx(does, rel=1e-3)
            assert abs(claim.size - STEP_G) < 4.0 * claim.std
            wait_for(lambda: saved_stills(state) == STANDS, 10.0, "a saved state", daemon)
            assert "not in force" in highside_says("watch", "propose", state, "--store", store, "-o", proposed)
            record = highside.Calibration.load(proposed).record
            assert (record.content["valid"], record.content["parent"]) == ("in-hole", first)
            assert in_force(ear) == first
            reload(daemon, ear, first)
            assert (again := watch(ear)) is not None
            assert (again.verdict, again.cal_id) == ("departs", first)

            # a person puts it in force
            highside_says("calibrate", "activate", proposed, "--store", store)
            reload(daemon, ear, record.id)
            said = wait_for(lambda: (w := watch(ear)) and w.cal_id == record.id and w, 10.0, "the new watch", daemon)
            assert said.began == f"began anew: the calibration is another one ({record.id[:12]})"
            assert (said.verdict, said.stills, said.claims) == ("learning", 0, [])
            # the picture of the last day goes on, with a mark
            shown = wait_for(lambda: (h := history_said(ear)) and h.cal_id == record.id and h, 10.0, "history", daemon)
            assert len(shown.times) >= STANDS
            assert [(one.before, one.cal_id, one.why) for one in shown.changes] == [(first, record.id, said.began)]
            wait_for(lambda: "calibration_departs" not in alarms(ear), 10.0, "the end of the alarm", daemon)
            tool.stands(STANDS, STANDS + HOLDS)
            said = after(ear, daemon, HOLDS, HOLDS - 1)
            assert said.verdict == "holds"
            assert abs(said.parameters["b_x"].value) < 4.0 * said.parameters["b_x"].std
            ours = [
                one for one in map(AttitudeMessage.model_validate, ear.payloads("attitude")) if one.cal_id == record.id
            ]
            assert len(ours) > 10
            assert not any("calibration_departs" in one.flags for one in ours)

            # and takes it back: the record of before does not fit the tool any more
            highside_says("calibrate", "rollback", "--store", store, "--tool", "HS-1")
            reload(daemon, ear, first)
            said = wait_for(
                lambda: (w := watch(ear)) and w.cal_id == first and w.stills == 0 and w, 10.0, "anew", daemon
            )
            assert said.verdict == "learning"
            tool.stands(STANDS + HOLDS, STANDS + LATER)
            said = after(ear, daemon, AGAIN, AGAIN - 1)
            assert said.verdict == "departs"
            assert "b_x" in said.claims[0].equivalence_class
            wait_for(lambda: "calibration_departs" in alarms(ear), 10.0, "the alarm", daemon)

            # nothing was lost over two changes of the record, and the books are balanced
            wait_for(lambda: (h := ear.latest("health")) and h["monitor"]["received"] == tool.sent, 20.0, "all", daemon)
            health = ear.latest("health")
            assert health is not None
            assert health["monitor"]["out_of_range"] == tool.shocks == 1
            assert health["monitor"]["gap"] == 0
            # at each of the two changes the stretch that was being collected was of the record before, and is counted
            assert health["watch"]["dropped"] <= 2
            assert health["codec"]["bytes_junk"] == 0
            assert all(health["balance"].values())
            assert health["reload"] == {"count": 3, "refused": None}
            assert daemon.terminate() == 0
            assert "Traceback" not in daemon.log
        wait_for(lambda: any(t.endswith("/status") and p == b"offline" for t, p, *_ in ear.drain()), 10.0, "the end")
        seqs = [one["seq"] for one in ear.payloads("attitude")]
        assert seqs == list(range(seqs[0], seqs[0] + len(seqs)))
        history = [(one.action, one.record_id) for one in CalibrationStore(store).history("HS-1")]
        assert history == [("activate", first), ("activate", record.id), ("rollback", first)]
    finally:
        ear.close()
        tool.pty.close()


def test_what_the_service_says_of_the_last_day_outlasts_a_kill_and_the_dashboard_finds_its_metrics(
    tmp_path: Path, broker: Mosquitto, tool: Tool, store: Path
) -> None:
    port = free_port()
    path = config(tmp_path, tool, broker, store, f"[metrics]\nport = {port}\n")
    state = tmp_path / "state" / "watch.json"
    ear = Subscriber(broker.port)
    try:
        with running(path) as daemon:
            wait_for(lambda: ear.latest("watch/history"), 60.0, "the first word", daemon)
            tool.stands(0, STANDS)
            said = after(ear, daemon, STANDS, STANDS - 1)
            assert said.verdict == "departs"
            wait_for(lambda: saved_stills(state) == STANDS, 10.0, "a saved state", daemon)
            enough = lambda: (h := history_said(ear)) and len(h.times) >= STANDS and h  # noqa: E731
            found = wait_for(enough, 10.0, "the history", daemon)
            # a point a stand, half an hour apart, ending now
            hours = (np.array(found.times) - found.t) / 3600.0
            assert hours[0] == pytest.approx(-0.5 * (STANDS - 1), abs=0.1)
            for name, one in said.parameters.items():
                if name in found.parameters:
                    assert found.parameters[name].std[-1] == pytest.approx(one.std, rel=1e-3)
                    assert found.parameters[name].value[-1] == pytest.approx(one.value, rel=1e-3, abs=1e-12)
            shift = np.array(found.parameters["b_x"].value)
            assert shift[-1] - shift[0] == pytest.approx(STEP_G, rel=0.5)
            assert found.evidence[-1] > found.threshold > found.evidence[0]
            dashboard = json.loads((Path(__file__).parents[2] / "config" / "grafana-dashboard.json").read_text())
            wait_for(lambda: (h := ear.latest("health")) and h["watch"]["verdict"] == "departs", 10.0, "health", daemon)
            assert_finds_the_watch(dashboard, port)
            daemon.kill()
        ear.drain()
        mark = len(ear.payloads("watch/history"))
        with running(path) as daemon:
            wait_for(lambda: len(ear.payloads("watch/history")) > mark, 60.0, "the history after the kill", daemon)
            again = history_said(ear)
            assert again is not None
            assert again.parameters == found.parameters
            assert daemon.terminate() == 0
    finally:
        ear.close()


def rig(folder: Path, tools: dict[str, Tool], broker: Mosquitto, store: Path) -> Path:
    """Configuration of several tools in one process."""
    path = folder / "rig.toml"
    path.write_text(
        f'[codec]\nname = "tool"\n[pipeline]\noutput_rate_hz = 0.5\naveraging_s = 1.0\n'
        f'[calibration]\nstore = "{store}"\n'
        f"[site]\ngravity_mps2 = 9.81\n[mqtt]\nport = {broker.port}\n[recorder]\nenabled = false\n"
        "[watch]\ninterval_s = 0.1\nsave_interval_s = 0.2\n"
        f'[service]\nstate_dir = "{folder / "state"}"\nhealth_interval_s = 0.2\n'
        + "".join(
            f'[[tools]]\nid = "{name}"\nlink = {{ kind = "serial", port = "{tool.pty.path}", stale_after_s = 0.0 }}\n'
            for name, tool in tools.items()
        )
    )
    return path


def test_of_two_tools_in_one_process_only_the_one_that_was_shaken_departs(
    tmp_path: Path, broker: Mosquitto, well: dict[str, Array], store: Path
) -> None:
    still = rows_of_a_well(3, stands=STANDS, inclinations_deg=(5.0, 85.0), rate_hz=RATE_HZ)
    second = highside.calibrate(poses_of_a_good_tool(2), "joint", tool="HS-2", temp_c=25.0)
    CalibrationStore(store).activate(second.record, now_s=1.7e9)
    tools = {"HS-1": Tool(well), "HS-2": Tool(still)}
    path = rig(tmp_path, tools, broker, store)
    ears = {name: Subscriber(broker.port, f"highside/{name}/#") for name in tools}
    try:
        with running(path) as daemon:
            for name, tool in tools.items():
                wait_for(lambda ear=ears[name]: watch(ear), 60.0, f"the watch of {name}", daemon)
                tool.stands(0, STEP_AT + 4)
            said = {name: after(ear, daemon, STEP_AT + 4, STEP_AT + 3) for name, ear in ears.items()}
            assert {name: one.verdict for name, one in said.items()} == {"HS-1": "departs", "HS-2": "holds"}
            assert said["HS-1"].cal_id != said["HS-2"].cal_id == second.record.id
            wait_for(lambda: "calibration_departs" in alarms(ears["HS-1"]), 10.0, "the alarm", daemon)
            assert "calibration_departs" not in alarms(ears["HS-2"])
            assert daemon.terminate() == 0
        for name, one in said.items():
            kept = json.loads((tmp_path / "state" / name / "watch.json").read_text())
            assert (kept["tool"], kept["said"]["verdict"]) == (name, one.verdict)
        for name, tool in tools.items():
            health = ears[name].latest("health")
            assert health is not None
            assert (health["monitor"]["received"], health["monitor"]["gap"]) == (tool.sent, 0)
            assert all(health["balance"].values())
    finally:
        for ear in ears.values():
            ear.close()
        for tool in tools.values():
            tool.pty.close()


def test_a_dead_a_stuck_and_a_saturated_axis_are_each_named_with_their_letter(
    tmp_path: Path, broker: Mosquitto, store: Path
) -> None:
    """Three tools in one process: after a good stand of four, each has an axis that reads gravity no more. Stands are
    as short as a turn that is used allows, and their rows as few."""
    whole = rows_of_a_well(3, stands=4, inclinations_deg=(40.0, 60.0), rate_hz=20, turns_s=45.0)
    broken = whole["t_s"] >= 1800.0
    cases = {
        "HS-1": ("ax_g", 0.0 * whole["ax_g"], ["dead axis x"]),
        "HS-2": ("ay_g", 0.0 * whole["ay_g"] + 0.31, ["stuck axis y", "saturation of y"]),
        "HS-3": ("ax_g", np.clip(whole["ax_g"], -0.4, 0.4), ["saturation of x"]),
    }
    rows_a_stand = whole["t_s"].size // 4
    tools = {
        name: Tool(whole | {at: np.where(broken, bad, whole[at])}, rows_a_stand) for name, (at, bad, _) in cases.items()
    }
    for name in ("HS-2", "HS-3"):
        own = highside.calibrate(poses_of_a_good_tool(1), "joint", tool=name, temp_c=25.0)
        CalibrationStore(store).activate(own.record, now_s=1.7e9)
    ears = {name: Subscriber(broker.port, f"highside/{name}/#") for name in tools}
    try:
        with running(rig(tmp_path, tools, broker, store)) as daemon:
            for name, tool in tools.items():
                wait_for(lambda ear=ears[name]: watch(ear), 60.0, f"the watch of {name}", daemon)
                tool.stands(0, 4)
            for name, (_, _, names) in cases.items():
                departed = lambda ear=ears[name]: (w := watch(ear)) and w.verdict == "departs" and w  # noqa: E731
                said = wait_for(departed, 60.0, f"the departure of {name}", daemon)
                (claim,) = said.claims
                assert (claim.parameter, claim.equivalence_class, claim.error) == ("length", names, None)
                assert "pull the tool" in said.advice[0]
                wait_for(lambda ear=ears[name]: "calibration_departs" in alarms(ear), 10.0, "the alarm", daemon)
            assert daemon.terminate() == 0
    finally:
        for ear in ears.values():
            ear.close()
        for tool in tools.values():
            tool.pty.close()


def history_said(ear: Subscriber) -> WatchHistory | None:
    found = ear.latest("watch/history")
    return None if found is None else WatchHistory.model_validate(found)


def assert_finds_the_watch(dashboard: dict[str, Any], port: int) -> None:
    """Each selector of a query of the watch has samples by the labels it asks for, and none of its names is missing."""
    scrape = urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10).read().decode()
    served: dict[str, list[dict[str, str]]] = {}
    for family in text_string_to_metric_families(scrape):
        for sample in family.samples:
            served.setdefault(sample.name, []).append(sample.labels)
    queries = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    of_the_watch = [query for query in queries if "highside_watch" in query]
    assert len(of_the_watch) == 12
    for query in of_the_watch:
        for name, labels in re.findall(r"(highside_watch\w+)\{([^}]*)\}", query):
            wanted = dict(re.findall(r'(\w+)=~"([^"]*)"', labels))
            assert wanted.pop("tool") == "$tool"
            assert {"tool", *wanted} <= served[name][0].keys(), query
            for asked in wanted.get("parameter", "").split("|"):
                assert not asked or any(one["parameter"] == asked for one in served[name]), (query, asked)


def retained(ear: Subscriber, name: str) -> bytes | None:
    """What the broker kept of a topic, if it has come."""
    kept = [payload for topic, payload, retained, _ in ear.drain() if retained and topic.endswith(f"/HS-1/{name}")]
    return kept[-1] if kept else None


def test_a_watch_that_is_switched_off_takes_its_retained_verdict_back(
    tmp_path: Path, broker: Mosquitto, tool: Tool, store: Path
) -> None:
    ear = Subscriber(broker.port)
    try:
        with running(config(tmp_path, tool, broker, store)) as daemon:
            wait_for(lambda: (said := watch(ear)) is not None and said.verdict == "learning", 60.0, "a verdict", daemon)
            config(tmp_path, tool, broker, store, "enabled = false\n")
            daemon.process.send_signal(signal.SIGHUP)
            wait_for(lambda: (said := watch(ear)) is not None and said.verdict == "off", 20.0, "off", daemon)
            # who comes later hears it too: it is what the broker keeps
            late = Subscriber(broker.port)
            try:
                said = wait_for(lambda: retained(late, "watch"), 20.0, "the retained verdict", daemon)
                seen = wait_for(lambda: retained(late, "watch/history"), 20.0, "the retained history", daemon)
                assert WatchMessage.model_validate_json(said).verdict == "off"
                assert WatchHistory.model_validate_json(seen).times == []
            finally:
                late.close()
            config(tmp_path, tool, broker, store)
            daemon.process.send_signal(signal.SIGHUP)
            wait_for(lambda: (said := watch(ear)) is not None and said.verdict == "learning", 20.0, "on again", daemon)
    finally:
        ear.close()


def test_a_damaged_state_is_set_aside_and_said(tmp_path: Path, broker: Mosquitto, tool: Tool, store: Path) -> None:
    state = tmp_path / "state"
    state.mkdir()
    (state / "watch.json").write_text('{"format": "highside.watch-state/1", "tool": "HS-1"}')
    ear = Subscriber(broker.port)
    try:
        with running(config(tmp_path, tool, broker, store)) as daemon:
            wait_for(lambda: "watch_state" in alarms(ear), 60.0, "the alarm", daemon)
            said = watch(ear)
            assert said is not None
            assert said.began == "began anew: what was kept is damaged"
            health = ear.latest("health")
            assert health is not None
            assert [one["file"] for one in health["damaged"]] == ["watch.json"]
            assert list(state.glob("watch.json.damaged-*"))
            # what is saved next is whole, and the alarm ends
            tool.stands(0, 2)
            wait_for(lambda: "watch_state" not in alarms(ear), 20.0, "the end of the alarm", daemon)
            assert np.isfinite(json.loads((state / "watch.json").read_text())["state"]["t_s"])
        # one character of what a running service had kept, still JSON and still numbers
        kept = bytearray((state / "watch.json").read_bytes())
        at = kept.index(b'"data"') + 40
        kept[at] = ord("B") if kept[at] == ord("A") else ord("A")
        (state / "watch.json").write_bytes(kept)
        with running(config(tmp_path, tool, broker, store)) as daemon:
            wait_for(lambda: "watch_state" in alarms(ear), 60.0, "the alarm of the second", daemon)
            again = watch(ear)
            assert again is not None
            assert again.began == said.began
            assert len(list(state.glob("watch.json.damaged-*"))) == 2
            # what is damaged while it runs is nothing that it reads: the next state replaces it
            (state / "watch.json").write_text("{")
            tool.stands(2, 3)
            wait_for(lambda: is_whole(state / "watch.json"), 20.0, "a whole state", daemon)
            assert saved_stills(state / "watch.json") >= 1
    finally:
        ear.close()
