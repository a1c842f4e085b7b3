"""State space of the failsafe's state machine, its specification written a second time, and its properties."""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.flight.failsafe.expr_arrays import combinations, flags
from twodof.flight.failsafe.causes_and_actions import ACTIONS
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, DISARMED, FLYING, LEVEL, OFF, REFUSED, STATES

Array = NDArray[Any]
Table = Mapping[str, Array]
"""Inputs and states by name, outputs as "output.state", next states as "update.state", each (cases,)."""

FLAGS = ("arm", "ready", "off", "descend", "brake", "level", "stuck", "user_given", "user_lost", "command_lost")
LIMITS = {"level_ticks": 4, "descent_ticks": 3}
"""Small bounds of the timer. With the real ones the compiled C is explored."""

STRANGE = (-1, 7, 99)
"""States that do not exist, as a flipped bit could make them."""


TIMERS = (*range(max(LIMITS.values())), 24, -3)
"""Every count below the bounds, and what a flipped bit could make of one."""


@functools.cache
def cases(timers: tuple[int, ...] = TIMERS) -> dict[str, Array]:
    """Every state, real or not, with each count and every vector of flags."""
    return combinations(state=(*range(len(STATES)), *STRANGE), timer=timers, user_failed=(False, True), **flags(*FLAGS))


def meant(state: int, timer: int, user_failed: bool, now: Mapping[str, bool], limits: Mapping[str, int]) -> list[Any]:
    """The state machine as docs/explanation/safety.md tells it, with plain ifs: its outputs, then its next states."""
    user_flew = now["user_given"] and not user_failed and state == FLYING
    may_turn = state in (FLYING, LEVEL, BRAKE, DESCEND)
    stuck_off = may_turn and now["stuck"] and not user_flew
    failed = now["arm"] and (user_failed or (user_flew and now["stuck"]))
    count = max(timer, 0) + 1
    if not now["arm"]:
        new = DISARMED
    elif state == DISARMED:
        quiet = not (now["off"] or now["descend"] or now["brake"] or now["level"])
        new = FLYING if now["ready"] and quiet else REFUSED
    elif not may_turn:
        new = state
    elif now["off"] or stuck_off:
        new = OFF
    elif state == DESCEND:
        new = OFF if count >= limits["descent_ticks"] else DESCEND
    elif now["descend"] or (state in (LEVEL, BRAKE) and count >= limits["level_ticks"]):
        new = DESCEND
    elif now["brake"]:
        new = BRAKE
    elif now["level"] or failed:
        new = LEVEL
    else:
        new = FLYING
    turn = new in (FLYING, LEVEL, BRAKE, DESCEND)
    goes_on = (new in (LEVEL, BRAKE) and state in (LEVEL, BRAKE)) or new == state == DESCEND
    action = {FLYING: "none", LEVEL: "level", BRAKE: "brake", DESCEND: "descend"}.get(new, "off")
    outputs = [
        new,
        count if goes_on else 0,
        ACTIONS.index(action),
        turn,
        now["user_given"] and new == FLYING and not failed,
    ]
    after = OFF if now["command_lost"] and turn else new
    return [*outputs, failed, not turn, stuck_off, after, outputs[1], now["arm"] and (failed or now["user_lost"])]


COLUMNS = (
    *(
        f"output.{name}"
        for name in ("state", "timer", "action", "armed", "user_flies", "failed", "stopped", "stuck_off")
    ),
    *(f"update.{name}" for name in ("state", "timer", "user_failed")),
)


@functools.cache
def meant_table(level_ticks: int, descent_ticks: int, timers: tuple[int, ...] = TIMERS) -> dict[str, Array]:
    """`meant` in all `cases`, for these bounds."""
    limits = {"level_ticks": level_ticks, "descent_ticks": descent_ticks}
    columns = {name: column.tolist() for name, column in cases(timers).items()}
    flag_rows = zip(*(columns[name] for name in FLAGS), strict=True)
    named = functools.cache(lambda now: dict(zip(FLAGS, now, strict=True)))
    rows = [
        meant(state, timer, failed, named(now), limits)
        for state, timer, failed, now in zip(
            columns["state"], columns["timer"], columns["user_failed"], flag_rows, strict=True
        )
    ]
    return {name: np.array(column) for name, column in zip(COLUMNS, zip(*rows, strict=True), strict=True)}


def turning(state: Array) -> Array:
    """Return True where motors may turn in a state."""
    return (state >= FLYING) & (state <= DESCEND)


PROPERTIES: dict[str, Callable[[Table], Array]] = {
    "disarmed means that the motors stand": lambda t: (
        t["arm"] | (t["output.stopped"] & (t["update.state"] == DISARMED))
    ),
    "only states in which motors may turn do not stop them": lambda t: (
        t["output.stopped"] != turning(t["output.state"])
    ),
    "armed is said where motors may turn": lambda t: t["output.armed"] == ~t["output.stopped"],
    "off stays off until disarmed": lambda t: (t["state"] != OFF) | ~t["arm"] | (t["update.state"] == OFF),
    "refused stays until disarmed": lambda t: (t["state"] != REFUSED) | ~t["arm"] | (t["update.state"] == REFUSED),
    "a state that is none stops until disarmed": lambda t: (
        np.isin(t["state"], (DISARMED, REFUSED, FLYING, LEVEL, BRAKE, DESCEND, OFF)) | t["output.stopped"]
    ),
    "what arms is ready, and nothing is wrong": lambda t: (
        (t["state"] != DISARMED)
        | t["output.stopped"]
        | (t["arm"] & t["ready"] & ~(t["off"] | t["descend"] | t["brake"] | t["level"]))
    ),
    "ready arms where nothing is wrong": lambda t: (
        (t["state"] != DISARMED)
        | ~(t["arm"] & t["ready"] & ~(t["off"] | t["descend"] | t["brake"] | t["level"]))
        | (t["output.state"] == FLYING)
    ),
    "off stops in the same tick": lambda t: ~t["off"] | t["output.stopped"],
    "the stock controller stuck stops in the same tick": lambda t: ~t["output.stuck_off"] | t["output.stopped"],
    "a lost command is off in the next tick": lambda t: (
        ~t["command_lost"] | ~turning(t["output.state"]) | (t["update.state"] == OFF)
    ),
    "descend is not left but for off": lambda t: (
        (t["state"] != DESCEND) | ~t["arm"] | np.isin(t["output.state"], (DESCEND, OFF))
    ),
    "descend comes in the same tick": lambda t: ~t["descend"] | t["output.stopped"] | (t["output.state"] == DESCEND),
    "brake comes in the same tick": lambda t: (
        ~t["brake"] | t["output.stopped"] | np.isin(t["output.state"], (BRAKE, DESCEND))
    ),
    "level comes in the same tick": lambda t: ~t["level"] | t["output.stopped"] | (t["output.state"] != FLYING),
    "a failed controller does not fly": lambda t: ~t["user_failed"] | ~t["output.user_flies"],
    "a failed controller is failed until disarmed": lambda t: ~(t["user_failed"] & t["arm"]) | t["update.user_failed"],
    "a controller lost in this tick has failed in the next": lambda t: (
        ~(t["user_lost"] & t["arm"]) | t["update.user_failed"]
    ),
    "a user's controller flies only where nothing acts": lambda t: (
        ~t["output.user_flies"] | (t["output.state"] == FLYING)
    ),
    "silent by default": lambda t: (
        (t["state"] != FLYING)
        | ~t["arm"]
        | t["off"]
        | t["descend"]
        | t["brake"]
        | t["level"]
        | t["stuck"]
        | t["user_failed"]
        | ((t["output.state"] == FLYING) & (t["output.user_flies"] == t["user_given"]))
    ),
}
"""What holds in each single case. How long something lasts is told by `longest`."""


def violated(table: Table) -> list[str]:
    """The properties that some case breaks."""
    return [name for name, holds in PROPERTIES.items() if not bool(np.all(holds(table)))]


def reached(table: Table) -> Array:
    """Which cases can come about, (cases,): those with a (state, timer, user_failed) reachable from power-on."""
    before, _ = _codes(table)
    source, target, nodes = _edges(table, np.ones(len(before), np.bool_))
    found = nodes == _code(np.array([DISARMED]), np.array([0]), np.array([False]))[0]
    count = 0
    while count < found.sum():
        count = int(found.sum())
        found[target[found[source]]] = True
    inside = np.zeros(1 << _BITS, np.bool_)
    inside[nodes[found]] = True
    return inside[before]


def longest(table: Table, states: tuple[int, ...]) -> int:
    """The most ticks in a row that can be spent in `states`, from anywhere that can be reached; -1 if no bound."""
    source, target, nodes = _edges(table, reached(table) & np.isin(table["output.state"], states))
    alive = np.zeros(len(nodes), np.bool_)
    alive[source] = True
    ticks = 0
    while alive.any():  # those from which a path of `ticks` + 1 steps in these states begins
        ticks += 1
        left = np.zeros(len(nodes), np.bool_)
        left[source[alive[target]]] = True
        if np.array_equal(left, alive):
            return -1
        alive = left
    return ticks


_BITS = 22


def _code(state: Array, timer: Array, failed: Array) -> Array:
    """A number for each internal state; the timer's real bounds, and what tests overwrite it with, stay apart."""
    number = ((np.asarray(state, np.int64) & 127) << 14) + ((np.asarray(timer, np.int64) & 8191) << 1)
    return number + np.asarray(failed, np.int64)


def _codes(table: Table) -> tuple[Array, Array]:
    before = _code(table["state"], table["timer"], table["user_failed"])
    return before, _code(table["update.state"], table["update.timer"], table["update.user_failed"])


def _edges(table: Table, used: Array) -> tuple[Array, Array, Array]:
    """The transitions of the cases `used`: from, to, as places in the codes that they join."""
    before, after = _codes(table)
    pairs = np.unique((before[used] << _BITS) + after[used])
    nodes, place = np.unique(np.concatenate([pairs >> _BITS, pairs & ((1 << _BITS) - 1)]), return_inverse=True)
    return place[: len(pairs)], place[len(pairs) :], nodes
