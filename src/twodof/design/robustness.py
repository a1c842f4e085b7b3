"""Robustness: which drones of a family a controller keeps stable, and the worst one in a confidence region.

Sampled drones give the share that is unstable. The worst drone lies on the border of the confidence region as a rule,
where samples are rare. A local search looks for it there. Neither is a proof.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.design.margins import DiskMargin, margins
from twodof.design.pitch_family import PARAMETERS, PitchFamily, PitchMembers
from twodof.design.pitch_loop import PitchLoop
from twodof.design.sampled_controller import SampledController
from twodof.errors import finite
from twodof.signals import PERIOD

Array = NDArray[np.float64]

SAMPLES = 2000
"""Drones that are sampled for a verdict."""

REGION = 0.999
"""Probability of the confidence region whose border is searched: one estimate in a thousand lies farther off."""

_DIRECTIONS = 300
_ROUNDS = 8
_KEPT = 5  # of the worst directions by each measure, searched further
_AROUND = 20  # directions about each, in a round
_FREQUENCIES = np.geomspace(1.0, 600.0, 80)  # rad/s, for the disk margin of many drones at once


@dataclass(frozen=True, eq=False)
class Robustness:
    """Verdict on a controller and a family of drones, from samples and a search.

    `unstable` is the share of the `members` sampled drones that are unstable. `worst` is the worst drone found, by
    parameter name: an unstable one, otherwise the one with the smallest disk margin. It is either a sample or on the
    border of the confidence region `region`. `radius` is the largest magnitude of a closed-loop pole that was found.
    `margin` is the disk margin of the worst drone, of the loop broken at M. `swing` [rad/s] and `growth` [1/s] describe
    the least stable pole of the worst drone.
    """

    unstable: float
    members: int
    region: float
    radius: float
    worst: Mapping[str, float]
    margin: DiskMargin
    swing: float
    growth: float

    @property
    def robust(self) -> bool:
        """Return True if all sampled drones and the worst drone found are stable."""
        return self.radius < 1.0

    @property
    def text(self) -> str:
        """Return the verdict as a sentence."""
        drone = ", ".join(f"{name} {value:.4g}" for name, value in self.worst.items())
        every = f"all {self.members:,} sampled drones"
        if self.robust:
            decibels, degrees = _decibels(self.margin), math.degrees(self.margin.phase)
            margin = f"a disk margin of {decibels:.1f} dB and {degrees:.0f} deg ({drone})"
            return f"stable for {every} and the worst one found, which has {margin}"
        moves = f"swings at {self.swing:.3g} rad/s" if self.swing > 0.0 else "grows without swinging"
        if self.unstable == 0.0:
            rare = f"one on the border of the {100.0 * self.region:g} % region {moves} ({drone})"
            return f"NOT ROBUST: stable for {every}, but {rare}"
        share = f"{100.0 * self.unstable:.1f} % of {self.members:,} sampled drones are unstable"
        return f"NOT ROBUST: {share}; the worst one {moves} ({drone})"

    def to_json(self) -> dict[str, Any]:
        """Return plain data; a gain margin that is infinite is null."""
        own = ("robust", "unstable", "members", "region", "radius", "worst")
        return {
            **{name: finite(getattr(self, name)) for name in own},
            "disk_margin": self.margin.alpha,
            "disk_margin_db": finite(_decibels(self.margin)),
            "disk_margin_deg": math.degrees(self.margin.phase),
            **{name: getattr(self, name) for name in ("swing", "growth")},
        }


def robustness(
    controller: SampledController,
    family: PitchFamily,
    members: int = SAMPLES,
    seed: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> Robustness:
    """Sample `members` drones of the family, and search the border of the confidence ellipsoid `REGION` for the worst.

    The search begins in many directions and goes on around the worst of them, ever nearer. It follows three measures:
    the largest magnitude of a pole, that of a pole that swings (which the slow pole of an integral would hide), and the
    disk margin. `progress` is called with the share done. Raise ParameterError for numbers out of range.
    """
    drawn = family.draw(members, seed)
    values = _measures(drawn, controller)
    unstable = float(np.mean(values[0] >= 1.0))
    found = [(drawn.one(int(row.argmax())), float(values[0, row.argmax()])) for row in (values[0], values[2])]
    if k := len(family.uncertain):
        rng = np.random.default_rng(seed + 1)
        directions = _unit(np.concatenate([rng.standard_normal((_DIRECTIONS, k)), np.eye(k), -np.eye(k)]))
        values = _measures(_on_border(family, directions), controller)
        for step in range(_ROUNDS):
            progress(step / _ROUNDS)
            top = directions[np.unique(np.argsort(-values, axis=1)[:, :_KEPT])]
            around = top[:, None] + 0.5**step * 0.7 * rng.standard_normal((len(top), _AROUND, k))
            directions = _unit(np.concatenate([top, around.reshape(-1, k)]))
            values = _measures(_on_border(family, directions), controller)
        border = _on_border(family, directions)
        found += [(border.one(int(row.argmax())), float(values[0, row.argmax()])) for row in (values[0], values[2])]
    radius = max(size for _, size in found)
    if radius >= 1.0:
        worst, margin = next(drone for drone, size in found if size == radius), DiskMargin(0.0, 0.0, math.nan)
    else:
        disks = [
            (drone, margins(PitchLoop(PitchMembers.of(drone), controller).loop_transfer()).disk) for drone, _ in found
        ]
        worst, margin = min(disks, key=lambda one: one[1].alpha)
    swing, growth = _motion(worst, controller)
    return Robustness(unstable, members, REGION, radius, worst, margin, swing, growth)


def _measures(members: PitchMembers, controller: SampledController) -> Array:
    """Return three measures of each drone, (3, n): largest pole, largest swinging pole, 1 / disk margin."""
    loop = PitchLoop(members, controller)
    size = np.abs(poles := loop.poles())
    swinging = np.where(np.abs(poles.imag) > 1e-6, size, 0.0)
    response = loop.moment_response(_FREQUENCIES)
    disk = np.abs(1.0 / (1.0 + response) - 0.5).max(axis=1)
    return np.stack([size.max(axis=1), swinging.max(axis=1), disk])


def _on_border(family: PitchFamily, directions: Array) -> PitchMembers:
    """Return the drone at which each direction leaves the ellipsoid or the parameters' physical bounds."""
    from scipy.special import gammaincinv  # imported late: most commands start without it

    # The quantile of chi-square with k degrees of freedom; scipy.stats takes a second to import.
    reach = math.sqrt(2.0 * float(gammaincinv(0.5 * len(family.uncertain), REGION)))
    rows = reach * directions @ family.root().T
    centre = np.array([family.values[name] for name in family.uncertain])
    low, high = np.array([PARAMETERS[name] for name in family.uncertain]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(rows > 0.0, (high - centre) / rows, np.where(rows < 0.0, (low - centre) / rows, np.inf))
    inside = np.clip(centre + np.minimum(room.min(axis=1), 1.0)[:, None] * rows, low, high)
    columns = {name: np.full(len(rows), float(family.values[name])) for name in PARAMETERS}
    return PitchMembers(**columns | {name: inside[:, i] for i, name in enumerate(family.uncertain)})


def _unit(rows: Array) -> Array:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def _motion(drone: Mapping[str, float], controller: SampledController) -> tuple[float, float]:
    """Return frequency [rad/s] and growth [1/s] of the least stable pole of one drone."""
    poles = PitchLoop(PitchMembers.of(drone), controller).poles()[0]
    s = np.log(poles[np.abs(poles).argmax()]) / PERIOD
    return abs(float(s.imag)), float(s.real)


def _decibels(margin: DiskMargin) -> float:
    high = margin.gain[1]
    return 20.0 * math.log10(high) if 0.0 < high < math.inf else math.inf
