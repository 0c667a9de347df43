"""The sentences that records, journals and their store hold or answer with: made there in English, kept in files, and
told in the reader's language where they are shown, as those of `sentences`."""

from __future__ import annotations

from highside.words.marks import said_later

STATES = (
    said_later("accepted"),
    said_later("accepted, its record not stored yet"),
    said_later("rejected"),
    said_later("aborted"),
    said_later("damaged"),
    said_later("in use"),
    said_later("unfinished"),
    said_later("not begun"),
    said_later("open"),
    said_later("done"),
    said_later("skipped"),
    said_later("again"),
    said_later("gravity"),
    said_later("bench"),
    said_later("photograph %(digits)s is missing or cannot be read"),
    said_later("photograph %(digits)s was changed after it was taken"),
)
"""Of sessions (`journal_file.found_journal`), their poses and photographs; what the angles of a record refer to."""

REMARKS = (
    said_later("pose %(pose)s"),
    said_later("pose %(pose)s (inclination %(inc)s, toolface %(tf)s deg)"),
    said_later("poses %(poses)s"),
    said_later("%(one)s and %(other)s are swapped: each reading fits the other's setting; both rejected"),
    said_later(
        "%(pose)s lies %(sigmas)s standard deviations from what the other poses predict; left out: measure it again"
    ),
    said_later("%(pose)s lies %(sigmas)s standard deviations from what the other poses predict; rejected"),
    said_later(
        "these poses cannot tell %(what)s; the stated uncertainty says so. The pose that would help most: inclination"
        " %(inc)s, toolface %(tf)s deg"
    ),
    said_later(
        "the poses scatter %(times)s times as much as their reading noise explains, along gravity too, where the bench"
        " cannot: noise that is not white, or physics that is not modelled"
    ),
    said_later(
        "the bench repeats in %(angle)s to %(found)s deg only, against %(stated)s deg stated; or physics that is not"
        " modelled looks like it"
    ),
    said_later(
        "the offset differs between the way up and the way down (%(sizes)s); half of it is in the stated uncertainty"
    ),
    said_later("made at %(temps)s C only: nothing is known of other temperatures"),
    said_later("the pose table states no noise; 50 ug a reading is assumed"),
    said_later(
        "the four readings at %(inc)s deg do not close by %(size)s mg (p = %(p)s): a wrong pose, a moved tool or"
        " physics that is not modelled; measure %(again)s again"
    ),
    said_later(
        "these poses do not show the zero offset; it is taken as zero within %(within)s mg: add poses with each axis"
        " down (six positions)"
    ),
    said_later(
        "these poses do not show the zero offset; it is taken as given within %(within)s mg: add poses with each axis"
        " down (six positions)"
    ),
    said_later(
        "|g| does not show a rotation of the triad: A is %(gauge)s; the axes may be turned by %(angle)s deg against the"
        " tool (1 sigma, in the stated uncertainty)"
    ),
    said_later("symmetric"),
    said_later("lower-triangular"),
    said_later(
        "at inclination %(inc)s deg there is no pose near toolface %(tf)s deg; balance needs 45, 135, 225 and 315 deg"
    ),
    said_later(
        "the reversed poses at %(inc)s deg are of use to the joint method only; omitted from balance",
    ),
    said_later(
        "balance at %(inc)s deg is refused: all four poses have gz near zero, so the axial row of the matrix is not"
        " determined and a corrected gz of zero would only look exact; use the joint or conventional method there"
    ),
    said_later(
        "balance at %(inc)s deg is refused: the poses differ by less than noise allows; use an inclination above 0.06"
        " deg"
    ),
    said_later("%(why)s (and %(count)s other inclinations for a like reason)"),
    said_later(
        "%(count)s poses are fewer than the 14 unknowns of sensor and bench need (three readings a pose); measure at"
        " least five poses, better four toolfaces at each of three inclinations"
    ),
    said_later(
        "the poses contradict one another by %(angle)s deg (worst: %(poses)s); check that readings and settings belong"
        " together, and measure again"
    ),
    said_later(
        "this is not a sensor of nominal axes and scale: %(rows)s, elements up to %(most)s from nominal; check axes,"
        " signs, units and the toolface zero"
    ),
    said_later("an offset of %(offset)s g is no accelerometer in order; check the units"),
    said_later("%(count)s poses cannot give the nine elements of a matrix; measure at least three"),
    said_later(
        "the %(count)s poses do not span three directions (condition %(condition)s); add poses that bring each axis"
        " along gravity"
    ),
    said_later(
        "matrix and offset cannot be separated from these poses; add poses at a second, very different inclination"
    ),
    said_later(
        "%(count)s poses for nine unknowns by |g| alone; hold the tool still in at least %(least)s different attitudes,"
        " better twenty"
    ),
    said_later(
        "the attitudes do not cover the sphere: offset and scale cannot be separated; add poses with the %(axis)s axis"
        " up, and down"
    ),
)
"""Remarks of the calibration methods (`calibration.remark`), and why one of them refuses."""

ANSWERS_OF_STORE = (
    said_later("calibration refused (%(reason)s): %(why)s"),
    said_later("record %(record)s is not put in force: %(why)s"),
    said_later("record %(record)s bears no signature, and only signed ones are accepted; see `highside keys sign`"),
    said_later("record %(record)s is signed with the key %(key)s (%(signer)s), which is not trusted here"),
    said_later("record %(record)s: the signature of %(signer)s is not of this content; use the original file"),
    said_later("record %(record)s is of tool %(tool)s, not of %(other)s"),
    said_later("record %(record)s is of serial number %(serial)s, not of %(other)s"),
    said_later("record %(record)s expired on %(date)s; calibrate again"),
    said_later("no record %(record)s in %(place)s; see calibrate history"),
    said_later("%(count)s records begin with %(record)s; see calibrate history"),
    said_later("%(place)s: holds another record (%(record)s)"),
    said_later("%(place)s: its content has the hash %(found)s, not %(stated)s; use the original file"),
    said_later("%(place)s: parts are missing or contradict one another (%(detail)s)"),
    said_later("the store has changed: %(what)s is in force for tool %(tool)s now"),
    said_later("the store has changed: a roll back leads to %(found)s, not %(expected)s"),
    said_later("tool %(tool)s has no earlier calibration in %(place)s"),
    said_later("%(what)s is in force for tool %(tool)s"),
    said_later("the store"),
    said_later("nothing"),
)
"""Why a record cannot be shown or put in force (`calibration.record`, `recording.calibration_store`)."""

SENTENCES = STATES + REMARKS + ANSWERS_OF_STORE
