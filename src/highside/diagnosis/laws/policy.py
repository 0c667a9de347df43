"""The numbers that decide for laws.

Each stands with its unit, its meaning and what set it. They are no settings for users.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LawGroupsPolicy:
    """The functions that are tried."""

    cosines: int = 16
    """Cosines over the range of a covariate and a tenth more on either side. Source: the trial of 32 sessions that set
    the method used 14 over the range itself; as many to a wave."""
    orders: int = 12
    """Whole orders of toolface, a cosine and a sine each. Source: orders 1 to 12 in the same trial."""
    pair_orders: int = 7
    """Functions of each covariate in a product, order 0 among them. Source: orders 0 to 5 in the same trial, over the
    range itself; as many to a wave."""
    pair_turns: int = 3
    """Whole orders of toolface in a product. Source: chosen, about as many functions as of another covariate."""
    onset_values: int = 3
    """Values on either side of an onset, at least. Source: two are fitted by a constant and a slope."""
    finer_orders: int = 10
    """Functions of each covariate in a product that was found, order 0 not counted. Source: waves of a length of a
    fifth of the range, as a law of one covariate of medium smoothness has them."""
    finer_turns: int = 6
    """Whole orders of toolface in such a product. Source: half of those of a law of the toolface alone."""
    averaged_rows: int = 400_000
    """Rows of a session, at most, over which functions are averaged; of more they are those of the mean. Source: 17
    functions of 360,000 rows take 0.1 s."""
    averaged_kept: int = 1000
    """Covariates whose functions over cells are kept. Source: 60 MB of 3,000 cells; 360,000 rows ask for 620."""
    by_nodes: float = 2.0
    """rad by which the fastest function of a covariate turns over one standard deviation within a cell, up to which its
    mean is taken from six nodes. Source: of values that are spread evenly it is right to 2e-5 there."""
    nodes_kept: int = 200
    """Covariates whose nodes within cells are kept. Source: 90 MB of 4,500 cells; lags are asked for a few times in
    a row."""
    pairs: int = 20
    """Pairs of covariates that are tried side by side in a place, about. Source: the list of pairs."""
    steps: int = 48
    """Places in time at which a step, a ramp or a decay is tried, at most. Source: chosen; finer than a tenth of the
    sessions' thirds, over which a law has to be stable."""
    decays: tuple[float, ...] = (0.03, 0.1, 0.3)
    """Time constants of decays, shares of the range of time. Source: chosen; the cosines take longer ones."""
    onsets_between: int = 24
    """Onsets between two of those places that are tried for a step, ramp or decay that was found, at most. Source: with
    `steps` 1,152 onsets in a session, more than values of most; one value on the wrong side of a step of 20 sigma costs
    200 nats, and two steps of an offset 5 and 20 s beside their places were taken for slow noise."""
    decays_between: tuple[float, ...] = (0.6, 0.75, 0.9, 1.1, 1.33, 1.7)
    """Factors of the time constant that are tried for a decay that was found. Source: together they span the factor of
    3 between two of `decays` on either side."""
    waves: int = 240
    """Waves of an offset over time, at most. Source: two for each of 60 poses, in steps of half a turn."""
    first_wave: float = 3.0
    """Turns of the slowest. Source: chosen; a wave of fewer turns is a curve of the time."""
    wave_step: float = 0.5
    """Turns over the session by which two waves differ. Source: half a turn between them leaves a fifth at most of one
    in their middle, and what is found is sharpened."""
    a_value: float = 2.0
    """Turns of the fastest wave for each value. Source: chosen; a line of the mains that is sampled comes at any
    period, and a pose of a third of its period keeps 0.83 of it."""
    dents: int = 36
    """Toolfaces around which a dent is tried. Source: chosen; its widths overlap."""
    dent_widths_deg: tuple[float, ...] = (6.0, 12.0, 24.0)
    """Widths of a dent, deg. Source: chosen; wider ones are the sum of few orders."""
    fractions: int = 80
    """Orders of toolface that are no whole numbers, tried in steps of a tenth. Source: chosen, orders below 8."""
    lines: int = 120
    """Orders of a line of the turn that are searched, beside which it is one. Source: half orders up to 60."""
    fraction_step: float = 0.1
    """Step of these orders, 1 per turn. Source: chosen; a session of one turn tells no finer ones apart."""
    distinct: float = 1e-6
    """Share of the range by which values of a covariate are the same. Source: rounding of a recording."""
    few: int = 3
    """Distinct values of a covariate from which it is one with a curve. Source: two are a step and no more."""
    constant: float = 1e-9
    """Range of a covariate, beside its size, below which it does not vary. Source: rounding."""
    absent: float = 1e-9
    """What a unit of a law does in a place, beside the most it does in any, below which it does nothing there. Source:
    rounding; the scale of a gyro across the axis of the turn acts by 1e-15 of that along it (null/251 of the open
    world of seed fresh-23-nov, in which such columns, 1e10 times, passed for a law)."""


LAW_GROUPS = LawGroupsPolicy()


@dataclass(frozen=True)
class LawEvidencePolicy:
    """The prior of a smooth function, and its grid."""

    lengths: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0)
    """Orders beyond which the prior falls off. Source: the grid of the trial that set the method."""
    rough: float = 2.0
    """Length at which a group is looked at first. Source: chosen; in the middle of the grid."""
    slack: float = 6.0
    """Nats that another length may add to a group that is of interest. Source: chosen; a law of a few tens of nats
    shows few of its functions, and none but the rough ones differ by more from length to length."""
    undetermined: float = 0.01
    """Variance that data add to a combination of a law's functions, in units of the prior's, below which noise is
    learnt without it. Source: it moves the evidence by less than 0.005 nat each."""
    power: float = 2.0
    """Power of the prior's fall. Source: variance s (1 + (k / l)^2)^-2 of that trial."""
    sizes: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 3e3, 1e4, 3e4, 1e5, 1e6, 1e7, 1e8)
    """Prior variances tried, in units of what noise lets one function's coefficient be known by. Source: chosen; from
    less than the noise to a strength of 1e8, so that no law is too large to be found."""
    ridge: float = 1e-9
    """Share of each column's own size added when its group is fitted without a prior: functions that are alike.
    Source: rounding."""
    clearly: float = 1e-6
    """What is left of each of some rows of length 1 beside those before it, from which they are independent. Source: of
    inner products 1e-8 is rounding."""
    nearly: float = 1e-3
    """How far from 0 and 1 the inner products of rows made orthonormal once may be to be made so by once more. Source:
    what is left is its square."""
    halved: int = 4
    """Groups of which one is not positive that are still halved to find it. Source: chosen; eigenvalues of four small
    matrices cost as much as a call."""
    nothing: float = 1e-30
    """Square of whitened columns below which they are nothing. Source: rounding of columns that what is free takes."""
    first: int = 24
    """Groups of the highest bounds that are looked at first. Source: chosen; one of them is the best nearly always."""
    at_once: int = 256
    """Columns of groups that are whitened at once. Source: a processor's cache; for one a pass costs as much."""
    raw: int = 10_000_000
    """Numbers of columns that are kept as they are where all are no more. Source: memory of 80 MB; 264 poses have 8.4
    million, and are diagnosed in a tenth less time."""
    scores: int = 2
    """Noises under which what was scored is kept. Source: chosen; a step and what is told of it ask for the last."""
    kept: int = 20_000_000
    """Numbers of whitened columns that are kept, of the noises tried last; of more each pass makes them anew. As many
    of single laws under one noise, and of their inner products with all others. Source: memory of 160 MB; poses keep
    four and more noises, cells of a rotation (3,000 values, 530 MB a noise) none."""


LAW_EVIDENCE = LawEvidencePolicy()


@dataclass(frozen=True)
class LawSearchPolicy:
    """What a law must show."""

    curves_at_the_floor: int = 2
    """Curves, at most, after which a search that has come down to the floor ends. Source: a proof by removal compares
    two with each and with none; of three there are sets that it does not."""
    at_the_floor: float = 3.0
    """Standard deviations by which the noise of values that are independent may exceed the floor by chance. Source:
    0.1 % of a normal law."""
    quiet: float = 0.1
    """Share of the floor by which it may at most, however few the values. Source: a definition: a tenth."""
    gain: float = 12.0
    """Nats that a law must be worth with the noise learnt again. Source: 0 of 65 sessions without a law had one, in
    the trial that set the method."""
    each: float = 6.0
    """Nats that each law must be worth where sets of them are compared. Source: as `LAW_VERDICT.each`."""
    hopeless: float = 100.0
    """Nats behind names that are known already, after which a search among laws goes no further than its first starts;
    and behind the best in a name's place, after which a group is not sized (all limits on that are less).
    Source: of 15 such searches of known effects of the open world (6724e666, every fourth) further starts gained at
    most 55."""
    dominant: float = 0.9
    """Share of the misfit that one law must explain for what it does beyond first order to be taken out before the
    search. Source: chosen; what two laws of like size do beyond first order is not that of either."""
    most: int = 6
    """Laws of one session, at most. Source: chosen; decks have up to four."""
    most_first: int = 4
    """Laws taken before any noise is learnt, at most. Source: chosen; coloured noise would be given any number."""
    numbers_first: int = 200
    """Numbers that these laws have, at most, where all of them would explain less than noise alone. Source: 12,300 rows
    of coloured noise and a law: with 583 numbers the noise beside them took 37 s to learn, and the search went on from
    noise alone."""
    simpler: float = 12.0
    """Nats by which a law of two covariates must be ahead of one of these alone. Source: a further covariate is a
    further claim, and must be worth as much as a law; of 6 nats a product over all pairs of covariates took the place
    of its true factor in heavy-tailed noise (law/294 of the open world of seed pl-tune-1)."""
    named: float = 6.0
    """Nats behind the best law within which an effect of the library is taken in its place. Source: chosen; a tie."""
    rival_gain: float = 1.0
    """Nats by which another group must be ahead to take a law's place. Source: chosen; less is a tie."""
    variant: float = 12.0
    """Nats by which a variant, with an onset or of finer functions, must be ahead of a law. Source: as `simpler`."""
    tie: float = 1e-3
    """Nats within which groups tie, and the first of them is taken. Source: an offset and a cross-axis element of the
    load at one inclination differ by 1e-8, with the processor's rounding (tests/unit/test_diagnosis_rotation.py)."""
    finer_shapes: int = 9
    """Values of a shape parameter that are tried between two neighbours of the one found. Source: chosen; of time
    constants a factor of four apart three rounds leave steps of 1 %, and half of such a step leaves 0.1 of a strength
    of 1e5 (a decay changes by a tenth of itself with the logarithm of its time constant, sizes refitted)."""
    shape_rounds: int = 3
    """Rounds of that. Source: as `finer_shapes`."""
    shape_step: float = 1e-3
    """Step of a shape parameter, as a share of itself, over which its slope is taken. Source: a second difference of
    1e-6 beside it, and rounding of 1e-13."""
    rounds: int = 2
    """Rounds of rival refits. Source: chosen; the third changed nothing in the trial."""
    most_rivals: int = 4
    """Laws that are told with a name. Source: chosen; a reader wants few."""


LAW_SEARCH = LawSearchPolicy()


@dataclass(frozen=True)
class LawReportPolicy:
    """What is reported of a law."""

    folds: int = 8
    """Sets of values that are left out in turn. Source: chosen; an eighth is small enough to leave the law as it is."""
    held_out: float = 12.0
    """Nats that a law must gain on them. Source: as `LawSearchPolicy.gain`; of 320 laws told in stepped sessions of the
    open world (seeds d31709b, ties-fresh-1, ties-fresh-2, names-tune-1) those of right answers gained 18 and more, and
    four of wrong ones -77 to 10.6, among them the one false law (null/200 of d31709b, 4.9)."""
    ridge: float = 1e-10
    """Share of a column's size that keeps normal equations from being singular. Source: rounding."""
    over_range: int = 400
    """Values over a range at which a curve is the same with other functions. Source: ten a wave of the finest."""
    case: float = 0.05
    """Share of what a name does that a law's functions cannot do, below which the name is a case of that law. Source:
    chosen; fourteen cosines make a square to better than a thousandth, another place makes none of it."""
    known: float = 0.5
    """Standard deviation of a law's size in a part of the session, in units of itself, from which that part says
    something of stability. Source: chosen; a part that knows it by less agrees with anything."""
    shape: float = 0.1
    """Scatter of a law's size over parts that its uncertain shape alone makes. Source: chosen; a learnt curve is off
    by up to a tenth of its size at strength 400."""
    stable: float = 0.01
    """Chance of the disagreement over parts below which a law is not stable. Source: chosen; one in a hundred."""
    sure: float = 2.0
    """Standard errors of an interval. Source: 95 % of a normal deviate."""
    unseen: float = 40.0
    """Strength (square of the size in units of the noise) that a shape may differ by unseen. Source: the trial that
    set the method: no margin tells less apart."""
    least_log: float = 700.0
    """Nats beyond which a chance is no number any more. Source: the range of double precision."""
    grid: int = 61
    """Points of a curve that is reported. Source: chosen; more than its functions have waves."""


LAW_REPORT = LawReportPolicy()


@dataclass(frozen=True)
class ClosedRivalsPolicy:
    """Closed forms beside names, where only |g| is known."""

    ahead: float = 6.0
    """Nats by which a form must be ahead of a name for the name to be withdrawn. Source: as
    `LawFormulasPolicy.margin`."""
    behind: float = 6.0
    """Nats behind a name within which a form that runs differently is told beside it. Source: as `ahead`."""
    differs: float = 0.9
    """Share of a form that the name can do as well, below which it runs differently: of one that is more like it
    `shape_within` speaks. Source: as `LawVerdictPolicy.resembles`."""
    same: float = 0.99
    """Share of a form that the name can do as well, from which the two are one. Source: what 18 named effects of
    strength 400 left room for (`python -m studies.hand_outsiders effects --first-seed 500`)."""
    tied: float = 3.0
    """Nats ahead of a name from which a form that runs nearly as it does is told beside it. Source: strong evidence
    (Kass and Raftery 1995); in the same 18 no such form was ahead by more than 1.8."""
    most: int = 3
    """Forms that are told, at most. Source: as `LawFormulasPolicy.most`."""
    shown: float = 1e-4
    """Share of a column outside of what is free, below which it is rounding. Source: as
    `MagnitudeNoisePolicy.independent`."""
    ridge: float = 1e-9
    """Share of a column's size added where those of one form run together. Source: as `LawEvidencePolicy.ridge`."""


CLOSED_RIVALS = ClosedRivalsPolicy()


@dataclass(frozen=True)
class LawFloorPolicy:
    """The noise floor that the misfit has no part in."""

    least: float = 1e-9
    """Share of the readings' own size that is noise at least. Source: rounding."""
    rows: int = 200
    """Rows of cells that have several, from which the scatter within cells is the floor. Source: a median of so many is
    known to a tenth."""
    rows_of_a_cell: int = 6
    """Rows of a cell of which what is straight within it is no noise. Source: chosen; three of six are its mean and
    the slopes of toolface and time."""
    mad: float = 0.6745
    """Median of the size of a normal deviate. Source: the normal distribution."""
    apart: float = 0.02
    """Share of the noise's variance by which rows of a cell differ from its mean, at least. Source: two neighbouring
    rows of noise that is correlated by 0.96; beyond, an error of that correlation is as large."""
    correlation: float = 0.98
    """Correlation of neighbouring rows, at most. Source: `apart`."""
    alike: float = 0.5
    """Correlation of rows of a cell that are far apart, up to which their difference says how large noise is. Source:
    chosen; of more, an error of the correlation is as large."""
    straight: float = 1e-6
    """Part of a slope that is left beside a cell's mean, from which it differs within the cell. Source: rounding."""
    coloured: float = 0.1
    """Correlation of neighbouring rows from which they are not independent. Source: chosen; the mean of many rows is
    then a tenth less certain."""
    turns: int = 4
    """Times that the size and the correlation of rows are estimated, each beside the other. Source: chosen."""


LAW_FLOOR = LawFloorPolicy()


@dataclass(frozen=True)
class LawCellsPolicy:
    """Cells that stand for the rows of a rotation."""

    most: int = 1500
    """Cells of a session, about, and rows below which each is its own. Source: chosen; the cost of a search stays at
    that of 264 poses times four."""
    limit: int = 4500
    """Cells of a session, at most, while wider ones make them fewer. Source: of 80 rotations of the deck of 28cdabc7
    three had more, one of them 12,585; a search of 10,610 had not ended after 15 minutes."""
    wider: tuple[int, ...] = (2, 4, 8)
    """Times as much as usual that a rate may change within a cell. Source: as `limit`; eight times are two fifths of
    the largest rate."""
    a_wave: float = 6.0
    """Sectors of a turn for each wave of a line that was found in it. Source: a mean over a sixth of a wave keeps 0.95
    of its size."""
    sectors: int = 30
    """Sectors of a turn. Source: chosen; the twelfth order keeps 0.76 of its size in a mean
    over one, the fourth 0.97."""
    rate: float = 0.05
    """Change of the rate, as a share of the largest, at which a cell ends. Source: chosen; as the steady rates of the
    diagnosis by rows."""
    bins: int = 6
    """Bins of a channel's prediction beside another program's output. Source: chosen; a factor keeps 0.97 of what its
    field is in the means of a sixth."""
    alike: float = 1e-12
    """Standard deviation of a covariate within a cell, beside its mean, from which its values differ. Source: rounding
    of squares."""
    nodes: int = 6
    """Values of a covariate from which the mean of a smooth function over a cell is taken. Source: `by_nodes`."""
    further: float = 1e-4
    """Root mean square of the next orthogonal polynomial of a covariate's values within a cell, beside that of the
    last, from which there is a further node. Source: of as many values as nodes it is zero but for rounding."""
    slow: float = 4.0
    """How many times longer than the mean a block may last. Source: chosen; at rest no turn ends it."""


LAW_CELLS = LawCellsPolicy()


@dataclass(frozen=True)
class LawVerdictPolicy:
    """When names give way to laws."""

    margin: float = 5.0
    """Nats by which laws must be ahead of names to take their place. Source: margins of 5 to 8 kept 87 of 90 true names
    and 3 of 126 outsiders, in the trial that set the method."""
    each: float = 6.0
    """Nats that each name or law must be worth where sets of them are compared. Source: chosen; half of what a law must
    be worth by itself, as names and laws of one set differ in how many functions they have."""
    beside: float = 8.0
    """Nats that a free law may gain beside a single name that is believed without further comparison; and by which a
    name with a shape of its own must, beside laws, be ahead of each law in its place. Source: margins of 5 to 8 in the
    same trial; a step told beside two laws that it was not was 4.2 ahead (law/062 of 06d8469)."""
    ahead: float = 3.0
    """Nats by which one law in the place of a name must be ahead of it, the noise kept, to be told instead. Source: of
    26 sessions with effects of the library the nearest was 2.7 ahead, of eight outsiders that had a name four were 3.3
    to 16 (studies.open_world, a deck of seed 06d8469e11e0 and the sealed one of 06d8469)."""
    worth: float = 3.0
    """Nats that a name by itself must gain beside the noise that is learned with it. Source: strong evidence (Kass and
    Raftery 1995); `wobble` in two sessions whose bench shook to all sides alike, and without any effect, gained 0.4
    (null/046 and null/174 of 6e7a832)."""
    shrunk: float = 0.01
    """Share of what a name explains by which its prior may cost it. Source: chosen; it cost a tilt of 1.3 deg 0.0004 of
    14 million nats, and outsiders were ahead by 0.1 and more."""
    second_order: float = 20.0
    """Chi-square of what laws do beyond first order, from which they are looked for again with it taken out. Source:
    chosen; below it no further law is made of it."""
    turns: int = 2
    """Times that they are. Source: chosen; the second changed laws of a degree by less than their band."""
    large: float = 0.25
    """Share of a law's largest departure from its median from which it is large there. Source: chosen; a bump is
    located by 3.3 of its standard deviations."""
    beside_random_walk: float = 20.0
    """Nats that an offset that follows time or temperature must gain in a rotation where a random walk of the zero
    offset was found. Source: a bump over temperature of 2.5 sigma in four minutes gains 36.9 (tests.bench.
    diagnosis_speed), and none of 21 random walks of 12,000 to 90,000 rows had a law of 12; it was 40 while the noise of
    means was taken for a chain. Poses need no more than other laws: none of 171 nulls of walking, 1/f and coloured
    noise of three decks had a law, and of laws in 14 poses, of whatever size, none can gain 40."""
    least_explained: float = 0.01
    """Share of a misfit larger than the noise below which laws are no answer, nor names where it is taken for errors of
    the set angles. Source: an offset that swings ever faster was told as a law that explained less than 0.001."""
    least_share: float = 1e-5
    """Share of the misfit below which a law beside names is none. Source: two effects of 30 mg (lever arm, late clock)
    leave 3e-7 of what they do to the means over cells (tests/unit/test_diagnosis_long.py)."""
    leftover: float = 0.02
    """Share of the misfit below which a name found beside laws is a part of these that their functions leave. Source: a
    surface of seven by seven functions left 0.011 of a product with an edge, which was named (law/021 of 06f31f0a)."""
    far_alone: float = 10.0
    """Scatter of one axis above its floor, in units of another's, from which a walk of it alone may be something left
    out. Source: as `most_left`; laws of one axis in 14 poses, of strengths 400 to 405,000, left 15 to 263 (law/120 of
    6724e666)."""
    no_stand_in: float = 1e6
    """Nats of several names of a rotation, from which no law is sought in their place. Source: arithmetic; laws that
    names stand for would leave `LawSearchPolicy.gain` beside them, and names mimic no law to a part of 1e-5."""
    memory: float = 12.0
    """Nats by which noise that is correlated from pose to pose must be ahead of noise that is not, to be what is left.
    Source: as `LawSearchPolicy.gain`."""
    poses_a_function: int = 3
    """Poses for each function of a law, from which errors of the set angles are distinguished from a law of them.
    Source: chosen; of 36, 42, 42 and 45 poses laws of strength 902 to 53,000 were taken for such errors (law/272 of the
    open world of seed pl-tune-1; law/060, law/230 and law/236 of seed d31709b), of 53 poses and more none."""
    hidden: float = 100.0
    """Chi-square above the floor that errors of the set angles take, from which a law may be hidden in them. Source: a
    quarter of the strength at which laws are to be found (400)."""
    most_left: float = 10.0
    """Standard deviations of a channel in those of its noise floor, from which a name does not explain what is there.
    Source: of 51 sessions with effects of the library under nine noises right names left 1.0 to 3.6
    (studies.open_world, a deck of seed leadtune-a); one of two laws that had a wrong name left 63 (law/258 of b4791ee).
    """
    repeats: float = 5.0
    """Nats by which readings that repeat worse than they scatter must be ahead of readings that do not, beside errors
    of the set angles, to be what is left. Source: of 26 sessions of 18 to 42 poses without any effect the largest was
    2.5, where the sizes on the grid were 1.35 and the verdict `unknown`; 25 fresh ones had no alarm."""
    set_angles_rad: float = 1.8e-4
    """rad; errors of the set angles that a bench has without anything being left out. Source: a table of steps of 0.018
    deg, pose and station together (`pose_error`: 1.3e-4 rad), and what 20 poses know of it (a standard deviation to a
    sixth, two of them)."""
    independent: float = 10.0
    """Independent stretches, two memories of the noise apart, below which noise that is correlated from pose to pose
    is not distinguished from something slow. Source: as `ColourPolicy.few`."""
    far_above: float = 2.0
    """Standard deviations of a channel in those of its noise floor, from which such noise must be. Source: sealed null
    sessions whose noise is correlated from pose to pose leave 1.35 to 1.5 (`ProblemPolicy.floor_ratio`)."""
    no_walk: float = 100.0
    """The same from which, in few poses, offsets that wander are no answer. Source: the walks of the open world end at
    13 at most; law/082 of seed 925c2d2d, two laws of 0.1 rad in 13 poses, left 883 and was told as a walk."""
    resembles: float = 0.9
    """Share of a law that an effect of the library explains, from which the law resembles it. Source: chosen; the rest
    is more than the band of a law of strength 400."""
    most_shapes: int = 24
    """Shapes of an effect at which a law is compared with it. Source: chosen; the largest grid of the library."""
    overshoot: float = 1.85
    """Times the error of rounding that a smooth law of it reaches. Source: the overshoot of a series of waves at a jump
    (Gibbs), 1.179, and that the error is of half a step where its first wave is of a step / pi: null/061 of 21b7a4d6
    had a law of 1.8 times that wave."""
    names: int = 3
    """Names that a law is said to resemble, at most. Source: chosen; a reader wants few."""


LAW_VERDICT = LawVerdictPolicy()
