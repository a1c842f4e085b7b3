"""A block's method as the reference runs it: on numbers, at every step. A user's method is judged by its trace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twodof.blocks.block import Block
from twodof.blocks.declarations import Port, State, numeric
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.expressions.numbers import Vector
from twodof.blocks.mistakes import HIDDEN, is_users, mistake, place
from twodof.blocks.namespaces import Namespace, twin
from twodof.blocks.trace import by_method, by_path, computed, matrices, with_matrices
from twodof.errors import DiagramError, shown

_OWN_PRECISION = "write float(...) around numbers of numpy, which have a precision of their own"


class BlockMethod:
    """A method of the block at `path`. A call gives numbers of the declared types (tracing has checked the names)."""

    def __init__(self, path: str, block: Block, name: str, declared: Sequence[Port | State]) -> None:
        self.path, self.block, self.name = path, block, name
        self._method = getattr(block, name)
        self._declared = [(d.name, d.kind, d.width, None if d.width is not None else d.kind) for d in declared]
        self._matrices = matrices(declared)
        shapes = [matrices(block.inputs), matrices(block.states), matrices(block.params, block.derived), matrices()]
        self._shown = shapes[2:] if name == "prepare" else shapes
        self._sees_matrices = any(self._shown)

    def __call__(self, *seen: Namespace) -> dict[str, Any]:
        return self.given(self._result(seen))

    def given(self, result: Any) -> dict[str, Any]:
        """Return a method's values by name, as numbers of the declared types."""
        if self._matrices.buses:
            result = by_path(result, [name for name, *_ in self._declared])
        if type(result) is not dict and not isinstance(result, Mapping):
            result = {self._declared[0][0]: result} if self._declared else {}
        types = numbers.scalar_types()
        given = {}
        for name, kind, width, scalar in self._declared:
            if name in result:
                value = result[name]
                # What is of the type already, as nearly all is, needs no look at what else it could be.
                given[name] = value if type(value) is types.get(scalar) else self._number(value, kind, width, name)
        return given

    def _result(self, seen: Sequence[Namespace]) -> Any:
        if self._sees_matrices:
            seen = [with_matrices(view, shapes) for view, shapes in zip(seen, self._shown, strict=True)]
        try:
            return self._method(*seen)
        except Exception as error:
            found = mistake(error, self.block, self.name)
            raise DiagramError(found.what, f"{self.path}, {found.where}", found.remedy) from error

    def _number(self, value: Any, kind: str, width: int | None, name: str = "") -> Any:
        try:
            return numeric(value, kind, width, "", self._matrices.get(name))
        except DiagramError as error:
            if isinstance(value, Expr):
                what = f"{self.name} gives a value that it kept from when it was traced"
                raise DiagramError(what, self.where(), HIDDEN) from error
            raise DiagramError(error.what, self.where(), error.remedy) from error

    def where(self) -> str:
        """Return the block's path, and the method's line."""
        return f"{self.path}, {place(self.block, self.name)}"


class EdgesMethod(BlockMethod):
    """The method `edges`: a call gives pairs of reals."""

    def given(self, result: Any) -> dict[str, Any]:
        return {port: tuple(self._number(value, "real", None) for value in pair) for port, pair in result.items()}


class JudgedMethod:
    """A user's method. Raises DiagramError if it gives another value than its trace, which is what is compiled.

    What is recorded once cannot count, draw lots or remember. A method that does so computes on numbers, and then the
    reference and the compiled program would differ without a word.
    """

    def __init__(self, method: BlockMethod) -> None:
        self._method = method
        self._recorded = by_method(method.block.trace)[method.name]
        self._roots = [root for roots in self._recorded.values() for root in roots]

    def __call__(self, *seen: Namespace) -> dict[str, Any]:
        # It sees copies: whatever it does to them, the machine's own values stay.
        given = self._method(*map(twin, seen))
        u, x, p, t = seen if len(seen) == 4 else (None, None, *seen)
        values = iter(computed(self._roots, u, x, p, t))
        found = {n: tuple(next(values) for _ in roots) for n, roots in self._recorded.items()}
        expected = self._method.given({n: pair if len(pair) == 2 else pair[0] for n, pair in found.items()})
        for name in given | expected:
            one, other = given.get(name), expected.get(name)
            if not numbers.identical(one, other):
                raise DiagramError(
                    f"{self._method.name} gives {name!r} = {_text(one)} now, and {_text(other)} as it was traced",
                    self._method.where(),
                    HIDDEN if numbers.real_type() is np.float64 else f"{HIDDEN}; {_OWN_PRECISION}",
                )
        return given


def running(path: str, block: Block, name: str, declared: Sequence[Port | State]) -> BlockMethod | JudgedMethod:
    """Return the method `name` of the block at `path`, which gives the `declared` values."""
    method = EdgesMethod(path, block, name, ()) if name == "edges" else BlockMethod(path, block, name, declared)
    return JudgedMethod(method) if is_users(block) else method


def _text(value: Any) -> str:
    if isinstance(value, tuple) and not isinstance(value, Vector):
        return shown([numbers.plain(one) for one in value])
    return "nothing" if value is None else shown(numbers.plain(value))
