"""What a published table says of its instrument: the sets of effects that were tried, and the one taken for best.

The whole procedure behind the table is set up (which columns may be refitted, which effects of the library leave a
trace in it), sets are searched, rows that no set explains are left out and the search is done once more without them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import pose_candidates
from highside.diagnosis.core.policy import REGRESSION
from highside.diagnosis.core.result import NotTestable
from highside.diagnosis.table.chain import Linear, Procedure, Sessions
from highside.diagnosis.table.fit import ErrorTable, Fitted, Option, fit_set, options_of, rechanced
from highside.diagnosis.table.policy import EXPLAINING
from highside.diagnosis.table.search import polished, search, unexplained_rows
from highside.errors import InputError
from highside.physics.effects import all_effects
from highside.physics.effects.pose_error import EFFECT as POSE_ERROR
from highside.physics.forward import ForwardModel

Progress = Callable[[float, str], None]

NO_TIME = "a table does not say when a row was measured"
NO_SIDE = "a table does not say from which side a pose was approached"


def not_in_a_table() -> dict[str, str]:
    """Effects that a table cannot show, and why: those counted in seconds or seconds' rates, those of the side."""
    known = [effect for effect in all_effects().values() if not effect.random]
    timed = [e for e in known if "t_s" in e.needs and any("s" in p.unit.split("/") for p in e.parameters)]
    timed.sort(key=lambda effect: (not effect.follows_time_alone, effect.id))
    sided = [effect for effect in known if "direction" in effect.needs]
    return dict.fromkeys((e.id for e in timed), NO_TIME) | dict.fromkeys((e.id for e in sided), NO_SIDE)


@dataclass(frozen=True)
class TableProblem:
    """What there is to explain and what may explain it: the model that is known, its parameters that may be refitted
    (`base_names`, in units of `base_units`), the table, the effects, and those that leave no trace in it."""

    model: ForwardModel
    base_names: list[str]
    base_units: Array
    table: ErrorTable
    options: list[Option]
    base: Fitted
    lacking: list[NotTestable]
    seed: int


@dataclass(frozen=True)
class Explained:
    """The best set, all that were tried (best score first), and rows left out with their probability."""

    problem: TableProblem
    best: Fitted
    tried: list[Fitted]
    lost: dict[int, float]


def explain(problem: TableProblem, progress: Progress) -> Explained:
    """Search for the set of effects that the table requires; rows that it does not explain are left out."""
    found = search(
        problem.table, problem.options, problem.base, report=lambda s, w: progress(EXPLAINING.progress * s, w)
    )
    best = polished(problem.table, found.best)
    lost: dict[int, float] = {}
    table = problem.table
    while best.options and len(lost) < len(table.published) // EXPLAINING.lost:
        odd = unexplained_rows(table, best)
        if not odd:
            break
        worst = min(odd, key=odd.__getitem__)
        lost[worst] = odd[worst]
        table = table.without_row(worst)
        best = fit_set(table, best.options, best)
    if lost:
        progress(EXPLAINING.progress, "once more without the rows that do not fit")
        problem = replace(problem, table=table, base=fit_set(table, (), problem.base))
        seeds = [fit_set(table, f.options, f) for f in found.tried[:3]]
        found = search(table, problem.options, problem.base, width=3, depth=3, seeds=[best, *seeds])
        best = polished(table, found.best)
    return Explained(problem, best, found.tried, lost)


def prepare(
    inc_deg: Array,
    published: Array,
    procedure: Procedure,
    model: ForwardModel,
    free: tuple[str, ...],
    noise_g: float | None,
    seed: int,
) -> TableProblem:
    """The problem of R rows `published` (R, 4) in deg at inclinations (R,). Raises InputError where they say too
    little."""
    if POSE_ERROR.id not in model.ids:
        model = model.with_effects(
            {
                POSE_ERROR.id: {
                    "inc_station": EXPLAINING.step_rad,
                    "tf_station": EXPLAINING.step_rad,
                    "inc_pose": 0.0,
                    "tf_pose": 0.0,
                }
            }
        )
    sessions = Sessions.of(np.radians(inc_deg), procedure)
    names = model.free_names(free)
    columns = np.asarray(model.jacobian(sessions.state, names), dtype=float) if names else None
    units = np.array([_typical(name) for name in names])
    kept: list[int] = []
    if columns is not None:
        columns = columns * units[:, None, None]
        probe = Linear.about(sessions, model, columns)
        visible = np.mean(probe.columns**2, axis=(1, 2, 3)) > REGRESSION.independent * np.mean(columns**2, axis=(1, 2))
        kept = [int(k) for k in np.flatnonzero(visible)]
    base_columns = columns[kept] if columns is not None else np.empty((0, 3, sessions.state.n))
    table = ErrorTable.of(sessions, published, model, base_columns, noise_g, seed)
    if table.mask.sum() < EXPLAINING.min_cells:
        raise InputError(
            f"{int(table.mask.sum())} cells are too few for a diagnosis", remedy=f"give {EXPLAINING.min_cells}"
        )
    options, lacking = _options(sessions, model, free)
    base = rechanced(table, fit_set(table, ()))
    return TableProblem(model, [names[k] for k in kept], units[kept], table, options, base, lacking, seed)


def _options(sessions: Sessions, model: ForwardModel, free: tuple[str, ...]) -> tuple[list[Option], list[NotTestable]]:
    """Effects that leave a trace behind the correction, and those that do not with the reason."""
    clean = np.asarray(model.predict(sessions.state), dtype=float)
    candidates, unobservable = pose_candidates(model, sessions.state, free)
    hidden = not_in_a_table()
    lacking = [NotTestable(b.effect.id, b.why, b.effect.splitter) for b in unobservable if b.effect.id not in hidden]
    options: list[Option] = []
    for candidate in candidates:
        assert candidate.effect is not None
        if candidate.id in hidden:
            continue
        own = options_of(sessions, clean, candidate)
        options += own
        if not own:
            why = f"the correction ({sessions.procedure.corrected_by}) takes it up: it leaves no trace in these columns"
            lacking.append(NotTestable(candidate.id, why, candidate.effect.splitter))
    lacking += [NotTestable(e, why, all_effects()[e].splitter) for e, why in hidden.items()]
    return options, lacking


def _typical(name: str) -> float:
    effect_id, _, parameter = name.partition(".")
    return next(p.typical for p in all_effects()[effect_id].parameters if p.name == parameter)
