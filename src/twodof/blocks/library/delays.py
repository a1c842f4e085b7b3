"""Blocks that remember: unit, N-sample, variable and fractional delay, zero-order hold, rate transition, data store."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from twodof.blocks.block import Clock, library_block
from twodof.blocks.bus import Bus, leaves_of
from twodof.blocks.declarations import Param, Port, State, check_name
from twodof.blocks.elementwise import OneOutput, count, elementwise, width_of
from twodof.blocks.enumeration import Kind
from twodof.blocks.expressions.arrays import Matrix, array_of, flat_of, shaped, store
from twodof.blocks.expressions.expr import int32, maximum, minimum, to_int32, to_real, where
from twodof.blocks.namespaces import BusView
from twodof.errors import DiagramError, nearest

__all__ = [
    "DataStore",
    "Delay",
    "FractionalDelay",
    "RateTransition",
    "StoreRead",
    "StoreWrite",
    "UnitDelay",
    "VariableDelay",
    "ZeroOrderHold",
]

MAX_SAMPLES = 100_000


@library_block("unit_delay")
class UnitDelay(OneOutput):
    """Delay by one sample of the block's own rate: y[k] = u[k-1], y[0] = initial. Breaks algebraic loops."""

    def __init__(self, initial: Any = 0, kind: Kind = "real", width: int | None = None, unit: str = "") -> None:
        self.ports("u", kind, width, unit)
        self.params = [Param("initial", initial, kind, width, unit)]
        self.states = [State("x", "initial", kind, width, unit)]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return x.x

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.u


class _RingBuffer(OneOutput):
    """The last `bound` inputs, read before one is written; what was before them is `initial`. Of a bus each field."""

    def _declare(self, bound: int, initial: Any, kind: Kind, width: int | None, unit: str) -> None:
        self.bound = bound
        ring, size = kind, None
        if isinstance(kind, Bus):
            leaves = [replace(leaf, name=leaf.name.partition(".")[2]) for leaf in leaves_of(Port("u", kind, width))]
            ring = Bus(kind.name, [replace(leaf, width=bound * (leaf.width or 1), shape=None) for leaf in leaves])
        else:
            size = bound * (width or 1)
        self.ports("u", kind, width, unit)
        self.params = [Param("initial", initial, kind, width, unit)]
        self.states = [
            State("buffer", 0 if kind != "bool" else False, ring, size, unit),
            State("before", "initial", kind, width, unit),
            State("position", 0, "int32"),
            State("age", 0, "int32"),
        ]

    def _past(self, samples: Any, x: Any) -> Any:
        """u[k - samples], 1 <= samples <= bound."""
        back = x.position - samples
        place = where(back < 0, back + self.bound, back)
        arrived = samples <= x.age
        return _read(x.buffer, x.before, place, arrived)

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        after = x.position + 1
        return {
            "buffer": _written(x.buffer, u.u, x.position),
            "position": where(after < self.bound, after, int32(0)),
            "age": where(x.age < self.bound, x.age + 1, x.age),
        }


def _read(ring: Any, before: Any, place: Any, arrived: Any) -> Any:
    """Return the value in a ring at `place` if it has `arrived` there, else the value before."""
    if isinstance(before, BusView):
        return {name: _read(ring[name], before[name], place, arrived) for name in vars(before)}
    if isinstance(before, Matrix):
        return shaped(_read(ring, flat_of(before), place, arrived), before.shape)
    width = width_of(before)
    if width is None:
        return where(arrived, ring[place], before)
    return array_of(width, lambda i: where(arrived, ring[place * width + i], before[i]))


def _written(ring: Any, value: Any, place: Any) -> Any:
    """Return a ring with `value` at `place`."""
    if isinstance(value, BusView):
        return {name: _written(ring[name], value[name], place) for name in vars(value)}
    flat = flat_of(value)
    width = width_of(flat)
    if width is None:
        return store(ring, place, flat)
    for i in range(width):
        ring = store(ring, place * width + i, flat[i])
    return ring


@library_block("delay")
class Delay(_RingBuffer):
    """Delay by `samples` samples of the block's own rate: y[k] = u[k - samples], and `initial` for k < samples.

    A ring buffer of `bound` samples, read before it is written. `samples` may be tuned within 1 .. bound (bound is
    the first value of `samples` unless it is given); a change acts at once on the samples that are kept. Of a bus all
    fields are delayed alike.
    """

    def __init__(
        self,
        samples: int = 1,
        bound: int | None = None,
        initial: Any = 0,
        kind: Kind = "real",
        width: int | None = None,
        unit: str = "",
    ) -> None:
        bound = count(samples if bound is None else bound, 1, MAX_SAMPLES, "bound")
        count(samples, 1, bound, "samples")
        self._declare(bound, initial, kind, width, unit)
        self.params = [Param("samples", samples, "int32", unit="samples", low=1, high=bound), *self.params]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self._past(p.samples, x)


@library_block("variable_delay")
class VariableDelay(_RingBuffer):
    """Delay by as many samples as the int32 input `samples` says: y[k] = u[k - samples[k]], `initial` before the start.

    `samples` is clamped to 0 .. bound; it may change at any sample, and a change acts at once on the samples that are
    kept. 0 is the input itself. With `direct` false at least one sample is taken, and the block breaks algebraic
    loops. A ring buffer of `bound` samples, read before it is written. Of a bus all fields are delayed alike.
    """

    def __init__(
        self,
        bound: int = 10,
        initial: Any = 0,
        direct: bool = True,
        kind: Kind = "real",
        width: int | None = None,
        unit: str = "",
    ) -> None:
        self._declare(count(bound, 1, MAX_SAMPLES, "bound"), initial, kind, width, unit)
        self.direct = direct
        self.inputs = [*self.inputs, Port("samples", "int32", unit="samples")]

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        samples = minimum(maximum(u.samples, int32(1)), int32(self.bound))
        past = self._past(samples, x)
        if not self.direct:
            return past
        return elementwise(lambda now, then: where(u.samples < 1, now, then), u.u, past)


@library_block("fractional_delay")
class FractionalDelay(_RingBuffer):
    """Delay of a held signal by `delay` seconds, which need not be a multiple of the tick: y(t) = u(t - delay).

    Let delay / dt = n + f with 0 <= f < 1. In the step from tick k on, y is u[k-n-1] before the fraction f of the step
    and u[k-n] after it. Continuous blocks see the change where it happens (an edge: the integration is split). So a
    linear plant is integrated as exactly as without the delay. At the tick itself y reads u[k-n-1], or u[k-n] if f = 0.
    Inputs before the start are `initial`. For the base rate.

    `samples` ticks are kept: a delay of more than samples * dt gives NaN. With `direct` false the delay is at least one
    tick (a shorter one is taken as one tick), and the block breaks algebraic loops.
    """

    def __init__(
        self, delay: float = 0.0, samples: int = 64, initial: float = 0.0, direct: bool = True, unit: str = ""
    ) -> None:
        self._declare(count(samples, 1, MAX_SAMPLES, "samples"), initial, "real", None, unit)
        self.direct = direct
        self.params = [Param("delay", delay, unit="s", low=0.0), *self.params]
        self.derived = [Port("whole", "int32"), Port("fraction"), Port("fits", "bool")]

    def prepare(self, p: Any, t: Clock) -> Any:
        ratio = p.delay / t.dt
        if not self.direct:
            ratio = where(ratio < 1.0, 1.0, ratio)
        whole = to_int32(ratio)
        return {"whole": whole, "fraction": ratio - to_real(whole), "fits": ratio <= float(self.bound)}

    def _delayed(self, samples: Any, u: Any, x: Any, p: Any) -> Any:
        """u[k - samples] for 0 <= samples <= bound."""
        past = self._past(samples, x)
        if self.direct:
            past = where(samples < 1, u.u, past)
        return where(p.fits, past, math.nan)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return self._delayed(where(p.fraction > 0.0, p.whole + 1, p.whole), u, x, p)

    def edges(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return {"y": (p.fraction, self._delayed(p.whole, u, x, p))}


class _Passes(OneOutput):
    """y = u."""

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        return u.u


@library_block("zero_order_hold")
class ZeroOrderHold(_Passes):
    """Sample and hold: at the block's own ticks y = u, held in between. May read a signal of another rate.

    Before the first of them y is 0, or what `Diagram.add` is given as `initial={"y": value}`.
    """

    crossing = True

    def __init__(self, kind: Kind = "real", width: int | None = None, unit: str = "") -> None:
        self.ports("u", kind, width, unit)


@library_block("rate_transition")
class RateTransition(UnitDelay):
    """Sample and hold, and a delay by one sample of the block's own rate: y[k] = u[k-1], y[0] = initial.

    Before the first of its ticks y is 0, or what `Diagram.add` is given as `initial={"y": value}`.

    May read a signal of another rate; breaks algebraic loops over two rates.
    """

    crossing = True


@library_block("data_store")
class DataStore(UnitDelay):
    """Value that one place writes and others read, without wires: y is the value after the previous tick.

    Its input is fed by the one StoreWrite of its name, or by a connection. It is read by StoreReads, or by
    connections. Both look in the diagram that they are in and then in those around it; the nearest store of the name
    is theirs. So a store reads as it did before the tick; the order of the blocks does not matter. It is `initial`
    until it is written, and keeps what was written while its writer does not act.
    """

    crossing = True

    def __init__(self, initial: Any = 0, kind: Kind = "real", width: int | None = None, unit: str = "") -> None:
        self.ports("u", kind, width, unit)
        self.states = [State("x", initial, kind, width, unit)]


@library_block("store_write")
class StoreWrite(_Passes):
    """Writes u into the DataStore named `store` as its only writer; y = u."""

    def __init__(self, store: str = "store", kind: Kind = "real", width: int | None = None, unit: str = "") -> None:
        self.store = check_name(store, "")
        self.ports("u", kind, width, unit)


@library_block("store_read")
class StoreRead(_Passes):
    """y is the value of the DataStore named `store`, which feeds the input u if nothing is connected to it."""

    crossing = True

    def __init__(self, store: str = "store", kind: Kind = "real", width: int | None = None, unit: str = "") -> None:
        self.store = check_name(store, "")
        self.ports("u", kind, width, unit)


def nearest_store(level: Any, name: str, where: str) -> tuple[Any, Any]:
    """Return the level that has the data store `name`, and the store's place: in `level`, or around it.

    A level has its `parts` by name and its `parent`; the place of a block has the `block` and its `path`.
    """
    at = level
    while at is not None:
        found = at.parts.get(name)
        if isinstance(getattr(found, "block", None), DataStore):
            return at, found
        at = at.parent
    raise DiagramError(f"no data store {name!r} here or in a diagram around it", where, "add a DataStore of this name")


def note_writer(writers: dict[Any, Any], level: Any, writer: Any) -> Any:
    """Note a StoreWrite's place by that of its store, and return the store's. Raises DiagramError for a second one."""
    at, store = nearest_store(level, writer.block.store, writer.path)
    other = writers[store].path if store in writers else at.diagram.connections.get((writer.block.store, "u"))
    if other is not None:
        what = f"the data store {store.path} is written by {other} too"
        raise DiagramError(what, writer.path, "a store has one writer: choose between them in front of it")
    writers[store] = writer
    return store


def stored(writers: Mapping[Any, Any], level: Any, part: str, port: str, where: str) -> tuple[Any, str]:
    """Return the place and the output that feed the unconnected input `port` of a part: a data store, or its writer."""
    item, place = level.diagram.parts[part].item, level.parts.get(part)
    if isinstance(item, StoreRead):
        giver = nearest_store(level, item.store, where)[1]
    elif place in writers:
        giver = writers[place]
    else:
        remedy = f'connect it, or add StoreWrite("{part}")' if isinstance(item, DataStore) else "connect it"
        raise DiagramError(f"the input {port} is not connected", where, remedy)
    output = f"y{port.removeprefix('u')}"  # perhaps a field, "y.roll"
    names = [p.name for p in giver.block.outputs]
    if output not in names:
        what = f"{giver.path} has another type: its outputs are {nearest(output, names)}"
        raise DiagramError(what, where, "declare both alike")
    return giver, output
