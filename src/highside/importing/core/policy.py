"""The numbers that decide what a foreign column is. Each with its unit and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ImportPolicy:
    """When a guess is certain, likely or open."""

    gravity_share: float = 0.05
    """1: how far the median of |a| may be from one g for a unit to be inferred from values alone. A MEMS triad without
    calibration is within 3 % (data sheets of MPU-6050, LSM6DSO: 40 to 60 mg a channel). 1,024 counts and 1,000 mg
    both fit then, and it is open which."""
    named_gravity_share: float = 0.2
    """1: how far it may be for a unit that the file names to be believed: motion and large offsets, but no other
    unit (the nearest two, g and m/s2, are ten times apart)."""
    resolutions: tuple[int, ...] = (256, 512, 1024, 2048, 4096, 8192, 16384, 32768)
    """counts per g of 8 to 16 bit converters with full scales of 1 to 16 g (data sheets)"""
    counts_share: float = 0.01
    """1: within it whole numbers are taken for counts of a resolution although mg are named; 1,000 and 1,024 are 2.4 %
    apart (tests/unit/test_importing_mistakes.py)"""
    rate_hz: tuple[float, float] = (1.0, 8000.0)
    """Hz: rates at which inertial sensors are logged; a unit of time is inferred where one alone gives such a rate"""
    named_rate_hz: tuple[float, float] = (0.1, 10_000.0)
    """Hz: rates outside of which even a named unit of time is doubted; of a file logged at 10 to 100 rows/s a unit that
    is wrong by a thousand falls outside on either side (tests/unit/test_importing_mistakes.py)"""
    epoch_s: tuple[float, float] = (946_684_800.0, 4_102_444_800.0)
    """s: 2000-01-01 to 2100-01-01; numbers in it, in s, ms, us or ns, are times since 1970"""
    stated_rate_share: float = 0.02
    """1: how far the step of a clock may be from the rows/s that the file itself states: crystals and resistors of
    sensors (data sheets: 1 %, MPU-6050)"""
    same_share: float = 0.5
    """1: share of rows that have the time of the row before beyond which it is no time of rows: written to the second,
    or of the packet that brought several"""
    same_rows: int = 20
    """rows from which on that is looked at"""
    rate_rad_s: float = 40.0
    """rad/s: 2,290 deg/s, above the widest usual full scale (2,000 deg/s): larger numbers are no rad/s"""
    rate_dps: float = 4500.0
    """deg/s: above the widest full scale of any (4,000 deg/s): larger numbers are no deg/s"""
    kinematic_share: float = 0.25
    """1: how far the rate of the gravity direction may be from that of the gyros for their unit to be inferred; deg/s
    and rad/s are 57 times apart"""
    kinematic_correlation: float = 0.9
    """1: least correlation of the two for the comparison to count: noise that leaves it there takes at most 19 % off
    the ratio"""
    kinematic_turn_rad: float = 0.2
    """rad: least turn of the gravity direction in all for the comparison to count"""
    step_counts: float = 50.0
    """counts: readings up to so many are looked at for steps; two data sheets that differ by 0.1 % are 0.05 steps apart
    there"""
    step_values: int = 5
    """different counts that must occur for steps to be seen"""
    least_stepped: int = 1000
    """readings for steps to be seen"""
    step_share: float = 0.8
    """1: least mean cosine of the phases for steps: of readings without them it is below 0.1 for 1,000 rows"""
    counts_of_rates_share: float = 0.05
    """1: how far the counts per deg/s that the turn of gravity says may be from a data sheet's: the nearest two are
    13 % apart"""
    rest_rows: int = 50
    """rows of a rest that are averaged: 0.5 s at 100 rows/s"""
    least_rests: int = 12
    """rests for a sphere, which has four unknowns"""
    rest_share: float = 0.05
    """1: how far |a| at rest may be from one g with the zero of the converter: a MEMS triad (`gravity_share`)"""
    rest_spread: float = 0.1
    """1: least variance of the directions of gravity along any axis, of 0.33 for all round"""
    zero_share: float = 0.2
    """1: how far the zero that is found may be from the middle of a converter, in g: offsets of MEMS triads"""
    kinematic_fast: float = 0.3
    """1: share of the fastest turn from which on they are compared by themselves where the whole does not go together
    (two recordings of 22 rests, turned by hand between them: correlation 0.86 of all, 0.93 of these)"""
    celsius: tuple[float, float] = (-60.0, 230.0)
    """deg C: readings of down-hole electronics"""
    kelvin: tuple[float, float] = (240.0, 500.0)
    """K: the same; 230 to 240 is neither by itself"""
    angle_rms_deg: float = 10.0
    """deg: rms angle between accelerometer and reference below which axes and unit of the reference agree"""
    angle_floor_deg: float = 1.0
    """deg: rms below which no other arrangement is looked for: a sensor without calibration on a bench that leans"""
    angle_ratio: float = 3.0
    """1: how many times worse the next arrangement of axes must be for one to be inferred"""
    marker_times: float = 10.0
    """1: how many times the largest other value of a column a number must be to be the mark of a missing value; -999.25
    stands beside g, m/s2, deg/s of a hand and deg C, not beside mg or counts, which |a| shows"""
    gap_steps: float = 1.5
    """1: a step of more than so many usual ones is a gap (the jitter of USB and radio loggers stays below)"""
    rows_around: int = 9
    """rows before and behind a wide step whose times are compared: a row that is late itself is no median of them"""
    rows_between: int = 2
    """rows: wide steps that are not further apart are judged together"""
    room_rows: int = 1000
    """rows before a time that falls back among which room for it is looked for"""
    whole_share: float = 0.15
    """1: how far from a whole number of rows the times may have moved for rows to be called lost. Of steps of a clock
    by any amount 3 in 10 pass for lost rows then; no lost row passed for a step of the clock up to a jitter of 6 %
    (tests/unit/test_importing_steps.py)"""
    whole_scatters: float = 3.0
    """1: the same in scatters (median) of the regular steps, where that is more"""
    pause_steps: float = 20.0
    """1: a step of more than so many usual ones is a pause: who writes rows at rest alone (a session of stops) or was
    unplugged wrote nothing, and how many rows were lost cannot be said"""
    uneven_share: float = 0.1
    """1: share of steps that are gaps beyond which the steps are uneven and nothing is lost: of an MPU-6050 polled by a
    computer 27 % were (a static recording of 10 min)"""
    catch_up_rows: int = 100
    """rows within which a late row is followed by later times; beyond, the clock began again"""
    joined_gap_steps: float = 5.0
    """1: a step of a joined table of more than so many usual ones is not interpolated across"""
    lag_s: float = 30.0
    """s: lags that are looked at between clocks that say the same: buffers, time zones are not among them"""
    lag_steps: float = 2.0
    """1: usual steps beyond which a measured lag is asked about"""
    lag_points: int = 1 << 18
    """points on which two signals are compared: 44 min at 100 rows/s without thinning"""
    lag_agreement: float = 0.8
    """1: least correlation for a lag to be believed"""
    lag_second: float = 0.8
    """1: share of the highest peak that a second one must stay below: a swing of 3 s seen 10 times gives 0.9"""
    shown_rows: int = 5
    """rows named in a message"""
    judged_rows: int = 200_000
    """rows on which values are judged, spread evenly: the medians stand to 1 % with far fewer"""


POLICY = ImportPolicy()
"""what the commands use"""
