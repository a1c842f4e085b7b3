"""How an input behaves between its samples: held (zero-order hold), a straight line, or band-limited.

A structure's program holds its inputs over each tick. An input may move on between its samples. The ticks of a step are
then given the values that have the same moments over the step as the moving input. These are its integral, and those of
its products with t, t^2 and t^3. The states of a linear structure that is slow beside the step are then right at each
sample to the fourth order. The course of the input in between does not matter.
"""

import functools

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Array = NDArray[np.float64]

HOLDS = ("zoh", "linear", "band-limited")
"""Held from one sample to the next; straight lines between samples; no content above half the sampling rate
(Pintelon and Schoukens, System Identification, section 13.2)."""

LEAST_TICKS = 4
"""Fewest ticks a step for an input that is not held."""

_MOMENTS = 4
_NODES = 8
# Samples by which a record is continued at both ends before its Fourier transform, which takes it as periodic.
_CONTINUED = 512


def ticks(values: Array, hold: str, pieces: int, direct: bool = False) -> Array:
    """What a program with `pieces` ticks a step is given for an input's `values` (steps,).

    The shape is (steps * pieces,). `hold` is one of HOLDS. With `direct` (an output depends on the input in the same
    tick) the first tick of each step has the sample itself, at the price of one moment.
    """
    if hold == "zoh":
        return np.repeat(values, pieces)
    nodes, _ = legendre.leggauss(_NODES)
    late = 0.5 + 0.5 * nodes
    inside = _linear(values, late) if hold == "linear" else _band_limited(values, late)
    return np.ascontiguousarray((inside @ _held(pieces, direct).T).reshape(-1))


@functools.lru_cache(maxsize=16)
def _held(pieces: int, direct: bool) -> Array:
    """The ticks' values from those at the nodes of a step, shape (pieces, nodes).

    They are the means over each tick, changed as little as the moments ask for. Moments are taken with Legendre's
    polynomials on -1..1, the step.
    """
    nodes, weights = legendre.leggauss(_NODES)
    to_series = np.linalg.inv(legendre.legvander(nodes, _NODES - 1))
    edges = np.linspace(-1.0, 1.0, pieces + 1)
    # The integral of each polynomial over each tick.
    integrals = np.stack(
        [np.diff(legendre.legval(edges, legendre.legint(np.eye(_NODES)[i]))) for i in range(_NODES)], axis=1
    )
    means = integrals @ to_series * (pieces / 2.0)
    count = min(_MOMENTS, pieces - direct)
    wanted = legendre.legvander(nodes, count - 1).T * weights
    given = integrals[:, :count].T
    if direct:
        wanted = np.vstack([wanted, legendre.legvander(np.array([-1.0]), _NODES - 1) @ to_series])
        given = np.vstack([given, np.eye(pieces)[:1]])
    return np.asarray(means + np.linalg.pinv(given) @ (wanted - given @ means))


def _linear(values: Array, late: Array) -> Array:
    """The straight lines `late` shares of a step after each sample, shape (steps, late); held after the last."""
    rise = np.append(np.diff(values), 0.0)
    return np.asarray(values[:, None] + rise[:, None] * late)


def _band_limited(values: Array, late: Array) -> Array:
    """The interpolation by sines, `late` shares of a step after each sample, shape (steps, late).

    The record less the line through its ends is continued by its point reflection at both ends, and fades out there.
    """
    n = values.size
    slope = (values[-1] - values[0]) / max(n - 1, 1)
    line = values[0] + slope * np.arange(n)
    rest = values - line
    lap = min(_CONTINUED, n - 1)
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, lap + 1) / (lap + 1.0))
    size = 1 << (n + 2 * lap).bit_length()
    whole = np.zeros(size)
    whole[:n] = rest
    whole[n : n + lap] = -rest[n - 1 - lap : n - 1][::-1] * fade
    whole[size - lap :] = (-rest[1 : lap + 1] * fade)[::-1]
    frequency = np.fft.rfftfreq(size)
    # Of a sine at half the sampling rate the samples do not tell the phase; it is left out.
    spectrum = np.fft.rfft(whole) * (frequency < 0.5)
    found = np.empty((n, late.size))
    for j, share in enumerate(late):
        moved = np.fft.irfft(spectrum * np.exp(2j * np.pi * frequency * share), size)
        found[:, j] = moved[:n] + line + slope * share
    return found
