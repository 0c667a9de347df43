"""What a diagnosis says of one recording: hints, why an effect could not be tested, what to measure next, how was held
out, faults of the data. Made in English where it is found out, with what was measured in it, kept in files that
programs read, and told in the reader's language where a report shows it (`told`, of `DIAGNOSIS`); a test reads the
sources of the diagnosis and finds the sentence that is missing here.
"""

from __future__ import annotations

from highside.words.marks import said_later
from highside.words.sentences_of_data import SAID

ANSWERS = (
    said_later("only %(names)s would explain it, of a size that no instrument has"),
    said_later("it resembles %(names)s, but a smooth law would explain more of it"),
    said_later("it resembles %(names)s, but most of it is left"),
    said_later("as good as %(effect)s: %(law)s"),
    said_later("more attitudes, where the two differ most: all over the range of what they follow"),
    said_later("%(left)s rms are left out; they resemble %(effect)s, but %(law)s is ahead of it by %(nats)s nats"),
    said_later("every attitude is reached from one side, so it is a constant; or the side is not recorded"),
    said_later("the temperature does not change, or is not recorded"),
    said_later("latitude and azimuth of the bench are not known"),
    said_later("the tool does not rotate while it is read"),
    said_later("the rotation is not sped up or slowed down"),
    said_later("vibration is not recorded, or there is none"),
    said_later("vibration is not recorded axis by axis, or there is none"),
    said_later("every pose is read after the same time, or the recording has no poses"),
    said_later("the recording has no length"),
    said_later("gyros are not recorded, or do not respond to it here"),
    said_later("it does not act in any attitude of this recording"),
    said_later("the tool does not move while it is read"),
    said_later("inclination station at %(inc)s deg"),
    said_later(
        "only %(used)s of about %(expected)s holds were still enough to be read: hold the tool still, on a rest"
    ),
    said_later("%(effect)s beside a remainder of %(factor)s times the noise: %(why)s"),
    said_later("follows %(what)s"),
    said_later("%(channel)s follows %(what)s"),
    said_later("the zero offsets follow a random walk: slow effects cannot be distinguished from it here"),
    said_later("none needed: no other effect of the library explains this recording as well"),
    said_later("none needed"),
    said_later("none needed: no other effect explains the table as well"),
    said_later("none needed: noise that follows vibration was tried and does not explain the scatter"),
    said_later(
        "%(place)s, reads %(off)s g off what the others say (%(size)s sigma) and was left out: measure it again; "
        "what acts there alone cannot be told from a fault"
    ),
    said_later("pose %(pose)s of %(count)s, at inclination %(inc)s and toolface %(tf)s deg"),
    said_later("pose %(pose)s, at inclination %(inc)s and toolface %(tf)s deg"),
    said_later(
        "poses %(one)s and %(other)s read as each other should: with their angles exchanged the misfit falls from "
        "%(before)s to %(after)s g rms. Both were left out: look at what was written down"
    ),
    said_later("reading %(reading)s of %(count)s, at %(time)s s"),
    said_later("it would show from %(size)s on, and is not plausible beyond %(most)s"),
    said_later("whatever its size, it is absorbed by %(names)s"),
    said_later("whatever its size, these readings do not respond to it"),
    said_later("its size over %(split)s is %(sizes)s times that over all"),
    said_later("thirds of the session"),
    said_later("halves of the inclinations"),
    said_later("halves of the rates"),
    said_later("the beginning, middle and end of the session"),
    said_later("lower rates, higher rates and ramps"),
    said_later(
        "%(effect)s may be no constant: %(why)s, or the zero offsets follow a random walk; its size is a mean over "
        "the session: record another one to see which"
    ),
    said_later("%(effect)s explains less than %(other)s would if that changes: %(why)s"),
    said_later("%(effect)s is not the cause, for it is no constant: %(why)s"),
    said_later("%(count)s sets of every %(nth)sth pose, since what was found lives within few poses"),
    said_later("%(count)s contiguous blocks of poses"),
    said_later("%(count)s contiguous stretches"),
    said_later("%(count)s contiguous stretches; figures are of %(names)s"),
    said_later("each pose left out in turn"),
    said_later("each of %(count)s inclinations in turn"),
    said_later(
        "%(count)s sets of every %(nth)sth value, each predicted from the others, in units of the noise that was learnt"
    ),
    said_later(
        "%(count)s contiguous stretches with gaps, each predicted from the others; means over sectors of %(angle)s "
        "deg of the turn, of %(rows)s rows each; whitened"
    ),
    said_later("what is left of a reading is below half a step of the converter (%(sizes)s): rounding explains it"),
    said_later("%(readings)s disagree %(ratio)s times more than they repeat (%(left)s against %(floor)s)"),
    said_later("magnitudes of still readings"),
    said_later("pose means"),
    said_later("turn in both senses"),
    said_later("approach the same poses from both sides"),
    said_later("record while the tool rotates, at several rates"),
    said_later("turn at three rates at least, in both senses"),
    said_later("record the temperature, and change it up and down"),
    said_later("record the vibration at rest and while the tool is shaken"),
    said_later("record the vibration of each axis (vibration_x_rms_g and so on), at rest and shaken along each"),
    said_later("hold some poses briefly and others long, and record every row of them"),
    said_later("measure at other inclinations than %(inc)s deg as well"),
    said_later("record the gyros too, while the tool rotates"),
    said_later("say where the bench stands ([site] latitude_deg, azimuth_deg in the model)"),
    said_later(
        "in so many rows an error of the colour of the noise may pass for a random walk: diagnose parts of about a "
        "million rows each, and compare"
    ),
    said_later(
        "all %(rows)s rows were used for fits, tests and the choice of effects; the colour of the noise was learned"
        " from %(learned)s of them, single lines were looked for in %(part)s, and what is left was held beside the "
        "noise of sensors in %(sample)s"
    ),
    said_later("%(words)s; laws were not looked for"),
    said_later("%(words)s; laws were sought in %(count)s, which lie in %(stretches)s stretches"),
    said_later("noise: %(noise)s"),
    said_later("what is left is taken for %(what)s"),
    said_later(
        "in %(poses)s poses errors of the set angles cannot be distinguished from readings that repeat badly, nor "
        "from something that the angles follow: record %(enough)s poses or more, or each pose several times"
    ),
    said_later(
        "%(words)s; in %(poses)s poses these cannot be distinguished from something that the angles follow: record "
        "%(enough)s poses or more, or each pose several times"
    ),
    said_later("%(channel)s scatters %(above)s times more than it repeats"),
    said_later(
        "%(channel)s scatters %(above)s times more than it repeats, and %(other)s %(least)s times: the zero offset of "
        "one axis wanders, or something that acts on it was left out; record %(enough)s poses or more, at temperatures "
        "that are not in order"
    ),
    said_later(
        "%(channel)s scatters %(above)s times more than it repeats: in %(poses)s poses this cannot be distinguished "
        "from something that the angles follow; record %(enough)s poses or more, or each pose several times"
    ),
    said_later(
        "%(channel)s scatters %(above)s times more than it repeats, correlated over %(memory)s poses: in %(poses)s "
        "poses such noise cannot be distinguished from something slow, as what follows time or temperature is; "
        "record %(enough)s poses or more, at temperatures that are not in order"
    ),
    said_later(
        "the rows within the poses do not tell whether the poses disagree by noise with a memory or by something that "
        "was left out: hold each pose longer, or record each several times"
    ),
    said_later("%(size)s deg of inclination"),
    said_later("%(size)s deg of toolface"),
    said_later("%(inc)s deg of inclination, %(tf)s deg of toolface"),
    said_later("%(size)s deg across the plane of the tilt"),
    said_later("some readings are clipped"),
    said_later(
        "%(count)s more that follow something are not claimed: each explains less of its channel than a prediction "
        "beside strong effects is exact to"
    ),
    said_later("temperature with lags from %(low)s to %(high)s s"),
    said_later("vary %(what)s over the range that matters"),
    said_later("vary %(what)s over the range that matters and over several turns"),
    said_later("vary %(what)s over the range that matters, independently of %(others)s"),
    said_later("vary %(what)s over the range that matters and over several turns, independently of %(others)s"),
    said_later("record another session and %(confirm)s"),
    said_later("hold one pose for several periods, at another rate of recording"),
    said_later("white noise up to %(times)s times the floor"),
    said_later("a zero offset that wanders"),
    said_later("1/f noise"),
    said_later("errors of the set angles"),
    said_later("the floor alone"),
    said_later("errors of the set angles: %(sizes)s"),
)
"""Of the engine, of its parts and of laws."""

PLACES = (
    said_later("added to a channel"),
    said_later("in proportion to the load of a channel"),
    said_later("one scale of all channels"),
    said_later("share of one axis' load in another"),
    said_later("error of the reference inclination"),
    said_later("error of the reference toolface"),
    said_later("how much later a row was sampled"),
    said_later("tilt of the bench"),
    said_later("added to a gyro"),
    said_later("in proportion to the rate of a gyro"),
    said_later("a factor of a predicted channel"),
    said_later("delay of a predicted channel"),
    said_later("%(place)s (%(channels)s) as %(functions)s"),
)
"""Where a law acts (`physics.places`)."""

READINGS = (
    said_later("temperature drift of the zero offset"),
    said_later("a ramp up and one down"),
    said_later("temperature differences within the sensor, or a thermometer away from it"),
    said_later("hold a temperature until nothing changes"),
    said_later("temperature coefficient of one axis' scale"),
    said_later("the reference voltage of the converter drifts"),
    said_later("record the reference, or a second sensor on it"),
    said_later("the axes turn against the housing as it warms"),
    said_later("a suspension with two sides, or a converter that differs in sign"),
    said_later("poses close to zero load"),
    said_later("a response of the axis that is no straight line"),
    said_later("poses all over its range, both signs"),
    said_later("response to the load, on the axis or across it"),
    said_later("poses in which the loads differ"),
    said_later("hysteresis: the sensor or its mounting remembers the pose before"),
    said_later("the same pose from two others"),
    said_later("settling or creep after a move"),
    said_later("hold one pose for long"),
    said_later("a shock, or a contact that changed"),
    said_later("look at what happened then; return to the first pose"),
    said_later("warming up after power came on"),
    said_later("start cold again"),
    said_later("a line of the mains that is sampled too slowly, a pump, or a controller that hunts"),
    said_later("hold one pose for some periods; record at another rate"),
    said_later("ageing or a slow drift, or what was not recorded"),
    said_later("return to the first pose from time to time; record the temperature"),
    said_later("a dent or a particle in the bearing, at one toolface"),
    said_later("turn the tool against the rotor and repeat"),
    said_later("a gear, or a cage of a bearing: an order that is no whole number"),
    said_later("two full turns and more"),
    said_later("eccentric or stretched scale of the inclination encoder, or sag"),
    said_later("the same inclinations from the other side"),
    said_later("eccentric or stretched scale of the toolface encoder"),
    said_later("turn the encoder against the shaft and repeat"),
    said_later("the bench leans more and more"),
    said_later("level it between rounds; record a level"),
    said_later("the bench bends with temperature"),
    said_later("the same poses at another temperature of the room"),
    said_later("something that comes round with each turn"),
    said_later("electrical pick-up, or friction: it follows the rate and not its square"),
    said_later("both senses of rotation at each rate"),
    said_later("backlash, or friction that turns with the sense of rotation"),
    said_later("the same stations from both sides"),
    said_later("a flexible shaft, or a sensor away from the axis"),
    said_later("other ramps"),
    said_later("rectified vibration"),
    said_later("the same pose with the shaker off"),
    said_later("offset of the gyros over temperature or after power came on"),
    said_later("stand still at two temperatures"),
    said_later("a clock, or a filter whose delay changes"),
    said_later("a sharp move every minute"),
    said_later("a constant of the simulation that is none"),
    said_later("vary it alone"),
)
"""What a law may be, and what tells it apart (`diagnosis.laws.readings`)."""

DIAGNOSIS = ANSWERS + PLACES + READINGS + SAID
