"""Plan of a campaign: runs with a seed and parameters of the rig, from a grid or drawn from means and a covariance."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from twodof.errors import ExperimentError, is_number

_TRIES = 1000
"""Draws of one member within its bounds before it is given up: bounds that keep a thousandth are a mistake."""


@dataclass(frozen=True)
class Run:
    """One run of a campaign: its `number` in the plan, the `seed` of its noise, and the `parameters` it changes.

    `case` names what is run, where a campaign has several.
    """

    number: int
    seed: int
    parameters: Mapping[str, float] = field(default_factory=dict)
    case: str = ""


def plan(
    seeds: Iterable[int],
    members: Sequence[Mapping[str, float]] = ({},),
    cases: Sequence[str] = ("",),
) -> tuple[Run, ...]:
    """Return the runs of each of the `cases`, one after the other, with the `seeds` and `members`.

    Members are sets of changed parameters. One member is that of all seeds. Otherwise each seed has a member of its
    own. Raises ExperimentError for a seed below 0 and for other numbers of members.
    """
    seeds = list(seeds)
    for seed in seeds:
        if not is_number(seed, 0, whole=True):
            raise ExperimentError(f"{seed!r:.80} is not a seed", "plan", "give whole numbers from 0 on")
    each = list(members) * len(seeds) if len(members) == 1 else list(members)
    if len(each) != len(seeds):
        what = f"{len(members)} sets of parameters for {len(seeds)} seeds"
        raise ExperimentError(what, "plan", "give one set for all seeds, or one for each")
    runs = ((case, int(seed), dict(one)) for case in cases for seed, one in zip(seeds, each, strict=True))
    return tuple(Run(i, seed, one, case) for i, (case, seed, one) in enumerate(runs))


def drawn(
    means: Mapping[str, float],
    covariance: ArrayLike,
    count: int,
    seed: int = 0,
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> list[dict[str, float]]:
    """Draw `count` members from a normal distribution with these `means` and this `covariance` (n, n).

    A member outside of its `bounds` (lower, upper) is drawn again. Each member has a generator of its own: a longer
    campaign begins with the members of a shorter one. Raises ExperimentError for a covariance that is none, and where
    almost no draw lies within the bounds.
    """
    names, centre = list(means), np.array(list(means.values()), dtype=np.float64)
    matrix = np.asarray(covariance, dtype=np.float64)
    if matrix.shape != (len(names), len(names)) or not np.isfinite(matrix).all() or not np.isfinite(centre).all():
        what = f"a covariance of shape {matrix.shape} for {len(names)} parameters"
        raise ExperimentError(what, "drawn", "give one finite row and column for each parameter")
    sizes, directions = np.linalg.eigh(matrix)
    if not np.allclose(matrix, matrix.T) or sizes.min(initial=0.0) < -1e-9 * sizes.max(initial=0.0):
        raise ExperimentError("the covariance is not symmetric and positive", "drawn", "check its signs")
    spread = directions * np.sqrt(np.maximum(sizes, 0.0))
    within = {**dict.fromkeys(names, (-math.inf, math.inf)), **(bounds or {})}
    low, high = (np.array([within[name][side] for name in names]) for side in (0, 1))
    members = []
    for i in range(count):
        generator = np.random.default_rng([seed, i])
        for _ in range(_TRIES):
            member = centre + spread @ generator.standard_normal(len(names))
            if (member >= low).all() and (member <= high).all():
                break
        else:
            raise ExperimentError(f"none of {_TRIES} draws is within the bounds", "drawn", "widen the bounds")
        members.append(dict(zip(names, member.tolist(), strict=True)))
    return members
