"""The numbers that decide in the watch: each with its unit, its meaning and what set it."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["POLICY", "STATED", "StatedNoise", "WatchPolicy"]


@dataclass(frozen=True)
class StatedNoise:
    """What a tool may do without its calibration having departed: one standard deviation each, of the tool's class.

    A calibration record states none of them yet but the covariance of its parameters. Those below are of a good
    quartz tool; a poorer one is watched with its own.
    """

    repeat_g: float = 1e-4
    """of each offset from one power-up to another and from the bench to the hole, beside the record's covariance"""
    repeat: float = 1e-4
    """the same of each element of the matrix"""
    offset_random_walk: float = 5e-6
    """random walk of each offset, g/sqrt(h)"""
    matrix_random_walk: float = 5e-6
    """the same of each element of the matrix, 1/sqrt(h)"""
    still_floor_g: float = 1e-5
    """of the mean of a still beyond what its own rows scatter: 1/f noise, creep of the string"""
    window_floor_g: float = 2e-5
    """the same of each harmonic of a turning window"""
    whirl_m: float = 1e-4
    """rms of a sideways motion of the collar while it turns: adds `whirl x rate^2` to the centres of x and y"""
    temperature_g_per_c: float = 1e-6
    """of an offset's coefficient, where the record was made over temperatures; else the record's own growth"""
    rectification_per_g: float = 2e-5
    """g of offset per g^2 of vibration"""
    arm_m: float = 0.01
    """distance of the sensor from the axis it turns about, each way"""
    tilt_rad: float = 5e-4
    """of the axis of rotation in the tool: a bent collar"""
    gravity_g: float = 1e-4
    """of the site's gravity, relative"""
    gravity_per_km: float = 1.05e-4
    """growth of gravity per km of depth, relative: rock of 2.2 to 2.7 g/cm3 (0.38 to 0.25 mg in 3 km)"""
    gravity_per_km_std: float = 2.4e-5
    gravity_per_h: float = 4e-6
    """growth of gravity per hour where no depth is recorded: 0.4 mg in 100 h of drilling down"""


@dataclass(frozen=True)
class WatchPolicy:
    """Of what is said."""

    threshold: float = 36.0
    """of twice the log-likelihood ratio of the best hypothesis: six standard deviations. No false departure in 3,000 h
    as stated, 1 in 2,970 h with noise 1.4 and random walk 1.5 times the stated (`studies.watch_wells --first-seed
    5000`)"""
    power: float = 1.65
    """standard deviations by which a departure must pass the threshold to be found with 95 % probability"""
    taken_back: float = 0.5
    """share of the threshold below which the evidence must fall for a departure not to be said any more. Of 50 true
    steps the evidence of a day after the alarm is 0.90 of the threshold at the least; of a bent collar that was read as
    a misalignment it fell to 0.35 (wells as of `studies.watch_beyond`, first seeds 94000000 and 82000000)"""
    stale_s: float = 7200.0
    """since the last measurement that was used, from which nothing is said to hold: within two hours of measurements a
    departure is to be found"""
    same_class: float = 10.0
    """of twice the log-likelihood ratio: hypotheses that close to the best are one class; a rival of the truth is
    ahead by so much with a probability of exp(-5) at most"""
    recent_s: float = 3600.0
    """within which each measurement is an onset: a step between a rest and the rotation after it would else be named a
    drift at the alarm (9 of 262 wells, `studies.watch_wells --departures 150 --first-seed 1320000` and 1520000)"""
    onset_s: float = 600.0
    """between two older onsets. All are kept: ones thinned to some hours give wrong names, since a bias that stepped
    between two of them looks like a temperature coefficient"""
    most_onsets: int = 4000
    """kept at one time (four weeks at this distance); then the oldest but the first leaves"""
    largest: float = 0.05
    """g or ratio: a hypothesis that needs more than this is none, and a reading whose length departs from gravity by
    more is none of a tool with small errors: an axis is dead, stuck or saturated"""
    fewest_beyond: int = 2
    """such readings from which that is said: one may be a shock"""
    wide: float = 2e-3
    """g or ratio: how far each parameter may be off for what the hole alone says (`learning` or `holds`)"""
    still_unseen_deg: float = 0.1
    """of inclination, or of toolface times sin I: `holds` is said only where three standard deviations of what the
    hole alone says of the present attitude are below this"""
    seen: float = 0.5
    """share of a parameter's variance below which the hole must have brought it for it to be observable"""
    scale_over: int = 200
    """innovations over whose scale the noise is judged"""
    scale_from: int = 60
    """innovations below which it is not judged, and over the last of which it is followed: in the wells of
    `studies.watch_wells` those of about four hours"""
    noise_share: float = 0.5
    """of a measurement's variance that must be the sensor's noise for it to tell of that: whirl would hide that noise
    grows. In the wells of `studies.watch_wells` the share is above 0.7 or below 0.3"""
    grown: float = 1.5
    """ratio of the innovations' standard deviation to the stated one from which `noise_grown` is said"""
    noise_rests: int = 60
    """rests whose scatter is kept, axis by axis (`watch.axis_noise`): about a day of drilling"""
    noise_fewest: int = 5
    """rests before a change that its size is judged by"""
    noise_confirm: int = 3
    """rests one after another that must all scatter `grown` times what nine tenths of the rests before did, or as much
    less than what one tenth did, for a change to be said, and all be within it for its end. Scatters of two seconds are
    known within 25 % from the shortest rest: by chance alone three of them pass in fewer than one of 10,000"""
    jump: float = 7.0
    """twice the log-likelihood ratio of noise that has grown, of one measurement, from which the next ones must tell
    whether it is noise or a departure: one number beyond 3.2 standard deviations, in one of 800 by chance. Of a step
    the first that it moves by so much is then among those that tell"""
    jump_chance: float = 1e-2
    """that noise of any size alone looks so much like one given departure (`watch.hold`): twice the log-likelihood
    ratio against noise must pass -2 ln of it, 9.2. There are some ten directions, and their sizes are free: how often
    some departure passes is what `studies.watch_means` counts"""
    jump_fewest: int = 4
    """numbers of which that is judged: one of ten directions, its size and its onset explain three of anything nearly
    as well"""
    jump_wait: int = 8
    """measurements waited for; what has not passed as a departure by then is taken for noise"""
    left_ratio: float = 1.2
    """of the sum of squares that the likeliest departure leaves to what noise as expected leaves, from which it is not
    all that departs: the noise is followed until the alarm by 60 numbers, within 22 % of its square"""
    left_sigmas: float = 5.0
    """by which it must be more than that besides"""
    walk: float = 1.3
    """random walk, in units of the stated one, that stated standard deviations allow for: innovations hardly show it.
    Set on 200 wells each (first seed 91000): with the stated walk, 1.5 times it, and 1.5 times it with noise 1.4 times
    the stated, 95 % intervals hold the truth in 96.7, 94.0 and 96.5 %; with a value of 1 in 95.3, 92.3 and 96.4 %"""
    most_traced: int = 20_000
    """measurements whose trace is kept for a picture (two months of five an hour); then the oldest leaves"""
    most_beyond: int = 1000
    """readings kept that are not gravity's"""
    coldest_c: float = -100.0
    hottest_c: float = 400.0
    """deg C: temperatures beyond these are none of an electronic tool; the hottest wells have some 300"""
    pull_deg: float = 1.0
    """error of inclination, or of toolface times sin I, from which the advice is to pull the tool: the tolerance of
    most well plans"""


STATED = StatedNoise()
POLICY = WatchPolicy()
