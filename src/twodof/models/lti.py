"""Linear models: state space with an input delay, exact zero-order hold, frequency response, step figures."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import ParameterError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def check_system(a: Array, b: Array, c: Array, d: Array, where: str) -> None:
    """Raise ParameterError unless A (n, n), B (n, m), C (p, n) and D (p, m) fit together and are finite."""
    shapes = (a.shape, b.shape, c.shape, d.shape)
    if shapes != (a.shape[:1] * 2, a.shape[:1] + d.shape[1:], d.shape[:1] + a.shape[:1], d.shape) or d.ndim != 2:
        raise ParameterError(f"shapes {shapes} do not fit together", where, "give A (n,n), B (n,m), C (p,n), D (p,m)")
    if not all(np.isfinite(part).all() for part in (a, b, c, d)):
        raise ParameterError("a matrix holds NaN or infinity", where, "give finite numbers")


@dataclass(frozen=True, eq=False)
class SampledStateSpace:
    """x[k+1] = phi x[k] + old u[k-n-1] + new u[k-n]; y[k] = C x[k] + D u[k-n], or D u[k-n-1] if `split`; n: `whole`.

    The input delay is `whole` steps of `dt` [s], and a part of a step more if `split`.
    """

    phi: Array
    old: Array
    new: Array
    c: Array
    d: Array
    whole: int
    split: bool
    dt: float

    def simulate(self, u: ArrayLike, x0: ArrayLike | None = None, before: float = 0.0) -> Array:
        """Return outputs (k, p) for inputs `u` of shape (k,) or (k, m). At all earlier times the input was `before`.

        `x0` of shape (n,) is the state at sample 0 (default zero).
        """
        inputs = np.asarray(u, dtype=float)
        inputs = inputs[:, None] if inputs.ndim == 1 else inputs
        lead = np.full((self.whole + 1, inputs.shape[1]), before)
        padded = np.concatenate([lead, inputs])
        steps = inputs.shape[0]
        u_old, u_new = padded[:steps], padded[1 : steps + 1]
        drive = u_old @ self.old.T + u_new @ self.new.T
        states = np.empty((steps, self.phi.shape[0]))
        x = np.zeros(self.phi.shape[0]) if x0 is None else np.asarray(x0, dtype=float)
        for k in range(steps):
            states[k] = x
            x = self.phi @ x + drive[k]
        through = u_old if self.split else u_new
        return np.asarray(states @ self.c.T + through @ self.d.T)

    def augmented(self) -> tuple[Array, Array, Array, Array]:
        """Return the model as plain (A, B, C, D) with past inputs as states, for tools without delays."""
        n, m = self.new.shape
        past = self.whole + 1 if self.split else self.whole
        # Columns: the states, then the inputs by age, the present one first.
        step = np.zeros((n + past * m, n + (past + 1) * m))
        read = np.zeros((self.c.shape[0], step.shape[1]))
        step[:n, :n], read[:, :n] = self.phi, self.c
        step[:n, n + self.whole * m : n + (self.whole + 1) * m] = self.new
        if self.split:
            step[:n, n + past * m :] = self.old
        step[n:, n : n + past * m] = np.eye(past * m)
        read[:, n + past * m :] = self.d
        present = slice(n, n + m)
        a, c = (np.delete(matrix, present, axis=1) for matrix in (step, read))
        return a, step[:, present], c, read[:, present]


@dataclass(frozen=True, eq=False)
class DelayedStateSpace:
    """x' = A x + B u(t - delay), y = C x + D u(t - delay), in continuous time.

    Shapes: `a` (n, n), `b` (n, m), `c` (p, n), `d` (p, m); `delay` [s] is common to all inputs.
    Raises ParameterError when shapes do not fit, a number is not finite or the delay is negative.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    delay: float = 0.0

    def __post_init__(self) -> None:
        check_system(self.a, self.b, self.c, self.d, "StateSpace")
        if not (math.isfinite(self.delay) and self.delay >= 0.0):
            raise ParameterError(f"delay {self.delay} s is not a finite time >= 0", "StateSpace.delay")

    @classmethod
    def of(cls, a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike, delay: float = 0.0) -> Self:
        """Make a state space from anything array-like; a one-dimensional b is a column, c a row."""
        column = np.asarray(b, dtype=float)
        row = np.asarray(c, dtype=float)
        return cls(
            np.atleast_2d(np.asarray(a, dtype=float)),
            column.reshape(-1, 1) if column.ndim < 2 else column,
            np.atleast_2d(row),
            np.atleast_2d(np.asarray(d, dtype=float)),
            float(delay),
        )

    def poles(self) -> Complex:
        """Return the eigenvalues of A [rad/s], shape (n,)."""
        return np.linalg.eigvals(self.a).astype(np.complex128)

    def response(self, omega: ArrayLike) -> Complex:
        """Return C (j w I - A)^-1 B + D times exp(-j w delay) at `omega` [rad/s]: shape (k, p, m)."""
        w = np.atleast_1d(np.asarray(omega, dtype=float))
        late = np.exp(-1j * w * self.delay)[:, None, None]
        return np.asarray(transfer(self.a, self.b, self.c, self.d, 1j * w) * late, dtype=np.complex128)

    def zero_order_hold(self, dt: float) -> SampledStateSpace:
        """Return the exact discrete model for an input held over each `dt` [s], which need not divide the delay.

        Where the delay ends inside a step the step is split at that edge (Astrom and Wittenmark, Computer-Controlled
        Systems, section 2.3). Raises ParameterError when dt is not a positive finite time.
        """
        if not (math.isfinite(dt) and dt > 0.0):
            raise ParameterError(f"sample time {dt} s is not a finite time > 0", "zero_order_hold")
        whole = math.floor(self.delay / dt + 1e-9)
        part = self.delay - whole * dt
        # A delay that is a multiple of dt up to rounding is that multiple: no sliver of a step is split off.
        part = 0.0 if part < 1e-9 * dt else part
        phi_new, gamma_new = _held_step(self.a, self.b, dt - part)
        phi_old, gamma_old = _held_step(self.a, self.b, part)
        return SampledStateSpace(
            phi_new @ phi_old, phi_new @ gamma_old, gamma_new, self.c, self.d, whole, part > 0.0, dt
        )


def transfer(a: Array, b: Array, c: Array, d: Array, places: ArrayLike) -> Complex:
    """Return C (p - A)^-1 B + D at points p of the s plane or the z plane, (k,): shape (k, outputs, inputs)."""
    points = np.atleast_1d(np.asarray(places, dtype=np.complex128))
    drive = np.broadcast_to(b, (points.size, *b.shape)).astype(np.complex128)
    return np.asarray(c @ np.linalg.solve(points[:, None, None] * np.eye(len(a)) - a, drive) + d)


@dataclass(frozen=True)
class StepFigures:
    """Figures of a step response; times in seconds from the step, overshoot as a share of the step."""

    rise_time: float
    settling_time: float
    overshoot: float
    peak: float
    peak_time: float
    final: float


def step_figures(t: ArrayLike, y: ArrayLike, start: float, final: float, band: float = 0.02) -> StepFigures:
    """Return figures of a step response sampled at `t` [s] (0 at the step), from value `start` to `final`.

    The rise is from 10 to 90 %. Settling ends with the last sample outside +-`band` of the step. Both times are
    interpolated linearly, and NaN if the record does not reach them. Raises ParameterError if start equals final or
    shapes differ.
    """
    time, value = np.asarray(t, dtype=float), np.asarray(y, dtype=float)
    if time.shape != value.shape or time.size < 2:
        raise ParameterError(
            f"time {time.shape} and response {value.shape} differ or have under two samples", "step_figures"
        )
    if start == final:
        raise ParameterError("start and final value are equal, so this is not a step", "step_figures")
    z = (value - start) / (final - start)
    outside = np.flatnonzero(np.abs(z - 1.0) > band)
    if outside.size == 0:
        settling = float(time[0])
    elif outside[-1] == time.size - 1:
        settling = math.nan
    else:
        last = int(outside[-1])
        edge = 1.0 + math.copysign(band, z[last] - 1.0)
        settling = float(time[last] + (edge - z[last]) / (z[last + 1] - z[last]) * (time[last + 1] - time[last]))
    top = int(np.argmax(z))
    rise = float(rise_times(time, z[:, None])[0])
    return StepFigures(
        rise_time=rise if math.isfinite(rise) else math.nan,
        settling_time=settling,
        overshoot=max(0.0, float(z[top]) - 1.0),
        peak=float(value[top]),
        peak_time=float(time[top]),
        final=final,
    )


def rise_times(time: Array, shares: Array) -> Array:
    """Return the rise from 10 to 90 % [s] of responses (steps, n), as shares of the step; infinite if not reached."""

    def first(level: float) -> Array:
        reached = shares >= level
        k, column = reached.argmax(axis=0), np.arange(shares.shape[1])
        before = np.maximum(k - 1, 0)
        rise = np.where(k > 0, shares[k, column] - shares[before, column], 1.0)
        at = time[before] + (level - shares[before, column]) / rise * (time[k] - time[before])
        return np.where(reached.any(axis=0), at, np.inf)

    end = first(0.9)
    with np.errstate(invalid="ignore"):
        return np.where(np.isfinite(end), end - first(0.1), np.inf)


def _held_step(a: Array, b: Array, dt: float) -> tuple[Array, Array]:
    """Return exp(A dt) and its integral times B, from one exponential (Van Loan 1978), so that A may be singular."""
    from scipy.linalg import expm  # imported late: most commands start without it

    n, m = b.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a * dt, b * dt
    both = expm(block)
    return np.asarray(both[:n, :n]), np.asarray(both[:n, n:])
