"""Modes and transitions: what a state machine is made of, as its user writes it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twodof.blocks.namespaces import Clock
from twodof.blocks.plain_data import plain_data
from twodof.errors import DiagramError, shown

ACTIONS = ("entry", "during", "exit")
ARGUMENTS = ("u", "x", "p", "t")
Action = Callable[..., Any] | Mapping[str, Any] | None
Guard = Callable[..., Any] | bool


@dataclass(frozen=True, eq=False)
class Mode:
    """What a state machine can be in; a `State` is what a block remembers.

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
