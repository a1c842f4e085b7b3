"""Robustness: which members of a family a controller keeps stable, and the worst member in a confidence region.

Members that are drawn tell the share. The worst one lies on the border of the region as a rule, where hardly any is
drawn: it is searched for there. Where nothing unstable is found a proof is asked for that nothing is there.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.design.certified.certificate import RegionStability, certificate
from twodof.design.certified.zero_exclusion import MOST_CELLS
from twodof.design.uncertain.pitch_family import PARAMETERS, PitchFamily, PitchMembers
from twodof.design.uncertain.pitch_loop import PitchLoop
from twodof.design.uncertain.sampled_controller import SampledController
from twodof.errors import ParameterError
from twodof.signals import PERIOD

Array = NDArray[np.float64]

REGION = 0.999
"""The confidence region that is searched: one estimate in a thousand lies farther off."""

_DIRECTIONS = 300
_ROUNDS = 8
_KEPT = 5  # of the worst directions, each searched further
_AROUND = 20  # directions about each, in a round


@dataclass(frozen=True, eq=False)
class Robustness:
    """`unstable`: share of the members drawn that are. `radius`: the largest pole's magnitude that was found in the
    confidence region `region`, at the member `worst`; `swing` [rad/s] and `growth` [1/s] are what that pole does.

    `decision` is of the whole region, after `looked` boxes of it: what is undecided counts as refused, see `reason`.
    """

    unstable: float
    members: int
    region: float
    radius: float
    worst: Mapping[str, float]
    swing: float
    growth: float
    decision: RegionStability
    looked: int
    reason: str = ""

    @property
    def robust(self) -> bool:
        """Whether every member of the region is proved stable, and none that was drawn beyond it is unstable."""
        return self.decision is RegionStability.stable and self.unstable == 0.0

    @property
    def text(self) -> str:
        """In a sentence."""
        swings = self.swing > 0.0
        where = ", ".join(f"{name} {value:.4g}" for name, value in self.worst.items())
        whole = f"the whole {100.0 * self.region:g} % region"
        if self.robust:
            slowest = f"swing of {self.swing:.3g} rad/s" if swings else "answer"
            return f"stable on {whole}, proved; slowest {slowest} at {where}"
        if self.decision is RegionStability.undecided and self.unstable == 0.0:
            return f"NOT PROVED stable on {whole}: {self.reason}. The least stable member found is at {where}"
        moves = f"swings at {self.swing:.3g} rad/s" if swings else "grows without swinging"
        return f"NOT ROBUST: {100.0 * self.unstable:.1f} % of the members are unstable; the worst {moves} ({where})"

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "robust": self.robust,
            "decision": self.decision.value,
            "boxes": self.looked,
            "reason": self.reason,
            "unstable": self.unstable,
            "members": self.members,
            "region": self.region,
            "radius": self.radius,
            "worst": dict(self.worst),
            "swing": self.swing,
            "growth": self.growth,
        }


def robustness(
    controller: SampledController,
    family: PitchFamily,
    members: int = 1000,
    region: float = REGION,
    seed: int = 1,
    said: Callable[[float], None] = lambda share: None,
    most: int = MOST_CELLS,
) -> Robustness:
    """Draw `members`, search the confidence ellipsoid `region` for the least stable one, and prove that none is not.

    The search begins at many directions of the border and goes on around the worst of them, ever nearer. The slow pole
    that an integral leaves is a pole like any other, so `radius` near 1 is not by itself a warning; 1 and above is
    unstable. Where nothing unstable was found, `certificate` decides with at most `most` boxes. Raises ParameterError
    for numbers out of range.
    """
    if not 0.5 <= region < 1.0:
        raise ParameterError(f"a region of {region!r}", "robustness", "give 0.5 to 0.99999")
    drawn = family.draw(members, seed)
    radii = PitchLoop(drawn, controller).radii()
    rng = np.random.default_rng(seed + 1)
    k = len(family.uncertain)
    best, point = float(radii.max()), drawn.one(int(radii.argmax()))
    if k:
        directions = _unit(np.concatenate([rng.standard_normal((_DIRECTIONS, k)), np.eye(k), -np.eye(k)]))
        values = _radii(family, region, directions, controller)
        for step in range(_ROUNDS):
            said(0.5 * step / _ROUNDS)
            order = np.argsort(-values, axis=1)[:, :_KEPT]
            top = directions[np.unique(order)]
            around = top[:, None] + 0.5**step * 0.7 * rng.standard_normal((len(top), _AROUND, k))
            directions = _unit(np.concatenate([top, around.reshape(-1, k)]))
            values = _radii(family, region, directions, controller)
        i = int(values[0].argmax())
        if values[0, i] > best:
            best, point = float(values[0, i]), _members(family, region, directions[i : i + 1]).one(0)
    unstable = float(np.mean(radii >= 1.0))
    if best >= 1.0:
        decided, looked, reason = RegionStability.unstable, 0, ""
    else:
        found = certificate(controller, family, _reach(region, k), most, lambda share: said(0.5 + 0.5 * share))
        decided, looked, reason = found.decision, found.looked, found.reason
        if found.witness is not None:
            point = found.witness
            best = float(PitchLoop(_one(point), controller).radii()[0])
    swing, growth = _motion(point, controller)
    return Robustness(unstable, members, region, best, point, swing, growth, decided, looked, reason)


def _reach(region: float, k: int) -> float:
    """Standard deviations from the estimate to the border of the region of `k` parameters."""
    from scipy.special import gammaincinv  # imported late: most commands start without it

    # The quantile of chi-square with k degrees of freedom; scipy.stats takes a second to import.
    return math.sqrt(2.0 * float(gammaincinv(0.5 * k, region))) if k else 1.0


def _members(family: PitchFamily, region: float, directions: Array) -> PitchMembers:
    """Where each direction meets the border of the ellipsoid, kept within what a member can be."""
    far = _reach(region, len(family.uncertain))
    size = np.sqrt(np.diag(family.covariance))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(family.covariance / np.outer(scale, scale))
    rows = far * directions @ (size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))).T
    n = len(rows)
    columns = {name: np.full(n, float(family.values[name])) for name in PARAMETERS}
    for i, name in enumerate(family.uncertain):
        columns[name] = np.clip(columns[name] + rows[:, i], *PARAMETERS[name])
    return PitchMembers(**columns)


def _radii(family: PitchFamily, region: float, directions: Array, controller: SampledController) -> Array:
    """(2, n): the largest magnitude of a pole, and of a pole that swings, which a slow one would hide."""
    size = np.abs(poles := PitchLoop(_members(family, region, directions), controller).poles())
    return np.stack([size.max(axis=1), np.where(np.abs(poles.imag) > 1e-6, size, 0.0).max(axis=1)])


def _unit(rows: Array) -> Array:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _motion(member: Mapping[str, float], controller: SampledController) -> tuple[float, float]:
    """(rad/s, 1/s) of the largest pole of one member."""
    a = PitchLoop(_one(member), controller).matrices[0][0]
    poles = np.linalg.eigvals(np.delete(np.delete(a, 3, axis=0), 3, axis=1)).astype(np.complex128)
    worst = poles[np.abs(poles).argmax()]
    s = np.log(worst) / PERIOD
    return abs(float(s.imag)), float(s.real)


def _one(member: Mapping[str, float]) -> PitchMembers:
    return PitchMembers(**{name: np.array([value]) for name, value in member.items()})
