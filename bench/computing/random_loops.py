"""Random loops for comparisons: stable and unstable, resonant, with integrators, sampled with delays, by seed."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

KINDS = ("stable", "unstable", "resonant", "sampled", "delayed")
COUNT = 50


class RandomLoop(NamedTuple):
    """Numerator and denominator of L, highest power first; `dt` None in continuous time."""

    kind: str
    numerator: Floats
    denominator: Floats
    dt: float | None


def random_loop(seed: int) -> RandomLoop:
    """Loop number `seed`; the kinds take turns."""
    r = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    dt = 0.05 if kind in ("sampled", "delayed") else None
    poles = list(-r.uniform(0.2, 6.0, r.integers(1, 4)))
    if r.random() < 0.5:
        poles.append(0.0)
    pairs = {"resonant": 3, "stable": 0}.get(kind, int(r.integers(0, 2)))
    zeros = list(-r.uniform(0.3, 8.0, r.integers(0, len(poles))))
    for _ in range(pairs):
        w, xi = r.uniform(1.0, 15.0), r.uniform(0.01, 0.1) if kind == "resonant" else r.uniform(0.1, 0.7)
        poles += [w * (-xi + 1j * np.sqrt(1 - xi**2)), w * (-xi - 1j * np.sqrt(1 - xi**2))]
        if kind == "resonant":
            w *= r.uniform(0.7, 1.4)
            zeros += [w * (-0.1 + 1j), w * (-0.1 - 1j)]
    if kind == "unstable":
        poles[0] = -0.5 * poles[0]
    if dt is not None:
        poles, zeros = list(np.exp(np.array(poles) * dt)), list(np.exp(np.array(zeros) * dt))
    if kind == "delayed":
        poles += [0.0] * int(r.integers(1, 6))
    top, bottom = np.atleast_1d(np.poly(zeros)).real, np.poly(poles).real
    # Of size 1 about 2 rad/s, so that there are crossings.
    place = 2j if dt is None else np.exp(2j * dt)
    size = abs(np.polyval(top, place) / np.polyval(bottom, place))
    return RandomLoop(kind, top * r.uniform(0.4, 4.0) / size, bottom, dt)
