"""The best that theory allows on the cases of laws: what could be closed on the second session, and which law seen.

    python -m studies.open_world.limit --seed HASH [--design rotation] [--answers FILE] [--laws N] [--every K]
                                       [--only NAMES] [--out FOLDER]

Of sessions of strength 400 and more, stepped ones or (--design rotation) rotations. An estimator is given what no
engine is told: the number of laws, the place, channels and covariates of each, the statistics of the noise, and either

- `form`: the kind of each function (a kink, a process of this smoothness), so that only its parameters are unknown; or
- `smooth`: that each function is smooth, with the smoothness that explains the true one best. Over an angle it closes
  upon itself: a line at an order that is no integer, which in a rotation goes on from turn to turn, is not among these.

Offset, scale and misalignment of each channel are free; `whitening` is what the noise does. With `form` the errors are
those of the Bayesian Cramer-Rao bound (Van Trees 1968): the covariance (J^T C^-1 J + P^-1)^-1 of the parameters, with J
at the truth and P the spread from which the deck draws them; carried to the second session it gives the share that can
be closed. With `smooth` it is the estimate of a Gaussian process itself, whose errors are both the noise and what it
smooths away. A law's gain is the expected log evidence, in nats, that it adds to all others; no engine that demands 12
nats of a claim can tell one below that.

With --answers (of `studies.open_world.score` on the same deck) each case also stands beside what an engine closed.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from . import deck, judging, laws, noises, score, table, whitening, world
from .answers import Case
from .laws import Law
from .noises import Noise
from .shapes import Shape
from .world import Session

Row = dict[str, Any]
SAMPLES = 400
"""of the errors that the bound allows"""
NATS = 12.0
"""expected log evidence below which a claim is not made (rule of docs/theory/laws.md)"""
LENGTHS = (0.12, 0.2, 0.3, 0.45, 0.7, 1.1, 1.8)
"""of a smooth function whose form is not known, of half the range of its covariate"""
POINTS = {1: 41, 2: 13}
"""of a process along each covariate, at which its values are the parameters"""
FOLD = 8_000
"""whitened rows above which columns are brought to a triangle first: only their inner products count"""
SPREAD = 1.0 / np.sqrt(12.0)
"""standard deviation of a uniform draw, of its range"""
PARAMETERS = {
    "power": {}, "modulus": {"at": 1.0}, "kink": {"at": 1.0}, "saturation": {"at": 1.0, "width": 0.4},
    "exponential": {"width": 0.4}, "sine": {"frequency": 6.0, "phase": 2 * np.pi}, "bump": {"at": 1.0, "width": 0.4},
    "threshold_tanh": {"at": 1.0, "width": 0.4}, "dent": {"at": 2 * np.pi, "width": 0.5},
    "line": {"order": 6.4, "phase": 2 * np.pi}, "square": {"phase": 2 * np.pi, "width": 0.5},
}  # fmt: skip
"""of each formula: the ranges from which the deck draws what it does not choose from a list"""

Basis = tuple[np.ndarray, np.ndarray, np.ndarray]
"""functions at the rows of the first (n, p) and second session (m, p), and the prior's standard deviations (p,)"""


@dataclass(frozen=True)
class Parts:
    """What a case was made from."""

    case: Case
    noise: Noise
    sensor: world.Sensor
    first: Session
    second: Session


def made(seed: str, name: str, number: int) -> Parts:
    """A case of the deck with the noise and the sensor it was drawn with."""
    kept: list[tuple[Any, ...]] = []
    build = deck.built

    def remembered(*words: Any, **more: Any) -> Case:
        kept.append(words)
        return build(*words, **more)

    with mock.patch.object(deck, "built", remembered):
        case = deck.law_case(name, seed, number)
    # a case that hardly shows is drawn again: the last is the one that stands
    _, _, _, _, noise, _, sensor, _ = kept[-1]
    assert case.first is not None and case.other is not None
    return Parts(case, noise, sensor, case.first, case.other)


# --- functions of a law ---------------------------------------------------------------------------------------------


def scaled(law: Law, s: Session) -> np.ndarray:
    """Its covariates (k, n) as its shape takes them."""
    return np.stack([
        laws.covariate(s, name) if name in laws.ANGLES else 2.0 * (laws.covariate(s, name) - low) / (high - low) - 1.0
        for name, (low, high) in zip(law.covariates, law.ranges, strict=True)
    ])  # fmt: skip


def _process(u: tuple[np.ndarray, ...], angles: tuple[bool, ...], lengths: tuple[float, ...]) -> list[np.ndarray]:
    """Independent functions of unit variance (n, p) whose sum is a smooth process, at each set of covariates (k, n)."""
    grids = []
    for k, angle in enumerate(angles):
        count = POINTS[len(angles)]
        ends = [np.concatenate([part[k] for part in u])]
        span = (0.0, 2 * np.pi * (1 - 1 / count)) if angle else (float(np.min(ends)), float(np.max(ends)))
        grids.append(np.linspace(*span, count))
    points = np.stack([axis.ravel() for axis in np.meshgrid(*grids, indexing="ij")])

    def kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        total = np.zeros((a.shape[1], b.shape[1]))
        for k, (angle, length) in enumerate(zip(angles, lengths, strict=True)):
            apart = a[k][:, None] - b[k][None]
            # over an angle the distance through the circle (MacKay 1998), so that the process closes
            total += (2 * np.sin(apart / 2) / length) ** 2 if angle else (apart / length) ** 2
        return np.exp(-0.5 * total)

    size, turn = np.linalg.eigh(kernel(points, points))
    kept = size > 1e-10 * size[-1]
    root = turn[:, kept] / np.sqrt(size[kept])
    return [kernel(part, points) @ root for part in u]


def _shape_basis(shape: Shape, u: tuple[np.ndarray, np.ndarray], angles: tuple[bool, ...]) -> Basis:
    """Derivatives of a shape of its known form by what is drawn of it, at the truth."""
    if shape.kind == "product":
        parts = [Shape(**part) for part in shape.params["parts"]]
        found = []
        for k, part in enumerate(parts):
            own, beside = (slice(0, 1), slice(1, 2)) if k == 0 else (slice(1, 2), slice(0, 1))
            a, b, spread = _shape_basis(part, (u[0][own], u[1][own]), angles[own])
            other = [parts[1 - k](x[beside])[:, None] for x in u]
            found.append((a * other[0], b * other[1], spread))
        return tuple(np.concatenate(each, axis=-1) for each in zip(*found, strict=True))  # type: ignore[return-value]
    if shape.kind == "process":
        waves = np.array(shape.params["frequencies"])
        # the drawn waves say how long the process is; that the spread of the draw does is known
        lengths = tuple(1.0 / np.sqrt(np.mean(waves**2, axis=0)))
        first, second = _process(u, angles, lengths)
        return first, second, np.ones(first.shape[1])
    if shape.kind == "harmonics":
        sizes = np.hypot(shape.params["cos"], shape.params["sin"])
        orders = np.arange(1, sizes.size + 1)
        # the spread falls with the order; its slope is that of the drawn ones
        slope, top = np.polyfit(orders, np.log(np.maximum(sizes, 1e-12)), 1)
        spread = np.exp(top + slope * orders) / np.sqrt(2)
        waves_of = [np.concatenate([np.cos(orders * x[0][:, None]), np.sin(orders * x[0][:, None])], axis=1) for x in u]
        return waves_of[0], waves_of[1], np.concatenate([spread, spread])
    columns: list[list[np.ndarray]] = [[shape(x)] for x in u]
    spread_of = [1.0]
    for name, span in PARAMETERS[shape.kind].items():
        step = 1e-5 * span
        up, down = (Shape(shape.kind, shape.params | {name: shape.params[name] + sign * step}) for sign in (1, -1))
        for each, x in zip(columns, u, strict=True):
            each.append((up(x) - down(x)) / (2 * step))
        spread_of.append(span * SPREAD)
    return np.stack(columns[0], axis=1), np.stack(columns[1], axis=1), np.array(spread_of)


def smooth_bases(law: Law, first: Session, second: Session) -> Iterator[Basis]:
    """A smooth function of a law's covariates, at every length that is tried."""
    u = (scaled(law, first), scaled(law, second))
    angles = tuple(name in laws.ANGLES for name in law.covariates)
    value = law.size * law.shape(u[0])
    spread = float(np.sqrt(np.mean(value**2))) or law.size
    for length in LENGTHS:
        a, b = _process(u, angles, (length,) * len(angles))
        # a constant of its own: off the mean of the process
        a, b = (np.concatenate([x, np.ones((len(x), 1))], axis=1) for x in (a, b))
        yield a, b, np.full(a.shape[1], spread)


def form_basis(law: Law, first: Session, second: Session) -> Basis:
    """The functions of a law whose kind is known."""
    u = (scaled(law, first), scaled(law, second))
    a, b, spread = _shape_basis(law.shape, u, tuple(name in laws.ANGLES for name in law.covariates))
    return law.size * a, law.size * b, spread


# --- what the readings say ------------------------------------------------------------------------------------------


def sensitivity(s: Session, sensor: world.Sensor, hidden: tuple[Law, ...], number: int) -> np.ndarray:
    """Change of each row's readings (C, n) by the value of one law there, at the truth."""

    class Moved(Law):
        step = 0.0

        def values(self, of: Session) -> np.ndarray:
            return super().values(of) + self.step

    step = 1e-6
    sides = []
    for sign in (1.0, -1.0):
        moved = Moved(**{name: getattr(hidden[number], name) for name in Law.__dataclass_fields__})
        object.__setattr__(moved, "step", sign * step)
        sides.append(world.readings(s, sensor, (*hidden[:number], moved, *hidden[number + 1 :])))
    return (sides[0] - sides[1]) / (2 * step)


@dataclass(frozen=True)
class Seen:
    """What is seen of a law: its columns in the whitened first session, off the plain errors, and in the second."""

    first: np.ndarray
    second: np.ndarray
    truth: np.ndarray
    """what it adds to the whitened first session"""


def gain(mine: np.ndarray, truth: np.ndarray, others: list[np.ndarray]) -> float:
    """Expected log evidence that a law adds to all others, nats; columns in units of their spread, errors of 1."""
    beside = np.concatenate(others, axis=1) if others else np.zeros((len(mine), 0))
    # everything lives in the span of the columns and the truth: outside of it both ways say the same
    q, _ = np.linalg.qr(np.concatenate([beside, mine, truth[:, None]], axis=1))
    a, b, d = q.T @ beside, q.T @ mine, q.T @ truth
    null = np.eye(len(d)) + a @ a.T
    full = null + b @ b.T
    inverse = np.linalg.inv(full)
    fit = d @ np.linalg.solve(null, d) - d @ inverse @ d + len(d) - np.trace(inverse @ null)
    return float(0.5 * (fit - np.linalg.slogdet(full)[1] + np.linalg.slogdet(null)[1]))


class Pair:
    """Both sessions of a case, as its laws are seen in them."""

    def __init__(self, parts: Parts) -> None:
        self.sensor, self.laws, self.first = parts.sensor, parts.case.laws, parts.first
        self.white = whitening.whitened(parts.first, parts.noise)
        self.base = whitening.span(self.white(whitening.plain_columns(parts.first)))
        known = parts.case.kept_from
        rows = np.isfinite(known).all(axis=0) if known is not None else np.zeros(0, bool)
        self.there = parts.second.rows(rows)
        # a temperature that lags belongs to the whole session, also where not all of its rows count; poses have theirs
        # of those rows alone, as their recorded figures do
        whole = parts.first.kind == "rotation"
        self.second = parts.second if whole else self.there
        self.rows: np.ndarray | slice = rows if whole else slice(None)
        self.weight = 1.0 / np.array(parts.case.sigma)[:, None]
        self.alone = tuple(replace(law, onset_s=None) for law in self.laws)
        true = world.contribution(self.second, self.sensor, self.alone)[:, self.rows]
        self.true = (self.weight * world.off_base(self.there, true)).ravel()
        """what all laws add to the second session, in units of the noise of a row, off the base fit"""

    def seen(self, k: int, basis: Basis) -> Seen:
        """What is seen of law k as a sum of functions."""
        a, b, spread = basis
        first, law = self.first, self.laws[k]
        act = 1.0 if law.onset_s is None else (first.t - first.t[0] >= law.onset_s)[:, None]
        mine = self.white(sensitivity(first, self.sensor, self.laws, k)[:, :, None] * (act * a * spread)[None])
        here = world.contribution(first, self.sensor, (law,))
        other = sensitivity(self.second, self.sensor, self.alone, k)[:, self.rows, None]
        other = other * (b[self.rows] * spread)[None]
        flat = np.stack(
            [self.weight * world.off_base(self.there, other[:, :, j]) for j in range(other.shape[2])], axis=-1
        )
        truth = self.white(here[:, :, None])
        off = np.concatenate([mine, truth], axis=1)
        off = off - self.base @ (self.base.T @ off)
        return Seen(off[:, :-1], flat.reshape(-1, flat.shape[2]), off[:, -1])

    def form(self, k: int) -> Seen:
        """Law k with the kind of its function known."""
        return self.seen(k, form_basis(self.laws[k], self.first, self.second))

    def smooth(self, k: int) -> Seen:
        """Law k as a smooth function, of the length that explains it best."""
        best: tuple[float, Seen] | None = None
        for basis in smooth_bases(self.laws[k], self.first, self.second):
            tried = self.seen(k, basis)
            (few,) = folded([tried])
            worth = gain(few.first, few.truth, [])
            if best is None or worth > best[0]:
                best = worth, tried
        assert best is not None
        return best[1]


def folded(all_of: list[Seen]) -> list[Seen]:
    """The same with as few rows of the first session as their inner products need, where there are many."""
    if len(all_of[0].truth) <= FOLD:
        return all_of
    factor = whitening.triangle([*[each.first for each in all_of], *[each.truth[:, None] for each in all_of]])
    ends = np.cumsum([each.first.shape[1] for each in all_of])
    return [
        Seen(factor[:, end - each.first.shape[1] : end], each.second, factor[:, ends[-1] + k])
        for k, (each, end) in enumerate(zip(all_of, ends, strict=True))
    ]


def limits(parts: Parts) -> Row:
    """Of one case: what each way can close on the second session, and the gain of each law."""
    pair = Pair(parts)
    numbers = range(len(pair.laws))
    row: Row = {"name": parts.case.name, "laws": len(numbers), "noise": parts.noise.kind}
    rng = np.random.default_rng(0)
    for way, made_of in (("form", pair.form), ("smooth", pair.smooth)):
        all_of = folded([made_of(k) for k in numbers])
        a = np.concatenate([each.first for each in all_of], axis=1)
        b = np.concatenate([each.second for each in all_of], axis=1)
        covariance = np.linalg.inv(a.T @ a + np.eye(a.shape[1]))
        draws = rng.standard_normal((SAMPLES, a.shape[1]))
        if way == "form":
            # errors as the bound has them
            errors = draws @ np.linalg.cholesky(covariance).T @ b.T
        else:
            pull = covariance @ a.T
            bias = b @ (pull @ np.sum([each.truth for each in all_of], axis=0)) - pair.true
            # noise of the readings through the estimate
            turn, size, _ = np.linalg.svd(pull, full_matrices=False)
            errors = bias + draws[:, : size.size] @ (turn * size).T @ b.T
        closed = 1.0 - np.sum(errors**2, axis=1) / np.sum(pair.true**2)
        row[way] = {
            "closed": float(np.median(closed)),
            "to_0.8": float(np.mean(closed >= 0.8)),
            "gains": [
                gain(each.first, each.truth, [o.first for o in all_of if o is not each]) for each in all_of
            ],
        }  # fmt: skip
    return row


def summary(rows: list[Row], answers: dict[str, Row]) -> str:
    """The table, over sessions that another one can repeat."""
    lines = ["| cases | way | closed, median | closed to 0.8, expected | every law worth 12 nats |", "|---" * 5 + "|"]
    solid = [r for r in rows if r["noise"] in table.SOLID]
    groups = {
        "all": rows, "one law, white and its like": [r for r in solid if r["laws"] == 1],
        "white and its like": solid, "slow noise": [r for r in rows if r["noise"] in noises.SERIAL],
    }  # fmt: skip
    for words, part in groups.items():
        for way in ("form", "smooth"):
            again = [r for r in part if r["repeatable"]]
            if not again:
                continue
            closed = np.median([r[way]["closed"] for r in again])
            share = 100 * np.mean([r[way]["to_0.8"] for r in again])
            told = 100 * np.mean([min(r[way]["gains"]) >= NATS for r in part])
            lines.append(
                f"| {words} ({len(again)} of {len(part)}) | {way} | {closed:.3f} | {share:.1f} % | {told:.1f} % |"
            )
        if answers:
            given = [answers[r["name"]] for r in part if r["repeatable"] and r["name"] in answers]
            closed_by = np.array([a["closed"] for a in given if a["closed"] is not None])
            if closed_by.size:
                share = 100 * np.mean(closed_by >= 0.8)
                lines.append(f"| {words} | engine | {np.median(closed_by):.3f} | {share:.1f} % | |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", required=True)
    parser.add_argument("--answers", type=Path, help="of score, on the same deck")
    parser.add_argument("--laws", type=int, default=deck.Size.laws)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--design", choices=deck.KINDS, default="poses")
    parser.add_argument("--only", default="", help="cases whose name begins so, or so: separated by commas")
    parser.add_argument("--out", type=Path, default=Path("open-world"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    what = "limit" if given.design == "poses" else f"limit-{given.design}"
    path = given.out / f"{what}-of-{given.seed[:12]}.jsonl"
    rows = score.written(path)
    done = {row["name"] for row in rows}
    answers = {row["name"]: row for row in score.written(given.answers)} if given.answers else {}
    with path.open("a") as file:
        for k in range(0, given.laws, given.every):
            name = f"law/{k:03d}"
            asked = deck.kind_of(name) == given.design and name.startswith(tuple(given.only.split(",")))
            if not asked or name in done:
                continue
            parts = made(given.seed, name, k)
            if parts.case.strength < judging.STRONG:
                continue
            row = limits(parts) | {
                "strength": parts.case.strength, "repeatable": all(laws.repeatable(law) for law in parts.case.laws),
            }  # fmt: skip
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
            own = answers.get(name, {}).get("closed")
            told = "" if own is None else f", engine {own:.2f}"
            print(
                f"{name} {row['laws']} {row['noise']}: form {row['form']['closed']:.3f}, smooth"
                f" {row['smooth']['closed']:.3f}{told}; nats {[round(g) for g in row['form']['gains']]}", flush=True,
            )  # fmt: skip
    print(summary(rows, answers))


if __name__ == "__main__":
    main()
