"""What a block's methods see of matrices and buses: their values are kept flat, and shown as what they are."""

from collections.abc import Iterable, Mapping
from itertools import chain
from typing import Any, TypeVar

from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.matrix import Matrix
from twodof.blocks.namespaces import BusView

View = TypeVar("View")


class Shapes(dict[str, tuple[int, int]]):
    """The shapes of declared matrices by name; `buses`: whether something declared is the field of a bus."""

    def __init__(self, declared: Iterable[Port | State | Param] = ()) -> None:
        every = list(declared)
        super().__init__({d.name: d.shape for d in every if d.shape})
        self.buses = any("." in d.name for d in every)

    def __bool__(self) -> bool:
        """Whether a view shows anything in another form than it is kept."""
        return self.buses or len(self) > 0


def matrices(*declared: Iterable[Port | State | Param]) -> Shapes:
    """The names of the declared matrices, with their shapes."""
    return Shapes(chain.from_iterable(declared))


def with_matrices(view: View, shapes: Shapes) -> View:
    """A view (Inputs, States, Parameters) with its matrices and buses as such; `view` itself without any."""
    if not shapes:
        return view
    values: dict[str, Any] = vars(view)
    made: Any = type(view)
    values = {**values, **{n: Matrix(values[n], s) for n, s in shapes.items() if n in values}}
    shown: View = made(_nested(values) if shapes.buses else values)
    return shown


def _nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values by path as values by name, those of a bus as a view of its fields."""
    found: dict[str, Any] = {}
    inside: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        name, _, field = path.partition(".")
        if field:
            inside.setdefault(name, {})[field] = value
            found.setdefault(name, None)  # in its place
        else:
            found[name] = value
    return {**found, **{name: BusView(_nested(fields)) for name, fields in inside.items()}}
