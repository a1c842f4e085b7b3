"""Linear model of a diagram at a point: A, B, C, D with names."""

import importlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import CompileError, listed

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def python_control() -> Any:
    """Return the package python-control. Raises CompileError if it is not installed."""
    try:
        return importlib.import_module("control")
    except ImportError as error:
        remedy = "install it where twodof is: pip install control"
        raise CompileError("python-control is not installed", "python-control", remedy) from error


def without_dots(names: Iterable[str]) -> list[str]:
    """Return names for python-control, where a dot separates the name of a system from that of its signal."""
    return [name.replace(".", "_") for name in names]


@dataclass(frozen=True, eq=False)
class LinearModel:
    """x' = A x + B u, y = C x + D u, in deviations from a point; x' is x[k + 1], or dx/dt if `dt` is None.

    Shapes: `a` (n, n), `b` (n, m), `c` (p, n), `d` (p, m). `states`, `inputs` and `outputs` name the rows and columns
    by paths. There `[i]` is an element of an array and `[k-i]` the sample of i steps ago in a delay. `point` has the
    values of states and inputs at the point, `output_values` those of the outputs. `left_out` has the reason for each
    state of the diagram that is not in the model. `remarks` describe each input without effect on any output at the
    point, each output without an influence, and each integer or bool state that only `at` holds.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    dt: float | None
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    point: Mapping[str, float] = field(default_factory=dict)
    output_values: Mapping[str, float] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    name: str = "diagram"
    remarks: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        time = "continuous" if self.dt is None else f"dt {self.dt:g} s"
        signals = f"{listed(self.inputs)} -> {listed(self.outputs)}"
        return f"<LinearModel {self.name}: {len(self.states)} states, {time}, {signals}>"

    def poles(self) -> Complex:
        """Return the eigenvalues of A, shape (n,): in the z plane, or in rad/s if `dt` is None."""
        return np.linalg.eigvals(self.a).astype(np.complex128)

    def response(self, omega: ArrayLike) -> Complex:
        """Return C (s - A)^-1 B + D at `omega` [rad/s], s = j omega or exp(j omega dt), of shape (k, p, m)."""
        w = np.atleast_1d(np.asarray(omega, dtype=np.float64))
        s = 1j * w if self.dt is None else np.exp(1j * w * self.dt)
        resolvent = s[:, None, None] * np.eye(len(self.a)) - self.a
        inner = np.linalg.solve(resolvent, np.broadcast_to(self.b, (w.size, *self.b.shape)).astype(np.complex128))
        return np.asarray(self.c @ inner + self.d, dtype=np.complex128)

    @classmethod
    def from_control(cls, system: Any) -> Self:
        """Return the model that a StateSpace or TransferFunction of python-control describes, with the same names.

        Raises CompileError if python-control is not installed, and for a system of another type, without a sample
        time, or that is improper.
        """
        control = python_control()
        if not isinstance(system, control.StateSpace | control.TransferFunction) or system.dt is True:
            what = f"{type(system).__name__} of sample time {getattr(system, 'dt', None)} is not a linear model"
            remedy = "give a StateSpace or a TransferFunction; its sample time is 0 or a number of seconds"
            raise CompileError(what, "from_control", remedy)
        try:
            s = control.ss(system)
        except ValueError as reason:
            remedy = "give a proper transfer function: its numerator's degree is at most that of the denominator"
            raise CompileError(f"it has no state space: {reason}", "from_control", remedy) from None
        names = (tuple(s.state_labels), tuple(s.input_labels), tuple(s.output_labels))
        return cls(s.A, s.B, s.C, s.D, s.dt or None, *names, name=s.name)

    def to_control(self) -> Any:
        """Return the model as python-control's StateSpace, with the same names, `_` for each dot in them.

        Raises CompileError if python-control is not installed.
        """
        control = python_control()
        named = {what: without_dots(getattr(self, what)) for what in ("states", "inputs", "outputs")}
        (name,) = without_dots([self.name])
        dt = 0 if self.dt is None else self.dt
        return control.StateSpace(self.a, self.b, self.c, self.d, dt, **named, name=name, remove_useless_states=False)

    @classmethod
    def from_json(cls, document: Any, where: str) -> Self:
        """Return the model of `to_json`, without its point. Raises CompileError for anything else."""
        try:
            a, b, c, d = (np.array(document[key], dtype=float) for key in "ABCD")
            names = [tuple(map(str, document[key])) for key in ("states", "inputs", "outputs")]
            n, m, p = map(len, names)
            # An empty matrix has lost its shape.
            a, b, c, d = a.reshape(n, n), b.reshape(n, m), c.reshape(p, n), d.reshape(p, m)
            dt = None if document["dt"] is None else float(document["dt"])
        except (TypeError, KeyError, ValueError) as error:
            raise CompileError("it holds no linear model", where, "write it with `twodof identify --out`") from error
        return cls(a, b, c, d, dt, names[0], names[1], names[2], name=str(document.get("name", "model")))

    def to_json(self) -> dict[str, Any]:
        """Return plain data: names, point, matrices as lists of rows and poles as [real, imaginary]."""
        return {
            "name": self.name,
            "dt": self.dt,
            "states": list(self.states),
            "inputs": list(self.inputs),
            "outputs": list(self.outputs),
            "A": self.a.tolist(),
            "B": self.b.tolist(),
            "C": self.c.tolist(),
            "D": self.d.tolist(),
            "poles": [[float(p.real), float(p.imag)] for p in self.poles()],
            "point": dict(self.point),
            "output_values": dict(self.output_values),
            "left_out": dict(self.left_out),
            "remarks": dict(self.remarks),
        }
