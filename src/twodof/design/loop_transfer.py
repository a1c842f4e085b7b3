"""LoopTransfer: the transfer L once around a feedback loop, as matrices, sampled or continuous with a delay."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.compile.linear.linear_model import LinearModel, python_control, without_dots
from twodof.errors import ParameterError, nearest, shown
from twodof.models.lti import DelayedStateSpace, SampledStateSpace

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MAX_STATES = 600
"""Largest number of states of a loop; with more the searches take minutes."""


@dataclass(frozen=True, eq=False)
class LoopTransfer:
    """L of a loop with negative feedback, of one input and one output: the closed loop is L / (1 + L).

    `a` (n, n), `b` (n, 1), `c` (1, n), `d` a number. With `dt` None it is C (s - A)^-1 B + D behind `delay` [s]. With a
    sample time `dt` [s] it is C (z - A)^-1 B + D, and delays are states. Raises ParameterError for shapes that do not
    fit, numbers that are not finite and more than `MAX_STATES` states. It refuses `delay` in a sampled loop. It refuses
    a delay around a direct path D too: such a loop has infinitely many poles that do not die out.

    `name`, `input` and `output` are the names of the loop and its signals, for python-control.
    """

    a: Array
    b: Array
    c: Array
    d: float
    dt: float | None = None
    delay: float = 0.0
    name: str = "loop"
    input: str = "u"
    output: str = "y"

    def __post_init__(self) -> None:
        if not all(isinstance(part, np.ndarray) and part.ndim == 2 for part in (self.a, self.b, self.c)):
            raise _error("a, b and c are not all matrices", "give arrays, or a model to LoopTransfer.of")
        n, shapes = len(self.a), tuple(part.shape for part in (self.a, self.b, self.c))
        if shapes != ((n, n), (n, 1), (1, n)):
            raise _error(f"shapes {shapes} are not a loop of one input and one output", "give (n,n), (n,1), (1,n)")
        if n > MAX_STATES:
            raise _error(f"{n} states are over {MAX_STATES}", "shorten the delays, or sample more slowly")
        if not all(np.isfinite(part).all() for part in (self.a, self.b, self.c, self.d)):
            raise _error("a matrix holds NaN or infinity", "give finite numbers")
        if not 0.0 < (1.0 if self.dt is None else self.dt) < math.inf or not 0.0 <= self.delay < math.inf:
            what = f"a sample time of {self.dt} s or a delay of {self.delay} s cannot be"
            raise _error(what, "give a finite sample time > 0, or None if continuous, and a finite delay >= 0")
        if self.delay and self.dt is not None:
            raise _error("a sampled loop cannot have a `delay`", "make it states: DelayedStateSpace.zero_order_hold")
        if self.delay and self.d:
            what = "a delay around a direct path D gives infinitely many poles that do not die out"
            raise _error(what, "add a lag, however fast, or sample the loop with zero_order_hold")

    @classmethod
    def of(cls, model: Any, source: int | str = 0, to: int | str | None = None, negate: bool = False) -> Self:
        """Return the loop from input `source` of a model to its output `to` (default: that of the same name or index).

        `model` is a LinearModel, DelayedStateSpace, SampledStateSpace or another loop. `negate` turns the sign, for a
        model that was cut out of a closed loop and contains the minus of the feedback. Raises ParameterError for
        another type and an unknown name.
        """
        inputs: tuple[str, ...] = ()
        outputs: tuple[str, ...] = ()
        name = getattr(model, "name", "loop")
        if isinstance(model, LoopTransfer):
            a, b, c, d, dt, delay = model.a, model.b, model.c, np.array([[model.d]]), model.dt, model.delay
            inputs, outputs = (model.input,), (model.output,)
        elif isinstance(model, LinearModel):
            a, b, c, d, dt, delay = model.a, model.b, model.c, model.d, model.dt, 0.0
            inputs, outputs = model.inputs, model.outputs
        elif isinstance(model, DelayedStateSpace):
            a, b, c, d, dt, delay = model.a, model.b, model.c, model.d, None, model.delay
        elif isinstance(model, SampledStateSpace):
            (a, b, c, d), dt, delay = model.augmented(), model.dt, 0.0
        else:
            remedy = "give a LinearModel, LoopTransfer.from_control(system) for python-control, or estimate.linear(dt)"
            raise _error(f"{type(model).__name__} is not a linear model", remedy)
        i = _place(source, inputs, b.shape[1], "input")
        j = _place(source if to is None else to, outputs, c.shape[0], "output")
        sign = -1.0 if negate else 1.0
        names = (name, inputs[i] if inputs else "u", outputs[j] if outputs else "y")
        return cls(a, b[:, i : i + 1], sign * c[j : j + 1], sign * float(d[j, i]), dt, delay, *names)

    @classmethod
    def of_gain(cls, gain: float, dt: float | None = None) -> Self:
        """Return a loop that is a number alone."""
        return cls(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), float(gain), dt)

    def __repr__(self) -> str:
        time = "continuous" if self.dt is None else f"sampled every {self.dt:g} s"
        return f"<LoopTransfer of {len(self.a)} states, {time}, delay {self.delay:g} s>"

    def times(self, other: "LoopTransfer") -> "LoopTransfer":
        """Return the product of both loops, with the signal through `other` first: `controller.times(plant)`.

        Raises ParameterError for different sample times.
        """
        if self.dt != other.dt:
            raise _error(f"sample times {self.dt} and {other.dt} s differ", "sample both alike")
        n, m = len(self.a), len(other.a)
        a = np.block([[self.a, self.b @ other.c], [np.zeros((m, n)), other.a]])
        b, c = np.vstack([self.b * other.d, other.b]), np.hstack([self.c, self.d * other.c])
        delay = self.delay + other.delay
        return LoopTransfer(a, b, c, self.d * other.d, self.dt, delay, input=other.input, output=self.output)

    def scaled(self, factor: float) -> "LoopTransfer":
        """Return the loop with `factor` times the gain."""
        return replace(self, c=factor * self.c, d=factor * self.d)

    def balanced(self) -> "LoopTransfer":
        """Return the same loop with states of similar size, which makes eigenvalues more accurate."""
        from scipy.linalg import matrix_balance  # imported late: most commands start without it

        n = len(self.a)
        whole = np.block([[self.a, self.b], [self.c, np.zeros((1, 1))]])
        even, _ = matrix_balance(whole, permute=False)
        return replace(self, a=even[:n, :n], b=even[:n, n:], c=even[n:, :n])

    def response(self, omega: ArrayLike) -> Complex:
        """Return L at the frequencies `omega` [rad/s], shape (k,)."""
        w = np.atleast_1d(np.asarray(omega, dtype=float))
        return self.at(1j * w if self.dt is None else np.exp(1j * w * self.dt))

    def at(self, place: ArrayLike) -> Complex:
        """Return L at points of the s plane, of the z plane if sampled, shape (k,); infinite at the poles of L."""
        s = np.atleast_1d(np.asarray(place, dtype=np.complex128))
        if len(self.a):
            n = len(self.a)
            found = np.empty(s.size, np.complex128)
            few = max(1, 2_000_000 // n**2)  # points at a time: 32 MB
            for k in range(0, s.size, few):
                part = s[k : k + few]
                b = np.broadcast_to(self.b, (part.size, n, 1)).astype(np.complex128)
                inner = _solved(part[:, None, None] * np.eye(n) - self.a, b)
                pole = ~np.isfinite(inner).all(axis=(1, 2))
                inner[pole] = 0.0
                found[k : k + few] = np.where(pole, np.inf, (self.c @ inner)[:, 0, 0] + self.d)
        else:
            found = np.full(s.size, self.d, np.complex128)
        if self.delay:
            finite = np.isfinite(found)
            found[finite] *= np.exp(-s[finite] * self.delay)
        return found

    def poles(self) -> Complex:
        """Return the open loop's poles: in the z plane, or in rad/s, shape (n,)."""
        return np.linalg.eigvals(self.a).astype(np.complex128)

    @classmethod
    def from_control(cls, system: Any) -> Self:
        """Return the loop that a system of python-control describes; see `LinearModel.from_control`.

        Raises ParameterError for a system of several inputs or outputs.
        """
        model = LinearModel.from_control(system)
        if (len(model.inputs), len(model.outputs)) != (1, 1):
            what = f"a system of {len(model.inputs)} inputs and {len(model.outputs)} outputs is not one loop"
            raise _error(what, "give one of its elements: system[0, 0]")
        return cls.of(model)

    def to_control(self, omega: ArrayLike | None = None) -> Any:
        """Return L as python-control's FrequencyResponseData, for `control.margin`, `bode_plot` and `feedback`.

        `omega` [rad/s] defaults to 2,000 frequencies around all poles and the crossover. python-control computes
        margins of a state space from polynomials, which are wrong for loops of some 20 states or more; `state_space`
        gives that form. The result of `feedback` has no name, which `bode_plot` needs:
        `control.frd(control.feedback(loop), name="closed")`. Raises CompileError if python-control is not installed.
        """
        if omega is None:
            poles = self.poles()  # at z = 0 are delays
            sizes = np.abs(poles if self.dt is None else np.log(poles[poles != 0.0]) / self.dt)
            top = math.pi / self.dt if self.dt else 1e3 * max(sizes, default=1.0) or 1.0
            low = 1e-2 * min(sizes[(sizes > 1e-6 * top) & (sizes < top)], default=top)

            def size(omega: float) -> float:
                return float(abs(self.response(omega)[0]))

            # Integrators and a high gain cross over far from the poles.
            while self.dt is None and top < 1e12 and size(top) > 0.1 and size(10.0 * top) < 0.5 * size(top):
                top *= 10.0
            while low > 1e-12 and size(low) < 10.0 and size(0.1 * low) > 2.0 * size(low):
                low *= 0.1
            omega = np.geomspace(low, max(top, 10.0 * low, 10.0 / self.delay if self.delay else 0.0), 2000)
        w = np.atleast_1d(np.asarray(omega, dtype=float))
        signals = {"inputs": without_dots([self.input]), "outputs": without_dots([self.output])}
        (name,) = without_dots([self.name])
        return python_control().frd(self.response(w), w, dt=self.dt or 0, name=name, **signals)

    def state_space(self) -> Any:
        """Return the loop as python-control's StateSpace.

        Raises CompileError if python-control is not installed, and ParameterError for a continuous loop with a delay.
        """
        if self.delay:
            raise _error("python-control has no delays in continuous time", "sample it with zero_order_hold first")
        names = tuple(f"x{i}" for i in range(len(self.a)))
        d, signals = np.array([[self.d]]), ((self.input,), (self.output,))
        return LinearModel(self.a, self.b, self.c, d, self.dt, names, *signals, name=self.name).to_control()


def _solved(matrices: Complex, b: Complex) -> Complex:
    """Return the solutions for a stack of matrices, infinite for singular ones."""
    try:
        return np.array(np.linalg.solve(matrices, b))
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full_like(b, np.inf)
        half = len(matrices) // 2
        return np.concatenate([_solved(matrices[:half], b[:half]), _solved(matrices[half:], b[half:])])


def _place(name: int | str, names: Sequence[str], count: int, what: str) -> int:
    if isinstance(name, str) and name in names:
        return names.index(name)
    if isinstance(name, str) or not 0 <= name < count:
        known = f": {nearest(name, names)}" if isinstance(name, str) and names else ", from 0 on"
        raise _error(f"no {what} {shown(name)}", f"there are {count}{known}")
    return name


def _error(what: str, remedy: str) -> ParameterError:
    return ParameterError(what, "LoopTransfer", remedy)


_HIDDEN = 1e-10
"""Share in the output below which the motion of a state counts as not shown."""

_NOTHING = 1e-11
"""Share below which a state counts as not reached: roundings make 1e-14, a state that counts 1e-5 and more."""


def minimal(loop: LoopTransfer) -> LoopTransfer:
    """Return the transfer without states that cancel exactly: they would look like a crossing near frequency 0.

    The vectors b, A b, A^2 b, ... span the states that the input reaches. Arnoldi's iteration builds an orthonormal
    basis of them, vector by vector, and ends when the next vector adds nothing. The same iteration with c finds the
    states that the output shows. It is less sharp for many states, so unseen integrators are removed separately.
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
    """Return a basis without one motion of the pole `pole` that c does not show; None if there is none."""
    n = len(a)
    _, sizes, rows = np.linalg.svd(np.vstack([a - pole * np.eye(n), c]))
    if sizes[-1] > _HIDDEN * sizes[0]:
        return None
    return np.asarray(rows[:-1].T)  # what is orthogonal to it: A leaves its line where it is


def _reached(a: Array, start: Array) -> Array:
    """Return an orthonormal basis, shape (n, k), of the space that `a` reaches from `start` in any number of steps."""
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
