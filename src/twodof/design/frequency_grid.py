"""A grid of frequencies that follows a loop: dense where its poles, open and closed, make it turn."""

import numpy as np
from numpy.typing import NDArray

from twodof.design.closed_loop_poles import logarithms
from twodof.design.loop_transfer import LoopTransfer
from twodof.errors import ParameterError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PER_DECADE = 40
_WIDTHS = np.concatenate([-np.geomspace(30.0, 0.1, 12), [0.0], np.geomspace(0.1, 30.0, 12)])
_PER_TURN = 16  # of the phase of a delay
_MOST = 40_000


def frequency_grid(loop: LoopTransfer, closed: Complex, further: Array, below: float = 1e-3) -> Array:
    """Frequencies [rad/s], sorted and > 0, from far below the slowest pole to the Nyquist frequency.

    In continuous time they end where |L| stays below `below`. The frequencies `further` are among them, with a point
    between each two. Raises ParameterError where a delay turns the loop more often than can be looked at.
    """
    every = np.concatenate([loop.poles(), closed])
    s = logarithms(every[np.abs(every) > 0.0], loop.dt)
    size = np.abs(s)
    size = size[np.isfinite(size) & (size > 1e-9)]
    given = further[further > 0.0]
    known = np.concatenate([size, given]) if size.size + given.size else np.ones(1)
    low = 1e-2 * float(known.min())
    if loop.dt is None:
        high = _end(loop, 10.0 * float(known.max()), below)
    else:
        high = np.pi / loop.dt
    count = max(50, int(PER_DECADE * np.log10(high / low)))
    around = (np.abs(s.imag)[:, None] + np.abs(s.real)[:, None] * _WIDTHS).ravel()
    between = np.sqrt(given[1:] * given[:-1]) if given.size > 1 else given[:0]
    parts = [np.geomspace(low, high, count), around, given, between, [high]]
    if loop.delay:
        turns = high * loop.delay / (2.0 * np.pi)
        if turns * _PER_TURN > _MOST:
            raise ParameterError(
                f"the delay of {loop.delay:g} s turns the loop {turns:.3g} times before its gain has fallen",
                "margins",
                "give the loop a lag at a lower frequency, or a shorter delay",
            )
        parts.append(np.linspace(low, high, int(turns * _PER_TURN) + 2))
    grid = np.unique(np.concatenate(parts))
    return np.asarray(grid[(grid >= min(low, float(known.min()))) & (grid <= high)])


def _end(loop: LoopTransfer, start: float, below: float) -> float:
    """From where on |L| stays below `below` or goes on to its direct path."""
    end = start
    for _ in range(40):
        if abs(loop.response(end)[0]) < below or loop.d:
            break
        end *= 2.0
    return end
