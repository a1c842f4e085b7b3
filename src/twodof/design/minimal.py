"""Minimal: a loop without the states that its input does not move or its output does not show."""

import numpy as np
from numpy.typing import NDArray

from twodof.design.loop_transfer import LoopTransfer

Array = NDArray[np.float64]

_HIDDEN = 1e-10
"""A motion shown by less than this share is not shown."""

_NOTHING = 1e-11
"""A state moved by less than this share is not: roundings make 1e-14, a state that counts 1e-5 and more."""


def minimal(loop: LoopTransfer) -> LoopTransfer:
    """The same transfer in fewer states, so that what cancels exactly does not look like a crossing near frequency 0.

    The vectors b, A b, A^2 b, ... span the states that the input reaches. Arnoldi's iteration builds an orthonormal
    basis of them, vector by vector. It ends when the next vector has nothing new. The same with c for those that are
    seen. After many states that is told less sharply, so integrators that nothing shows are looked for by themselves.
    """
    basis = _reached(loop.a, loop.b[:, 0])
    a, b, c = basis.T @ loop.a @ basis, basis.T @ loop.b, loop.c @ basis
    basis = _reached(a.T, c[0])
    a, b, c = basis.T @ a @ basis, basis.T @ b, c @ basis
    still = 0.0 if loop.dt is None else 1.0
    while len(a):
        hidden = _unseen(a, c, still)
        if hidden is None:
            break
        a, b, c = hidden.T @ a @ hidden, hidden.T @ b, c @ hidden
    return LoopTransfer(a, b, c, loop.d, loop.dt, loop.delay)


def _unseen(a: Array, c: Array, pole: float) -> Array | None:
    """A basis of what is left without one motion of the pole `pole` that c does not show; None if there is none."""
    n = len(a)
    _, sizes, rows = np.linalg.svd(np.vstack([a - pole * np.eye(n), c]))
    if sizes[-1] > _HIDDEN * sizes[0]:
        return None
    return np.asarray(rows[:-1].T)  # what is orthogonal to it: A leaves its line where it is


def _reached(a: Array, start: Array) -> Array:
    """An orthonormal basis, shape (n, k), of what `a` makes of `start` in any number of steps."""
    n = len(a)
    basis = np.zeros((n, n))
    size = float(np.linalg.norm(start))
    scale = float(np.linalg.norm(a)) if n else 0.0
    new = start
    for k in range(n):
        length = float(np.linalg.norm(new))
        if length <= _NOTHING * size:
            return basis[:, :k]
        basis[:, k] = new / length
        new = a @ basis[:, k]
        size = max(float(np.linalg.norm(new)), 1e-6 * scale)
        for _ in range(2):  # once more takes away what rounding left
            new = new - basis[:, : k + 1] @ (basis[:, : k + 1].T @ new)
    return basis
