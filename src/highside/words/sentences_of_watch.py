"""What the watch over a calibration says: its verdict, from what it began, what to do next and why a parameter cannot
be seen. Made in English on the tool's own computer (`watch.words`, `service.watch_keeper`), and told where a page shows
it (`told`, of `WATCH`).
"""

from __future__ import annotations

from highside.words.marks import said_later

WATCH = (
    said_later("under the record of tool %(tool)s; --tool says whose recording it is"),
    said_later("began from the record"),
    said_later("began anew: %(id)s is another one (%(digits)s)"),
    said_later("began anew: the calibration is another one (%(digits)s, before %(before)s)"),
    said_later("began anew: the site's gravity is another one"),
    said_later("began anew: what was kept is damaged"),
    said_later("began anew, as was asked for"),
    said_later(
        "take a roll test here: eight toolfaces 45 deg apart, a minute each (four at right angles cannot see S_xy +"
        " S_yx); it tells %(names)s. A second one after 10 to 30 deg of build tells b_z from S_zz and b_x from S_xz"
    ),
    said_later("b_x, b_y, S_xx, S_yy and S_xy + S_yx"),
    said_later("only b_z with the scale of z (little more can be seen in a vertical hole)"),
    said_later("the readings are not those of gravity: use none of them, pull the tool"),
    said_later("nothing was measured: let the tool lie still, or turn with gyros recorded"),
    said_later("go on"),
    said_later(
        "never seen in a hole, and as the bench left it: toolface zero (S_xy - S_yx), and what reads like a bent"
        " collar; the record and the tool's class state %(tf)s deg of toolface times sin I and %(inc)s deg of"
        " inclination for both (3 standard deviations)"
    ),
    said_later(
        "for %(hours)s h no rest and no rotation could be used: what is said here is of then; let the tool lie still,"
        " or turn with gyros recorded"
    ),
    said_later(
        "the last reading does not fit: its length is %(excess)s mg from gravity's; use it for nothing, and take"
        " another at once: a second one says that an axis is broken"
    ),
    said_later(
        "what was said to depart at %(alarm)s s was taken back at %(at)s s: later measurements speak against it, or it"
        " has gone again; check the surveys in between"
    ),
    said_later("a toolface offset, never seen in a hole: toolface zero is as the bench left it"),
    said_later("reading without numbers"),
    said_later("rest in which the tool moves slowly"),
    said_later(
        "not yet known: an error of up to %(inc)s deg of inclination and %(tf)s deg of toolface times sin I would "
        "not have been seen."
    ),
    said_later("Near horizontal b_z and S_zz stay out of sight: a still at another inclination is needed."),
    said_later("%(names)s are not told apart so far: %(what)s"),
    said_later(
        "one departure does not explain what was seen: there is a second one, the first has gone again, or noise has"
        " grown; trust no size, acknowledge and restart the watch, and calibrate again at surface"
    ),
    said_later("the error is large: pull the tool"),
    said_later("check the next surveys against another tool, and calibrate again when this one is at surface"),
    said_later(
        "the last measurement is far from what was expected: noise that has grown, or a departure; take two or "
        "three rests more, which tell it, and trust no survey before"
    ),
    said_later(
        "the last %(count)s measurements are far from what was expected: noise that has grown, or a departure; take"
        " two or three rests more, which tell it, and trust no survey before"
    ),
    said_later(
        "all axes have become noisier (%(times)s): the tool shakes (pumps, rotation elsewhere in the string) or its"
        " supply is noisy; repeat the rest with the pumps off"
    ),
    said_later("%(axis)s %(factor)s times"),
    said_later(
        "%(axis)s has become %(factor)s times as noisy, which is no departure: take longer rests, and look at that "
        "sensor, its plug and its supply at surface"
    ),
    said_later(
        "%(axis)s scatters %(factor)s times what it did: a filter was set, or the axis begins to stick; compare it "
        "in another attitude"
    ),
    said_later("S_xy - S_yx is a toolface offset and never observable; the sum needs toolfaces beside 0, 90, 180, 270"),
    said_later("a bent collar reads like an antisymmetric misalignment of x or y against z"),
    said_later("an error of the site's gravity reads like a common scale"),
    said_later("gravity's growth with depth runs together with time and temperature"),
    said_later("needs temperatures apart from that of the calibration"),
    said_later("needs a recorded vibration (column vibration_rms_g) that changes"),
    said_later("needs rotation at rates that differ"),
    said_later("needs other attitudes, or rotation with gyros: at rest one number is seen, the length of gravity"),
    said_later(
        "b_z, S_zz and gravity are told apart by a spread of inclinations, and are out of sight near horizontal"
    ),
    said_later("needs other inclinations: at one of them it is not told from its neighbours"),
    said_later("learning"),
    said_later("holds"),
    said_later("departs"),
    said_later("off"),
    said_later("nothing is watched: %(why)s"),
    said_later("it is switched off in the configuration"),
    said_later("no calibration record is in force"),
    said_later("went on under other limits"),
)
