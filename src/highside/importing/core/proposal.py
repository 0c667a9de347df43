"""What the columns of a foreign table are, as a proposal: each with its evidence and how certain it is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from highside.errors import InputError
from highside.importing.core.axes import UNREFERENCED, AxesGuess, axes_by_reference, axes_given
from highside.importing.core.columns import MANY, block_is_whole, by_range, named_column, row_number, worth_as_time
from highside.importing.core.headerless import accelerations_among, rates_among, unnamed
from highside.importing.core.instants import is_instant
from highside.importing.core.policy import POLICY, ImportPolicy
from highside.importing.core.source import Numbers, SourceColumn, SourceTable
from highside.importing.core.timing import TimeReading, read_time
from highside.importing.core.units import Quantity, Unit, unit_wanted
from highside.importing.core.vectors import UnitGuess, acceleration_unit, rate_unit, turn_arrangement
from highside.importing.core.wishes import NOTHING, Wishes
from highside.importing.core.words import Meaning, counted_from_one, meaning
from highside.recording.table import RECORDING_COLUMNS

KNOWN = frozenset(RECORDING_COLUMNS)
ACCELERATIONS = ("ax_g", "ay_g", "az_g")
RATES = ("gx_dps", "gy_dps", "gz_dps")
_RAW = ("uncal", "raw")
"""of a name: the same sensor before the maker's own correction"""
_TRIADS = ((Quantity.ACCELERATION, ACCELERATIONS), (Quantity.RATE, RATES))


class Sure(StrEnum):
    """How certain a guess is. `open` cannot be used before the user decides; `likely` rests on values alone."""

    GIVEN = "given"
    CERTAIN = "certain"
    LIKELY = "likely"
    OPEN = "open"


@dataclass(frozen=True, slots=True)
class Guess:
    """One column of ours, the column of the file it comes from, its unit there, and why."""

    target: str
    column: str
    unit: Unit | None
    sure: Sure
    evidence: tuple[str, ...]
    open: str | None = None


@dataclass(frozen=True, slots=True)
class Doubt:
    """What must be decided or confirmed, and the option that does it."""

    what: str
    remedy: str
    open: bool
    option: str = ""
    """what decides it on the command line, as short as it can be written"""


@dataclass(frozen=True, slots=True)
class Proposal:
    """All of it. `kept` are columns that go over as they are, by their name in the file."""

    table: SourceTable
    guesses: tuple[Guess, ...]
    time: TimeReading | None
    rate_hz: float | None
    axes: AxesGuess
    axes_given: bool
    kept: tuple[str, ...]
    omitted: tuple[str, ...]
    doubts: tuple[Doubt, ...]
    part: int | None = None
    poses: bool = False
    """whether each row is a pose"""

    def guess(self, target: str) -> Guess | None:
        """The guess for a column of ours."""
        return next((guess for guess in self.guesses if guess.target == target), None)


def _corrected(judged: list[tuple[UnitGuess, list[SourceColumn]]]) -> list[tuple[UnitGuess, list[SourceColumn]]]:
    """Of several triads those that are not named as raw ones beside them."""
    plain = [pair for pair in judged if not any(word in pair[1][0].name.lower() for word in _RAW)]
    return plain or judged


def propose(table: SourceTable, wishes: Wishes, policy: ImportPolicy = POLICY) -> Proposal:
    """A proposal for this table. Raises InputError for a wish that the table cannot meet."""
    wishes.check(RECORDING_COLUMNS)
    # a damaged number of 1e300 may be squared: it fits no unit then
    with np.errstate(over="ignore", invalid="ignore"):
        return _Proposing(table, wishes, policy).proposal()


@dataclass(slots=True)
class _Proposing:
    table: SourceTable
    wishes: Wishes
    policy: ImportPolicy
    meanings: dict[str, Meaning] = field(default_factory=dict)
    given: dict[str, tuple[SourceColumn, str | None]] = field(default_factory=dict)
    guesses: dict[str, Guess] = field(default_factory=dict)
    doubts: list[Doubt] = field(default_factory=list)
    time: TimeReading | None = None
    other_times: set[str] = field(default_factory=set)
    poses: bool = False

    def proposal(self) -> Proposal:
        self.poses = self.wishes.poses
        self.meanings = self._meanings(reference=self.wishes.reference or self.poses)
        for target, text in self.wishes.mapping.items():
            if text != NOTHING:
                self.given[target] = named_column(self.table, target, text)
        self._time()
        for quantity, targets in _TRIADS[:1] if self.poses else _TRIADS:
            self._triad(quantity, targets)
        self._single_columns()
        axes = self._axes()
        used = {guess.column for guess in self.guesses.values()} | {self.time.column if self.time else ""}
        omitted = tuple(c.name for c in self.table.columns if c.name not in used and row_number(c))
        kept = tuple(c.name for c in self.table.columns if c.name not in used and c.name not in omitted)
        order = {name: place for place, name in enumerate(RECORDING_COLUMNS)}
        return Proposal(
            self.table,
            tuple(sorted(self.guesses.values(), key=lambda guess: order[guess.target])),
            self.time,
            self._rate() if self.time is None else None,
            axes,
            self.wishes.axes is not None,
            kept,
            omitted,
            tuple(self.doubts),
            self.wishes.part,
            self.poses,
        )

    def _meanings(self, *, reference: bool) -> dict[str, Meaning]:
        names = [column.name for column in self.table.columns]
        counted = counted_from_one(names)
        return {
            column.name: meaning(counted.get(column.name, column.name), column.unit, KNOWN, reference=reference)
            for column in self.table.columns
        }

    # --- time -----------------------------------------------------------------------------------------------------

    def _time(self) -> None:
        if self.wishes.rate_hz is not None or self.poses:
            return
        if "t_s" in self.given:
            column, text = self.given["t_s"]
            unit = unit_wanted(text, Quantity.TIME) if text else self.wishes.unit_of(Quantity.TIME)
            own = self.meanings[column.name].unit
            said = unit or (own if own and own.quantity is Quantity.TIME else None)
            self.time = read_time(column, said, self.policy, self.table.rate_hz)
            if self.time is None:
                raise InputError("is no time", where=self.table.where, field=column.name, remedy="--map t_s=COLUMN:ms")
            self._time_guess(Sure.GIVEN if unit else None)
            return
        found = list(self._times())
        if not found:
            stated = self.table.rate_hz
            as_poses = self._meanings(reference=True)
            angles = {known.target for known in as_poses.values()}
            if stated is None and not self.wishes.reference and angles >= {"inc_ref_deg", "tf_ref_deg"}:
                self.poses, self.meanings = True, as_poses
                what = "no column is a time, but each row has an inclination and a toolface: a table of poses"
                self.doubts.append(Doubt(what, "--poses, or --rate HZ", False, "--poses"))
            elif stated is None:
                self.doubts.append(Doubt("no column is a time", "--rate HZ, or --map t_s=COLUMN:ms", True, "--rate HZ"))
            else:
                what = f"no column is a time; the file says {stated:g} rows/s"
                self.doubts.append(Doubt(what, f"--rate {stated:g}, or --map t_s=COLUMN:ms", False))
            return
        found.sort(key=worth_as_time)
        self.time = found[0]
        self.other_times = {reading.column for reading in found[1:]}
        self._time_guess(None)

    def _rate(self) -> float | None:
        return self.wishes.rate_hz or self.table.rate_hz

    def _times(self) -> Iterator[TimeReading]:
        for column in self.table.columns:
            known = self.meanings[column.name]
            written = known.target is None and bool(column.texts) and is_instant((column.texts or ("",))[0])
            hinted = column.instant or column.name == self.table.hints.get("t_s")
            if not (known.quantity is Quantity.TIME or hinted or written):
                continue
            unit = known.unit if known.unit is not None and known.quantity is Quantity.TIME else None
            reading = read_time(column, self.wishes.unit_of(Quantity.TIME) or unit, self.policy, self.table.rate_hz)
            if reading is not None and (reading.step_ns > 0 or column.n < 2):
                yield reading

    def _time_guess(self, sure: Sure | None) -> None:
        time = self.time
        assert time is not None
        open_ = time.open if sure is not Sure.GIVEN else None
        sure = sure or (Sure.OPEN if open_ else Sure.LIKELY if time.likely else Sure.CERTAIN)
        rate = f"{1e9 / time.step_ns:.5g} rows/s" if time.step_ns else "one row"
        evidence = time.evidence if any("rows/s" in text for text in time.evidence) else (*time.evidence, rate)
        self.guesses["t_s"] = Guess(
            "t_s", time.column, Unit(time.unit, Quantity.TIME, 1.0), sure, (*evidence, *time.notes), open_
        )
        column = self.table.column(time.column)
        written = column is not None and column.texts is not None
        units = "dmy or mdy" if written else "s, ms, us, ns, ticks/HZ"
        how = f"--map t_s={time.column}:UNIT ({units})" + (", or --rate HZ" if open_ else "")
        self._doubt(self.guesses["t_s"], how)

    # --- triads ---------------------------------------------------------------------------------------------------

    def _triad(self, quantity: Quantity, targets: tuple[str, str, str]) -> None:
        wanted = [self.wishes.mapping.get(target) for target in targets]
        if all(text == NOTHING for text in wanted):
            return
        if any(target in self.given for target in targets):
            missing = [target for target in targets if target not in self.given]
            if missing:
                raise InputError(f"{missing[0]} is missing", field="--map", remedy=f"give all of {', '.join(targets)}")
            columns = [self.given[target][0] for target in targets]
            texts = [self.given[target][1] for target in targets]
            first = next((text for text in texts if text), None)
            units = None if first is None else [unit_wanted(text or first, quantity) for text in texts]
            self._place(quantity, targets, columns, units)
            return
        found = list(self._candidates(quantity))
        if not found and unnamed(self.table):
            found = self._by_values(quantity)
        judged = [(self._judge(quantity, columns), columns) for columns in found]
        fitting = [pair for pair in judged if pair[0].open is None]
        exact = [pair for pair in judged if [c.name for c in pair[1]] == list(targets)]
        best = exact or _corrected(fitting) or _corrected(judged)
        if not best:
            if quantity is Quantity.ACCELERATION and not self.wishes.reference:
                names = ", ".join(column.name for column in self.table.columns[:MANY])
                more = ", ..." if len(self.table.columns) > MANY else ""
                what = f"no three columns are accelerations; it has {names}{more}"
                remedy, option = "--map ax_g=COLUMN:UNIT (and ay_g, az_g), or ax_g=none", "--map ax_g=COLUMN:UNIT"
                self.doubts.append(Doubt(what, remedy, True, f"{option} --map ay_g=COLUMN --map az_g=COLUMN"))
            return
        if len(best) > 1:
            names = " or ".join("(" + ", ".join(c.name for c in columns) + ")" for _, columns in best[:3])
            what = f"{len(best)} triads may be the {quantity}: {names}"
            self.doubts.append(Doubt(what, f"--map {targets[0]}=COLUMN, and the others", True))
            return
        self._place(quantity, targets, best[0][1])

    def _by_values(self, quantity: Quantity) -> list[list[SourceColumn]]:
        if quantity is Quantity.ACCELERATION:
            return accelerations_among(self.table, self.policy)
        gravity = self._vector(ACCELERATIONS)
        taken = {guess.column for guess in self.guesses.values()}
        return [] if gravity is None else rates_among(self.table, taken, gravity, self.policy)

    def _candidates(self, quantity: Quantity) -> Iterator[list[SourceColumn]]:
        groups: dict[str, dict[int, SourceColumn]] = {}
        double: set[str] = set()
        for column in self.table.columns:
            known = self.meanings[column.name]
            hinted = next((ours for ours, name in self.table.hints.items() if name == column.name), None)
            wanted = ACCELERATIONS if quantity is Quantity.ACCELERATION else RATES
            if hinted in wanted:
                groups.setdefault("by the form", {})[wanted.index(hinted)] = column
                continue
            bare = quantity is Quantity.ACCELERATION and known.quantity is None and known.group == ""
            if column.numbers is None or known.axis is None or not (known.quantity is quantity or bare):
                continue
            members = groups.setdefault(known.group, {})
            if known.axis in members:
                double.add(known.group)
            members[known.axis] = column
        for group, members in groups.items():
            if len(members) == 3 and group not in double:
                yield [members[0], members[1], members[2]]
            elif self._speaks_of(quantity, members):
                names = ", ".join(column.name for column in members.values())
                what = "names an axis twice" if group in double else "lacks an axis"
                self.doubts.append(
                    Doubt(
                        f"{names}: {what}",
                        f"--map a{'x'}_g=COLUMN"
                        if quantity is Quantity.ACCELERATION
                        else "--map gx_dps=COLUMN, or gx_dps=none",
                        True,
                    )
                )

    def _speaks_of(self, quantity: Quantity, members: dict[int, SourceColumn]) -> bool:
        return any(self.meanings[column.name].quantity is quantity for column in members.values())

    def _judge(self, quantity: Quantity, columns: list[SourceColumn], units: list[Unit] | None = None) -> UnitGuess:
        """`units`: what the user gives for each axis."""
        named = self.wishes.unit_of(quantity)
        own = {unit for column in columns if (unit := self.meanings[column.name].unit) and unit.quantity is quantity}
        if named is None and units is None and len(own) > 1:
            names = ", ".join(sorted(unit.name for unit in own))
            return UnitGuess(None, (f"named {names}",), f"its columns are of different units ({names})")
        block = np.vstack([np.full(c.n, np.nan) if c.numbers is None else c.numbers for c in columns])
        named = named or next(iter(own), None)
        if units is not None:
            named = units[0]
            rows = zip(block, units, strict=True)
            block = np.vstack(
                [
                    (row - unit.zero) * unit.factor / named.factor + named.zero if unit is not named else row
                    for row, unit in rows
                ]
            )
        whole = block_is_whole(columns)
        if quantity is Quantity.ACCELERATION:
            return acceleration_unit(block, named, whole, self.policy)
        return rate_unit(block, named, self._vector(ACCELERATIONS), self._seconds(), whole, self.policy)

    def _seconds(self) -> Numbers | None:
        """Times in s (N,) as far as they are known yet."""
        if self.time is not None:
            since: Numbers = (self.time.ns - self.time.ns[0]) * 1e-9
            return since
        rate = self._rate()
        return np.arange(self.table.n) / rate if rate else None

    def _place(
        self,
        quantity: Quantity,
        targets: tuple[str, str, str],
        columns: list[SourceColumn],
        units: list[Unit] | None = None,
    ) -> None:
        texts = [column.name for column in columns if column.numbers is None]
        if texts:
            remedy = "map another column"
            raise InputError("holds texts, numbers are expected", where=self.table.where, field=texts[0], remedy=remedy)
        guess = self._judge(quantity, columns, units)
        decided = units is not None or self.wishes.unit_of(quantity) is not None
        open_ = None if decided else guess.open
        evidence = guess.evidence
        if guess.open is not None and decided:
            evidence = (*evidence, f"taken as given, though {guess.open}")
        sure = Sure.GIVEN if decided else Sure.OPEN if open_ else Sure.LIKELY if guess.likely else Sure.CERTAIN
        for place, (target, column) in enumerate(zip(targets, columns, strict=True)):
            unit = guess.unit if units is None else units[place]
            self.guesses[target] = Guess(target, column.name, unit, sure, evidence, open_)
            evidence = ("as its x axis",)
        if quantity is Quantity.RATE and not any(target in self.given for target in targets):
            self._same_axes(columns)
        name, example = columns[0].name, "m/s2" if quantity is Quantity.ACCELERATION else "rad/s"
        kind = "accel=lsb/16384" if quantity is Quantity.ACCELERATION else "gyro=lsb/131"
        more = "" if quantity is Quantity.ACCELERATION else ", or gx_dps=none (and the others)"
        remedy = f"--units {example} (or {kind}), or --map {targets[0]}={name}:UNIT (and the other axes){more}"
        option = f"--units {kind}" if block_is_whole(columns) else f"--units {example}"
        self._doubt(self.guesses[targets[0]], remedy, option)

    def _same_axes(self, columns: list[SourceColumn]) -> None:
        """Rates and accelerations are of one frame, or it is asked."""
        gravity, seconds = self._vector(ACCELERATIONS), self._seconds()
        rates = np.vstack([column.numbers for column in columns if column.numbers is not None])
        other = None if gravity is None or seconds is None else turn_arrangement(rates, gravity, seconds, self.policy)
        if other is not None:
            what = f"gravity turns as the rates say only with their axes as {other}: a sign or a name is wrong"
            nothing = " ".join(f"--map {target}=none" for target in RATES)
            self.doubts.append(Doubt(what, f"--map gx_dps=COLUMN (and the others), or {nothing}", True, nothing))

    def _vector(self, targets: tuple[str, str, str]) -> Numbers | None:
        found = [self.guesses.get(target) for target in targets]
        columns = [self.table.column(guess.column) for guess in found if guess is not None and guess.unit is not None]
        if len(columns) < 3 or any(column is None or column.numbers is None for column in columns):
            return None
        units = [guess.unit for guess in found if guess is not None and guess.unit is not None]
        pairs = [(c.numbers, unit) for c, unit in zip(columns, units, strict=True) if c is not None]
        return np.vstack([(n - unit.zero) * unit.factor + unit.offset for n, unit in pairs if n is not None])

    # --- single columns -------------------------------------------------------------------------------------------

    def _single_columns(self) -> None:
        for target, (column, text) in self.given.items():
            if target not in self.guesses:
                self._single(target, column, text, given=True)
        used = {guess.column for guess in self.guesses.values()} | self.other_times
        candidates: dict[str, list[SourceColumn]] = {}
        for column in self.table.columns:
            meant = self.meanings[column.name].target
            if meant is None or meant in self.guesses or column.name in used or column.numbers is None:
                continue
            if meant in ("t_s", *ACCELERATIONS, *RATES) or self.wishes.mapping.get(meant) == NOTHING:
                continue
            candidates.setdefault(meant, []).append(column)
        for target, columns in candidates.items():
            exact = [column for column in columns if column.name == target]
            if len(columns) > 1 and not exact:
                names = " or ".join(column.name for column in columns)
                self.doubts.append(Doubt(f"{target} may be {names}", f"--map {target}=COLUMN, or {target}=none", True))
                continue
            self._single(target, (exact or columns)[0], None, given=False)

    def _single(self, target: str, column: SourceColumn, text: str | None, *, given: bool) -> None:
        quantity = meaning(target, None, KNOWN).quantity or Quantity.NUMBER
        if column.numbers is None:
            raise InputError("holds texts, numbers are expected", where=self.table.where, field=column.name)
        unit = unit_wanted(text, quantity) if text else None
        sure = Sure.GIVEN if given else Sure.CERTAIN
        evidence: tuple[str, ...] = ("its name",)
        open_: str | None = None
        if unit is None and quantity is not Quantity.NUMBER:
            own = self.meanings[column.name].unit
            unit = own if own is not None and own.quantity is quantity else self.wishes.unit_of(quantity)
            evidence = (f"named {unit.name}",) if unit else evidence
            if unit is None:
                unit, evidence, open_ = by_range(quantity, column.numbers, self.policy)
                sure = Sure.OPEN if open_ else Sure.LIKELY
        self.guesses[target] = Guess(target, column.name, unit, sure, evidence, open_)
        self._doubt(self.guesses[target], f"--map {target}={column.name}:UNIT, or {target}=none")

    # --- axes -----------------------------------------------------------------------------------------------------

    def _axes(self) -> AxesGuess:
        if self.wishes.axes is not None:
            return axes_given(self.wishes.axes, rates=RATES[0] in self.guesses)
        gravity = self._vector(ACCELERATIONS)
        references = [self.guesses.get(name) for name in ("inc_ref_deg", "tf_ref_deg")]
        if gravity is None or any(guess is None or guess.unit is None for guess in references):
            return UNREFERENCED
        inc, tf = (self._converted(guess) for guess in references if guess is not None)
        guess = axes_by_reference(gravity, inc, tf, self.policy)
        if guess.open or guess.likely:
            what = guess.open or f"axes {guess.axes} agree with the reference, those of the file do not"
            self.doubts.append(Doubt(what, f"--axes {guess.axes} (or another arrangement)", bool(guess.open)))
        return guess

    def _converted(self, guess: Guess) -> Numbers:
        column = self.table.column(guess.column)
        assert column is not None and column.numbers is not None and guess.unit is not None
        return (column.numbers - guess.unit.zero) * guess.unit.factor + guess.unit.offset

    def _doubt(self, guess: Guess, remedy: str, option: str = "") -> None:
        if guess.sure is Sure.OPEN:
            self.doubts.append(Doubt(f"{guess.target} from {guess.column}: {guess.open}", remedy, True, option))
        elif guess.sure is Sure.LIKELY:
            unit = guess.unit.name if guess.unit else "no unit"
            self.doubts.append(
                Doubt(f"{guess.target} from {guess.column} in {unit} rests on its values alone", remedy, False)
            )
