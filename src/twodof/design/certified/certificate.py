"""Certificate: whether a controller keeps every member of a confidence region stable, decided and not only sampled."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from twodof.design.certified.pitch_region import PitchRegion
from twodof.design.certified.pitch_symbols import pitch_formula
from twodof.design.certified.resolvent import coprime_factors
from twodof.design.certified.zero_exclusion import MOST_CELLS, exclude_zero
from twodof.design.uncertain.pitch_family import PitchFamily
from twodof.design.uncertain.pitch_loop import PitchLoop
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.errors import ParameterError

Array = NDArray[np.float64]

_ARCS = np.concatenate([[0.0], np.geomspace(1e-4, 0.03, 24), np.linspace(0.03, math.pi, 160)[1:]])
_ROUND = 40_000  # boxes between two looks at whether a member is unstable
_LOOKED_AT = 300


class RegionStability(StrEnum):
    """Of a whole region: every member stable, an unstable one found, or open after so many boxes."""

    stable = "stable"
    unstable = "unstable"
    undecided = "undecided"


@dataclass(frozen=True)
class Certificate:
    """`decision` for the members up to `radius` standard deviations off, after `looked` boxes.

    `witness` is an unstable member by name where one was found. `reason` says why it is undecided.
    """

    decision: RegionStability
    radius: float
    looked: int
    witness: dict[str, float] | None = None
    reason: str = ""


def certificate(
    controller: SampledController,
    family: PitchFamily,
    radius: float,
    most: int = MOST_CELLS,
    said: Callable[[float], None] = lambda share: None,
) -> Certificate:
    """Decide whether `controller` keeps stable every member up to `radius` standard deviations from the estimate.

    `radius` is in the metric of the covariance; members beyond the bounds of `PARAMETERS` do not count. The estimate is
    stable by its poles; then no member may have a pole on the unit circle (`exclude_zero`). What it says of "stable" is
    a proof up to roundings, which are bounded too. `most` boxes are looked at; `said` is called with the share of them.
    Raises ParameterError for a radius that is not positive.
    """
    if not 0.0 < radius < math.inf:
        raise ParameterError(f"a radius of {radius!r}", "certificate", "give standard deviations, above 0")
    nominal = family.nominal()
    if not PitchLoop(nominal, controller).radii()[0] < 1.0:
        return Certificate(RegionStability.unstable, radius, 0, nominal.one(0))
    try:
        factors = coprime_factors(controller.a, controller.b[:, 1:], controller.c, controller.d[:, 1:])
    except ParameterError as reason:
        return Certificate(RegionStability.undecided, radius, 0, None, reason.what)
    region = PitchRegion.of(family, radius)
    formula, cells, looked = pitch_formula(region, factors), region.cells(_ARCS), 0

    def goes_on(done: int, left: int) -> bool:
        said(min(1.0, (looked + done) / most))
        return False

    while looked < most:
        found = exclude_zero(formula, cells, region.radius, min(_ROUND, most - looked), goes_on)
        looked += found.looked
        if found.proved:
            return Certificate(RegionStability.stable, radius, looked)
        cells = found.left
        few = cells.part(np.unique(np.linspace(0, len(cells) - 1, _LOOKED_AT).astype(np.int64)))
        members = region.members(few)
        radii = PitchLoop(members, controller).radii()
        if radii.max() >= 1.0:
            return Certificate(RegionStability.unstable, radius, looked, members.one(int(radii.argmax())))
    return Certificate(
        RegionStability.undecided, radius, looked, None, f"a search of it in {looked} parts does not decide it"
    )
