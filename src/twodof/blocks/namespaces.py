"""Namespaces of a block's methods: inputs, states, parameters and the clock by attribute, all read-only."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar, Never

from twodof.blocks.expressions.expr import fault, to_real


class Namespace:
    """Values for a block's methods: attributes by name, a live view of `values`. An unknown name is an error.

    So is an assignment: recorded once and computed again at every step, it would mean two things.
    """

    what: ClassVar[str] = "name"
    instead: ClassVar[str] = "use a local variable"

    def __init__(self, values: dict[str, Any]) -> None:
        object.__setattr__(self, "__dict__", values)

    def __getattr__(self, name: str) -> Any:
        raise fault(f"no {type(self).what} named {name!r}", f"there are: {', '.join(self.__dict__) or 'none'}")

    def __getitem__(self, name: str) -> Any:
        values = self.__dict__
        if name in values or "." not in name:
            return getattr(self, name)
        bus, _, field = name.partition(".")
        return getattr(self, bus)[field]

    def __setattr__(self, name: str, value: Any) -> Never:
        raise fault(f"the {type(self).what} {name!r} is assigned", type(self).instead)

    __setitem__ = __setattr__

    def __delattr__(self, name: str) -> Never:
        raise fault(f"the {type(self).what} {name!r} is deleted", type(self).instead)


class BusView(Namespace):
    """The fields of a bus. Of an array of buses each is an array; `view[i]` is one bus, and `len` counts them."""

    what = "field"
    instead = "give the whole bus with this field changed"

    def __getitem__(self, name: Any) -> Any:
        if isinstance(name, str):
            return super().__getitem__(name)
        return BusView({field: value[name] for field, value in vars(self).items()})

    def __len__(self) -> int:
        return len(next(iter(vars(self).values())))

    def __bool__(self) -> bool:
        return True

    def __iter__(self) -> Iterator[BusView]:
        return (self[i] for i in range(len(self)))


class Inputs(Namespace):
    """The inputs of a block."""

    what = "input"


class States(Namespace):
    """The states of a block."""

    what = "state"
    instead = "return its new value from update (of a continuous state: its slope from derivative)"


class Parameters(Namespace):
    """The parameters of a block, given and derived."""

    what = "parameter"
    instead = "return a derived parameter from prepare, or use a local variable"


class Clock(Namespace):
    """Time as a block sees it: `tick` (uint32 base tick), `dt` [s] of the block, `base_dt` [s] of the tick.

    A `tick` of None is not there at all: derived parameters do not depend on it.
    """

    what = "clock value"

    def __init__(self, tick: Any, dt: Any, base_dt: Any) -> None:
        super().__init__({"dt": dt, "base_dt": base_dt} | ({} if tick is None else {"tick": tick}))

    @property
    def time(self) -> Any:
        """Seconds since the start, tick * base_dt (in float32 exact to 2^24 ticks: count ticks where that matters)."""
        return to_real(self.tick) * self.base_dt


def twin(view: Namespace) -> Namespace:
    """Return a view of a copy of the values that `view` shows now."""
    made = object.__new__(type(view))
    object.__setattr__(made, "__dict__", dict(vars(view)))
    return made
