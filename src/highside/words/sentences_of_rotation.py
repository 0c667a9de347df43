"""What a compensation by the rotor angle says beside its curves: remarks of a fit, which its file keeps, and why a
method was refused. Made in English where it is found (`rotation`), and told where a page shows it (`told`, of
`ROTATION`).
"""

from __future__ import annotations

from highside.words.marks import said_later

REMARKS = (
    said_later("no rows from %(start)s deg over %(size)s deg of the turn: the compensation is a guess in there"),
    said_later("%(share)s %% of the rows lie more than four standard deviations off: held down"),
    said_later(
        "the highest order that these rows can carry (%(order)s) was taken: finer structure may be left; more rows over"
        " more of the turn would show it"
    ),
    said_later("from four positions: a third harmonic would pass for the first"),
    said_later(
        "rate term %(power)s omitted: these runs do not separate it from the angle (%(share)s %% its own); runs at"
        " several rates would"
    ),
    said_later("trained on every %(stride)sth row of %(rows)s"),
    said_later("training stopped at %(count)s iterations; another seed gives another curve"),
    said_later("%(rows)s rows for %(count)s parameters: the network follows the noise"),
    said_later("the constant is unobservable without an outside reference: it is zero here"),
    said_later("the first harmonic is uncertain by %(size)s': bias and misalignment of the gyros"),
)
ORDERS = (
    said_later(
        "the highest order of the usual range (%(order)s) was taken; orders to %(higher)s fit these rows better, but"
        " not turns that the fit did not use (%(left)s against %(usual)s rms): %(why)s"
    ),
    said_later(
        "order (%(order)s) was taken; orders to %(higher)s fit these rows better, but not turns that the fit did not"
        " use (%(left)s against %(usual)s rms): %(why)s"
    ),
    said_later(
        "order %(order)s is the highest of the usual range; of less than two whole turns finer structure cannot be told"
        " from noise that is slower than the rows: record more turns"
    ),
    said_later("these rows are too few to predict it"),
    said_later("what is left does not come back from turn to turn"),
    said_later("order %(order)s was taken, beyond the usual range of %(usual)s"),
    said_later(
        "order %(order)s was taken, beyond the usual range of %(usual)s and is the highest that can be tried: finer"
        " structure may be left"
    ),
    said_later("%(what)s; turns not used by the fit: %(left)s rms against %(usual)s"),
    said_later("an error of order %(order)s, amplitude %(size)s, %(seen)s and is left: %(advice)s"),
    said_later("an error of order %(order)s, amplitude %(size)s, %(seen)s and is left (and of %(others)s): %(advice)s"),
    said_later("comes back in all %(turns)s turns"),
    said_later("stands above the orders near it"),
    said_later("orders above %(order)s are not fitted: such fine teeth belong to the encoder or the coupling"),
    said_later("record more turns, with more rows a turn, for the order to be fitted"),
)
"""Which order was taken, and what is left above it (`rotation.fit`)."""
SELF = (
    said_later("the accelerometers' own errors pass for the turntable's: give calibration= or of='rotor'"),
    said_later("%(worst)s deg from the bench in a row: no error of a turntable"),
    said_later("omit rows in motion and rows of another fixture"),
    said_later("must not be negative"),
    said_later("time stands or goes back"),
    said_later("sort the rows by time"),
    said_later("%(file)s: %(rows)s rows in which rotor angle and readings are all known"),
    said_later("the part %(part)s needs gyros; without them only %(other)s can be separated"),
    said_later("no %(turns)s turns in one go: nothing repeats by which an error could be distinguished from motion"),
    said_later("%(rows)s rows a turn; %(least)s are needed: record faster or turn slower"),
    said_later("within three degrees of vertical there is no toolface to tell errors of"),
    said_later("the part 'sensor' is no error of a turntable: use 'rotor', or 'decoded' of a calibrated tool"),
    said_later("rows within three degrees of vertical have no toolface to speak of"),
    said_later("leave them out"),
    said_later("one inclination cannot separate the encoder from the wobble of the axis; add a turn at another one"),
    said_later("%(rows)s rows at these angles cannot separate the encoder from the wobble of the axis"),
    said_later(
        "this compensation is for %(channels)s, good at one inclination only; a bench needs one of rotation turntable"
    ),
)
"""Of a turntable's own fit, and of one without an outside reference (`api.turntable`)."""
REFUSALS = (
    said_later(
        "only %(angle)s deg of the turn are covered: a constant and a first harmonic cannot be separated; record at"
        " least half a turn, better two"
    ),
    said_later(
        "the rotor stood at too few different angles for the %(count)s parameters of %(method)s; record a turning rotor"
        " or use another method"
    ),
    said_later("the rotor stood at too few different angles for a curve over the turn"),
    said_later("rate terms were requested, but the rotor rate is constant; record at several rates"),
    said_later(
        "rate terms were requested, but in these runs the rate follows the angle and they cannot be separated; record"
        " at several rates"
    ),
)

DIRECTIONS = (
    said_later(
        "no difference by direction is detected: %(size)s' +- %(std)s' (95 %%) over %(forward)s turns"
        " forwards and %(backward)s backwards"
    ),
    said_later(
        "the error differs by the direction of rotation: forwards minus backwards %(size)s' +- %(std)s' (95"
        " %%) on average, up to %(largest)s' at some angles (play, friction or a late angle); the curve is"
        " their mean: fit the directions apart, or take the play away"
    ),
    said_later(
        "the error differs by the direction of rotation: forwards minus backwards %(size)s' +- %(std)s' (95"
        " %%) on average, up to %(largest)s' at some angles (play, friction or a late angle); direction and"
        " time run together, so that a drift would look the same; the curve is their mean: fit the directions"
        " apart, or take the play away"
    ),
    said_later("the rotor turns forwards (growing angle) for %(turns)s turns; the fit never saw that direction"),
    said_later("the rotor turns backwards (falling angle) for %(turns)s turns; the fit never saw that direction"),
    said_later(
        "the rotor turns at %(low)s to %(high)s deg/s; the fit saw %(least)s to %(greatest)s: what depends on"
        " the rate is not in it"
    ),
    said_later(
        "%(count)s of %(rows)s rows lie up to %(angle)s deg from the inclination of %(inc)s deg at which the"
        " compensation was fitted: its coefficients change with attitude"
    ),
)
"""What depends on the direction, the rate and the inclination (`rotation.direction`, `rotation.recording`)."""

ROTATION = REMARKS + ORDERS + SELF + REFUSALS + DIRECTIONS
