"""The rotation half of the development deck: `python -m studies.diagnosis_deck --design rotation`.

Cases come from `rotation_cases`; each line of a table is one truth, with the answers that were not exactly it. As the
deck of poses, it shares the forward model with the engine and proves nothing blind.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from multiprocessing import Pool
from typing import NamedTuple

import numpy as np

from highside.diagnosis.engine import diagnose_rotation
from highside.physics import effects as library
from highside.physics.forward import ForwardModel

from . import rotation_cases as cases

REFUSED = ("partial", "unknown", "wander", "implausible_fit")


class Job(NamedTuple):
    """A case by what makes it."""

    row: str
    """the line of the table it belongs to"""
    effects: tuple[str, ...]
    outsider: str
    strength: float
    kind: str
    seed: int
    gyros: bool


@dataclass
class Answer:
    """How a case ended."""

    row: str
    verdict: str
    named: list[str]
    words: str
    alarm: bool
    exact: bool
    in_class: bool
    first: bool
    wrong: bool
    refused: bool
    errors: list[float]
    held: list[bool]
    seconds: float


def answered(job: Job) -> Answer:
    """Make the case and diagnose it."""
    if job.outsider:
        made = cases.outsider(job.outsider, job.strength, job.kind, job.seed)
    else:
        made = cases.case(job.effects, job.strength, job.kind, job.seed, job.gyros)
    free = cases.FREE + cases.GYRO_FREE if made.gyros else cases.FREE
    start = time.process_time()
    diagnosis, _ = diagnose_rotation(made.session, ForwardModel.of({}), free)
    seconds = time.process_time() - start
    named = [claim.effect for claim in diagnosis.claims]
    classes = [set(claim.equivalence_class) for claim in diagnosis.claims]
    truth = set(job.effects)
    # each claim must have a true effect in its class, each true effect a claim
    in_class = bool(truth) and truth <= set().union(*classes)
    wrong = any(not (own & truth) for own in classes) or len(named) > len(truth)
    errors, held = [], []
    for claim in diagnosis.claims:
        if claim.effect in made.truth:
            amplitudes = [p.name for p in library.get(claim.effect).parameters if not p.shape]
            fitted = [claim.parameters[name] for name in amplitudes]
            true = np.array([made.truth[claim.effect][name] for name in amplitudes])
            # amplitudes that are only bounded by what is plausible were not fitted
            seen = np.array([f.high - f.low < 1.9 * max(abs(v) for v in p.gate) for f, p in zip(
                fitted, [p for p in library.get(claim.effect).parameters if not p.shape], strict=True)])  # fmt: skip
            value = np.array([f.value for f in fitted])
            errors.append(float(np.linalg.norm((value - true)[seen]) / np.linalg.norm(true[seen])))
            held += [f.low <= t <= f.high for f, t, s in zip(fitted, true, seen, strict=True) if s]
    reported = "+".join(named) or "+".join(diagnosis.remainder.resembles) or "; ".join(diagnosis.remainder.hints)
    return Answer(
        row=job.row,
        verdict=diagnosis.verdict,
        named=named,
        words=f"{job.seed}{job.kind[0]} {diagnosis.verdict}:{reported}",
        alarm=diagnosis.verdict != "nothing_left_out",
        exact=bool(truth) and set(named) == truth,
        in_class=in_class,
        first=bool(named) and named[0] in truth,
        wrong=wrong,
        refused=diagnosis.verdict in REFUSED,
        errors=errors,
        held=held,
        seconds=seconds,
    )


def jobs(only: str, runs: int, strengths: Sequence[float], seed: int, gyros: bool, rows: Sequence[str]) -> list[Job]:
    """The cases of a table; `rows` restricts it to some truths or kinds of noise."""
    found: list[Job] = []
    kinds = cases.KINDS
    for run in range(seed, seed + runs):
        kind = kinds[run % len(kinds)]
        if only == "nulls":
            found += [Job(k, (), "", 0.0, k, run, gyros) for k in rows or cases.NULL_KINDS]
            continue
        for strength in strengths:
            tag = f" {strength:g}"
            if only == "open":
                names = rows or list(cases.outsiders(cases.design(0, seconds=60.0)))
                found += [Job(name + tag, (), name, strength, kind, run, False) for name in names]
            elif only == "pairs":
                rng = np.random.default_rng([run, 11])
                for _ in range(6):
                    pair = tuple(str(e) for e in rng.choice(list(cases.SINGLES), 2, replace=False))
                    found.append(Job("pairs" + tag, pair, "", strength, kind, run, False))
            else:
                names = rows or list(cases.GYRO_SINGLES if gyros else cases.SINGLES)
                found += [Job(name + tag, (name,), "", strength, kind, run, gyros) for name in names]
    return found


def table(what: Iterable[Job], processes: int) -> list[Answer]:
    """Answer all, print a line a row, and the shares of all."""
    every = list(what)
    with Pool(processes) as pool:
        answers = list(pool.imap(answered, every, chunksize=1))
    columns = ("alarm", "exact", "first", "in_class", "wrong", "refused")
    print(f"{'':44s}{'n':>4s}" + "".join(f"{c:>9s}" for c in columns) + "   answers that were not exact")
    for row in dict.fromkeys(a.row for a in answers):
        own = [a for a in answers if a.row == row]
        odd = "; ".join(a.words for a in own if not a.exact and (a.alarm or a.row not in cases.NULL_KINDS))
        shares = "".join(f"{100 * np.mean([getattr(a, c) for a in own]):9.0f}" for c in columns)
        print(f"{row:44s}{len(own):4d}{shares}   {odd[:400]}")
    shares = "".join(f"{100 * np.mean([getattr(a, c) for a in answers]):9.1f}" for c in columns)
    errors = [e for a in answers for e in a.errors]
    held = [h for a in answers for h in a.held]
    last = f"   {np.mean([a.seconds for a in answers]):.2f} s a case"
    if errors:
        last += (
            f", parameter error median {100 * np.median(errors):.1f} %, 95 % intervals hold {100 * np.mean(held):.1f} %"
        )
        last += f" of {len(held)}"
    print(f"{'ALL':44s}{len(answers):4d}{shares}{last}")
    return answers
