"""PitchLoop: many members of a family, each closed with one controller, as matrices side by side."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.design.loop_transfer import LoopTransfer
from twodof.design.pitch_family import PitchMembers
from twodof.design.sampled_controller import SampledController
from twodof.errors import ParameterError
from twodof.flight.gains import Gains
from twodof.signals import PERIOD, Q_AGE

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Chunk = tuple[Array, Array, Array]

THETA, Q, ROTORS, GUST = range(4)
NO_LAG = 1e-5
"""A lag [s] that stands for none: the matrices then have the same shape for all members."""
AHEAD = 0.5 * PERIOD
"""Time [s] by which theta summed by rectangles is ahead of the integral of q."""
TILT_WALK = 6.5e-4
"""Walk of the estimated theta [rad/sqrt(s)] by the noise of accelerometer and range, on the rigs `paper` and `lab`."""
_LEAK = 1.0 - PERIOD / 2.0
"""Share of an error of theta that the estimator keeps from a sample to the next: it is corrected within 2 s."""
_CHUNK = 256  # steps between two calls of `progress`
_BLOCK = 16  # steps that are made one after the other, of all blocks of a chunk at once
_MOST_KEPT = 200_000
"""Most steps of all members together whose noise is kept for the next controller: 8 MB."""


@dataclass(frozen=True, eq=False)
class PitchLoop:
    """Loop of n members under one controller, sampled at 250 Hz as they fly.

    M is held between samples and the dead time is exact; to that of the members comes the age of q when M is computed.
    The controller reads q of the present sample and theta of the sample before, as the estimator integrates q: by
    rectangles, with q's noise. The states are theta, q, the rotors' moment and the gust, then the moments in the delay
    line, the published theta, and the states of the controller. The gust is a Gauss-Markov process with the correlation
    time `gust_time` [s], one or (n,).
    """

    members: PitchMembers
    controller: SampledController
    gust_time: float | Array = 0.1

    def under(self, controller: SampledController) -> "PitchLoop":
        """Return the same members under another controller; their own matrices are not computed again."""
        other = PitchLoop(self.members, controller, self.gust_time)
        other.__dict__["plant"] = self.plant
        return other

    @cached_property
    def plant(self) -> tuple[Array, Array]:
        """Matrices (A, b) of the plant, its delay line and the published theta: shapes (n, m, m) and (n, m)."""
        from scipy.linalg import expm  # imported late: most commands start without it

        g, n = self.members, len(self.members)
        lag = np.maximum(g.lag, NO_LAG)
        # The stand-in for no lag is taken off the dead time, so that the sum stays.
        dead = np.maximum(0.0, g.dead_time + Q_AGE - np.where(g.lag < NO_LAG, NO_LAG, 0.0))
        block = np.zeros((n, 5, 5))
        block[:, THETA, Q] = 1.0
        block[:, Q, THETA], block[:, Q, Q] = -(g.w_n**2), -2.0 * g.xi * g.w_n
        block[:, Q, ROTORS], block[:, Q, GUST] = g.mu, 1.0
        block[:, ROTORS, ROTORS], block[:, ROTORS, 4] = -1.0 / lag, 1.0 / lag
        block[:, GUST, GUST] = -1.0 / self.gust_time
        whole = np.floor(dead / PERIOD + 1e-9).astype(int)
        part = np.maximum(0.0, dead - whole * PERIOD)
        new = expm(block * (PERIOD - part)[:, None, None])
        old = expm(block * part[:, None, None])
        depth = int(whole.max()) + 1
        a, b = np.zeros((n, 5 + depth, 5 + depth)), np.zeros((n, 5 + depth))
        a[:, :4, :4] = new[:, :4, :4] @ old[:, :4, :4]
        each = np.arange(n)
        # The column of the moment of j steps ago is 3 + j; that of now is b.
        a[each, :4, 4 + whole] = (new[:, :4, :4] @ old[:, :4, 4:5])[..., 0]
        direct = whole == 0
        fresh = new[:, :4, 4]
        b[direct, :4] = fresh[direct]
        a[each[~direct], :4, 3 + whole[~direct]] = fresh[~direct]
        b[:, 4] = 1.0
        for j in range(1, depth):
            a[:, 4 + j, 3 + j] = 1.0
        a[:, 4 + depth, THETA], a[:, 4 + depth, Q] = 1.0, AHEAD
        return a, b

    @cached_property
    def _open(self) -> tuple[Array, Array, Array]:
        """Matrices (A, b, c) of the open loop, from the acting moment to M: (n, m, m), (n, m), (m,)."""
        plant, b = self.plant
        k, (n, m) = self.controller, b.shape
        size = len(k.a)
        read = np.zeros((2, m))
        read[0, m - 1], read[1, Q] = 1.0, 1.0
        a = np.zeros((n, m + size, m + size))
        a[:, :m, :m], a[:, m:, :m], a[:, m:, m:] = plant, k.b[:, 1:] @ read, k.a
        return a, np.pad(b, ((0, 0), (0, size))), np.concatenate([k.d[:, 1:] @ read, k.c], axis=1)[0]

    @cached_property
    def matrices(self) -> tuple[Array, Array, Array, Array]:
        """Matrices (A, B, C, D) of the closed loop: (n, m, m), (n, m, 3), (n, 3, m), (n, 3, 3).

        Inputs: theta_0, the noise of the theta that is read, and that of q. Outputs: the estimated theta without its
        noise, the measured q, and M.
        """
        a, b, moment = self._open
        given, (n, m) = self.controller.d[0], b.shape
        drive = b[:, :, None] * given
        drive[:, m - len(self.controller.a) :] = self.controller.b
        c, d = np.zeros((n, 3, m)), np.zeros((n, 3, 3))
        c[:, 0, THETA], c[:, 0, Q], c[:, 1, Q], c[:, 2] = 1.0, AHEAD, 1.0, moment
        d[:, 1, 2], d[:, 2] = 1.0, given
        return a + b[:, :, None] * moment, drive, c, d

    def poles(self) -> Complex:
        """Return the poles of each member in the z plane, (n, m), without the pole of the gust."""
        a = np.delete(np.delete(self.matrices[0], GUST, axis=1), GUST, axis=2)
        return np.linalg.eigvals(a).astype(np.complex128)

    def radii(self) -> Array:
        """Return the largest pole magnitude of each member, (n,), without the gust: below 1 the member is stable."""
        return np.asarray(np.abs(self.poles()).max(axis=1))

    def closed_with_moment_input(self) -> tuple[Array, Array, Array, Array]:
        """Return (A, B, C, D) of the first member's closed loop, without the gust.

        Inputs: theta_0 and a moment added to M before the delay. Outputs: theta and the controller's M.
        """
        a, drive, c, d = (part[0] for part in self.matrices)
        kept = np.delete(np.arange(len(a)), GUST)
        both = np.stack([drive[:, 0], self._open[1][0]], axis=1)
        through = np.array([[0.0, 0.0], [d[2, 0], 0.0]])
        return a[np.ix_(kept, kept)], both[kept], c[[0, 2]][:, kept], through

    def loop_transfer(self) -> LoopTransfer:
        """Return L of the first member's loop, broken at M."""
        a, b, c = self._open
        kept = np.delete(np.arange(len(c)), GUST)
        return LoopTransfer(a[0][np.ix_(kept, kept)], b[0][kept, None], -c[None, kept], 0.0, PERIOD)

    def theta_response(self, omega: Array) -> Complex:
        """Return the closed-loop response of theta to theta_0 at `omega` [rad/s], shape (n, k)."""
        a, drive, c, _ = self.matrices
        z = np.exp(1j * np.atleast_1d(omega) * PERIOD)
        whole = z[None, :, None, None] * np.eye(a.shape[1]) - a[:, None]
        inner = np.linalg.solve(whole, drive[:, None, :, :1].astype(np.complex128))
        return np.asarray((c[:, None, :1] @ inner)[..., 0, 0])

    def moment_response(self, omega: Array) -> Complex:
        """Return L of each loop, broken at M, at `omega` [rad/s], shape (n, k); the closed loop solves 1 + L = 0."""
        plant, b = self.plant
        z = np.exp(1j * np.atleast_1d(omega) * PERIOD)
        # The moments under way are a delay line; rotors and pitch are solved for by hand, for all members at once.
        ahead = b[:, :, None] + sum(plant[:, :, 4 + j, None] * z ** -(j + 1) for j in range(b.shape[1] - 5))
        rotors = ahead[:, ROTORS] / (z - plant[:, ROTORS, ROTORS, None])
        one, two = (ahead[:, i] + plant[:, i, ROTORS, None] * rotors for i in (THETA, Q))
        a = plant[:, :2, :2, None]
        determinant = (z - a[:, 0, 0]) * (z - a[:, 1, 1]) - a[:, 0, 1] * a[:, 1, 0]
        theta = ((z - a[:, 1, 1]) * one + a[:, 0, 1] * two) / determinant
        q = ((z - a[:, 0, 0]) * two + a[:, 1, 0] * one) / determinant
        back = np.stack([self.controller.response(float(w)) for w in np.atleast_1d(omega)])
        return np.asarray(-(back[:, 1] * (theta + AHEAD * q) / z + back[:, 2] * q))

    def simulate(
        self,
        theta_0: Array,
        seed: int = 1,
        gust: float | Array = 0.0,
        q_noise: float = 0.0,
        q_band: tuple[float, float] = (0.0, 0.0),
        tilt: float = 0.0,
        progress: Callable[[float], None] = lambda share: None,
    ) -> tuple[Array, Array, Array]:
        """Return theta, q and M, each (steps, n), for the set-point `theta_0` (steps,) [rad].

        Flights start from rest, with the gust already stationary. `gust` [rad/s2], one or (n,), and `q_noise` [rad/s]
        are standard deviations, `q_band` is the colour of the noise (`FittedNoise`), and `tilt` [rad/sqrt(s)] the walk
        of the estimated theta. The returned theta and q include their noise. `progress` is called with the share done
        (0 to 1). Raise ParameterError for a set-point that is empty or not finite.
        """
        goal = np.asarray(theta_0, dtype=float)
        if goal.ndim != 1 or not goal.size or not np.isfinite(goal).all():
            what = f"a set-point of shape {goal.shape} is empty, not finite or of more than one dimension"
            raise ParameterError(what, "simulate", "give finite numbers of shape (steps,)")
        a, b, c, d = self.matrices
        power = np.linalg.matrix_power(a, _BLOCK)
        n, steps = len(self.members), goal.size
        noise = _kept_noise if n * steps <= _MOST_KEPT else _noise
        first, chunks = noise(goal.tobytes(), n, seed, q_noise, q_band, tilt)
        x = np.zeros((n, a.shape[1], 1))
        x[:, GUST, 0] = gust * first
        fresh = gust * np.sqrt(1.0 - np.exp(-2.0 * PERIOD / self.gust_time))
        out = np.empty((steps, n, 3))
        for start, (given, push, after) in zip(range(0, steps, _CHUNK), chunks, strict=True):
            progress(start / steps)
            now = slice(start, start + len(after))
            drive = b @ given
            drive[:, :, GUST] += np.reshape(fresh, (-1, 1)) * push[:, :, 0]
            own = np.zeros_like(drive)
            for k in range(1, _BLOCK):
                own[k] = a @ own[k - 1] + drive[k - 1]
            ends, begins = a @ own[-1] + drive[-1], np.empty(drive.shape[1:])
            for k in range(ends.shape[-1]):
                begins[..., k : k + 1] = x
                x = power @ x + ends[..., k : k + 1]
            for part in own:
                part += begins
                begins = a @ begins
            out[now] = (c @ own + d @ given).transpose(3, 0, 1, 2).reshape(-1, n, 3)[: len(after)]
            out[now, :, 0] += after
        return out[..., 0], out[..., 1], out[..., 2]

    def after_step(self, goal: float, steps: int) -> Array:
        """Return theta, q and M (3, steps, 1) of the first member after a step to `goal` [rad], without gust and noise.

        States are doubled in number by powers of the loop's matrix: far sooner there than `simulate`.
        """
        a, b, c, d = (part[0] for part in self.matrices)
        power, states = np.eye(len(a) + 1), np.eye(1, len(a) + 1, len(a))
        power[:-1, :-1], power[:-1, -1] = a, b[:, 0] * goal
        while len(states) < steps:
            states = np.concatenate([states, states @ power.T])
            power = power @ power
        out = states[:steps, :-1] @ c.T + d[:, 0] * goal
        return np.asarray(out.T[..., None])


def _noise(
    goal: bytes, n: int, seed: int, q_noise: float, q_band: tuple[float, float], tilt: float
) -> tuple[Array, Iterable[Chunk]]:
    """Return the first gusts (n,), and for each chunk the inputs of the loop, the new gusts and the noise of theta.

    Inputs and gusts are in blocks, the noise is (k, n); gusts have variance 1. `goal` has the bytes of the set-point.
    """
    from scipy.signal import lfilter  # imported late: most commands start without it

    rng = np.random.default_rng(seed)
    first = rng.standard_normal(n)
    # The vibration is white noise through a band-pass (`rig.sensors`), of variance 1.
    size, turn, radius = np.sqrt(0.5 * (1.0 - q_band[1])), np.cos(2.0 * np.pi * q_band[0] * PERIOD), q_band[1]
    band = ([size, 0.0, -size], [1.0, -(1.0 + radius) * turn, radius])

    def chunks() -> Iterator[Chunk]:
        setpoint, kept, walked = np.frombuffer(goal), np.zeros((2, n)), np.zeros((1, n))
        for start in range(0, len(setpoint), _CHUNK):
            now = setpoint[start : start + _CHUNK]
            white, walk, push = rng.standard_normal((len(now), 3, n)).swapaxes(0, 1)
            noise, kept = lfilter(*band, white, axis=0, zi=kept) if radius > 0.0 else (white, kept)
            given = np.empty((len(noise), n, 3))
            given[:, :, 0], given[:, :, 2] = now[:, None], q_noise * noise
            moved = PERIOD * given[:, :, 2] + tilt * PERIOD**0.5 * walk
            after, _ = lfilter([1.0], [1.0, -_LEAK], moved, axis=0, zi=_LEAK * walked)
            given[:, :, 1] = np.concatenate([walked, after[:-1]])
            walked = after[-1:]
            # Blocks side by side, the last one filled up: a few large products, and not a small one for each step.
            yield _in_blocks(given), _in_blocks(push[..., None]), after

    return first, chunks()


@lru_cache(maxsize=2)
def _kept_noise(*given: Any) -> tuple[Array, Iterable[Chunk]]:
    """Return `_noise`, kept for the next controller: a slider asks for many, and half of their work would be noise."""
    first, chunks = _noise(*given)
    return first, [*chunks]


def _in_blocks(rows: Array) -> Array:
    """Return rows (k, n, i) as blocks side by side, (_BLOCK, n, i, blocks); rows of zeros fill the last one."""
    whole = np.pad(rows, ((0, -len(rows) % _BLOCK), (0, 0), (0, 0)))
    return np.ascontiguousarray(whole.reshape(-1, _BLOCK, *rows.shape[1:]).transpose(1, 2, 3, 0))


PITCH_LOOPS = ("motors", "rate", "attitude")
"""Where a loop is broken: at M with both loops closed, at q in rate mode, and at theta with the rate loop closed."""


def pitch_loops(member: PitchMembers, gains: Gains) -> dict[str, LoopTransfer]:
    """Return L at each of `PITCH_LOOPS`, sampled at 250 Hz, of the first of `member` with the stock law's `gains`."""
    plant = PitchLoop(member, SampledController.of_cascade(*gains.rate, gains.attitude))
    rate = plant.under(SampledController.of_cascade(*gains.rate, 0.0))
    inner = plant.under(SampledController.of_cascade(*gains.rate, gains.attitude, theta_loop=False))
    a, drive, _, _ = (part[0] for part in inner.matrices)
    kept = np.delete(np.arange(len(a)), GUST)
    # The theta that the attitude loop reads is the last state of the plant.
    read = np.zeros((1, len(a)))
    read[0, inner.plant[1].shape[1] - 1] = 1.0
    attitude = LoopTransfer(a[np.ix_(kept, kept)], drive[kept][:, :1], read[:, kept], 0.0, PERIOD)
    return {"motors": plant.loop_transfer(), "rate": rate.loop_transfer(), "attitude": attitude}
