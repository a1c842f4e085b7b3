"""Design for the rail: gains of the velocity and position loops that best meet a specification."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from twodof.design.specification import Requirement, Specification
from twodof.errors import ParameterError
from twodof.flight.gains import DEFAULT, Gains
from twodof.parameters import PARAMETERS
from twodof.sim.promised.rail_promise import MEMBERS, RailFamily, check_rail, rail_promise

Array = NDArray[np.float64]

_NAMES = ("VEL_KP", "VEL_KI", "POS_KP")
_HIGHEST = {row.name: float(row.high) for row in PARAMETERS if row.name in _NAMES}
_LOWEST = 0.02  # of the highest: below, a loop does nothing that anyone would notice

RESERVE = 0.03
"""Share by which each figure must be better than asked before the search ends, as other members differ by as much."""

_LINEAR, _FLIGHTS = 100, 40  # sets of gains that a simplex tries
_GRID = (0.25, 0.6)  # of the highest
_COARSE = 1 + len(_GRID) ** len(_NAMES)
_UNSTABLE = 5.0  # a miss by a factor of 150
_NO_FIGURE = 1e-3  # an overshoot of 0 has no ratio
_MEAN = 0.05  # of the mean miss, so that the search goes on where the worst one does not move


@dataclass(frozen=True, eq=False)
class RailDesign:
    """Result of a search: `gains`, the `requirements` with their figures, and the number of sets of gains `tried`."""

    gains: Gains
    requirements: tuple[Requirement, ...]
    tried: int

    @property
    def met(self) -> bool:
        """Return True if all requirements are met."""
        return all(one.met for one in self.requirements)


class _Met(Exception):
    """End of a search: all is met, with the reserve."""


class _Search:
    """Judges gains, given as logarithms, and keeps the best."""

    def __init__(
        self,
        asked: Specification,
        family: RailFamily,
        kept: Gains,
        members: int,
        seed: int,
        progress: Callable[[float], None],
    ) -> None:
        self.asked, self.flown = asked, False
        self.best: tuple[float, Gains, tuple[Requirement, ...]] | None = None
        self.tried = 0
        self._family, self._kept, self._progress = family, kept, progress
        self._members, self._seed = members, seed

    def judge(self, x: Array) -> float:
        """Return the largest miss as a log ratio, below 0 if every bound is met. Raises _Met if that suffices."""
        gains = self.gains(x)
        linear, flown = self.asked.of_loops, self.asked.of_step
        rows: tuple[Requirement, ...] = ()
        if linear is not None:
            rows += check_rail(linear, self._family, gains)
        if flown is not None and self.flown:
            promised = rail_promise(
                self._family, flown.loop, gains=gains, goal=flown.step, members=self._members, seed=self._seed
            )
            rows += check_rail(flown, self._family, gains, promised=promised)
        misses = np.array([_miss(row) for row in rows])
        worst = float(misses.max() + _MEAN * misses.mean())
        self.tried += 1
        most = (_LINEAR + _COARSE) * (linear is not None) + (_FLIGHTS + _COARSE) * (flown is not None)
        self._progress(min(1.0, self.tried / most))
        if self.best is None or worst < self.best[0]:
            self.best = worst, gains, rows
        if self.flown and misses.max() < -RESERVE:
            raise _Met
        return worst

    def gains(self, x: Array) -> Gains:
        """Return the gains from their logarithms: velocity Kp and Ki, and position Kp if it is searched."""
        kp, ki, *position = (float(f"{v:.4g}") for v in np.exp(x))
        return replace(self._kept, velocity=(kp, ki), position=position[0] if position else self._kept.position)


def rail_design(
    specification: Specification,
    family: RailFamily,
    kept: Gains = DEFAULT,
    members: int = MEMBERS,
    seed: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> RailDesign:
    """Search for gains of the stock velocity and position loops that meet `specification`, starting from `kept`.

    A simplex (Nelder and Mead, 1965) minimises the largest miss: first of bandwidths and margins of the estimated
    model, then of the flown step. `members` of the family fly it, the same ones for all gains, which `rail_promise`
    draws with `seed`. The position's gain is kept if nothing is asked of its loop. `progress` is called with the share
    done, and may raise to end the search. Raises ParameterError if nothing is asked, and as `rail_promise`.
    """
    linear, flown = specification.of_loops, specification.of_step
    if linear is None and flown is None:
        raise ParameterError(
            "it asks for no figure of the rail's loops", "specification", "ask for one, such as velocity_bandwidth = 4"
        )
    search = _Search(specification, family, kept, members, seed, progress)
    outer = linear is not None and set(linear.required) - {"velocity_bandwidth"}
    names = _NAMES if outer or specification.loop == "position" else _NAMES[:2]
    high = np.log([_HIGHEST[name] for name in names])
    low = high + math.log(_LOWEST)
    start = np.log(np.maximum([*kept.velocity, kept.position][: len(names)], 1e-9)).clip(low, high)
    if linear is not None:
        start = _simplex(search, start, low, high, _LINEAR)
    if flown is not None:
        search.flown, search.best = True, None
        with suppress(_Met):
            _simplex(search, start, low, high, _FLIGHTS)
    assert search.best is not None
    return RailDesign(search.best[1], search.best[2], search.tried)


def _simplex(search: _Search, start: Array, low: Array, high: Array, most: int) -> Array:
    from scipy.optimize import minimize  # imported late: most commands start without it

    # The figures have several valleys: the search goes down from the best of a coarse grid.
    grid = [np.array(row) + high for row in product(np.log(_GRID), repeat=len(high))]
    start = min([start, *grid], key=search.judge)
    # 30 % of each gain at first, towards the middle; a tenth of a per cent of a gain is nothing
    corners = np.vstack([start, start + 0.3 * np.diag(np.where(start > 0.5 * (low + high), -1.0, 1.0))])
    options = {"initial_simplex": corners, "maxfev": most, "xatol": 1e-3, "fatol": 1e-3}
    found = minimize(
        search.judge, start, method="Nelder-Mead", bounds=list(zip(low, high, strict=True)), options=options
    )
    return np.asarray(found.x, dtype=np.float64)


def _miss(row: Requirement) -> float:
    if not math.isfinite(row.got):
        return -_UNSTABLE if math.isinf(row.got) and not row.at_most else _UNSTABLE
    ratio = math.log(max(row.got, _NO_FIGURE) / max(row.asked, _NO_FIGURE))
    return min(_UNSTABLE, max(-_UNSTABLE, ratio if row.at_most else -ratio))
