"""The numbers that decide what lots have in common: each with its unit, its meaning and what set it."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["COMMON", "POOLING", "SPREAD", "STABILITY", "TASKS"]


@dataclass(frozen=True)
class PoolingPolicy:
    """Of the estimates of one effect."""

    steps: int = 200
    """fixed-point steps of the restricted likelihood, at most"""
    settled: float = 1e-8
    """change of the variance between tools, of itself and the least variance of an estimate, at which it stands"""
    visible: float = 1e-8
    """of the largest eigenvalue of a scaled information: directions below say nothing (as `REGRESSION.visible`^2)"""
    conspicuous: float = 2.5
    """robust standard deviations from the median of the tools from which one is tested as an outlier: what is called
    out among 10 tools or more passes 4, and only the tests of the others are saved"""


@dataclass(frozen=True)
class CommonPolicy:
    """Of what is said of a lot."""

    fewest_tools: int = 5
    """tools below which a lot is not judged: Student's t with 3 degrees of freedom or fewer wants 6 standard
    deviations for what 100 tests show by chance"""
    false_discoveries: float = 0.01
    """expected share of false ones among the effects named, over lots x effects (Benjamini and Hochberg 1995). At 0.05
    13 of 50 fleets had one (`studies.fleet_lots --first-seed 70000`): named beside another, or by a neighbour's name"""
    same_class: float = 10.0
    """in BIC: effects that explain a lot within so much of one another are one class. A rival of the truth is ahead by
    that with a probability of at most exp(-5), 0.7 %; at the 6 of a single diagnosis it is 5 %, and most of the names
    that were wrong of 50 fleets (`studies.fleet_lots --first-seed 80000`) were such"""
    outlier_p: float = 0.01
    """chance that any tool of the fleet is called out where none is (Bonferroni over tools x effects)"""
    change_p: float = 0.01
    """the same of a change along the order of the tools (over lots x effects x places)"""
    hidden: float = 0.01
    """share of an effect's information that is left beside another, below which the two are one in a lot: a
    correlation of 0.995"""
    places: int = 40
    """along the order of the tools, at which a change is looked for, at most: each takes two fits"""
    most: int = 6
    """effects named in one lot, at most"""
    power_80: float = 0.84
    """standard deviations by which a size must pass the threshold to be found with 80 % probability"""


@dataclass(frozen=True)
class TaskPolicy:
    """Of the work that is given to a process in one piece."""

    seconds: float = 10.0
    """of work in one task: the scheduler takes about 1 ms a task, so 1e-4 of it"""
    diagnosis_s: float = 0.3
    """what a short recording takes to be diagnosed (126 poses: 0.25 to 0.6 s on one core of 2 GHz)"""
    other_s: float = 0.01
    """what one takes to be solved (12 poses: 6 to 7 ms there) or followed"""
    per_megabyte_s: float = 1.5
    """what each further megabyte takes (100,000 rows, 9 MB gzipped: 12 s)"""
    pieces: int = 4
    """for each process, at least: so they end within a quarter of their work of one another"""
    scheduler_s: float = 1e-3
    """that the scheduler takes for a task"""
    scheduler_share: float = 0.1
    """of its time, at most, when all processes ask it for tasks"""
    watched_s: float = 60.0
    """for each process, from which on dask's dashboard is begun unasked: it takes 0.4 s"""
    ask_again_s: float = 5.0
    """between two looks at whether all processes are there; one takes 2 to 10 s to start"""
    attempts: int = 3
    """deaths of the process that works on a recording alone before that is its result"""

    def seconds_of(self, job: str, size: int) -> float:
        """What a recording of so many bytes takes."""
        return (self.diagnosis_s if job == "diagnose" else self.other_s) + self.per_megabyte_s * size / 1e6

    def batch_seconds(self, work_s: float, processes: int) -> float:
        """Of a batch, where so many processes share so much work: few enough for the scheduler, and enough for all."""
        least = processes * self.scheduler_s / self.scheduler_share
        return min(self.seconds, max(least, work_s / (self.pieces * processes)))


@dataclass(frozen=True)
class SpreadPolicy:
    """Of one recording that is given out in parts."""

    runs: int = 64
    """of rows (`CHUNKS.rows`) in one task: 262,144 rows, one to five seconds of work. Its inner products
    are 0.8 MB for each fold and rate of a channel: 90 MB where all 160,000 rows of ten rates are one task"""
    waits_s: float = 30.0
    """for the first process of a cluster, which may be starting"""


@dataclass(frozen=True)
class StabilityPolicy:
    """Of calibrations over time."""

    fewest_pairs: int = 5
    """repeated calibrations below which no random walk is stated: its rate would be known to worse than a factor of
    two"""
    most_deviations: float = 3.5
    """standard deviations of an innovation beyond which it says nothing more of the random walk: one of 2,000 normal
    ones"""
    interval: float = 1.92
    """of the log likelihood: 95 % of one parameter"""
    grid: int = 60
    """rates that are tried, over their whole range: 15 % apart or less"""
    smallest: float = 1e-2
    """of a record's own error over the longest time between two: a rate that could not be told from none"""
    shortest_days: float = 0.1
    """between two calibrations, as far as the largest rate is concerned"""
    alarm_p: float = 0.01
    """chance that any calibration of a group is called a departure where none is (Bonferroni)"""
    ahead_days: float = 3650.0
    """how far ahead a due date is looked for"""
    halvings: int = 40
    """of that, until the date is found"""
    inclinations_deg: tuple[float, ...] = (1.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 120.0, 150.0, 179.0)
    toolfaces_deg: tuple[float, ...] = tuple(30.0 * k for k in range(12))
    """attitudes over which the worst is taken"""


POOLING = PoolingPolicy()
COMMON = CommonPolicy()
STABILITY = StabilityPolicy()
TASKS = TaskPolicy()
SPREAD = SpreadPolicy()
