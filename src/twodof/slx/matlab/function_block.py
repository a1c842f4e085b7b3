"""A MATLAB Function as a block: the function is carried out on recorded signals, and what it computes is the block.

Persistent variables are states. They are empty before the first call, in which most functions give them constants: then
these are the initial values. Where the first call computes anything else than it would from them, it is translated
apart and chosen by a state that says whether it was. The block travels in JSON as its recorded expressions.
"""

import keyword
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twodof.blocks.block import Block, Clock
from twodof.blocks.bus import Bus
from twodof.blocks.declarations import Port, State
from twodof.blocks.expressions.arrays import flat_of, shape_of, shaped, vector
from twodof.blocks.expressions.expr import Expr, convert, tracing
from twodof.blocks.namespaces import BusView, Inputs, States
from twodof.blocks.trace import leaves_of, matrices, with_matrices
from twodof.errors import DiagramError
from twodof.slx.matlab.evaluation import Evaluation
from twodof.slx.matlab.program import Code, call
from twodof.slx.matlab.signals import chosen
from twodof.slx.matlab.values import (
    FUNCTIONS,
    Array,
    Cells,
    Members,
    NotComputed,
    Value,
    cast,
    class_of,
    filled,
    is_empty,
    is_signal,
    lifted,
    stored,
)
from twodof.slx.translation import Signal

MOST_GUESSED = 9999
"""Largest width that an index may say."""
_CALLED = "was_called"
Names = dict[str, Value]


class MatlabFunction(Block):
    """The function `code` of inputs of these types, in the order of its arguments.

    Arguments that are not among the input `ports` have values of the workspace, `names`; without ports they are the
    last ones. `declared` are kinds of names, as a chart has them: then the function sees all `names`. It calls the
    functions of .m files in `folders`. A structure is a bus; `buses` order the fields of outputs. `notes` say what is
    left out. Raises DiagramError with the line of a statement that is not translated.
    """

    def __init__(
        self,
        code: str,
        signals: Sequence[Signal],
        names: Mapping[str, Value] | None = None,
        ports: Sequence[str] = (),
        declared: Mapping[str, Any] | None = None,
        folders: Sequence[Path] = (),
        buses: Mapping[str, Bus] | None = None,
    ) -> None:
        self.buses = buses or {}
        try:
            self.code = Code(code, folders)
            self.code.known |= {
                k: v for k, v in (names or {}).items() if isinstance(v, Members) or declared is not None
            }
            self.code.declared |= declared or {}
            self.code.base |= names or {}
            main = self.code.main
            self.code.shared = None if declared is None else set(main.arguments)
            named = len(ports) == len(signals) and set(ports) <= set(main.arguments)
            self.given = [k for k in main.arguments if k in ports] if named else main.arguments[: len(signals)]
            self.constants = {k: v for k, v in (names or {}).items() if k in main.arguments and k not in self.given}
            if missing := [k for k in main.arguments if k not in (*self.given, *self.constants)]:
                raise NotComputed(f"the argument {missing[0]} has neither a signal nor a value: give --workspace")
            if len(self.given) != len(signals):
                raise NotComputed(f"it has {len(signals)} inputs and takes {len(main.arguments)} arguments")
            if not main.results:
                raise NotComputed("it has no output")
            self.inputs = [one.port(_port(name)) for name, one in zip(self.given, signals, strict=True)]
            self.cells: Names = {}
            """Persistent cell arrays: they are constant from the first call on."""
            with tracing("MATLAB Function"):
                self._declare()
        except NotComputed as reason:
            raise DiagramError(str(reason), "MATLAB Function", "change the function, or draw it with blocks") from None
        self.notes = list(dict.fromkeys(self.code.notes))

    def _declare(self) -> None:
        """Find the states with their initial values, and the outputs."""
        u = with_matrices(Inputs(dict(leaves_of("input", self.inputs))), matrices(self.inputs))
        results, kept = self._called(u, {})
        for name, value in kept.items():
            if is_empty(value) or not isinstance(value, np.ndarray):
                raise NotComputed(f"the persistent {name.split('.')[1]} is not an array after the first call")
        began = _flat(self.code.initial)
        initial = {name: began.get(name) for name in kept}
        self.first = any(
            not isinstance(one, np.ndarray) or is_signal(one) or one.shape != kept[name].shape
            for name, one in initial.items()
        )
        self.first = self.first or not _same((results, kept), self._called(u, initial))
        self.late: Names = {}
        while True:  # of functions that only later calls come to
            self.kept = {name: _state_name(name) for name in kept}
            self.sizes = {name: value.shape for name, value in kept.items()}
            self.states = [
                _state(self.kept[name], value, None if self.first else initial.get(name))
                for name, value in kept.items()
            ]
            self.states += [State(_CALLED, False, "bool")] * self.first
            x = with_matrices(States(dict(leaves_of("state", self.states))), matrices(self.states))
            later = self._called(u, self._remembered(x))[1]
            new = {name: later[name] for name in later.keys() - kept.keys()}
            if not new:
                break
            new |= {f"{name}?": np.array([[False]]) for name in new if not name.endswith("?")}
            self.late |= {name: _zeros(value) for name, value in new.items()}
            kept |= dict(sorted(new.items()))
        for name, value in later.items():
            if value.shape != kept[name].shape or class_of(value) != class_of(kept[name]):
                raise NotComputed(f"the persistent {name.split('.')[1]} changes its size or class")
        results = self._computed(u, x)[0]
        self.outputs = [_declared(name, value) for name, value in results.items()]
        self.rows = [name for name, value in results.items() if value.shape[0] == 1 < value.size]
        self.code.notes += [
            f"the row {name} is a vector, which other MATLAB Functions see as a column" for name in self.rows
        ]

    def _called(self, u: Any, kept: Names) -> tuple[Names, Names]:
        """Return the results of a call, and the persistent variables after it."""
        given = [
            self.constants[name] if name in self.constants else value_of(u[_port(name)])
            for name in self.code.main.arguments
        ]
        evaluation = Evaluation(_nested(kept | self.cells if kept else kept, 2))
        names = call(self.code, self.code.main, given, evaluation)
        results: Names = {}
        for name in self.code.main.results:
            found = _flat({name: names[name]})
            for path, value in found.items():
                if not isinstance(value, np.ndarray) or not value.size:
                    raise NotComputed(f"the output {path} is not an array")
            wanted = [f"{name}.{leaf.name}" for leaf in self.buses[name].leaves] if name in self.buses else list(found)
            if set(wanted) != found.keys():
                raise NotComputed(f"the fields of the output {name} are not those of the bus {self.buses[name].name}")
            results |= {path: found[path] for path in wanted}
        after = _flat(dict(evaluation.names))
        for name in [name for name, one in after.items() if isinstance(one, Cells)]:
            if self.cells.setdefault(name, after[name]) is not after.pop(name):
                raise NotComputed(f"the cell array {name.split('.', 1)[1]} is kept and changes")
        return results, after

    def _remembered(self, x: Any) -> Names:
        return {name: value_of(x[one]).reshape(self.sizes[name], order="F") for name, one in self.kept.items()}

    def _computed(self, u: Any, x: Any) -> tuple[Names, Names]:
        later = self._called(u, self._remembered(x))
        if not self.first:
            return later
        first, called = self._called(u, {}), x[_CALLED]
        pairs = zip(first, later, strict=True)
        both = (({**self.late, **a}, b) for a, b in pairs)
        results, kept = ({name: chosen(called, b[name], a[name], name) for name in b} for a, b in both)
        return results, kept

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Carry out the function on the inputs."""
        found = self._computed(u, x)[0]
        return {port.name: _plain(found[name], port) for name, port in zip(found, self.outputs, strict=True)}

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Carry out the function, and keep the persistent variables."""
        if not self.states:
            return {}
        kept = self._computed(u, x)[1]
        made = {s.name: _plain(kept[name], s) for name, s in zip(self.kept, self.states, strict=False)}
        return {**made, _CALLED: True} if self.first else made


def last_index(text: str, argument: int, folders: Sequence[Path] = ()) -> int:
    """Return the largest constant index that code has for its argument of this number, from 1; 1 without any.

    Functions to which the code passes the argument on are followed.
    """
    most, seen = 1, set[tuple[str, str, int]]()
    try:
        code = Code(text, folders)
        left = [(code, code.main, argument - 1)]
        while left:
            code, function, at = left.pop()
            if at >= len(function.arguments) or (code.prefix, function.name, at) in seen:
                continue
            seen.add((code.prefix, function.name, at))
            name = function.arguments[at]
            body = " ".join(one.text for one in code.tokens[function.start : function.stop])
            for index in re.findall(rf"(?<!\. )(?<!\S){name} \( (\d+(?: : \d+)*|\[ [\d ,:;]+ \])(?: , [1:])? \)", body):
                most = max(most, *(int(one) for one in re.findall(r"\d+", index)))
            for called, arguments in re.findall(r"(?<!\S)([A-Za-z]\w*) \( ([^()]*) \)", body):
                for k, one in enumerate(arguments.split(" , ")):
                    if one.strip() == name and called not in function.arguments:
                        owner = code if called in code.functions else code.file(called)
                        left += [] if owner is None else [(owner, owner.functions.get(called, owner.main), k)]
    except NotComputed:
        pass
    return most if most <= MOST_GUESSED else 1


def value_of(shown: Any) -> Value:
    """Return an input or a state as a value of MATLAB: a vector is a column, a bus a structure."""
    if isinstance(shown, BusView):
        return {name: _widened(value_of(value)) for name, value in vars(shown).items()}
    shape, flat = shape_of(shown), flat_of(shown)
    if not shape:
        return filled((1, 1), [flat])
    return filled((*shape, 1)[:2], (flat[k] for k in range(int(np.prod(shape)))))


def typed(kind: str, array: Array) -> Value:
    """Return an array in the class of a kind."""
    return FUNCTIONS[{"real": "double", "bool": "logical"}.get(kind, kind)](array)


def zero_of(port: Port) -> Value:
    """Return what a port without a value gives."""
    if isinstance(port.kind, Bus) and port.width is None:
        return {one.name: zero_of(one) for one in port.kind.fields}
    if not isinstance(port.kind, str):
        raise NotComputed(f"the array {port.name} of buses is not translated")
    return typed(port.kind, np.zeros(port.shape or (port.width or 1, 1)))


def _widened(value: Value) -> Value:
    """Return a bus's element whose singles are reals, as all other numbers of a function are."""
    if not isinstance(value, np.ndarray):
        return value
    elements = (convert(one, "real") if getattr(one, "kind", "") == "float32" else one for one in value.flatten("F"))
    return filled(value.shape, elements)


def _flat(names: Names) -> Names:
    """Return values by path: `a.b` of a structure."""
    inside = {name: _flat(value) if isinstance(value, dict) else None for name, value in names.items()}
    return {
        f"{name}.{path}" if path else name: value
        for name, fields in inside.items()
        for path, value in ({"": names[name]} if fields is None else fields).items()
    }


def _nested(values: Names, roots: int) -> Names:
    """Return values by name, with structures of those whose path has more than `roots` parts."""
    made: Names = {}
    for path, value in values.items():
        parts = path.split(".")
        name = ".".join(parts[:roots])
        made[name] = stored(made.get(name), parts[roots:], value)
    return made


def _size(array: Array) -> dict[str, Any]:
    """Return width and shape of an array's declaration."""
    if array.size == 1:
        return {}
    return {"width": array.size} if 1 in array.shape else {"shape": array.shape}


def _declared(name: str, array: Array) -> Port:
    return Port(_port(name), class_of(array), **_size(array))


def _state(name: str, array: Array, initial: Array | None) -> State:
    kind = class_of(array)
    start = np.zeros(array.shape) if initial is None else initial
    values = start.astype(bool) if kind == "bool" else start.astype(float if kind == "real" else int)
    plain = values.tolist() if array.size > 1 and 1 not in array.shape else values.flatten(order="F").tolist()
    return State(name, plain[0] if array.size == 1 else plain, kind, **_size(array))


def _plain(array: Array, declared: Port | State) -> Any:
    """Return an array as the value of a port or state."""
    elements = [cast(one, declared.kind) for one in lifted(array).flatten(order="F")]
    return elements[0] if declared.width is None else shaped(vector(elements), declared.shape)


def _zeros(array: Array) -> Array:
    return np.zeros(array.shape, {"real": "float64"}.get(class_of(array), class_of(array)))


def _same(one: tuple[Names, Names], other: tuple[Names, Names]) -> bool:
    """Return True if two calls record the same expressions."""
    for first, second in zip(one, other, strict=True):
        for name, value in first.items():
            if value.shape != second[name].shape or class_of(value) != class_of(second[name]):
                return False
            pairs = zip(lifted(value).flatten(), lifted(second[name]).flatten(), strict=True)
            if not all(a is b or (not isinstance(a, Expr) and repr(a) == repr(b)) for a, b in pairs):
                return False
    return True


def _state_name(name: str) -> str:
    return re.sub(r"\W", "_", name)


def _port(name: str) -> str:
    """Return a legal name of a port: MATLAB's may end with an underscore, and Python's words are taken."""
    return f"{name}_" if keyword.iskeyword(name) or name.startswith("#") else name
