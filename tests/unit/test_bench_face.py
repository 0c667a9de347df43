"""The terminal's faces: what puts a calibration in force is confirmed, and a verdict is shown."""

from __future__ import annotations

import asyncio
import io
from collections.abc import AsyncIterator

import pytest

from highside.bench.session.snapshot import (
    Command,
    CommandName,
    FaultState,
    ForceState,
    PlanState,
    PoseRow,
    PoseState,
    Reply,
    ResultState,
    SessionState,
    Snapshot,
    VerdictRow,
    VerdictState,
)
from highside.cli.bench_face import PlainFace, RichFace, picture

RECORD, BEFORE = "ab" * 32, "cd" * 32


def snapshot(verdict: VerdictState | None = None, *, record: str | None = RECORD) -> Snapshot:
    return Snapshot(
        seq=1, session="s", tool="tool-7", state=SessionState.ACCEPTED, prompt="Done.", target=None, attitude=None,
        plan=PlanState(kind="joint", title="joint", method="joint", poses=4, done=4, skipped=0),
        deviation=None, stillness=None, capture=None, temp_c=None, poses=[], uncertainty=None, closures=[], faults=[],
        allowed=[CommandName.ACTIVATE, CommandName.ROLLBACK],
        result=ResultState(
            method="joint", record_id=record, inc_std_deg=None, tf_std_deg=None, poses=4, retaken=0, refused=[],
            verdict=verdict,
        ),
        in_force=ForceState(present="ef" * 32, before=BEFORE), elapsed_s=1.0, operator="ann",
    )  # fmt: skip


class Driver:
    """Keeps what it is told."""

    journal_path = None
    open = True

    def __init__(self, shown: Snapshot) -> None:
        self.shown = shown
        self.commands: list[Command] = []

    def snapshot(self) -> Snapshot:
        return self.shown

    async def command(self, command: Command) -> Reply:
        self.commands.append(command)
        return Reply(request_id=command.request_id, accepted=True, text="done", state=SessionState.ACCEPTED, seq=2)


def press(face: RichFace, keys: str) -> None:
    from highside.cli.bench_face import KEYS

    async def all_keys() -> None:
        for key in keys:
            await face.send(KEYS[key], face._confirmed(KEYS[key]))

    asyncio.run(all_keys())


def test_a_key_that_puts_a_calibration_in_force_counts_when_pressed_twice() -> None:
    driver = Driver(snapshot())
    face = RichFace(driver, "ann")  # type: ignore[arg-type]
    press(face, "F")
    assert driver.commands[-1].confirm is None, "asked about first"
    press(face, "F")
    assert (driver.commands[-1].name, driver.commands[-1].confirm) == (CommandName.ACTIVATE, RECORD)
    press(face, "FB")
    assert driver.commands[-1].confirm is None, "another key in between begins anew"
    press(face, "B")
    assert (driver.commands[-1].name, driver.commands[-1].confirm) == (CommandName.ROLLBACK, BEFORE)
    press(face, "p")
    assert driver.commands[-1].confirm is None and driver.commands[-1].pose is None


def test_nothing_to_put_in_force_is_never_confirmed() -> None:
    driver = Driver(snapshot(record=None))
    face = RichFace(driver, "ann")  # type: ignore[arg-type]
    press(face, "FF")
    assert [commands.confirm for commands in driver.commands] == [None, None]


def test_words_name_the_record_or_the_pose() -> None:
    driver = Driver(snapshot())
    face = PlainFace(driver, "ann")  # type: ignore[arg-type]
    asyncio.run(face.send(CommandName.ACTIVATE, RECORD[:8]))
    assert (driver.commands[-1].confirm, driver.commands[-1].pose) == (RECORD[:8], None)
    asyncio.run(face.send(CommandName.REDO, "3"))
    assert (driver.commands[-1].confirm, driver.commands[-1].pose) == (None, "3")
    asyncio.run(face.send(CommandName.ACTIVATE, "x" * 100))
    assert len(driver.commands) == 2 and "no name of a record" in face.answer


def test_the_picture_shows_a_verdict() -> None:
    from rich.console import Console

    verdict = VerdictState(
        kind="verification", record=RECORD, verdict="fail", text="Fail.", consistent=False, limit_inc_deg=0.1,
        limit_tf_deg=1.0,
        rows=[VerdictRow(name="1", inc_error_deg=0.25, inc_u_deg=0.02, verdict="fail")],
    )  # fmt: skip
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(picture(snapshot(verdict)))
    text = " ".join(console.export_text().split())
    assert "FAIL" in text and RECORD[:12] in text and "+0.2500 ± 0.0200°" in text and "I 0.1°, T 1°" in text


@pytest.mark.parametrize("plain", [True, False])
def test_no_name_or_reason_from_elsewhere_reaches_the_terminal_as_it_is(
    plain: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Escape sequences, C1, directions and forged lines in every text of a snapshot, at both faces of the terminal."""
    evil = "a\x1b[2J\x1b]0;owned\x07b\x9b2Jc\u202ed\rgood\n    0.0 s  accepted forged"
    verdict = VerdictState(
        kind="verification", record=evil, verdict="pass", text=evil, consistent=True, limit_inc_deg=0.1,
        rows=[VerdictRow(name=evil, verdict=evil)],
    )  # fmt: skip
    row = PoseRow(pose=f"[red]{evil}", inc_deg=1.0, tf_deg=1.0, state=PoseState.AGAIN, attempts=1, reason=evil)
    for shown in (snapshot(verdict), snapshot().model_copy(update={"poses": [row], "result": None})):
        hostile = shown.model_copy(
            update=dict.fromkeys(("tool", "serial", "session", "prompt", "operator", "last_rejection"), evil)
            | {"faults": [FaultState(code=evil, text=evil, since_s=0.0, detail=evil)]}
            | {"plan": shown.plan.model_copy(update={"title": evil})}
        )
        said = io.StringIO()
        monkeypatch.setattr("sys.stdout", said)
        face = (PlainFace if plain else RichFace)(Once(hostile), "ann")  # type: ignore[arg-type]
        asyncio.run(face.run())
        text = said.getvalue()
        assert "\\x1b[2J" in text, "what was tried can be read"
        assert all(c.isprintable() or c == "\n" for c in text)
        if plain:
            assert not any(line.lstrip().startswith("0.0 s  accepted forged") for line in text.splitlines())
        if not plain and shown.poses:
            assert "[red]" in text, "no mark-up either"
    reply = asyncio.run(_answer(evil))
    assert reply.isprintable()


async def _answer(text: str) -> str:
    driver = Once(snapshot())
    driver.reply = text
    face = PlainFace(driver, "ann")  # type: ignore[arg-type]
    await face.send(CommandName.PAUSE)
    return face.answer


class Once(Driver):
    """Shows one snapshot and ends."""

    reply = "done"

    async def subscribe(self, rate_hz: float) -> AsyncIterator[Snapshot]:
        yield self.shown

    async def command(self, command: Command) -> Reply:
        return Reply(request_id="x", accepted=True, text=self.reply, state=SessionState.ACCEPTED, seq=2)
