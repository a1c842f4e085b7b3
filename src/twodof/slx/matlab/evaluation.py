"""Bounds of a run of MATLAB code, and MATLAB's own operators and functions within them.

Nothing opens a file, calls a program or shows anything, and each run ends: after `MOST_STEPS` operations at most, and
with arrays of at most `MOST_ELEMENTS`.

Values are numpy arrays of two dimensions (float64, float32, whole numbers, bool; objects where they hold signals),
`str` for text, `dict` for a structure and `list` for a cell array.
"""

import io
import math
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twodof.blocks.expressions.arrays import fold
from twodof.blocks.expressions.expr import convert, where
from twodof.blocks.expressions.numbers import STORED
from twodof.errors import LogError
from twodof.flightlog import fence
from twodof.slx.matlab.signals import OPERATORS as SIGNAL_OPERATORS
from twodof.slx.matlab.signals import SIGNAL_FUNCTIONS, of_signals
from twodof.slx.matlab.values import (
    FUNCTIONS,
    MOST_ELEMENTS,
    OPERATORS,
    Array,
    Cells,
    NotComputed,
    String,
    Value,
    as_array,
    bounded,
    class_of,
    filled,
    is_signal,
    lifted,
    lowered,
    number,
    numeric,
)

MOST_STEPS = 50_000
PRODUCTS_A_STEP = 50_000
"""Rows by columns by the fewer of both that a matrix may have to count as one operation: inv(m) takes about as many."""
MOST_ON_SIGNALS = 200_000
"""Most operations on elements of signals: each becomes one of the program."""


def script_text(data: bytes, where: str) -> fence.Answer:
    """Return the text of a script, behind the fence."""
    try:
        return data.decode("utf-8-sig"), []
    except UnicodeDecodeError:
        return data.decode("latin-1"), []


def table_values(data: bytes, where: str) -> fence.Answer:
    """Return the numbers of a table (.csv) behind the fence, without its head; NaN for what is no number."""
    try:
        rows = np.genfromtxt(io.StringIO(script_text(data, where)[0]), delimiter=",", loose=True, ndmin=2)
    except ValueError:
        raise LogError("its rows have different numbers of columns", where, "make them alike") from None
    rows = rows[1:] if rows.size and np.isnan(rows[0]).all() else rows
    return list(rows.shape), [rows.astype(float).flatten()]


def data_of(path: Path) -> Value:
    """Return the values of a .mat file as a structure, or the numbers of a .csv file."""
    if path.suffix == ".mat":
        return recorded(path)[0]
    shape, (found,) = fence.read(table_values, path)
    return found.reshape(shape)


def recorded(path: Path) -> tuple[dict[str, Value], list[tuple[str, str]]]:
    """Return the values of a .mat file, and the names that are left out with the reasons."""
    plain, arrays = fence.read(mat_values, path)
    left = list(arrays)

    def value(said: Any) -> Value:
        if isinstance(said, dict):
            if "" in said:
                return Cells([[value(one) for one in row] for row in said[""]])
            return {name: value(one) for name, one in said.items()}
        return said if isinstance(said, str) else left[said[0]].reshape(said[1]).astype(said[2])

    return {name: value(said) for name, said in plain["values"].items()}, plain["skipped"]


def mat_values(data: bytes, where: str) -> fence.Answer:
    """Return what a .mat file holds, behind the fence: arrays apart, texts, structures and cell arrays by name."""
    from scipy.io import loadmat  # imported late, in the fence: the server starts without it

    arrays: list[Array] = []
    skipped: list[tuple[str, str]] = []

    def plain(name: str, value: Any) -> Any:
        if isinstance(value, np.ndarray) and value.dtype.names and value.size == 1:
            return {field: plain(f"{name}.{field}", value[field].flat[0]) for field in value.dtype.names}
        if isinstance(value, np.ndarray) and value.dtype.kind == "U" and value.size == 1:
            return str(value.flat[0])
        if isinstance(value, np.ndarray) and value.dtype == object and value.ndim == 2:
            return {"": [[plain(name, one) for one in row] for row in value]}
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub" or value.ndim != 2:
            skipped.append((name, "is not a number, a text or a structure"))
            return ""
        arrays.append(value.astype(float))
        return [len(arrays) - 1, list(value.shape), value.dtype.name]

    try:
        found = loadmat(io.BytesIO(data))
    except (NotImplementedError, ValueError, TypeError) as reason:
        raise LogError(f"is not read: {reason}", where, "") from reason
    values = {name: plain(name, value) for name, value in found.items() if not name.startswith("__")}
    missing = {name.partition(".")[0] for name, _ in skipped if "." not in name}
    return {"values": {n: v for n, v in values.items() if n not in missing}, "skipped": skipped}, arrays


@dataclass
class Evaluation:
    """The names that a run changes, and the operations that it has taken."""

    names: MutableMapping[str, Value]
    steps: int = 0
    on_signals: int = 0
    ends: list[tuple[Array, int, int]] = field(default_factory=list)
    """What `end` stands for: the array that is indexed, which index, and of how many."""

    def apart(self, names: Mapping[str, Value], run: Callable[["Evaluation"], Value]) -> tuple[Value, dict[str, Value]]:
        """Carry out `run` on names of its own; return its value, and the names after it.

        The values that functions keep between their calls, and the counts, are shared.
        """
        kept = {name: value for name, value in self.names.items() if "." in name}
        inner = Evaluation({**kept, **names}, self.steps, self.on_signals)
        value = run(inner)
        self.steps, self.on_signals = inner.steps, inner.on_signals
        self.names.update({name: value for name, value in inner.names.items() if "." in name})
        return value, dict(inner.names)

    def repeat(self, turn: Callable[[], tuple[Any, Any]], most: int) -> None:
        """Record a loop of turns, of which each says whether its condition held, and whether it is the last.

        It carries the names that a turn changes; a name that begins in it has no value behind it.
        """
        before, self.names = self.names, dict(self.names)
        turn()
        if begun := [name for name in self.names.keys() - before.keys() if "." in name]:
            raise NotComputed(f"{begun[0].strip('.?')} is kept and begins in a loop whose turns depend on signals")
        other = {name: value for name, value in before.items() if self.names.get(name) is not value}
        if text := [
            k for k, v in other.items() if not (isinstance(v, np.ndarray) and isinstance(self.names[k], np.ndarray))
        ]:
            raise NotComputed(f"{text[0]} changes in a loop whose turns depend on signals, and is no number")
        changed = {name: as_array(value) for name, value in other.items()}
        kinds = {name: class_of(array) for name, array in changed.items()}

        def arrays(scalars: Iterator[Any]) -> dict[str, Value]:
            return {
                name: filled(array.shape, [convert(next(scalars), kinds[name]) for _ in range(array.size)])
                for name, array in changed.items()
            }

        def elements(names: Mapping[str, Value]) -> list[Any]:
            found = {name: as_array(names[name]) for name in changed}
            if odd := [k for k, v in found.items() if v.shape != changed[k].shape or class_of(v) != kinds[k]]:
                raise NotComputed(f"{odd[0]} changes its size or class in a loop whose turns depend on signals")
            flat = [(kinds[name], one) for name, array in found.items() for one in lifted(array).flatten(order="F")]
            return [convert(one, "int32") if kind in STORED else one for kind, one in flat]

        def step(_: Any, goes: Any, *scalars: Any) -> list[Any]:
            self.names = {**before, **arrays(iter(scalars))}
            held, last = turn()
            on = goes & held
            now = [where(on, new, old) for new, old in zip(elements(self.names), scalars, strict=True)]
            return [on & (not last) if isinstance(last, bool) else on & ~last, *now]

        _, *last = fold(most, [True, *elements(before)], step)
        self.names = {**before, **arrays(iter(last))}

    def count(self, *values: Value, steps: int = 1) -> None:
        """Count an operation on these values, one on a large matrix as many. Raises NotComputed for one too many."""
        arrays = [one for one in values if isinstance(one, np.ndarray)]
        self.steps += steps + sum(one.size * min(one.shape) for one in arrays) // PRODUCTS_A_STEP
        if self.steps > MOST_STEPS:
            raise NotComputed(f"takes more than {MOST_STEPS} operations")

    def count_signals(self, operations: float) -> None:
        """Count operations on elements of signals before they are made. Raises NotComputed for too many."""
        self.on_signals += int(min(operations, MOST_ON_SIGNALS + 1))
        if self.on_signals > MOST_ON_SIGNALS:
            raise NotComputed(f"takes more than {MOST_ON_SIGNALS} operations on elements of signals")

    def called(self, name: str, arguments: list[Value], bracket: bool, count: int = 1) -> Value:
        """Return what a function of MATLAB's gives: for a `count` above 1 a list."""
        self.count(*arguments, steps=0)
        if name == "size" and count == 2:
            return [self.called(name, [arguments[0], np.array([[k]])], True) for k in (1.0, 2.0)]
        signals = count > 1 or any(map(is_signal, arguments)) or name not in FUNCTIONS
        if signals:
            self.count_signals(_operations(name, arguments))
        if name not in (*FUNCTIONS, *SIGNAL_FUNCTIONS):
            if "." in name and not bracket:
                remedy = f"if {name.partition('.')[0]} is an enumeration, name the folder of its class with --path"
                raise NotComputed(f"{name} has no value: {remedy}")
            raise NotComputed(f"{name} is not computed" if bracket else f"{name} has no value")
        try:
            with np.errstate(all="ignore"):
                value = lowered(of_signals(name, arguments, count)) if signals else FUNCTIONS[name](*arguments)
        except (TypeError, ValueError, IndexError, np.linalg.LinAlgError, OverflowError, MemoryError) as reason:
            raise NotComputed(f"{name}: {reason}") from None
        return bounded(value)

    def apply(self, operator: str, left: Value, right: Value) -> Value:
        """Compute an operation of two values."""
        left, right = number(left), number(right)
        self.count(left, right)
        if isinstance(left, dict | list) or isinstance(right, dict | list):
            raise NotComputed(f"'{operator}' of a structure or a cell")
        if operator in ("==", "~=") and isinstance(left, str) and isinstance(right, str):
            if isinstance(left, String) or isinstance(right, String):
                return np.array([[(left == right) == (operator == "==")]])
        a, b = as_array(left), as_array(right)
        if is_signal(a) or is_signal(b):
            self.count_signals(_operations(operator, (a, b)))
        try:
            with np.errstate(all="ignore"):
                return bounded((SIGNAL_OPERATORS if is_signal(a) or is_signal(b) else OPERATORS)[operator](a, b))
        except (ValueError, TypeError, np.linalg.LinAlgError) as reason:
            raise NotComputed(f"'{operator}': {reason}") from None


def _operations(name: str, values: Sequence[Value]) -> float:
    """Return how many operations on elements an operator or a function of these values takes, about."""
    arrays = [one for one in values if isinstance(one, np.ndarray)]
    sizes = [float(one.size) for one in arrays]
    if len(sizes) < 2 or (min(sizes) == 1.0 and name != "^"):
        return sum(sizes)
    a, b = arrays[:2]
    if name == "^":
        power = 1.0 if is_signal(b) else abs(float(b.flat[0]))
        return float(a.shape[0]) ** 3 * power if a.size > 1 else power
    return sizes[0] * b.shape[1] if name == "*" else sum(sizes)


def signed(sign: str, array: Array) -> Array:
    """Return -array, or where it is not true."""
    if is_signal(array):
        return SIGNAL_OPERATORS["negative" if sign == "-" else "~"](array)
    if sign == "-":
        return OPERATORS["-"](np.zeros((1, 1)), array) if array.dtype.kind in "iu" else -numeric(array)
    return ~array.astype(bool)


def range_of(first: Value, *others: Value) -> Array:
    """Return `first:last` or `first:step:last`."""
    bounds = [first, np.ones((1, 1)), *others] if len(others) == 1 else [first, *others]
    if any(map(is_signal, bounds)):
        raise NotComputed("a range whose bounds are signals has no fixed size")
    if not all(as_array(number(one)).size for one in bounds):
        return np.zeros((1, 0))
    begin, increment, end = (float(as_array(number(one)).flat[0]) for one in bounds)
    count = 0 if increment == 0 else math.floor((end - begin) / increment * (1 + 1e-15) + 1e-10) + 1
    if count > MOST_ELEMENTS or not math.isfinite(begin + end):
        raise NotComputed("a range has too many elements")
    return begin + increment * np.arange(max(count, 0), dtype=float)[None, :]
