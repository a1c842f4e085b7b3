"""The root locus: the closed loop's poles over the loop's gain, branch by branch."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.design.closed_loop_poles import closed_loop_poles
from twodof.design.loop_transfer import LoopTransfer
from twodof.errors import ParameterError

Complex = NDArray[np.complex128]

MAX_GAINS = 5000


def root_locus(loop: LoopTransfer, gains: ArrayLike) -> Complex:
    """The closed loop's poles for each factor in `gains` on L, shape (k, n): column j follows one pole.

    In the z plane, or in rad/s. A pole is matched with the nearest one of the gain before. Raises ParameterError for
    no gains, one that is not finite, more than `MAX_GAINS`, and a continuous loop with a delay.
    """
    from scipy.optimize import linear_sum_assignment  # imported late: most commands start without it

    factors = np.atleast_1d(np.asarray(gains, dtype=float))
    if factors.ndim != 1 or not 0 < factors.size <= MAX_GAINS or not np.isfinite(factors).all():
        raise ParameterError(
            f"gains of shape {factors.shape} are not 1 to {MAX_GAINS} finite numbers", "root_locus", "give a list"
        )
    if loop.delay:
        raise ParameterError(
            "a loop with a continuous delay has infinitely many poles", "root_locus", "sample it with zero_order_hold"
        )
    found = np.empty((factors.size, len(loop.a)), np.complex128)
    for k, factor in enumerate(factors):
        poles = closed_loop_poles(loop.scaled(float(factor)))
        if k:
            _, order = linear_sum_assignment(np.abs(found[k - 1][:, None] - poles[None, :]))
            poles = poles[order]
        found[k] = poles
    return found
