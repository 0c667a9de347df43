"""The sentences of a diagnosis about the data, recordings of magnitudes and poses, rotation, rows, another simulation
and tables; as those of `sentences_of_diagnosis`, which holds them together.
"""

from __future__ import annotations

from highside.words.marks import said_later

SAID = (
    said_later("check wire and codec"),
    said_later("%(share)s of the readings share the value %(limit)s g: use a larger range"),
    said_later("record %(names)s as well"),
    said_later("%(count)s of %(all)s values are missing: repeat those poses or leave the rows out"),
    said_later("%(count)s of %(all)s rows lack a value and are left out"),
    said_later("%(words)s: each pose is averaged from the rows that are there"),
    said_later("%(words)s: each pose is averaged from the rows that are there; poses without any: %(count)s"),
    said_later("|a| is %(size)s: looks like %(unit)s, divide by %(factor)s"),
    said_later("|a| is %(size)s where gravity is 1: scale the readings to g"),
    said_later("the readings do not follow the bench's angles under any axis map: are these the right columns?"),
    said_later("the bench's angles are followed if the channels are read as %(mapped)s: check wiring or [tool] axes"),
    said_later("the bench's angles are followed if the sign is turned (%(mapped)s): check [tool] axes"),
    said_later("binary digit %(bit)s is always %(value)s: the converter or its wire is broken"),
    said_later(
        "the converter's step of %(step)s g is coarser than the noise: errors of up to half of it stay in a mean"
    ),
    said_later("sort the rows by time"),
    said_later(
        "%(count)s rows are out of order, by %(most)s s at most: sort by time or counter, or correct the times if the "
        "clock was set back"
    ),
    said_later("%(lost)s frames are lost in %(gaps)s gaps (%(share)s): %(what)s"),
    said_later("check the link and record again"),
    said_later("few enough to go on with"),
    said_later("the rows that are there are diagnosed, each at its own time; check the link"),
    said_later("the clock is set back at t = %(time)s s: add the step to the times behind it"),
    said_later("the clock steps by %(size)s s at t = %(time)s s without a frame lost: correct the times"),
    said_later("the clock's rate changes by %(change)s over the recording: use a clock that counts frames evenly"),
    said_later("%(count)s frames are there twice: remove the copies"),
    said_later(
        "%(count)s readings are up to %(size)s times the scatter off their neighbours: they are left out; look for "
        "a loose contact or a shock"
    ),
    said_later("from %(begin)s to %(end)s s: %(what)s"),
    said_later("in %(count)s of %(all)s stretches, %(what)s"),
    said_later("it only turns the reading, and a magnitude does not show that"),
    said_later("%(found)s, of which %(names)s, which may be refitted, take up %(rank)s"),
    said_later("measure at least %(least)s attitudes all over the sphere; or let less be refitted ([sensor] free)"),
    said_later("%(what)s; more attitudes of the tool, spread over the whole sphere, held still"),
    said_later("%(names)s may be refitted and cannot be determined by this recording"),
    said_later(
        "in one attitude only what acts along gravity shows: the parameters are its smallest explanation, and what "
        "acts across gravity, or whether an offset or a scale factor changes, is not determined"
    ),
    said_later("it is adjusted, but in the attitudes of this recording %(names)s would do the same"),
    said_later("%(words)s; %(near)s would explain more of it than chance makes (p = %(p)s)"),
    said_later("readings repeat to %(size)s g: what follows time and is smaller than this does not show here"),
    said_later(
        "readings repeat to %(size)s g: what follows time and is smaller than this does not show here: %(sizes)s"
    ),
    said_later(
        "the magnitude differs by %(size)s mg between the %(count)s attitudes of this rest, and %(names)s, which "
        "may be refitted, take up any such difference"
    ),
    said_later(
        "%(found)s: for the sensor's matrix at least %(least)s attitudes are needed, for what follows time or "
        "temperature at least %(rest)s s at rest"
    ),
    said_later(
        "%(found)s: for the sensor's matrix at least %(least)s attitudes (%(few)s with columns n, std_ax, std_ay, "
        "std_az: how well they repeat) are needed, for what follows time or temperature at least %(rest)s s at rest"
    ),
    said_later("%(count)s averages in %(attitudes)s attitudes"),
    said_later("%(count)s still intervals in %(attitudes)s attitudes, %(time)s s in all"),
    said_later(
        "hold the tool still in at least %(least)s attitudes all over the sphere, a few seconds each, or leave it "
        "at rest for minutes; or record its attitude"
    ),
    said_later("measure these poses (inclination, toolface in deg): %(poses)s; otherwise: %(what)s"),
    said_later("(%(inc)s, %(tf)s)"),
    said_later("(%(inc)s, %(tf)s, from the other side)"),
    said_later("%(words)s: %(sizes)s; wait longer before a pose is read, or look for what moves"),
    said_later("readings creep while a pose is held, each pose its own way"),
    said_later("readings move while a pose is held, by more than their mean does from pose to pose"),
    said_later("readings move while pose %(pose)s is held, unlike in the others"),
    said_later("readings settle within the first %(time)s s of each pose"),
    said_later("readings drift alike in every pose"),
    said_later("readings drift while a pose is held, in proportion to its load"),
    said_later("readings oscillate at %(rate)s Hz while a pose is held"),
    said_later("%(name)s by %(size)s ug"),
    said_later("turn for 20 s each: %(stretches)s; otherwise: %(what)s"),
    said_later(
        "poses %(poses)s read more than 0.2 g off their angles: look at what was written down, and at their rows"
    ),
    said_later("steady %(rate)s deg/s at inclination %(inc)s deg"),
    said_later("ramps of 1 s between standstill and %(rate)s deg/s at inclination %(inc)s deg"),
    said_later("a vibration of %(rate)s Hz comes and goes on %(names)s"),
    said_later("at %(inc)s deg of inclination alone"),
    said_later(
        "%(where)s a function of the load is a function of the toolface: turn at another inclination too, where an "
        "error of the turn itself keeps its size and this effect does not"
    ),
    said_later(
        "in %(time)s s a random walk of the zero offsets and noise that is correlated over seconds cannot be "
        "distinguished, nor slow effects from either: record ten times as long"
    ),
    said_later(
        "the noise of %(names)s is correlated over some %(memory)s s, of which the %(time)s s hold %(count)s "
        "independent stretches"
    ),
    said_later("%(words)s: what is as slow shows only where it is large; a longer recording shows more"),
    said_later("%(words)s: %(what)s cannot be distinguished from such noise; record ten times as long"),
    said_later("what looks like %(names)s"),
    said_later(
        "the noise is correlated over some %(memory)s s, and %(time)s s were recorded: what is left cannot be "
        "distinguished from an error of its colour; record ten times as long"
    ),
    said_later(
        "%(channel)s is left with %(left)s rms, where noise would leave %(floor)s: something moves that the "
        "prediction does not have, from %(low)s to %(high)s Hz"
    ),
    said_later("%(words)s (likewise %(others)s)"),
    said_later("a motion is missing from the prediction, throughout: %(sizes)s rms are left"),
    said_later(
        "a motion is missing from the prediction, most of it from %(start)s to %(stop)s s: %(sizes)s rms are left there"
    ),
    said_later(
        "the tool turns by up to %(angle)s deg, most of it about %(axis)s, and the prediction does not: the "
        "accelerometers show %(share)s of what the gyros say of it, from %(low)s to %(high)s Hz"
    ),
    said_later("a shift of the clock alone explains more of the motion, or as much"),
    said_later("it would have to come before its cause: its time constant would be negative"),
    said_later("a filter's time constant is one: %(why)s"),
    said_later(
        "all accelerations are %(factor)s times the prediction: the simulation's value of g, or its unit, may be off"
    ),
    said_later(
        "all rates are %(factor)s times the prediction: the simulation's unit of rates, or its time step, may be off"
    ),
    said_later(
        "the motion of the prediction and its rates are %(ratio)s times as fast as the recorded ones: its frequency is "
        "off and no clock; where a spring or gravity sets it, a stiffness is %(stiffness)s times the real one, or a "
        "length %(length)s times"
    ),
    said_later("even the largest size that is plausible would not show in this recording"),
    said_later(
        "%(channel)s departs more from %(low)s to %(high)s Hz than at lower frequencies, as noise of a sensor does "
        "not: something moves that the prediction does not have"
    ),
    said_later(
        "%(channels)s together depart more from %(low)s to %(high)s Hz than at lower frequencies, as noise of "
        "sensors does not: something moves that the prediction does not have"
    ),
    said_later(
        "%(one)s and %(other)s depart together, most of all from %(low)s to %(high)s Hz, as noise of sensors of "
        "their own does not: both show something that the prediction does not have"
    ),
    said_later("the recording follows the prediction with the sign turned (slope %(slope)s)"),
    said_later("the recording is %(slope)s times the prediction: looks like %(unit)s"),
    said_later("%(unit)s against %(other)s"),
    said_later("thousandths against units"),
    said_later("units against thousandths"),
    said_later("each follows the prediction of the other: check the order of the columns"),
    said_later(
        "the two courses lie %(time)s s apart by their likeness alone, without any effect: the shift of the clock "
        "is sure. What is left beside it has no name that could be given"
    ),
    said_later(
        "no single inclination station of means and peak-to-peaks separates it from %(name)s (best: %(inc)s deg, "
        "expected chi-square %(chi)s): record the errors by toolface"
    ),
    said_later(
        "a station at %(inc)s deg inclination: there %(cell)s separates it from %(names)s (expected chi-square %(chi)s)"
    ),
    said_later("something like %(name)s helps as well, but has no sure name: %(why)s"),
    said_later("something like %(name)s helps as well (so do %(names)s), but has no sure name: %(why)s"),
    said_later("other sets without it come near"),
    said_later("it shows in peak-to-peaks only, which have lost order and phase: errors by toolface would tell"),
    said_later("%(name)s does as well with other amplitudes: %(parts)s"),
    said_later("the row at %(inc)s deg stays off: its %(cell)s is %(size)s sigma beside what is explained"),
    said_later(
        "the row at %(inc)s deg is not explained (p = %(p)s from the others; %(cell)s is %(size)s sigma): measure "
        "it again"
    ),
    said_later(
        "rows scatter by %(angle)s deg of direction beyond chance (%(before)s before): they were not measured under"
        " one and the same state"
    ),
    said_later("a table does not say when a row was measured"),
    said_later("a table does not say from which side a pose was approached"),
    said_later("the correction (%(by)s) takes it up: it leaves no trace in these columns"),
    said_later(
        "the table has no column t_s: the rows are taken to stand in the order in which they were measured, and "
        "what follows time, or how fast a temperature changes, gets no name"
    ),
    said_later("the table has no column t_s: when each row was taken is not known"),
    said_later(
        "the recording has no column direction: from which side each toolface was approached is taken from the order "
        "in which they were set, of a table that does not turn over its zero"
    ),
    said_later("add a column t_s, in s"),
    said_later(
        "%(size)s rms are left out; %(part)s follows the order of the rows; the table has no column t_s, so that no"
        " size per second is told"
    ),
    said_later(
        "%(part)s follows the order of the rows; the table has no column t_s, so that no size per second is told"
    ),
    said_later("%(share)s of what is explained"),
    said_later("%(meaning)s (to tell: %(apart)s)"),
    said_later("%(words)s: check signs"),
)
