"""Chart: the modes of a state machine, and which way each transition takes from each mode; checked for names."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twodof.blocks.declarations import check_name
from twodof.blocks.enumeration import plain_data
from twodof.blocks.namespaces import Clock
from twodof.errors import DiagramError, nearest, shown

ACTIONS = ("entry", "during", "exit")
ARGUMENTS = ("u", "x", "p", "t")
Action = Callable[..., Any] | Mapping[str, Any] | None
Guard = Callable[..., Any] | bool


@dataclass(frozen=True, eq=False)
class Mode:
    """Mode of a state machine, one at a time; a `State` is a block's memory.

    An action is a function of any of u, x, p and t that returns new values by name, or a mapping of constants. `entry`
    acts when the mode is entered, `exit` when it is left: both give variables. `during` acts at each tick that ends in
    the mode, and gives outputs and variables.

    `inner` are modes inside this one, of which the first is where it starts. With `history` it starts again in the one
    that it was left in.
    """

    name: str
    during: Action = None
    entry: Action = None
    exit: Action = None
    inner: Sequence[Mode] = ()
    history: bool = False


@dataclass(frozen=True, eq=False)
class Transition:
    """From the mode `source` to the mode `target`, where the guard `when` holds; `do` gives variables as it is taken.

    A guard is a function of any of u, x, p and t that returns a bool. `t.elapsed` are the ticks since the source was
    entered, `t.elapsed_time` the same in seconds.
    """

    source: str
    target: str
    when: Guard = True
    do: Action = None

    @property
    def text(self) -> str:
        """Where it leads, for messages and drawings."""
        return f"{self.source} -> {self.target}"


class ModeClock(Clock):
    """The clock of a machine's functions: `elapsed` [ticks of the block] and `elapsed_time` [s] since a mode began."""

    def __init__(self, tick: Any, dt: Any, base_dt: Any, elapsed: Any, elapsed_time: Any) -> None:
        super().__init__(tick, dt, base_dt)
        vars(self).update(elapsed=elapsed, elapsed_time=elapsed_time)


class MachineFunction:
    """A guard or an action, `given` as a function or as constants; `place` says whose it is.

    Raises DiagramError for one that takes other arguments than u, x, p and t.
    """

    def __init__(self, given: Any, place: str) -> None:
        self.given = given if callable(given) else plain_data(given, place)
        self.place = place
        self.constant = not callable(given)
        self.takes: tuple[str, ...] = ()
        if not self.constant:
            self.takes = tuple(inspect.signature(given).parameters)
            for name in self.takes:
                if name not in ARGUMENTS:
                    raise DiagramError(
                        f"{place} takes {shown(name)}", "", "let it take any of u (inputs), x (variables), p and t"
                    )

    def __call__(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        if self.constant:
            return self.given
        seen = {"u": u, "x": x, "p": p, "t": t}
        return self.given(*(seen[name] for name in self.takes))

    @property
    def line(self) -> str:
        """Its file and line, as an error's place names them; "" for constants."""
        code = getattr(inspect.unwrap(self.given), "__code__", None) if not self.constant else None
        return f", {code.co_filename}:{code.co_firstlineno}" if code else ""


MAX_MODES = 200
MAX_TRANSITIONS = 1000
MAX_WAYS = 100  # out of one mode, those of the mode around it included
MAX_ALL_WAYS = 2000  # from mode to mode


@dataclass(frozen=True, eq=False)
class Leaf:
    """A mode without inner ones, and the mode around it: the machine is in one leaf. `number` is what `mode` says."""

    number: int
    mode: Mode
    outer: Mode | None

    @property
    def path(self) -> tuple[Mode, ...]:
        """The mode around it, if there is one, and itself."""
        return (self.mode,) if self.outer is None else (self.outer, self.mode)


@dataclass(frozen=True, eq=False)
class Route:
    """Way of a transition from one leaf: the modes left, inner ones first, and those entered, outer ones first.

    `leaves` are where it may end. There are several where `resumes`, an outer mode, knows in which it was left.
    """

    number: int
    transition: Transition
    source: Leaf
    left: tuple[Mode, ...]
    entered: Mode | None
    leaves: tuple[Leaf, ...]
    resumes: Mode | None


class Chart:
    """The checked modes and transitions of a machine. Raises DiagramError for names that are wrong or missing.

    `routes` are those of each leaf, by its number, in the order in which they are tried. Those of the mode around it
    come first; those of one mode stand in the order in which they are listed.
    """

    def __init__(self, modes: Sequence[Mode], transitions: Sequence[Transition]) -> None:
        self.modes = _listed(modes, Mode, "modes", MAX_MODES)
        self.transitions: list[Transition] = _listed(transitions, Transition, "transitions", MAX_TRANSITIONS)
        if not self.modes:
            raise DiagramError("there is no mode to start in", "", 'write modes = [Mode("..."), ...]; the first starts')
        self.leaves: list[Leaf] = []
        self.by_name: dict[str, Mode] = {}
        self.outers: list[Mode] = []
        for mode in self.modes:
            self._add(mode, None)
        if len(self.by_name) > MAX_MODES:
            raise DiagramError(f"more than {MAX_MODES} modes", "", "make several machines")
        self.around = {leaf.mode.name: leaf.outer for leaf in self.leaves}
        for t in self.transitions:
            for name in (t.source, t.target):
                if name not in self.by_name:
                    what = f"the transition {shown(t.source)} -> {shown(t.target)} names no mode"
                    raise DiagramError(what, "", f"there are: {nearest(name, self.by_name)}")
        self.routes: list[list[Route]] = []
        for leaf in self.leaves:
            self.routes.append(list(self._routes(leaf)))
            ways = [sum(len(route.leaves) for route in routes) for routes in self.routes]
            if ways[-1] > MAX_WAYS or sum(ways) > MAX_ALL_WAYS:
                what = f"more than {MAX_WAYS} ways out of {leaf.mode.name!r}, or {MAX_ALL_WAYS} in all"
                raise DiagramError(what, "", "make several machines")
        self.guards = [MachineFunction(t.when, f"when of {t.text}") for t in self.transitions]
        self.does = [None if t.do is None else MachineFunction(t.do, f"do of {t.text}") for t in self.transitions]
        self.actions = {
            (name, action): MachineFunction(getattr(mode, action), f"{action} of {name}")
            for name, mode in self.by_name.items()
            for action in ACTIONS
            if getattr(mode, action) is not None
        }

    def _add(self, mode: Mode, outer: Mode | None) -> None:
        check_name(mode.name, "modes")
        if mode.name in self.by_name:
            raise DiagramError(f"two modes are named {mode.name!r}", "", "name each mode once, inner ones too")
        self.by_name[mode.name] = mode
        inner = _listed(mode.inner, Mode, f"inner modes of {mode.name}", MAX_MODES)
        if not inner:
            if mode.history:
                raise DiagramError(
                    f"{mode.name!r} has a history", "", "only a mode with inner ones has something to know"
                )
            self.leaves.append(Leaf(len(self.leaves), mode, outer))
            return
        if outer is not None:
            what = f"{mode.name!r} is inside {outer.name!r} and has inner modes itself"
            raise DiagramError(
                what, "", "modes have two levels: put its inner modes beside it, or into another machine"
            )
        self.outers.append(mode)
        for one in inner:
            self._add(one, mode)

    def inside(self, outer: Mode) -> list[Leaf]:
        """Return the leaves inside a mode, its start first."""
        return [leaf for leaf in self.leaves if leaf.outer is outer]

    def leaf(self, mode: Mode) -> Leaf:
        """Return the leaf that a mode is, or starts in."""
        return next(leaf for leaf in self.leaves if mode in leaf.path)

    def _routes(self, leaf: Leaf) -> Iterator[Route]:
        for mode in leaf.path:
            for number, t in enumerate(self.transitions):
                if t.source == mode.name:
                    yield self._route(number, t, leaf)

    def _route(self, number: int, t: Transition, leaf: Leaf) -> Route:
        target = self.by_name[t.target]
        end = self.leaf(target)
        # A mode around both ends stays. It is left if it is itself the source or the target.
        stays = leaf.outer is not None and leaf.outer is end.outer and leaf.outer.name not in (t.source, t.target)
        left = (leaf.mode,) if stays or leaf.outer is None else (leaf.mode, leaf.outer)
        entered = None if stays else end.outer
        inside = self.inside(target)
        if target.history and len(inside) > 1:
            return Route(number, t, leaf, left, entered, tuple(inside), target)
        return Route(number, t, leaf, left, entered, (end,), None)


def _listed(given: Sequence[Any], kind: type, what: str, most: int) -> list[Any]:
    if isinstance(given, str) or not isinstance(given, Sequence) or not all(isinstance(one, kind) for one in given):
        raise DiagramError(f"{what} are {shown(given)}", "", f"write a list of {kind.__name__}(...)")
    if len(given) > most:
        raise DiagramError(f"{len(given)} {what}", "", f"at most {most}: make several machines")
    return list(given)
