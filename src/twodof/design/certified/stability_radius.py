"""The stability radius of a family, in standard deviations: up to it every member is stable. Its inverse is mu."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from twodof.design.certified.certificate import RegionStability, certificate
from twodof.design.certified.zero_exclusion import MOST_CELLS
from twodof.design.uncertain.pitch_family import PitchFamily
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.errors import ParameterError

FARTHEST = 20.0
_TOLERANCE = 0.02
_SMALLEST = 0.01


@dataclass(frozen=True)
class StabilityRadius:
    """Every member up to `proved` standard deviations off is stable, and `witness` at most `broken` off is not.

    For the region of one standard deviation mu, the structured singular value of real parameters, is at most
    1 / `proved` and at least 1 / `broken` (Skogestad and Postlethwaite, section 8.6). `broken` is infinite where no
    unstable member was found.
    """

    proved: float
    broken: float
    witness: dict[str, float] | None

    @property
    def mu(self) -> tuple[float, float]:
        """(lower bound, upper bound)."""
        return 1.0 / self.broken, math.inf if self.proved == 0.0 else 1.0 / self.proved


def stability_radius(
    controller: SampledController,
    family: PitchFamily,
    tolerance: float = _TOLERANCE,
    most: int = MOST_CELLS,
    said: Callable[[float], None] = lambda share: None,
) -> StabilityRadius:
    """Bracket the stability radius by `certificate`, to the share `tolerance` of it where each is decided.

    It looks up to `FARTHEST` standard deviations off, at most `most` boxes for each radius that it tries. Raises
    ParameterError for a tolerance that is not .001 to 1.
    """
    if not 1e-3 <= tolerance <= 1.0:
        raise ParameterError(f"a tolerance of {tolerance!r}", "stability_radius", "give .001 to 1")
    low, high, witness = 0.0, math.inf, None
    tries, trial = 0, 3.0
    while tries < 40:
        said(tries / 40.0)
        tries += 1
        found = certificate(controller, family, trial, most)
        if found.decision is RegionStability.stable:
            low = trial
        elif found.decision is RegionStability.unstable:
            high, witness = trial, found.witness
        else:
            break
        if low >= FARTHEST or high <= _SMALLEST or high - low <= tolerance * low:
            break
        trial = min(FARTHEST, 2.0 * low) if math.isinf(high) else 0.5 * (low + high)
    return StabilityRadius(low, high, witness)
