"""A linear model of any record without a first guess, by subspaces: start values for a fit, and an order.

PO-MOESP (Verhaegen, Identification of the deterministic part of MIMO state space models given in innovations form,
Automatica 30, 1994; Van Overschee and De Moor, Subspace Identification for Linear Systems, 1996, chapter 4): what the
past tells of the future outputs beyond the future inputs spans the observability matrix. B, D, the initial state and
the outputs' offsets then follow by linear least squares of the simulation error.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twodof.errors import IdentificationError, is_number, shown
from twodof.identify.record import Record, check_record
from twodof.models.polynomial import orders_of
from twodof.models.structure import MAX_STATES, Entry, Structure, linear_model

Array = NDArray[np.float64]

_SLOWEST, _FASTEST = 1e-6, 1e-3


@dataclass(frozen=True, eq=False)
class SubspaceModel:
    """x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k] + bias, from x0; sampled with `dt` [s].

    Shapes: `a` (n, n), `b` (n, m), `c` (p, n), `d` (p, m), `x0` (n,), `bias` (p,). `singular_values` are those among
    which the order was chosen: the n large ones are the model, the others noise.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    dt: float
    a: Array
    b: Array
    c: Array
    d: Array
    x0: Array
    bias: Array
    singular_values: Array

    @property
    def order(self) -> int:
        """The number of states."""
        return int(self.a.shape[0])

    def simulate(self, u: Array) -> Array:
        """Return the outputs (k, p) for the inputs (k, m)."""
        drive = u @ self.b.T
        states = np.empty((u.shape[0], self.order))
        x = self.x0
        for k in range(u.shape[0]):
            states[k] = x
            x = self.a @ x + drive[k]
        return np.asarray(states @ self.c.T + u @ self.d.T + self.bias)

    def poles(self) -> NDArray[np.complex128]:
        """Poles in continuous time [rad/s], for held inputs; a pole at or below 0 in discrete time counts as fast."""
        z = np.linalg.eigvals(self.a).astype(np.complex128)
        real = np.abs(z.imag) <= 1e-9 * np.abs(z)
        z[real] = np.maximum(z[real].real, _FASTEST)
        return np.asarray(np.log(z) / self.dt)

    def structure(self, feed_through: bool = False, name: str = "subspace") -> Structure:
        """Return this model in continuous time as a structure to `fit`, with as many unknowns as data can show.

        Each pair of poles is x1' = x2 + b u, x2' = -stiffness x1 - damping x2 + b u, each real pole x' = -rate x + b u.
        The output in which it shows most reads x1 itself. All else is unknown: B, the rest of C, with `feed_through` D.
        The initial states and the outputs' biases are estimated too. Raises IdentificationError for poles that are
        equal, which this form does not have.
        """
        return _modal(self, feed_through, name)


def subspace(record: Record, *, order: int | None = None, feed_through: bool = False) -> SubspaceModel:
    """Return a linear model of `record` between its inputs, taken as held, and its outputs.

    `order`: the number of states, by default that before the largest gap between singular values. 10 to 30 samples
    before and after each one are looked at, by the record's length, and the order is at most half of that.
    `feed_through`: whether D is estimated.
    Raises IdentificationError for outputs that are not sampled at each step, for a record that is too short, and for an
    input that does not excite the model enough.
    """
    check_record(record)
    where = f"record '{record.name}'"
    ins, outs = tuple(record.inputs), tuple(record.outputs)
    for one in outs:
        if not (record.outputs[one].on_grid and record.outputs[one].value.size == record.steps):
            raise IdentificationError(
                "the output is not sampled at each step", f"{where}, output '{one}'", "resample the table first"
            )
    u = np.column_stack([record.inputs[one] for one in ins])
    y = np.column_stack([record.outputs[one].value for one in outs])
    steps, m, p = u.shape[0], u.shape[1], y.shape[1]
    most = (steps + 1) // (2 * (m + p) + 2)
    reach = min(max(10, steps // 50), 30, most)
    if reach < 2:
        raise record.error(f"{steps} samples are too few", "record more")
    largest = min(MAX_STATES, reach - 1)
    if order is not None and not is_number(order, 1, largest, whole=True):
        raise record.error(f"the order {shown(order)}", f"give 1 to {largest}, or a longer record")
    # Each signal in its own size: the singular values then weigh outputs alike.
    size_u, size_y = u.std(axis=0), y.std(axis=0)
    if still := [name for name, size in zip((*ins, *outs), (*size_u, *size_y), strict=True) if size == 0.0]:
        raise record.error(f"'{still[0]}' is constant", "choose another window")
    basis, values = _observability((u - u.mean(axis=0)) / size_u, (y - y.mean(axis=0)) / size_y, reach, where)
    if order is None:
        kept = values[: max(2, min(reach // 2, MAX_STATES) + 1)]
        order = int(np.argmax(kept[:-1] / np.maximum(kept[1:], 1e-14 * kept[0]))) + 1
    gamma = basis[:, :order]
    c = gamma[:p] * size_y[:, None]
    a = _stable(np.asarray(np.linalg.lstsq(gamma[:-p], gamma[p:], rcond=None)[0], dtype=float))
    b, d, x0, bias = _rest(a, c, u, y, size_y, feed_through)
    return SubspaceModel(ins, outs, record.dt, a, b, c, d, x0, bias, values)


def subspace_named(name: str, record: Record) -> Structure:
    """Return the structure of "subspace" or "subspace:4" between all channels of `record`, with its first guess.

    Raises IdentificationError as `subspace`, and for an order that is not an integer.
    """
    order = name.partition(":")[2]
    return subspace(record, order=orders_of(order, name) if order else None).structure()


def _observability(u: Array, y: Array, reach: int, where: str) -> tuple[Array, Array]:
    """Left singular vectors and singular values of what the past tells of the future."""
    columns = u.shape[0] - 2 * reach + 1

    def hankel(signal: Array, first: int) -> Array:
        rows = [signal[first + i : first + i + columns] for i in range(reach)]
        return np.concatenate(rows, axis=1)

    # A constant among the future inputs: the offsets of outputs would be a state with a pole at 1 otherwise.
    constant = np.ones((columns, 1))
    stacked = np.hstack([constant, hankel(u, reach), hankel(u, 0), hankel(y, 0), hankel(y, reach)])
    lower = np.transpose(np.asarray(np.linalg.qr(stacked, mode="r")))
    future, past = 1 + reach * u.shape[1], reach * (u.shape[1] + y.shape[1])
    told = np.linalg.svd(lower[1:future, 1:future], compute_uv=False)
    if told[-1] <= 1e-9 * told[0]:
        raise IdentificationError(f"the inputs do not excite a model of {reach} samples", where, "use a richer input")
    vectors, values, _ = np.linalg.svd(lower[future + past :, future : future + past])
    return np.asarray(vectors), np.asarray(values)


def _stable(a: Array) -> Array:
    """Return the same modes, growing ones turned into decaying ones of the same rate."""
    z, v = np.linalg.eig(a)
    if (np.abs(z) <= 1.0).all():
        return a
    z = np.where(np.abs(z) > 1.0, z / np.abs(z) ** 2, z)
    return np.asarray(np.real(v @ np.diag(z) @ np.linalg.inv(v)))


def _rest(
    a: Array, c: Array, u: Array, y: Array, size_y: Array, feed_through: bool
) -> tuple[Array, Array, Array, Array]:
    """B, D, x0 and bias by linear least squares: the output is linear in them."""
    (steps, m), p, n = u.shape, y.shape[1], a.shape[0]
    # Step k: the states' response to an impulse in each state at step 0, and to each input through each state.
    entering = np.zeros((steps, n, n + n * m))
    entering[:, :, n:] = (u[:, None, :, None] * np.eye(n)[None, :, None, :]).reshape(steps, n, n * m)
    states = np.empty_like(entering)
    now = np.eye(n, n + n * m)
    for k in range(steps):
        states[k] = now
        now = a @ now + entering[k]
    count = n + n * m + (p * m if feed_through else 0) + p
    rows = np.zeros((p, steps, count))
    for i in range(p):
        rows[i, :, : n + n * m] = c[i] @ states
        if feed_through:
            rows[i, :, n + n * m + i * m : n + n * m + (i + 1) * m] = u
        rows[i, :, count - p + i] = 1.0
    weighted = (rows / size_y[:, None, None]).reshape(p * steps, count)
    found = np.asarray(np.linalg.lstsq(weighted, (y / size_y).T.reshape(-1), rcond=None)[0], dtype=float)
    b = found[n : n + n * m].reshape(m, n).T
    d = found[n + n * m : count - p].reshape(p, m) if feed_through else np.zeros((p, m))
    return b, d, found[:n], found[count - p :]


def _modal(model: SubspaceModel, feed_through: bool, name: str) -> Structure:
    """Return the structure of real blocks: each one's first state is its part of the output in which it shows most."""
    z, v = np.linalg.eig(model.a)
    if np.linalg.cond(v) > 1e8:
        raise IdentificationError("two poles are equal", f"structure '{name}'", "choose another order")
    left, read = np.linalg.inv(v), model.c @ v
    m, p, n = len(model.inputs), len(model.outputs), model.order
    size = np.maximum(np.abs(model.c).max(axis=1), 1e-300)
    poles = np.log(np.where(z.imag != 0.0, z, np.maximum(z.real, _FASTEST)).astype(complex)) / model.dt
    # From the input held over a step to the input in continuous time, mode by mode.
    fast = np.abs(poles) * model.dt > _SLOWEST
    drive = np.where(fast, poles / np.where(fast, np.expm1(poles * model.dt), 1.0), 1.0 / model.dt)
    a: list[list[Entry]] = [[0.0] * n for _ in range(n)]
    guess: dict[str, float] = {}
    rows: list[Array] = []
    shown: dict[int, int] = {}
    for i in np.flatnonzero(z.imag >= 0.0).tolist():
        at, pair = len(rows), z[i].imag > 0.0
        main = int(np.argmax(np.abs(read[:, i]) / size))
        shown[at] = main
        row = (2.0 if pair else 1.0) * read[main, i] * left[i]
        rows.append(row)
        if pair:
            rows.append(row * poles[i])
            shown[at + 1] = main
            a[at][at + 1] = 1.0
            a[at + 1][at], a[at + 1][at + 1] = f"-stiffness{at + 1}", f"-damping{at + 1}"
            guess[f"stiffness{at + 1}"], guess[f"damping{at + 1}"] = abs(poles[i]) ** 2, -2.0 * poles[i].real
        else:
            a[at][at] = f"-rate{at + 1}"
            guess[f"rate{at + 1}"] = -poles[i].real
    turned = np.array(rows).real
    driven, started = turned @ (v * drive @ left @ model.b).real, turned @ model.x0
    seen = np.linalg.solve(turned.T, model.c.T).T
    b = [[f"b{i + 1}_{one}" for one in model.inputs] for i in range(n)]
    guess |= {b[i][k]: float(driven[i, k]) for i in range(n) for k in range(m)}
    c: list[list[Entry]] = [[f"c_{o}_{i + 1}" for i in range(n)] for o in model.outputs]
    guess |= {f"c_{o}_{i + 1}": float(seen[k, i]) for k, o in enumerate(model.outputs) for i in range(n)}
    for i, main in shown.items():
        del guess[f"c_{model.outputs[main]}_{i + 1}"]
        c[main][i] = 1.0 if i == 0 or a[i - 1][i] != 1.0 else 0.0
    d: list[list[Entry]] | None = None
    if feed_through:
        d = [[f"d_{o}_{one}" for one in model.inputs] for o in model.outputs]
        guess |= {str(d[i][k]): float(model.d[i, k]) for i in range(p) for k in range(m)}
    made = linear_model(a, b, c, d, inputs=model.inputs, outputs=model.outputs, guess=guess, name=name)
    biases = {f"{o}_bias": float(model.bias[i]) for i, o in enumerate(model.outputs)}
    made = made.with_guess(**{f"x{i + 1}_0": float(started[i]) for i in range(n)}, **biases)
    scale = _scales(guess) | {f"{o}_bias": float(size[i]) for i, o in enumerate(model.outputs)}
    return Structure(made.diagram, (*made.estimate, *biases), made.local, scale)


def _scales(guess: dict[str, float]) -> dict[str, float]:
    """Return scales for the unknowns: the size of the guess, at least a hundredth of the largest of its kind."""
    found: dict[str, float] = {}
    for kind in ("b", "c_", "d_", "stiffness", "damping", "rate"):
        own = {name: abs(value) for name, value in guess.items() if name.startswith(kind)}
        found |= {name: max(size, 0.01 * max(own.values())) or 1.0 for name, size in own.items()}
    return found
