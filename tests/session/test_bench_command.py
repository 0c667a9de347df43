"""`highside calibrate bench`: whole sessions through a real pty, killed, gone on with, wrongly used."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from dataclasses import replace
from pathlib import Path

import pytest
from rehearsal import Rehearsal

from highside.bench.journal_file import JournalFile, session_name
from highside.bench.session import outcome, plans
from highside.bench.session.entries import TakenPose
from highside.bench.session.journal import read_journal
from highside.recording.calibration_store import CalibrationStore, read_record

HIGHSIDE = str(Path(sys.executable).with_name("highside"))
CONFIG = Path(__file__).resolve().parents[2] / "config" / "bench-simulated.toml"
KEYS = {"record", "inc_error_deg", "tf_error_deg", "inc_std_deg", "tf_std_deg", "poses", "retaken"}

PLANS = {
    "balance": ('{kind="balance",inclinations_deg=[10.0]}', 4),
    "conventional": ('{kind="conventional",positions=6}', 6),
    "joint": ('{kind="joint",poses=8}', 8),
    "turntable": ('{kind="turntable",inclinations_deg=[30,80],stations=8}', 16),
    "oven": ('{kind="oven",temperatures_c=[25,45,25],inclinations_deg=[20,80],toolfaces_deg=[0,120,240]}', 18),
    "heated_roll": ('{kind="heated_roll",temperatures_c=[30,40],inclination_deg=60}', 8),
    "unguided": ('{kind="unguided",min_poses=12}', 20),
    "verification": ('{kind="verification",limit_inc_deg=0.1,limit_tf_deg=1}', 12),
    "roll_test": ('{kind="roll_test",inclination_deg=45,limit_inc_deg=0.3}', 8),
}
QUICK = ["simulated.speed=25", "simulated.oven_tau_s=10", "session.soak_s=10", "session.std_error_g=3e-5"]


def arguments(tmp_path: Path, *extra: str, sets: list[str] = QUICK) -> list[str]:
    store = [f"store.directory={tmp_path / 'store'}", f"store.sessions={tmp_path / 'sessions'}"]
    options = [word for item in [*sets, *store] for word in ("--set", item)]
    return [HIGHSIDE, "calibrate", "bench", "--config", str(CONFIG), *extra, *options]


def run(*command: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=timeout)


JUDGING = ("verification", "roll_test")


def in_force(store: Path, **changes: object) -> str:
    """Put a good calibration of the simulated tool in force; its id."""
    done = Rehearsal(plans.joint_plan(12, plans.Limits(std_error_g=3e-5, min_hold_s=1.0, max_hold_s=4.0))).run()
    assert done.session.solved is not None
    header = replace(done.header, tool_id="bench-demo", serial=None)
    header = replace(header, **changes)  # type: ignore[arg-type]
    record = outcome.make_record(header, done.session.ledger, done.session.solved, time.time())
    CalibrationStore(store).activate(record, now_s=time.time())
    return record.id


@pytest.mark.parametrize("kind", PLANS)
def test_a_session_of_each_plan_through_a_pty(kind: str, tmp_path: Path) -> None:
    plan, poses = PLANS[kind]
    judged = in_force(tmp_path / "store") if kind in JUDGING else None
    done = run(*arguments(tmp_path, "--auto", "--plain", sets=[*QUICK, f"plan={plan}"]))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert set(found) == KEYS | ({"verdict", "judged"} if kind in JUDGING else set())
    assert found["poses"] == poses and found["retaken"] == 0
    (journal_path,) = (tmp_path / "sessions").glob("*.journal")
    journal = read_journal(journal_path.read_bytes())
    _, _, replayed = outcome.replay(journal)
    if kind in JUDGING:
        assert found["record"] is None and replayed is None
        assert (found["verdict"], found["judged"]) == ("pass", judged)
        assert f"calibration {judged[:12]} is kept. Pass" in done.stdout  # type: ignore[index]
        return
    record = read_record(Path(found["record"]))
    assert replayed is not None and replayed.to_json() == record.to_json()
    table = tmp_path / "store" / "turntables" / "simulated-bench.json"
    assert table.is_file() is (kind == "turntable")
    # one session of one seed: three times what is stated (the statistics are those of a hundred seeds)
    assert found["inc_error_deg"] <= 3 * found["inc_std_deg"]
    assert found["tf_error_deg"] <= 3 * found["tf_std_deg"]


def test_a_session_that_nobody_can_command_ends(tmp_path: Path) -> None:
    """No terminal, no page, no broker: it would wait for ever."""
    done = subprocess.run(arguments(tmp_path), stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("highside: standard input: has ended") and "--web" in line
    piped = subprocess.run(arguments(tmp_path, "--plain"), input="", capture_output=True, text=True, timeout=60)
    assert (piped.returncode, piped.stderr) == (2, done.stderr)


def test_the_end_of_what_was_typed_is_said_and_ends_nothing(tmp_path: Path) -> None:
    command = arguments(tmp_path, "--plain")
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as it:
        assert it.stdin is not None and it.stdout is not None and it.stderr is not None
        it.stdin.write("start\n")
        it.stdin.close()
        try:
            assert it.stderr.readline().startswith("the input has ended: nothing more can be typed here")
            assert any(" 1/16 poses" in line for line in it.stdout), "the session goes on"
            it.send_signal(signal.SIGINT)
            assert it.stdout.read() is not None
            assert "--resume" in it.stderr.read()
        finally:
            it.kill()


def test_the_shipped_bench_takes_less_than_45_seconds(tmp_path: Path) -> None:
    start = time.monotonic()
    done = run(*arguments(tmp_path, "--auto", sets=[]))
    took = time.monotonic() - start
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert Path(found["record"]).is_file() and found["poses"] == 16
    assert took < 45.0
    assert found["inc_error_deg"] < 0.005 and found["tf_error_deg"] < 0.02


def test_mistakes_through_the_pty_are_mended(tmp_path: Path) -> None:
    sets = [*QUICK, f"plan={PLANS['joint'][0]}", 'simulated.mistakes={1="unplug",3="knock",5="wrong_tf"}']
    done = run(*arguments(tmp_path, "--auto", "--plain", sets=sets))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["poses"] == 8 and found["inc_error_deg"] <= 3 * found["inc_std_deg"]
    assert "link is down" in done.stdout or "No data from the tool" in done.stdout


def test_killed_and_gone_on_with(tmp_path: Path) -> None:
    command = arguments(tmp_path, "--auto", "--plain")
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if "5/16 poses" in line:
            break
    process.kill()
    process.wait()
    (journal_path,) = (tmp_path / "sessions").glob("*.journal")
    before = [line.id for line in read_journal(journal_path.read_bytes()).ledger().done]
    assert len(before) >= 5
    done = run(*arguments(tmp_path, "--auto", "--plain", "--resume"))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["poses"] == 16 and found["inc_error_deg"] <= 3 * found["inc_std_deg"]
    assert len(list((tmp_path / "sessions").glob("*.journal"))) == 1
    ledger = read_journal(journal_path.read_bytes()).ledger()
    assert [line.id for line in ledger.done][: len(before)] == before
    nothing = run(*arguments(tmp_path, "--auto", "--resume"))
    assert nothing.returncode == 2
    assert "no unfinished session" in nothing.stderr and len(nothing.stderr.splitlines()) == 1


def left_at(tmp_path: Path, poses: int, t_wall_s: float = 1_795_000_000.0) -> str:
    """The journal of a session of sixteen poses whose process ended when so many were taken; its name."""
    taken = Rehearsal(plans.joint_plan(16, plans.Limits(std_error_g=3e-5, min_hold_s=1.0, max_hold_s=4.0)))
    taken.run(on_step=lambda _: None, limit_s=10_000.0)
    directory = tmp_path / "sessions"
    name = session_name(directory, "bench-demo", t_wall_s)
    header = replace(taken.header, tool_id="bench-demo", serial=None, session=name, t_wall_s=t_wall_s)
    file = JournalFile.create(directory, header)
    for entry in taken.entries:
        file.write(entry, t_wall_s)
        if isinstance(entry, TakenPose):
            poses -= 1
        if not poses:
            break
    file.close()
    return name


def ended(process: subprocess.Popen[str], text: str, *, number: int = signal.SIGINT) -> str:
    """Read on until a line holds `text`, send a signal; what stands on stderr."""
    assert process.stdout is not None
    assert any(text in line for line in process.stdout), text
    process.send_signal(number)
    return process.communicate(timeout=30)[1]


def test_a_session_that_was_forgotten_is_offered_named_and_found_again(tmp_path: Path) -> None:
    """Ended with poses taken, then begun anew by mistake: the new one, without a pose, is never gone on with."""
    with_poses = left_at(tmp_path, 12)
    how = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    said = ended(subprocess.Popen(arguments(tmp_path, "--plain"), **how), "choose Start")  # type: ignore[call-overload]
    assert f"session {with_poses} of " in said and "has 12 of 16 poses and is left as it is" in said
    assert f"--resume {with_poses}" in said, "it says how to go on"
    assert "no pose was taken" in said, "of the new one"

    listed = run(HIGHSIDE, "calibrate", "sessions", *arguments(tmp_path)[3:])
    assert listed.returncode == 0, listed.stderr
    assert len(listed.stdout.splitlines()) == 2
    (line,) = (line for line in listed.stdout.splitlines() if line.startswith(with_poses))
    assert "12 of 16 poses" in line and "unfinished" in line and "joint, 16 poses" in line
    assert "not begun" in listed.stdout

    for words in (("--resume",), ("--resume", with_poses)):
        process = subprocess.Popen(arguments(tmp_path, "--plain", *words), **how)  # type: ignore[call-overload]
        said = ended(process, "12/16 poses")
        assert process.returncode == 130
        assert f"12 poses are kept. Go on: highside calibrate bench --config {CONFIG} --resume {with_poses}" in said
    assert len(list((tmp_path / "sessions").glob("*.journal"))) == 2

    other = run(*arguments(tmp_path, "--auto", "--plain", "--resume", "nobody"))
    assert other.returncode == 2 and "--resume: there is no session 'nobody'" in other.stderr
    unasked = run(*arguments(tmp_path, "--auto", "--plain", with_poses))
    assert unasked.returncode == 2 and f"--resume {with_poses}" in unasked.stderr


def test_a_session_that_is_over_is_not_offered(tmp_path: Path) -> None:
    over = left_at(tmp_path, 99)
    rows = json.loads(run(HIGHSIDE, "calibrate", "sessions", *arguments(tmp_path)[3:], "--json").stdout)
    assert [(row["session"], row["done"]) for row in rows] == [(over, 16)]
    (tmp_path / "store" / "records").mkdir(parents=True)
    ended_with = read_journal((tmp_path / "sessions" / f"{over}.journal").read_bytes()).ledger().ended
    assert ended_with is not None
    assert rows[0]["resumable"], "its record is not in the store yet"
    (tmp_path / "store" / "records" / f"{ended_with.record}.json").write_text("{}")
    rows = json.loads(run(HIGHSIDE, "calibrate", "sessions", *arguments(tmp_path)[3:], "--json").stdout)
    assert (rows[0]["state"], rows[0]["resumable"]) == ("accepted", False)
    again = run(*arguments(tmp_path, "--auto", "--plain", "--resume", over))
    assert again.returncode == 2 and f"session {over} is accepted" in again.stderr


@pytest.mark.parametrize(("answer", "journals"), [(b"\n", 1), (b"n\n", 2)])
def test_on_a_terminal_it_asks_whether_to_go_on(tmp_path: Path, answer: bytes, journals: int) -> None:
    name = left_at(tmp_path, 2)
    master, slave = pty.openpty()
    process = subprocess.Popen(
        arguments(tmp_path, "--plain"), stdin=slave, stdout=slave, stderr=slave, env=os.environ | {"TERM": "dumb"}
    )
    seen = b""
    end = time.monotonic() + 60.0

    def wait_for(text: bytes) -> None:
        nonlocal seen
        while text not in seen:
            assert time.monotonic() < end, (text, seen[-2000:])
            seen += os.read(master, 65536) if select.select([master], [], [], 0.2)[0] else b""

    try:
        wait_for(f"session {name} of ".encode())
        wait_for(b"has 2 of 16 poses: go on? [Y/n]")
        os.write(master, answer)
        wait_for(b"2/16 poses" if journals == 1 else b"choose Start")
        process.send_signal(signal.SIGINT)
        wait_for(b"2 poses are kept. Go on:" if journals == 1 else b"no pose was taken")
        assert process.wait(20) == 130
        assert len(list((tmp_path / "sessions").glob("*.journal"))) == journals
    finally:
        process.kill()
        process.wait()
        os.close(master)
        os.close(slave)


def test_an_operator_at_the_terminal_types_his_commands(tmp_path: Path) -> None:
    """Lines in, lines out: start, a wrong word, skip, pause, resume, abort; exit status 1."""
    process = subprocess.Popen(
        arguments(tmp_path, "--plain", "--operator", "ann"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        bufsize=1,
    )
    assert process.stdin is not None and process.stdout is not None

    def say(words: str, expected: str) -> None:
        process.stdin.write(words + "\n")  # type: ignore[union-attr]
        for line in process.stdout:  # type: ignore[union-attr]
            if expected in line:
                return
        raise AssertionError(expected)

    say("start", "> Start: done")
    say("dance", "one of Start")
    say("skip 3", "> Skip: done")
    say("redo 99", "no pose of that name")
    say("pause", "> Pause: done")
    say("go on", "> Go on: done")
    say("abort", "> Abort: done")
    process.stdin.close()
    assert process.wait(20) == 1


def test_ctrl_c_leaves_a_session_that_can_be_gone_on_with(tmp_path: Path) -> None:
    process = subprocess.Popen(arguments(tmp_path, "--auto", "--plain"), stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if "2/16 poses" in line:
            break
    os.kill(process.pid, signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 130
    (journal_path,) = (tmp_path / "sessions").glob("*.journal")
    ledger = read_journal(journal_path.read_bytes()).ledger()
    assert ledger.ended is None and len(ledger.done) >= 2


def test_a_failed_verification_ends_with_exit_status_1(tmp_path: Path) -> None:
    in_force(tmp_path / "store")
    sets = [*QUICK, f"plan={PLANS['roll_test'][0]}", "simulated.offset_g=[0.02,-0.0008,0.0015]"]
    done = run(*arguments(tmp_path, "--auto", "--plain", sets=sets))
    assert done.returncode == 1, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["verdict"] == "fail"
    assert "range of I: +" in done.stdout and "Fail: I varies by" in done.stdout


@pytest.mark.parametrize(
    ("plan", "tool", "says"),
    [
        (PLANS["verification"][0], None, "has no calibration in force for tool 'bench-demo'"),
        (PLANS["verification"][0], "tool-8", "(it has one of 'tool-8')"),
        ('{kind="verification",limit_tf_deg=3}', None, "plan.limit_inc_deg"),
        ('{kind="roll_test",limit_inc_deg=1,record="0123456789"}', "bench-demo", "no record 0123456789"),
        ('{kind="roll_test",limit_inc_deg=1,record_file="/does/not/exist.json"}', None, "no such file"),
    ],
)
def test_nothing_to_judge_is_said_in_one_line(plan: str, tool: str | None, says: str, tmp_path: Path) -> None:
    if tool is not None:
        in_force(tmp_path / "store", tool_id=tool)
    elif "store" not in says:
        (tmp_path / "store").mkdir()
    done = run(*arguments(tmp_path, "--auto", sets=[*QUICK, f"plan={plan}"]))
    assert done.returncode in (1, 2), done.stdout
    assert says in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
    assert not list(tmp_path.glob("sessions/*")), "no journal was begun"


@pytest.mark.parametrize(
    ("item", "says"),
    [
        ('plan={kind="balance",inclinations_deg=[90.0]}', "plan.inclinations_deg"),
        ('plan={kind="dance"}', "'dance' is unknown"),
        ("plan.positions=6", "plan.positions"),
        ("session.min_hold_s=-1", "session.min_hold_s"),
        ('simulated.mistakes={a="sleep"}', "simulated.mistakes"),
        ('link={kind="serial",port="/dev/none"}', "either [link]"),
        ('plan={kind="custom",file="/does/not/exist.csv"}', "no such file"),
    ],
)
def test_what_is_wrong_with_the_configuration_is_said_in_one_line(item: str, says: str, tmp_path: Path) -> None:
    done = run(*arguments(tmp_path, "--auto", sets=[item]))
    assert done.returncode == 2, done.stdout
    assert says in done.stderr and len(done.stderr.splitlines()) == 1


def test_poses_of_a_table_are_a_plan(tmp_path: Path) -> None:
    table = tmp_path / "poses.csv"
    table.write_text("inc_ref_deg,tf_ref_deg\n20,0\n20,120\n20,240\n80,60\n80,180\n")
    done = run(*arguments(tmp_path, "--auto", "--plain", sets=[*QUICK, f'plan={{kind="custom",file="{table}"}}']))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["poses"] == 5


def test_the_live_picture_takes_single_keys_on_a_terminal(tmp_path: Path) -> None:
    """Started on a terminal: it draws, s starts, p pauses, g goes on, Q aborts, and the terminal is as it was."""
    master, slave = pty.openpty()
    before = termios.tcgetattr(slave)
    process = subprocess.Popen(
        arguments(tmp_path, "--operator", "ann"),
        stdin=slave,
        stdout=slave,
        stderr=slave,
        env=os.environ | {"TERM": "xterm"},
    )
    seen = b""

    def wait_for(text: bytes) -> None:
        nonlocal seen
        end = time.monotonic() + 30.0
        while text not in seen:
            assert time.monotonic() < end, (text, seen[-2000:])
            if select.select([master], [], [], 0.2)[0]:
                seen += os.read(master, 65536)
        seen = b""

    try:
        wait_for(b"choose Start")
        os.write(master, b"s")
        wait_for(b"Start: done")
        os.write(master, b"p")
        wait_for(b"Paused")
        os.write(master, b"g")
        wait_for(b"Go on: done")
        os.write(master, b"Q")
        wait_for(b"Aborted")
        assert process.wait(20) == 1
        assert termios.tcgetattr(slave) == before
    finally:
        process.kill()
        process.wait()
        os.close(master)
        os.close(slave)


def test_the_picture_stands_once_when_the_session_is_over(tmp_path: Path) -> None:
    """What is said at the end is part of the picture: written past it, it left a second head behind."""
    from screen import screen

    pytest.importorskip("nicegui")
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 100, 0, 0))
    process = subprocess.Popen(
        arguments(tmp_path, "--operator", "ann", "--web", sets=[*QUICK, "web.port=0"]),
        stdin=slave, stdout=slave, stderr=slave, env=os.environ | {"TERM": "xterm"},
    )  # fmt: skip
    seen = b""

    def wait_for(text: bytes) -> None:
        nonlocal seen
        end = time.monotonic() + 40.0
        while text not in seen:
            assert time.monotonic() < end, (text, seen[-2000:])
            if select.select([master], [], [], 0.2)[0]:
                seen += os.read(master, 65536)

    try:
        wait_for(b"choose Start")
        os.write(master, b"Q")
        wait_for(b"until Ctrl-C")
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        process.wait(20)
        while select.select([master], [], [], 0.2)[0]:
            seen += os.read(master, 65536)
        shown = screen(seen)
        assert sum("highside  aborted" in line for line in shown) == 1, "\n".join(shown)
        assert not any("highside  idle" in line for line in shown), "\n".join(shown)
        assert sum("the session is over" in line for line in shown) == 1
    finally:
        process.kill()
        process.wait()
        os.close(master)
        os.close(slave)
