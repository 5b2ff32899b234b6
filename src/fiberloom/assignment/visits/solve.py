"""Solvers of the choice over many exposures: HiGHS of scipy, CP-SAT of ortools, and greedy beside them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import eye_array, hstack

from fiberloom.assignment.visits.model import VisitModel, stacked
from fiberloom.errors import InputError
from fiberloom.typing import Flags, Floats, Ints

MAX_NODES = 2000
"""Bound on HiGHS' search, not on time: the same answer on a slow machine."""
MAX_EFFORT = 10.0
"""Bound on CP-SAT's search in its deterministic time, some s of CPU each."""
_ROUNDING = 1e-4
INSTALL = "ortools is not installed: pip install 'fiberloom[survey]', or take the solver highs"


@dataclass(frozen=True, eq=False)
class ChosenVisits:
    """A choice of C candidates, and how good it is known to be."""

    columns: Flags
    """(C,)"""
    value: float
    """Sum of the values of all visits, dimensionless."""
    bound: float
    """No choice has more; inf: none is known."""
    cpu_s: float

    @property
    def gap(self) -> float:
        """By what share of the bound the choice may be worse than the best; 0: proven to be the best."""
        if math.isinf(self.bound):
            return math.inf
        return max(0.0, self.bound - self.value) / max(self.bound, 1.0)

    @property
    def proven(self) -> bool:
        """Values are whole numbers: a bound less than one above proves the choice."""
        return self.bound - self.value < 1.0 - 1e-6


def solve(model: VisitModel, solver: str = "highs", seed: int = 0) -> ChosenVisits:
    """The best choice, or the best that is found with its bound.

    Parameters
    ----------
    model : VisitModel
        C candidates.
    solver : str
        `highs`, `ortools`, or `greedy`.
    seed : int
        Decides between equally good choices.

    Returns
    -------
    ChosenVisits
        Keeps every rule of the model.

    Raises
    ------
    InputError
        A minimum that cannot be had: exposure, sector, number. A solver that is not there.
    """
    if solver not in SOLVERS:
        raise InputError(f"solver '{solver}': must be one of {', '.join(SOLVERS)}")
    began_s = time.process_time()
    order = np.random.default_rng(seed).permutation(len(model))
    columns, bound = SOLVERS[solver](model.shuffled(order), seed)
    chosen = np.zeros(len(model), dtype=bool)
    chosen[order] = columns
    if math.isfinite(bound):
        bound = math.floor(bound + _ROUNDING)  # values are whole numbers
    found = ChosenVisits(chosen, model.worth(chosen), bound, time.process_time() - began_s)
    if not model.allowed(chosen):
        raise InputError(f"survey: the choice of the solver {solver} breaks a rule; take another solver")
    return found


def require_solver(solver: str) -> None:
    """Raises InputError for a `solver` that is not installed, before anything long is started."""
    if solver == "ortools":
        try:
            import ortools.sat.python.cp_model  # noqa: F401
        except ImportError:
            raise InputError(INSTALL) from None


def one_by_one(model: VisitModel, seed: int = 0) -> ChosenVisits:
    """One exposure after the other, each the best for itself; of the `model` of E exposures."""
    began_s = time.process_time()
    chosen, left = np.zeros(len(model), dtype=bool), model.visits.copy()
    for exposure in np.unique(model.exposure).tolist():
        part, rows = model.only(exposure, left)
        mine = rows[solve(part, "highs", seed).columns]
        chosen[mine] = True
        left[model.target[mine]] -= 1
    return ChosenVisits(chosen, model.worth(chosen), math.inf, time.process_time() - began_s)


def _highs(model: VisitModel, seed: int) -> tuple[Flags, float]:
    if not len(model):
        _refuse_minimums(model)
        return np.zeros(0, dtype=bool), 0.0
    rules, low, high = stacked(model)
    result = _milp(-model.value, [LinearConstraint(rules, low, high)])
    if result.x is None:
        _refuse_minimums(model)
        raise InputError("survey: HiGHS found no choice; try the solver ortools")
    return result.x > 0.5, float(-result.mip_dual_bound)


def _milp(cost: Floats, rules: list[LinearConstraint], most: Floats | float = 1.0) -> Any:
    return milp(
        cost,
        constraints=rules,
        bounds=Bounds(0.0, most),
        integrality=np.ones(len(cost)),
        options={"node_limit": MAX_NODES, "mip_rel_gap": 0.0},
    )


def _refuse_minimums(model: VisitModel) -> None:
    """Raises InputError with the sectors whose minimums cannot all be had."""
    missing = shortage(model) if model.minimums else np.zeros(0, dtype=np.int64)
    rows = np.flatnonzero(missing).tolist()
    if not rows:
        return
    told = [
        f"{model.minimums[k]}: {model.minimums[k].number} {model.minimums[k].role} fibres are asked for, "
        f"{model.minimums[k].number - missing[k]} can be had"
        for k in rows
    ]
    more = f" (and {len(told) - 3} more)" if len(told) > 3 else ""
    raise InputError(f"{'; '.join(told[:3])}{more}; lower the minimum, or give more targets of the role")


def shortage(model: VisitModel) -> Ints:
    """(M,) by how much the minimums of a model must be lowered, in all as little as can be."""
    rules, low, high = stacked(model)
    n = len(model.minimums)
    slack = eye_array(len(low), n, k=n - len(low), format="csr")
    cost, most = np.zeros(len(model) + n), np.ones(len(model) + n)
    cost[len(model) :], most[len(model) :] = 1.0, np.inf
    result = _milp(cost, [LinearConstraint(hstack([rules, slack], format="csr"), low, high)], most)
    if result.x is None:
        return np.array([max(0, m.number - len(m.columns)) for m in model.minimums])
    short: Ints = np.rint(result.x[len(model) :]).astype(np.int64)
    return short


def _ortools(model: VisitModel, seed: int) -> tuple[Flags, float]:
    require_solver("ortools")
    from ortools.sat.python import cp_model

    programme = cp_model.CpModel()
    x = [programme.new_bool_var("") for _ in range(len(model))]
    rules, low, high = stacked(model)
    for row, (least, most) in enumerate(zip(low, high, strict=True)):
        mine = [x[k] for k in rules.indices[rules.indptr[row] : rules.indptr[row + 1]]]
        if least > -np.inf:
            programme.add(sum(mine) >= int(least))
        elif most == 1.0:
            programme.add_at_most_one(mine)
        else:
            programme.add(sum(mine) <= int(most))
    programme.maximize(sum(int(v) * one for v, one in zip(model.value, x, strict=True)))
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1  # the same answer on every machine
    solver.parameters.linearization_level = 2  # the relaxation is nearly whole
    solver.parameters.random_seed = seed % 2**31
    solver.parameters.max_deterministic_time = MAX_EFFORT
    status = solver.solve(programme)
    if status not in (cp_model.OPTIMAL, cp_model.FEASIBLE):
        _refuse_minimums(model)
        raise InputError("survey: ortools found no choice within its effort; try the solver highs")
    return np.array([solver.boolean_value(one) for one in x], dtype=bool), solver.best_objective_bound


def _greedy(model: VisitModel, seed: int) -> tuple[Flags, float]:
    """Minimums first, then the most valuable, whatever is still free."""
    rules, _, high = stacked(model)
    by_column = rules.tocsc()
    room, chosen = high.copy(), np.zeros(len(model), dtype=bool)

    def take(columns: Ints, most: int) -> int:
        taken = 0
        for k in columns.tolist():
            mine = by_column.indices[by_column.indptr[k] : by_column.indptr[k + 1]]
            if taken < most and not chosen[k] and (room[mine] >= 1.0).all():
                chosen[k] = True
                room[mine] -= 1.0
                taken += 1
        return taken

    for minimum in model.minimums:
        got = take(minimum.columns, minimum.number)
        if got < minimum.number:
            raise InputError(
                f"{minimum}: {minimum.number} {minimum.role} fibres are asked for, greedy finds {got}"
            )
    take(np.argsort(-model.value, kind="stable"), len(model))
    return chosen, math.inf


SOLVERS: dict[str, Callable[[VisitModel, int], tuple[Flags, float]]] = {
    "highs": _highs,
    "ortools": _ortools,
    "greedy": _greedy,
}
