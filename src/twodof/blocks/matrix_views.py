"""What a block's methods see of the values that are declared as matrices: they are kept flat, and shown as matrices."""

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.matrix import Matrix

View = TypeVar("View")


def matrices(*declared: Iterable[Port | State | Param]) -> dict[str, tuple[int, int]]:
    """The names of the declared matrices, with their shapes."""
    return {d.name: d.shape for some in declared for d in some if d.shape}


def with_matrices(view: View, shapes: Mapping[str, tuple[int, int]]) -> View:
    """A view (Inputs, States, Parameters) with its matrices as such; `view` itself without matrices."""
    if not shapes:
        return view
    values: dict[str, Any] = vars(view)
    made: Any = type(view)
    shown: View = made({**values, **{n: Matrix(values[n], s) for n, s in shapes.items() if n in values}})
    return shown
