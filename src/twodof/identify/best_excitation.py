"""The best excitation within the rig's limits: the doublet, 3-2-1-1 or multisine that tells the unknowns best."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError
from twodof.excitation import LIMITS, Doublet, Excitation, Multisine, ThreeTwoOneOne
from twodof.identify.disturbance.disturbance_model import DisturbanceModel
from twodof.identify.information import Information, predict, simulate_planned
from twodof.models.structure import Structure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Limits:
    """What an experiment may do to the rig.

    `within` is the largest magnitude of outputs, `travel` the largest peak-to-peak, since an experiment picks a start
    that fits the rail. `least` and `most` bound the excitation's amplitude: below `least` the machine sticks.
    `twodof.excitation.LIMITS` bounds it too, by its unit.
    """

    within: Mapping[str, float] = field(default_factory=dict)
    travel: Mapping[str, float] = field(default_factory=dict)
    least: float = 0.0
    most: float = math.inf


# A tenth of each is kept free: the model that plans the flight is the one that the flight shall correct.
_FREE = 0.9

PITCH_LIMITS = Limits(within={"theta": _FREE * math.radians(50.0)})
"""Pitch must stay under 50 degrees or the drone hits a carbon rod (paper, section 4.1); a tenth is kept free."""

RAIL_LIMITS = Limits(within={"theta": _FREE * math.radians(50.0)}, travel={"x": _FREE * 0.8})
"""And the cart has a stroke of about 0.8 m, of which a tenth is kept free as well."""


@dataclass(frozen=True, eq=False)
class Design:
    """The best excitation of its kind within the limits, what it will tell, and the kinds that were compared.

    `cost` is the root mean square of sigma / scale over the unknowns that are not local; `tried` holds (shape,
    amplitude, cost) of each candidate, NaN where none fits.
    """

    excitation: Excitation
    information: Information
    cost: float
    tried: tuple[tuple[float, float, float], ...]


Family = Callable[[float, float], Excitation]


def doublets(unit: str = "-", lead: float = 0.5) -> Family:
    """Doublets by period [s] and amplitude."""
    return lambda period, amplitude: Doublet(amplitude, period, unit=unit, lead=lead)


def three_two_one_ones(unit: str = "-", lead: float = 0.5) -> Family:
    """3-2-1-1 signals by the length of all seven steps together [s] and amplitude."""
    return lambda length, amplitude: ThreeTwoOneOne(amplitude, length / 7.0, unit=unit, lead=lead)


def multisines(unit: str = "-", lead: float = 0.5, harmonics: int = 10) -> Family:
    """Multisines of equal lines with Schroeder's phases by period [s] and peak."""
    return lambda period, peak: Multisine.schroeder(peak, period, tuple(range(1, harmonics + 1)), unit=unit, lead=lead)


def best(
    structure: Structure,
    family: Family,
    shapes: Sequence[float],
    duration: float,
    dt: float,
    noise: Mapping[str, float],
    limits: Limits,
    *,
    values: Mapping[str, float] | None = None,
    estimate: Collection[str] | None = None,
    disturbance: DisturbanceModel | None = None,
) -> Design:
    """The best of `family(shape, amplitude)` over `shapes`, each with the largest amplitude that `limits` allow.

    The experiment lasts `duration` [s], rest and free response included. Excitations that do not fit into it are passed
    over. `disturbance` as in `predict`. Raises IdentificationError if none fits the limits, saying which limit is in
    the way.
    """
    if len(structure.inputs) != 1:
        raise IdentificationError(
            f"the structure has {len(structure.inputs)} inputs", f"structure '{structure.name}'", "design for one input"
        )
    tried: list[tuple[float, float, float]] = []
    found: list[tuple[float, Excitation, Information]] = []
    reasons: set[str] = set()
    for shape in shapes:
        amplitude, reason = _largest(structure, family, shape, duration, dt, limits, values)
        if amplitude <= 0.0:
            reasons.add(reason)
            tried.append((shape, math.nan, math.nan))
            continue
        excitation = family(shape, amplitude)
        inputs = {structure.inputs[0]: _played(excitation, duration, dt)}
        info = predict(structure, inputs, dt, noise, values=values, estimate=estimate, disturbance=disturbance)
        cost = _cost(structure, info)
        tried.append((shape, amplitude, cost))
        found.append((cost, excitation, info))
    if not found:
        raise IdentificationError(
            f"no excitation fits: {'; '.join(sorted(reasons)) or 'no shape was given'}",
            f"structure '{structure.name}'",
            "try shorter shapes, a longer experiment, or another kind of signal",
        )
    cost, excitation, info = min(found, key=lambda one: one[0])
    return Design(excitation, info, cost, tuple(tried))


def _cost(structure: Structure, info: Information) -> float:
    unknowns = structure.unknowns
    shares = [
        float(sigma) / unknowns[label].scale
        for label, sigma in zip(info.labels, info.sigma, strict=True)
        if not unknowns[label].local
    ]
    return math.sqrt(sum(share**2 for share in shares) / max(1, len(shares)))


def _played(excitation: Excitation, duration: float, dt: float) -> Array:
    return excitation.at(dt * np.arange(round(duration / dt) + 1))


def _largest(
    structure: Structure,
    family: Family,
    shape: float,
    duration: float,
    dt: float,
    limits: Limits,
    values: Mapping[str, float] | None,
) -> tuple[float, str]:
    """The largest amplitude within the limits, to 1 %, or 0 and the limit that is in the way."""
    full = {name: unknown.value for name, unknown in structure.unknowns.items()} | dict(values or {})

    def broken(amplitude: float) -> str:
        u = _played(family(shape, amplitude), duration, dt)
        simulated = simulate_planned(structure, {structure.inputs[0]: u}, dt, full)
        for name, most in limits.within.items():
            if name in simulated and not float(np.abs(simulated[name]).max()) <= most:
                return f"{name} exceeds {most:g}"
        for name, most in limits.travel.items():
            if name in simulated and not float(np.ptp(simulated[name])) <= most:
                return f"{name} travels more than {most:g}"
        return ""

    low = max(limits.least, 1e-6)
    if family(shape, low).duration > duration:
        return 0.0, f"the signal is longer than {duration:g} s"
    reason = broken(low)
    if reason:
        return 0.0, f"{reason} at the least amplitude {low:g}"
    high = min(limits.most, LIMITS[family(shape, low).unit])
    if not broken(high):
        return high, ""
    while high / low > 1.01:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if broken(middle) else (middle, high)
    return low, ""
