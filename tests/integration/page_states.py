"""Every state of the bench page as a snapshot that never changes, and the page that shows them one after the other.

As a program it serves the real page over a driver that shows what standard input names, one state a line; the first
line it prints is the page's link.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator

from pydantic import SecretStr

from highside.bench.session.driver import Kept
from highside.bench.session.reasons import Fault, Rejection
from highside.bench.session.snapshot import (
    AttitudeState,
    Capture,
    ClosureState,
    Command,
    CommandName,
    Deviation,
    FaultState,
    ForceState,
    PlanState,
    PoseRow,
    PoseState,
    Reply,
    ResultState,
    SessionState,
    Snapshot,
    StillnessState,
    Target,
    UncertaintyState,
    VerdictRow,
    VerdictState,
)
from highside.config.web import WebTable

RECORD, BEFORE = "3fa9" * 16, "77c1" * 16
MEASURING = [CommandName.REDO, CommandName.SKIP, CommandName.UNDO, CommandName.PAUSE, CommandName.ABORT]
U = UncertaintyState(
    inc_deg=[1.0, 5.0, 15.0, 30.0, 60.0, 90.0], inc_std_deg=[0.0016, 0.0015, 0.0013, 0.0011, 0.0009, 0.0008],
    tf_std_deg=[0.09, 0.018, 0.006, 0.003, 0.0017, 0.0015], rms_inc_std_deg=0.0011, rms_tf_std_deg=0.0021,
)  # fmt: skip


def row(k: int, state: PoseState = PoseState.OPEN, text: str | None = None) -> PoseRow:
    """Pose k of twelve."""
    taken = state is PoseState.DONE
    return PoseRow(
        pose=str(k), inc_deg=(5.0, 45.0, 120.0)[(k - 1) // 4], tf_deg=45.0 + 90.0 * ((k - 1) % 4), state=state,
        attempts=int(state is not PoseState.OPEN), std_error_g=4.2e-6 + 1e-7 * k if taken else None,
        readings=900 if taken else 0, sigmas=0.3 + 0.1 * k if taken else None, text=text,
        reason=None if text is None else "outlier",
    )  # fmt: skip


def rows(done: int, **other: PoseRow) -> list[PoseRow]:
    made = [row(k, PoseState.DONE if k <= done else PoseState.OPEN) for k in range(1, 13)]
    return [other.get(f"pose_{r.pose}", r) for r in made]


def shown(name: str, state: SessionState, prompt: str, done: int, **more: object) -> Snapshot:
    """Where the tool is on its way to the next pose, unless `more` says otherwise."""
    asked = row(min(done + 1, 12))
    base = Snapshot(
        seq=1, session=name, tool="tool-7", serial="0042", state=state, prompt=prompt,
        plan=PlanState(kind="joint", title="joint, 12 poses", method="joint", poses=12, done=done, skipped=0),
        target=Target(pose=asked.pose, inc_deg=asked.inc_deg or 0.0, tf_deg=asked.tf_deg or 0.0),
        attitude=AttitudeState(inc_deg=41.37, tf_deg=118.42, g_total=0.99987),
        deviation=Deviation(inc_deg=3.63, tf_deg=16.58, angle_deg=11.9, tolerance_deg=0.61),
        stillness=StillnessState(value=14.2, still=False, noise_g=(2e-4, 2e-4, 2e-4), trace_step_s=0.25,
                            trace=[0.8, 0.7, 1.2, 9.0, 30.0, 25.0, 18.0, 14.2]),
        capture=None, temp_c=25.3, poses=rows(done), uncertainty=U if done > 5 else None, closures=[], faults=[],
        last_rejection=None, operator="A. Technician", allowed=MEASURING, result=None, elapsed_s=754.0,
        to_go_s=56.0 * (12 - done) if done > 2 else None,
    )  # fmt: skip
    return base.model_copy(update=more)


def result(**more: object) -> ResultState:
    made = ResultState(
        method="joint", record_id=None, inc_std_deg=0.0011, tf_std_deg=0.0021, poses=12, retaken=1, refused=[],
        remarks=["The bench is tilted by 0.021 deg; the calibration is free of it."],
    )  # fmt: skip
    return made.model_copy(update=more)


NOWHERE: dict[str, object] = {"attitude": None, "deviation": None, "stillness": None, "temp_c": None}
OVER: dict[str, object] = {"target": None, "deviation": None, "uncertainty": U, "to_go_s": None}
RING = ClosureState(inc_deg=45.0, size_g=38e-6, p=0.41, good=True, poses=["5", "6", "7", "8"])
BAD_RING = ClosureState(inc_deg=5.0, size_g=2.1e-3, p=1e-9, good=False, poses=["1", "2", "3", "4"], worst="3")
AGAIN = row(3, PoseState.AGAIN, f"{Rejection.OUTLIER.text} (9.4 standard deviations from what the other poses predict)")
VERDICT = VerdictState(
    kind="verification", record=RECORD, verdict="fail", limit_inc_deg=0.1, limit_tf_deg=1.0, consistent=False,
    text="Fail: 1 of 3 poses are beyond a limit by more than the uncertainty.",
    rows=[
        VerdictRow(name=str(k), inc_error_deg=0.03 * k, inc_u_deg=0.031, tf_error_deg=-0.2 * k, tf_u_deg=0.12,
                   verdict="pass" if k < 3 else "fail")
        for k in (1, 2, 3)
    ],
)  # fmt: skip

OVEN = PlanState(kind="oven", title="over temperature, 12 poses", method="joint", poses=12, done=6, skipped=0,
                 stage=1, stages=2, stage_temp_c=70.0)  # fmt: skip
SET_6 = "Set 6 (inclination 45, toolface 135): turn 17 deg clockwise, raise 3.6 deg."
PAGES = {
    s.session: s
    for s in (
        shown(
            "idle", SessionState.IDLE,
            "Clamp the tool, check that the table is level, then choose Start (joint, 12 poses).",
            0, target=None, deviation=None, operator=None, elapsed_s=0.0,
            allowed=[CommandName.START, CommandName.ABORT],
        ),
        shown(
            "soaking", SessionState.SOAKING,
            "Bring the tool to 70 deg C, now 25.3; the session goes on by itself once that is steady.",
            6, target=None, deviation=None, plan=OVEN,
            poses=[one.model_copy(update={"temp_c": 25.0 if k < 6 else 70.0}) for k, one in enumerate(rows(6))],
        ),
        shown("guiding", SessionState.GUIDING, SET_6, 5),
        shown(
            "measuring", SessionState.CAPTURING, "Hands off: measuring 6 (inclination 45, toolface 135).", 5,
            attitude=AttitudeState(inc_deg=44.98, tf_deg=135.03, g_total=1.00012),
            deviation=Deviation(inc_deg=0.02, tf_deg=-0.03, angle_deg=0.03, tolerance_deg=0.61),
            stillness=StillnessState(value=0.6, still=True, noise_g=None,
                                     trace=[9.0, 2.0, 0.9, 0.6], trace_step_s=0.25),
            capture=Capture(progress=0.62, elapsed_s=7.0, readings=700, std_error_g=7.1e-6, target_std_error_g=5e-6),
            allowed=[CommandName.CAPTURE, *MEASURING],
        ),
        shown("done", SessionState.SETTLING, "At the pose 9 (inclination 120, toolface 45): let it come to rest.", 8,
              closures=[RING]),
        shown(
            "again", SessionState.GUIDING,
            "Set 3 (inclination 5, toolface 225) again: turn away from it first, then set it with care.",
            8, target=Target(pose="3", inc_deg=5.0, tf_deg=225.0), poses=rows(8, pose_3=AGAIN), closures=[BAD_RING],
        ),
        shown("skipped", SessionState.GUIDING, "Set 8 (inclination 45, toolface 315): turn 17 deg clockwise.", 7,
              poses=rows(7, pose_2=row(2, PoseState.SKIPPED), pose_6=row(6, PoseState.SKIPPED))),
        shown(
            "no-data", SessionState.NO_DATA,
            Fault.LINK_DOWN.text, 5, last_rejection=Rejection.DATA_LOST.text, **NOWHERE,
            faults=[FaultState(code="link_down", text=Fault.LINK_DOWN.text, since_s=9.0, detail="ttyUSB0 is gone")],
            poses=rows(5, pose_6=row(6, PoseState.OPEN, Rejection.DATA_LOST.text)),
        ),
        shown(
            "alarm", SessionState.GUIDING, SET_6, 5,
            last_rejection=Rejection.MOVED.text,
            faults=[
                FaultState(code="lost_frames", text=Fault.LOST_FRAMES.text, since_s=9.0, detail="+0.31 s"),
                FaultState(code="axes_suspect", text=Fault.AXES_SUSPECT.text, since_s=9.0, detail="x-zy"),
            ],
        ),
        shown("paused", SessionState.PAUSED, "Paused: choose Go on; what has been measured is kept.", 5,
              allowed=[CommandName.RESUME, CommandName.REDO, CommandName.UNDO, CommandName.ABORT]),
        shown("solving", SessionState.SOLVING, "One moment: the calibration is being computed.", 12,
              allowed=[CommandName.ABORT], **OVER),
        shown(
            "review", SessionState.REVIEW,
            "All poses are taken and agree: I within 0.0011 deg (1 sigma); accept or reject.",
            12, result=result(), closures=[RING], **OVER,
            allowed=[CommandName.ACCEPT, CommandName.REDO, CommandName.UNDO, CommandName.REJECT],
        ),
        shown(
            "not-solved", SessionState.REVIEW,
            "No calibration follows: the poses do not determine the scale of x. Measure"
            " the poses named again, or reject.", 12, poses=rows(12, pose_3=AGAIN), **OVER,
            result=result(inc_std_deg=None, tf_std_deg=None, refused=["The scale of x is not determined."]),
            allowed=[CommandName.REDO, CommandName.UNDO, CommandName.REJECT],
        ),
        shown(
            "verdict", SessionState.REVIEW,
            f"Calibration {RECORD[:12]}: 2 of 3 poses are within limits. Accept or reject.",
            12, result=result(verdict=VERDICT, remarks=[]), allowed=[CommandName.ACCEPT, CommandName.REJECT], **OVER,
        ),
        shown(
            "accepted", SessionState.ACCEPTED,
            f"Done: calibration {RECORD[:12]} is kept. It is not in force until somebody"
            " puts it in force.", 12, result=result(record_id=RECORD), in_force=ForceState(present=BEFORE, before=None),
            closures=[RING], allowed=[CommandName.ACTIVATE], **OVER,
        ),
        shown(
            "in-force", SessionState.ACCEPTED,
            f"Calibration {RECORD[:12]} is in force: a running service takes it at its next"
            " reload.", 12, result=result(record_id=RECORD), in_force=ForceState(present=RECORD, before=None),
            closures=[RING], allowed=[], **OVER,
        ),
        shown("rejected", SessionState.REJECTED, "Ended: the result was rejected. The journal keeps what was measured.",
              12, result=result(), closures=[RING], allowed=[], **OVER),
        shown("aborted", SessionState.ABORTED,
              "Aborted. The journal keeps what was measured.", 5, target=None, allowed=[],
              to_go_s=None, **NOWHERE),
    )
}  # fmt: skip


class Slides:
    """A session's driver that shows one snapshot until told to show another."""

    journal_path = None
    open = True

    def __init__(self) -> None:
        self._now = PAGES["idle"]
        self._seq = 1
        self._turned = asyncio.Event()

    def snapshot(self) -> Snapshot:
        return self._now

    def turn(self, name: str) -> None:
        self._seq += 1
        self._now = PAGES[name].model_copy(update={"seq": self._seq})
        turned, self._turned = self._turned, asyncio.Event()
        turned.set()

    async def subscribe(self, max_rate_hz: float = 10.0) -> AsyncIterator[Snapshot]:
        while True:
            turned = self._turned
            yield self._now
            await turned.wait()

    async def remark(self, operator: str, text: str) -> Kept:
        return Kept(True, "kept")

    async def command(self, command: Command) -> Reply:
        return Reply(request_id=command.request_id, accepted=True, text="done", state=self._now.state, seq=self._seq)


class _Settings(WebTable):
    def read_token(self) -> SecretStr:
        return SecretStr("a token for pictures alone")


async def serve() -> None:
    from highside.web.server import BenchPage

    slides = Slides()
    page = BenchPage(slides, _Settings(port=0), operator="A. Technician")
    await page.start()
    print(page.link, flush=True)
    try:
        while name := (await asyncio.to_thread(sys.stdin.readline)).strip():
            slides.turn(name)
    finally:
        await page.stop()


if __name__ == "__main__":
    asyncio.run(serve())
