"""The sentences of sessions and services that the pages show: made there in English, with what was measured in them.

They travel in snapshots and messages, which programs and terminals read too, and are told in the reader's language
where they are shown (`words.told`). `%(name)s` stands for what changes; that may be one of these sentences itself. A
test holds the reasons of a session against this list, and sees whole sessions in a language of its own.
"""

from __future__ import annotations

from highside.words import sentences_of_records
from highside.words.marks import said_later

PROMPTS = (
    said_later("Ended: the result was rejected. The journal keeps what was measured."),
    said_later("Aborted. The journal keeps what was measured."),
    said_later("Clamp the tool, check that the table is level, then choose Start (%(plan)s)."),
    said_later("Paused: choose Go on; what has been measured is kept."),
    said_later("Hands off: measuring."),
    said_later("Hands off: measuring %(pose)s (inclination %(inc)s, toolface %(tf)s)."),
    said_later("At the pose: let it come to rest."),
    said_later("At the pose %(pose)s (inclination %(inc)s, toolface %(tf)s): let it come to rest."),
    said_later("Lay the tool down in an attitude that is new, and let go; %(done)s taken, %(more)s more are needed."),
    said_later(
        "Lay the tool down in an attitude that is new, and let go; %(done)s taken, accept when you have enough."
    ),
    said_later("Set %(pose)s (inclination %(inc)s, toolface %(tf)s)."),
    said_later("Set %(pose)s (inclination %(inc)s, toolface %(tf)s): %(how)s."),
    said_later(
        "Set %(pose)s (inclination %(inc)s, toolface %(tf)s) again: turn away from it first, then set it with care."
    ),
    said_later(
        "Set %(pose)s (inclination %(inc)s, toolface %(tf)s): it reads like pose %(other)s, where the tool stands; turn"
        " the table away first."
    ),
    said_later("One moment."),
    said_later("One moment: the calibration is being computed."),
    said_later("Bring the tool to %(temp)s deg C; the session goes on by itself once that is steady."),
    said_later("Bring the tool to %(temp)s deg C, now %(now)s; the session goes on by itself once that is steady."),
    said_later("Done: the verdict on calibration %(record)s is kept."),
    said_later("Done: the result is accepted and kept."),
    said_later("Done: calibration %(record)s is kept."),
    said_later("It is not in force until somebody puts it in force."),
    said_later("Calibration %(record)s is in force: a running service takes it at its next reload."),
    said_later("No calibration follows: %(why)s."),
    said_later("No verdict follows: %(why)s."),
    said_later("Measure the poses named again, or reject."),
    said_later("Calibration %(record)s: %(verdict)s"),
    said_later("Accept or reject."),
    said_later("The poses still contradict one another: look at the list, then accept, redo a pose, or reject."),
    said_later("All poses are taken; nothing was named to be judged by them."),
    said_later("All poses are taken and agree: I within %(inc)s deg (1 sigma); accept or reject."),
    said_later("%(done)s poses were taken, %(needed)s are needed"),
    said_later("no pose was taken"),
    said_later("not solved"),
)
"""What to do next (`session.view.prompt`)."""

WAYS = (
    said_later("hold it there"),
    said_later("raise %(angle)s deg"),
    said_later("lower %(angle)s deg"),
    said_later("turn %(angle)s deg clockwise"),
    said_later("turn %(angle)s deg counterclockwise"),
    said_later("turn %(turn)s deg clockwise, raise %(angle)s deg"),
    said_later("turn %(turn)s deg clockwise, lower %(angle)s deg"),
    said_later("turn %(turn)s deg counterclockwise, raise %(angle)s deg"),
    said_later("turn %(turn)s deg counterclockwise, lower %(angle)s deg"),
    said_later("no readings"),
    said_later("no pose requested"),
    said_later("at the pose"),
)
"""How to get to a pose (`session.guidance.instruction`)."""

PLANS = (
    said_later("balance at %(inclinations)s deg"),
    said_later("conventional, %(count)s positions"),
    said_later("joint, %(count)s poses"),
    said_later("joint, %(count)s poses by advice"),
    said_later("turntable, full turns at %(inclinations)s deg"),
    said_later("%(plan)s at %(temperatures)s C"),
    said_later("verification"),
    said_later("roll test at %(inclination)s deg"),
    said_later("%(plan)s of calibration %(record)s"),
    said_later("poses of %(file)s"),
    said_later("custom"),
    said_later("attitudes by hand"),
)
"""Titles of plans (`session.plans`)."""

TIMES = (
    said_later("less than a minute"),
    said_later("about %(minutes)s min"),
    said_later("about %(hours)s h %(minutes)s min"),
    said_later("%(done)s of %(poses)s poses"),
    said_later("%(done)s poses"),
)
"""How far a session is (`session.time_to_go`, `bench.journal_file`)."""

REASONS = (
    said_later("The tool moved while it was being measured. Keep hands off; it is measured again by itself."),
    said_later("The readings shook more than this sensor does at rest. Look for vibration near the bench."),
    said_later("The reading drifted during the hold: clamp the table, then wait until it has settled."),
    said_later("The tool left the requested pose before the measurement was done."),
    said_later("This pose has been measured already. Turn to the pose shown, or choose Redo."),
    said_later("The hold was too short to average. Leave the tool until the bar is full."),
    said_later("The tool's data stopped during the hold. Check the cable; the pose is measured again."),
    said_later("The readings do not change at all: the sensor or its converter is stuck. Power the tool off and on."),
    said_later("Readings were lost or reordered during the hold. The pose is measured again."),
    said_later("The readings at rest are far from 1 g. Check the units and the axis mapping in the configuration."),
    said_later("Rate sensors and accelerometers turn opposite ways: two axes are swapped or one sign is wrong."),
    said_later("The temperature left the step during the hold. Wait until it is steady again."),
    said_later("The reading contradicts the other poses. Set the pose again and look at table, clamp and scale."),
    said_later("The four readings at this inclination contradict one another. Set this pose again with care."),
    said_later("The solution had to leave this pose out. Set it again with care."),
    said_later("The pose could not be written to the disk. Free the disk; it is measured again."),
    said_later("Taken back by the operator."),
    said_later("The session was interrupted during this pose. It is measured again."),
    said_later("That cannot be done at this step."),
    said_later("Another holds this session, or it was taken elsewhere. Ask them, or let them pause it."),
    said_later("There is no pose of that name in this plan."),
    said_later("There is nothing left to take back."),
    said_later("The tool is not still, or not at an open pose."),
    said_later("Say who you are: a command needs an operator's name."),
    said_later("There is no solution to accept. Measure the poses requested, or reject the session."),
    said_later("The journal cannot be written. Free the disk; nothing was changed."),
    said_later("This session has made no calibration that could be put in force."),
    said_later("This calibration is in force already."),
    said_later("There is no earlier calibration to go back to."),
    said_later(
        "Confirm it: name (`confirm`) the record that is to be in force, by the first 6 digits of its id or more."
    ),
    said_later("The calibration store has refused, and nothing was changed."),
    said_later("That request_id was another command's. Give each command an id of its own."),
    said_later("No data from the tool. Check power and cable; the session waits."),
    said_later("The link is down and is being tried again. The session waits."),
    said_later("The tool does not come to rest. Keep hands off and look for vibration near the bench."),
    said_later("Readings are being lost on the way from the tool. Look at the cable and the baud rate."),
    said_later(
        "The reading fits no open pose, but it would fit with axes swapped or signs changed. Check the axis mapping."
    ),
    said_later(
        "Another pose than the one requested was recognised. That is allowed; if the table does stand at the pose that"
        " was requested, the axes are swapped: abort and check the axis mapping."
    ),
    said_later(
        "The tool reads the same at more than one setting of this plan (the table turned to either side); which one it"
        " stands at cannot be determined. Such a pose is measured on request: set the one shown."
    ),
    said_later("Nothing has happened for a long time. The session waits; pause it if you leave."),
    said_later("The temperature is not yet steady at this step. The session waits."),
    said_later("The plan goes by temperature, but the tool sends none. Abort and choose another plan."),
    said_later("The poses still contradict one another after being repeated. Accept only if you know why."),
    said_later("The journal cannot be written; nothing is taken until the disk is free again."),
    said_later("The computer's clock was set during the session. Times in the record follow the new clock."),
    said_later("The tool moved while it was being measured."),
    said_later("%(what)s (%(found)s)"),
    said_later("pose %(pose)s: %(why)s"),
    said_later("requested %(one)s, found %(other)s"),
    said_later("%(sigmas)s standard deviations from what the other poses predict"),
    said_later("axes %(axes)s would fit"),
    said_later("%(seconds)s s of the tool's time"),
)
"""Why a pose was not taken, a command refused, what is wrong (`session.reasons`), and what was found out."""

VERDICTS = (
    said_later("Pass: all %(count)s poses are within the limits, uncertainty included."),
    said_later("Fail: %(failed)s of %(count)s poses are beyond a limit by more than the uncertainty."),
    said_later("Undecided: the calibration does not hold at %(out)s of %(count)s poses."),
    said_later("Verify within its zones, or calibrate there."),
    said_later("Undecided: %(open)s of %(count)s poses are too near a limit for the uncertainty of this comparison."),
    said_later("pass"),
    said_later("fail"),
    said_later("undecided"),
    said_later("not covered"),
)

ANSWERS = (
    said_later("A note has 1 to %(most)s letters, and an operator."),
    said_later("There are %(most)s notes already: begin anew, or write them elsewhere."),
    said_later("The note is in the journal."),
    said_later("Say who you are: the field Operator is empty."),
    said_later("The photograph is kept with the session (SHA-256 %(digits)s)."),
    said_later("Not kept: %(why)s."),
    said_later("that is no photograph that can be read (JPEG, PNG or WebP; %(error)s): take it again"),
    said_later("the photograph is too large: %(most)s MB at most; send it smaller"),
    said_later("the photograph has too many points: %(most)s million at most"),
    said_later("the picture is too small: %(least)s points at least on each side"),
    said_later("there are %(most)s photographs of this session already"),
    said_later("It is %(record)s."),
)
"""What the driver of a session answers."""

COMMANDS = (
    said_later("Start"),
    said_later("Take now"),
    said_later("Accept"),
    said_later("Go on"),
    said_later("Pause"),
    said_later("Redo last"),
    said_later("Skip"),
    said_later("Undo"),
    said_later("Reject"),
    said_later("Abort"),
    said_later("Put in force"),
    said_later("Roll back"),
)
"""What stands on the buttons (`session.labels`)."""

EVENTS = (
    said_later("calibration %(present)s in force, before it %(earlier)s"),
    said_later("flag %(name)s"),
    said_later("flag %(name)s is over"),
    said_later("alarm %(name)s"),
    said_later("alarm %(name)s is over"),
    said_later("survey accepted"),
    said_later("survey refused"),
    said_later("survey refused: %(why)s"),
    said_later("watch: %(verdict)s"),
    said_later("is online"),
    said_later("is offline"),
)
"""What is noted of a tool (`tools.state`)."""

ALARMS = (
    said_later("The counts of bytes do not add up: a fault of the program; keep the log."),
    said_later("The counts of frames do not add up: a fault of the program; keep the log."),
    said_later("The counts of messages do not add up: a fault of the program; keep the log."),
    said_later("The link is gone: cable, adapter, permission; the log names it."),
    said_later(
        "The codec's decoder failed within the last hour on what it was given, `codec.faults` times; what it "
        "was given then is lost. The log says why: tell the maker of the codec."
    ),
    said_later("The link is open and silent: power and wiring of the tool."),
    said_later("No connection to the broker; messages wait on disk."),
    said_later(
        "Another client uses this tool's MQTT client id, or the broker sheds us: `broker.taken` says which. "
        "Stop one of the two, or give it its own `tool.id`."
    ),
    said_later("More commands came in the last minute than can be answered: find who sends them."),
    said_later("The outbox cannot write to the disk; messages wait in memory."),
    said_later(
        "The outbox's files were deleted or replaced within the last hour, while in use, and begun anew: "
        "keep others out of the state directory; the log says what was set aside."
    ),
    said_later(
        "Another highside uses the same state directory, which was deleted or replaced while in use: stop one of "
        "the two."
    ),
    said_later(
        "Messages were dropped within the last hour, `outbox.dropped` says why: more room (`[mqtt.outbox]`), "
        "or the broker back."
    ),
    said_later(
        "The wall clock was set within the last hour, `clock.last_step_s` says by how much: the `t` of "
        "messages before and after it are not of one clock."
    ),
    said_later("The recorder cannot write to the disk."),
    said_later("Surveys cannot be written to the disk; they are tried again."),
    said_later("No calibration was ever put in force in the configured store; readings pass uncorrected."),
    said_later("The configured calibration was refused, `calibration.refused` says why."),
    said_later("The calibration of before stays in force in memory: fix the configured one before a restart."),
    said_later(
        "The calibration in force expires one day, and whether that has come cannot be determined: the clock "
        "is not synchronised, or was set. It is used; fix the host's time (NTP, PTP, GPS)."
    ),
    said_later("The rotor-angle compensation was refused, `rotation.refused` says why."),
    said_later("The compensation of before stays in force in memory: fix the configured one before a restart."),
    said_later("The last reload was refused, `reload.refused` says why; the configuration before is in force."),
    said_later("This accelerometer gives one and the same value."),
    said_later("Every reading is the same: a dead converter."),
    said_later(
        "The log of toolface offsets cannot be read, or was lost; the offset before is in force, after a "
        "start none: `highside toolface set`."
    ),
    said_later(
        "The calibration in force does not hold any more, `watch` says what, how much and what to do; the "
        "command `acknowledge` ends the alarm."
    ),
    said_later("What the watch knew was not taken up, or cannot be kept, or it has failed; `watch.error` says why."),
    said_later("What is known of the azimuth was not taken up, or cannot be kept; `drift.error` says why."),
    said_later("A file of the state directory was damaged and set aside; `damaged` names it."),
    said_later("The service has ended at least three times within ten minutes; `starts.last` says by what."),
    said_later("Gtotal of the surveys drifts: run `diagnose`."),
    said_later("A WITS output has an error and nobody is connected to it."),
)
"""What the alarms of a service mean (`service.alarms`)."""

SENTENCES = (
    PROMPTS + WAYS + PLANS + TIMES + REASONS + VERDICTS + ANSWERS + COMMANDS + EVENTS + ALARMS
) + sentences_of_records.SENTENCES
