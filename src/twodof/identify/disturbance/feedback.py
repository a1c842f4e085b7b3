"""Does an input answer the noise, as the output of a controller does?"""

import numpy as np
from numpy.typing import NDArray

from twodof.identify.disturbance.autoregression import autoregression, pieces_of
from twodof.identify.problem import Problem

Array = NDArray[np.float64]

_LAGS = 9
_CHANCE = 1e-6
_LEAST = 100
_CLIP = 2.5
_MOVES = 0.5
"""Share of the samples at which the output of a controller differs from the one before, at the least."""


def answers(applied: Array, residual: Array) -> bool:
    """Whether the input at a sample goes with what is new in the residual at that sample or up to 8 earlier.

    Both have shape (samples,). Each is prefiltered by its own autoregression first: inputs and residuals that are
    smooth correlate without any feedback (Haugh, 1976). What is new is clipped at 2.5 deviations, so that one large
    misfit at the edge of a pulse is not taken for a rule. The sum of the squared correlations is then chi-square.

    An input that stands still at most samples is a test signal, such as a pulse: a controller's moves with the noise.
    Its few edges meet the misfit of a wrong structure, which is not chance, and is not feedback either.
    """
    size = residual.size
    if size < _LEAST or not float(np.ptp(applied)) > 0.0 or not float(np.ptp(residual)) > 0.0:
        return False
    if np.count_nonzero(np.diff(applied)) < _MOVES * (size - 1):
        return False
    u, e = _new(applied), _new(residual)
    total = sum(float(u[k:] @ e[: size - k]) ** 2 / (size - k) for k in range(_LAGS))
    from scipy.special import chdtrc  # imported late: most commands start without it

    return bool(chdtrc(_LAGS, total) < _CHANCE)


def inputs_that_answer(problem: Problem, residual: Array) -> tuple[str, ...]:
    """The structure's inputs that answer the residual of an output in one of the problem's records."""
    found = []
    for name in problem.structure.inputs:
        for block in problem.blocks:
            record = problem.records[block.record]
            if answers(record.inputs[name][block.when], residual[block.rows]):
                found.append(name)
                break
    return tuple(found)


def _new(signal: Array) -> Array:
    """What the signal's own past does not tell, clipped and with standard deviation 1."""
    centred = signal - signal.mean()
    piece = pieces_of(np.arange(float(signal.size)))
    fresh = autoregression(centred, piece).whiten(centred, piece)
    usual = 1.4826 * float(np.median(np.abs(fresh)))
    fresh = np.clip(fresh, -_CLIP * usual, _CLIP * usual) if usual > 1e-3 else fresh
    return np.asarray(fresh / max(float(np.sqrt(np.mean(fresh**2))), 1e-300))
