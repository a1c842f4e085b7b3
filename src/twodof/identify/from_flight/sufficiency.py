"""Sufficiency: whether the data of a flight tell what it was flown for, unknown by unknown, with the reason."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from twodof.identify.estimate import Estimate
from twodof.identify.validate import deviations

TOLD = 0.25
"""An unknown is told where its 95 % interval is within this share of its value: of a gain that is 2 dB, a third of the
margin of 6 dB that a controller commonly keeps."""

LEVEL = 0.95

PURPOSE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"impulse": ("w_n", "xi"), "doublet": ("mu", "tau"), "attitude": ("mu", "tau"), "velocity": ("k_v", "p_v")}
)
"""What each experiment is flown for."""


@dataclass(frozen=True)
class Sufficiency:
    """`shares` are half the 95 % intervals over the values, by unknown; `reasons` say what is missing.

    `trusted`: the error bars can be believed. Where the residual wanders, they are too small by an unknown factor.
    """

    shares: Mapping[str, float]
    reasons: tuple[str, ...]
    trusted: bool = True

    @property
    def enough(self) -> bool:
        """Whether nothing is missing."""
        return not self.reasons

    @property
    def text(self) -> str:
        """In a sentence."""
        known = ", ".join(f"{name} to {100.0 * share:.2g} %" for name, share in self.shares.items())
        doubt = "" if self.trusted else ". But the residual wanders, so these are too small: fly it again and compare"
        if self.enough:
            return f"informative enough: it tells {known}{doubt}"
        return f"not informative enough: {'; '.join(self.reasons)}{doubt}"


def sufficiency(found: Estimate, wanted: Collection[str] = ()) -> Sufficiency:
    """Judge a fit by the unknowns `wanted`, where it has them; by default by all that are not one record's own."""
    asked = [name for name in (*found.labels, *found.summed) if name in wanted]
    asked = asked or [name for name in found.labels if name not in found.local]
    shares, reasons = {}, []
    if not found.converged:
        reasons.append("the search did not converge")
    for name in asked:
        value, sigma = found[name], found.sigma(name)
        if name in found.at_bound or not sigma >= 0.0:
            reasons.append(f"{name} is held by its bound")
            continue
        shares[name] = deviations(LEVEL) * sigma / abs(value) if value else float("inf")
        if shares[name] > TOLD:
            reasons.append(f"{name} is known to {100.0 * shares[name]:.0f} % only")
    return Sufficiency(shares, tuple(reasons), not found.wanders)
