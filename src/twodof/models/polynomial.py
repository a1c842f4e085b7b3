"""Polynomial models in the shift operator, A y = sum of B_i / F_i u_i + C / D e: ARX, ARMAX, OE and Box-Jenkins.

Ljung, System Identification, 2nd edition, section 4.2; the letters and the order of the numbers are his, and those of
MATLAB's `arx`, `armax`, `oe` and `bj`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twodof.errors import IdentificationError, is_number, shown
from twodof.models.process import process
from twodof.models.structure import Structure

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

Order = int | Sequence[int]

MOST = 100
"""Largest order, and longest delay in samples."""


@dataclass(frozen=True)
class PolynomialModel:
    """Orders of a model of one output; nb, nf and nk (the delay in samples) have a number for each input.

    A = 1 + a1 q^-1 + ... + a_na q^-na, C, D and F_i alike. B_i = b1 q^-nk + ... + b_nb q^-(nk + nb - 1). Raises
    IdentificationError for orders that are not whole numbers from 0 to `MOST`, and for a model without unknowns.
    """

    kind: str
    inputs: tuple[str, ...]
    output: str
    na: int = 0
    nb: tuple[int, ...] = ()
    nc: int = 0
    nd: int = 0
    nf: tuple[int, ...] = ()
    nk: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        each = (*self.nb, *self.nf, *self.nk)
        if not self.inputs or any(len(one) != len(self.inputs) for one in (self.nb, self.nf, self.nk)):
            raise self.error(
                "the orders of B, F and the delay do not fit the inputs", "give one number, or one an input"
            )
        if wrong := [n for n in (self.na, self.nc, self.nd, *each) if not is_number(n, 0, MOST, whole=True)]:
            raise self.error(f"the order {shown(wrong[0])}", f"give whole numbers from 0 to {MOST}")
        if not all(self.nb):
            raise self.error("an input without an effect (nb is 0)", "leave that input out, or give nb of 1 or more")

    def error(self, what: str, remedy: str = "") -> IdentificationError:
        """Return an IdentificationError that names this model as its place."""
        return IdentificationError(what, f"model '{self.name}'", remedy)

    @property
    def name(self) -> str:
        """Kind and orders as they are written: bj:2,1,1,2,1, with a slash between numbers of several inputs."""
        orders = {
            "arx": (self.na, self.nb, self.nk),
            "armax": (self.na, self.nb, self.nc, self.nk),
            "oe": (self.nb, self.nf, self.nk),
            "bj": (self.nb, self.nc, self.nd, self.nf, self.nk),
        }[self.kind]
        return f"{self.kind}:{','.join(_written(order) for order in orders)}"

    measured = ()

    @property
    def outputs(self) -> tuple[str, ...]:
        """The output, as a structure has them."""
        return (self.output,)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the unknowns in the order of their values: a1, b1, c1, d1, f1; with several inputs b1_u, f1_u."""
        return tuple(self._labels())

    def _labels(self) -> Iterator[str]:
        tails = [f"_{name}" for name in self.inputs] if len(self.inputs) > 1 else [""]
        for letter, order in (("a", self.na), ("c", self.nc), ("d", self.nd)):
            yield from (f"{letter}{i + 1}" for i in range(order))
        for letter, orders in (("b", self.nb), ("f", self.nf)):
            for tail, order in zip(tails, orders, strict=True):
                yield from (f"{letter}{i + 1}{tail}" for i in range(order))

    def polynomials(self, values: Array) -> "Polynomials":
        """Return the polynomials for the values of `labels`, each from q^0 on."""
        parts = np.split(values, np.cumsum([self.na, self.nc, self.nd, *self.nb, *self.nf])[:-1])
        a, c, d = (np.append(1.0, part) for part in parts[:3])
        m = len(self.inputs)
        b = [np.append(np.zeros(k), part) for k, part in zip(self.nk, parts[3 : 3 + m], strict=True)]
        return Polynomials(a, b, c, d, [np.append(1.0, part) for part in parts[3 + m :]])


@dataclass(frozen=True, eq=False)
class Polynomials:
    """Coefficients of q^0, q^-1, ...: `a`, `c` and `d`, and of each input `b` and `f`."""

    a: Array
    b: list[Array]
    c: Array
    d: Array
    f: list[Array]

    def transfer(self, input: int) -> tuple[Array, Array]:
        """Return B and A F of an input, made equally long: numerator and denominator in z, the highest power first."""
        bottom = np.convolve(self.a, self.f[input])
        size = max(bottom.size, self.b[input].size)
        top, bottom = (np.append(one, np.zeros(size - one.size)) for one in (self.b[input], bottom))
        return top, bottom

    def response(self, input: int, omega: ArrayLike, dt: float) -> Complex:
        """Return the frequency response from an input to the output at `omega` [rad/s], shape (k,)."""
        z = np.exp(1j * np.asarray(omega, dtype=float) * dt)
        top, bottom = self.transfer(input)
        return np.asarray(np.polyval(top, z) / np.polyval(bottom, z), dtype=np.complex128)

    def matrices(self) -> tuple[Array, Array, Array, Array]:
        """Return A (n, n), B (n, inputs), C (1, n) and D (1, inputs) of the simulation, x[k+1] = A x + B u."""
        pairs = [self.transfer(i) for i in range(len(self.b))]
        n, at = sum(bottom.size - 1 for _, bottom in pairs), 0
        a, b, c, d = np.zeros((n, n)), np.zeros((n, len(pairs))), np.zeros((1, n)), np.zeros((1, len(pairs)))
        for i, (top, bottom) in enumerate(pairs):
            own = slice(at, at + bottom.size - 1)
            a[own, own] = np.eye(bottom.size - 1, k=-1)
            a[at, own], c[0, own], d[0, i] = -bottom[1:], top[1:] - top[0] * bottom[1:], top[0]
            b[at : at + 1, i], at = 1.0, own.stop
        return a, b, c, d

    @property
    def stable(self) -> bool:
        """Return True if all poles of the simulation lie within the unit circle."""
        return all(np.abs(np.roots(np.convolve(self.a, f))).max(initial=0.0) < 1.0 for f in self.f)


def arx(na: int, nb: Order, nk: Order = 1, *, inputs: Sequence[str] = ("u",), output: str = "y") -> PolynomialModel:
    """Return A y = B u + e, a linear regression. Raises IdentificationError as `PolynomialModel`."""
    n = len(inputs)
    return PolynomialModel("arx", tuple(inputs), output, na=na, nb=_each(nb, n), nf=_each(0, n), nk=_each(nk, n))


def armax(
    na: int, nb: Order, nc: int, nk: Order = 1, *, inputs: Sequence[str] = ("u",), output: str = "y"
) -> PolynomialModel:
    """Return A y = B u + C e: disturbances enter early in the process. Raises IdentificationError."""
    n = len(inputs)
    return PolynomialModel("armax", tuple(inputs), output, na, _each(nb, n), nc, nf=_each(0, n), nk=_each(nk, n))


def oe(nb: Order, nf: Order, nk: Order = 1, *, inputs: Sequence[str] = ("u",), output: str = "y") -> PolynomialModel:
    """Return y = B / F u + e, output error: white noise of a sensor. Raises IdentificationError."""
    n = len(inputs)
    return PolynomialModel("oe", tuple(inputs), output, nb=_each(nb, n), nf=_each(nf, n), nk=_each(nk, n))


def bj(
    nb: Order, nc: int, nd: int, nf: Order, nk: Order = 1, *, inputs: Sequence[str] = ("u",), output: str = "y"
) -> PolynomialModel:
    """Return y = B / F u + C / D e, Box-Jenkins: noise with dynamics of its own. Raises IdentificationError."""
    n = len(inputs)
    return PolynomialModel("bj", tuple(inputs), output, nb=_each(nb, n), nc=nc, nd=nd, nf=_each(nf, n), nk=_each(nk, n))


def _each(order: Order, count: int) -> tuple[int, ...]:
    """Return a number for each input; one number is that of all."""
    return tuple(order) if isinstance(order, Sequence) else (order,) * count


def _written(order: int | tuple[int, ...]) -> str:
    each = order if isinstance(order, tuple) else (order,)
    return str(each[0]) if len(set(each)) == 1 else "/".join(map(str, each))


POLYNOMIALS: Mapping[str, tuple[Callable[..., PolynomialModel], str]] = MappingProxyType(
    {"arx": (arx, "na,nb,nk"), "armax": (armax, "na,nb,nc,nk"), "oe": (oe, "nb,nf,nk"), "bj": (bj, "nb,nc,nd,nf,nk")}
)
"""Kinds of polynomial models, and the order of their numbers; nk may be left out, and is then 1."""

FORMS = (*(f"{kind}:{orders}" for kind, (_, orders) in POLYNOMIALS.items()), "process:P2DZ", "subspace:ORDER")
"""How models are named that need no file."""


def is_named(name: str) -> bool:
    """Return True if `name` begins as one of `FORMS`."""
    return name.partition(":")[0] in (*POLYNOMIALS, "process", "subspace")


def model_named(name: str, inputs: Sequence[str], outputs: Sequence[str]) -> Structure | PolynomialModel:
    """Return the polynomial or process model `name` between `inputs` and `outputs`.

    nb, nf and nk of several inputs are one number, or numbers with a slash between: "arx:2,2/1,1/3". Raises
    IdentificationError for another form, for several outputs, and as `arx` and `process` do.
    """
    kind, _, rest = name.partition(":")
    if kind in POLYNOMIALS and len(outputs) == 1:
        made, orders = POLYNOMIALS[kind]
        numbers = [orders_of(order, name) for order in rest.split(",")]
        if orders.count(",") <= len(numbers) <= orders.count(",") + 1:
            return made(*numbers, inputs=inputs, output=outputs[0])
    elif kind == "process" and len(inputs) == len(outputs) == 1:
        return process(rest, input=inputs[0], output=outputs[0])
    elif kind in (*POLYNOMIALS, "process"):
        most = "one input and one output" if kind == "process" else "one output"
        raise IdentificationError(f"{kind} is a model of {most}", name, "name the columns to fit, or take subspace")
    raise IdentificationError(f"no model is called {shown(name)}", "", f"write {', '.join(FORMS)}")


def orders_of(text: str, name: str) -> Any:
    """Return a whole number, or a list of those that slashes separate. Raises IdentificationError for other text."""
    try:
        numbers = [int(one) for one in text.split("/")]
    except ValueError as error:
        raise IdentificationError(f"{shown(text)} is not an order", name, f"write {', '.join(FORMS)}") from error
    return numbers if len(numbers) > 1 else numbers[0]
