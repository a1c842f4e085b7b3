"""The failsafe's state machine and timers, explored whole: every state, every count, every vector of flags."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.flight.failsafe.expr_arrays import combinations, flags, graph_of, mutants, mutants_on_arrays, on_arrays, tell
from tests.flight.failsafe.machine_space import (
    COLUMNS,
    FLAGS,
    LIMITS,
    PROPERTIES,
    cases,
    longest,
    meant_table,
    reached,
    violated,
)
from tests.flight.failsafe.unrolled import unrolled
from twodof.blocks import Block
from twodof.flight.declarations import tunable
from twodof.flight.failsafe.causes_and_actions import BIT, CAUSES, LEVEL, NONE, OFF, RequestedActions, named_causes
from twodof.flight.failsafe.diagram import TIMERS
from twodof.flight.failsafe.flags import OffDelay, WatchdogTimer
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, FLYING, MAY_TURN, REFUSED, FailsafeStateMachine
from twodof.flight.failsafe.state_machine import LEVEL as LEVELLING

pytestmark = pytest.mark.slow

EQUIVALENT = {
    "lt: le": "maximum(timer, 0) of 0 is 0 either way",
    "lt[0]: 0 is -1": "maximum(timer, 0): no integer lies between -1 and 0",
}
"""Mutants of the state machine that no case tells from it, and why. That none does is explored."""


def run(machine: Any, columns: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The compiled step of a block in every case: its outputs and next states, named as in a graph."""
    inputs = {
        (name if name in machine.program.flat.inputs else f"before_{name}"): column for name, column in columns.items()
    }
    out = machine.run(len(next(iter(columns.values()))), inputs)
    return {
        f"update.{name.removeprefix('after_')}" if name.startswith("after_") else f"output.{name}": value
        for name, value in out.items()
    }


REAL_BOUNDS = (2500, 250)
SAMPLE = 1000
"""A property is tried first on about so many of the cases that a mutant changes, and on all where it holds in these."""


@pytest.fixture(scope="module", params=[(100, 25), pytest.param(REAL_BOUNDS, marks=pytest.mark.soak)])
def bounds(request: pytest.FixtureRequest) -> tuple[int, int]:
    """For how many ticks level and brake, and descend, last at most."""
    return request.param


@pytest.fixture(scope="module")
def explored(bounds: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """The compiled state machine with these bounds in all its states and counts, with all vectors of flags."""
    machine = unrolled(FailsafeStateMachine())
    assert tuple(round(machine.get(f"block.{name}") / 0.004) for name in ("level_limit", "descent")) == REAL_BOUNDS
    level, descent = bounds
    machine.set_many({"block.level_limit": 0.004 * level, "block.descent": 0.004 * descent})
    timers = {LEVELLING: level, BRAKE: level, DESCEND: descent}
    rows = np.array(
        [(state, timer, failed) for state in range(7) for timer in range(timers.get(state, 1)) for failed in (0, 1)]
    )
    vectors = combinations(**flags(*FLAGS))
    count = len(vectors["arm"])
    columns = {name: np.tile(column, len(rows)) for name, column in vectors.items()}
    for place, name in enumerate(("state", "timer", "user_failed")):
        columns[name] = np.repeat(rows[:, place], count).astype(np.bool_ if name == "user_failed" else np.int32)
    return columns | run(machine, columns)


def test_the_compiled_machine_keeps_every_property_in_every_case(explored: dict[str, NDArray[Any]]) -> None:
    inside = reached(explored)
    tell(f"{len(inside)} cases, {inside.sum()} of them reachable")
    assert len(inside) > 400_000
    assert violated(explored) == []


def test_actions_last_as_long_as_stated_at_most(explored: dict[str, NDArray[Any]], bounds: tuple[int, int]) -> None:
    assert (longest(explored, (LEVELLING, BRAKE)), longest(explored, (DESCEND,))) == bounds
    flying = {name: column[explored["state"] == FLYING] for name, column in explored.items()}
    assert np.isin(flying["output.state"], [0, *MAY_TURN, 6]).all()


def test_no_reachable_state_leads_back_to_turning_motors_but_by_disarming(explored: dict[str, NDArray[Any]]) -> None:
    stands = ~np.isin(explored["state"], MAY_TURN)
    starts = stands & explored["output.armed"]
    assert set(explored["state"][starts].tolist()) == {0}
    assert explored["arm"][starts].all()
    assert explored["ready"][starts].all()


@pytest.mark.long
def test_it_does_what_is_meant_in_every_case_states_that_do_not_exist_included() -> None:
    compiled = unrolled(FailsafeStateMachine())
    compiled.set_many({"block.level_limit": 0.1, "block.descent": 0.1})
    around = (0, 24, -3)  # counts of the compiled one, whose bounds are the least that its parameters allow
    for expected, out in (
        (meant_table(**LIMITS), on_arrays(graph_of(FailsafeStateMachine()), cases() | LIMITS)),
        (meant_table(25, 25, around), run(compiled, cases(around))),
    ):
        for name in COLUMNS:
            np.testing.assert_array_equal(out[name], expected[name], name)


@pytest.mark.long
def test_no_mutant_of_the_machine_survives_but_those_explained() -> None:
    """And some mutant breaks each property, so none holds of itself."""
    expected, by_properties, by_meaning, survivors = meant_table(**LIMITS), 0, 0, []
    broken: set[str] = set()
    graph, columns = graph_of(FailsafeStateMachine()), cases() | LIMITS
    own = on_arrays(graph, columns)
    assert all(np.array_equal(own[name], expected[name]) for name in COLUMNS)
    assert violated(cases() | expected) == []
    for what, changed in mutants_on_arrays(graph, mutants(graph), columns):
        # A property is of single cases: where nothing differs it holds.
        differ = np.zeros(len(own["output.state"]), np.bool_)
        for name, column in changed.items():
            differ |= column != expected[name]
        rows = np.flatnonzero(differ)
        for tried in (rows[:: 1 + len(rows) // SAMPLE], rows):
            now = violated({name: column[tried] for name, column in (cases() | expected | changed).items()})
            if now:
                break
        if now:
            broken.update(now)
            by_properties += 1
        elif len(rows):
            by_meaning += 1
        else:
            survivors.append(what.partition(" ")[2])
    tell(f"killed by the properties {by_properties}, by the meaning {by_meaning}; left {survivors}")
    assert sorted(survivors) == sorted(EQUIVALENT)
    assert by_properties > 200
    assert broken == set(PROPERTIES)


def explore_timer(block: Block, inputs: str, limit: int) -> dict[str, NDArray[Any]]:
    """The compiled step of a timer from every count it can have, with its flag false and true."""
    (state,) = block.states
    columns = combinations(**{inputs: (False, True), state.name: tuple(range(limit + 1))})
    columns[state.name] = columns[state.name].astype(np.int32)
    return columns | run(unrolled(block), columns)


@pytest.mark.parametrize("name", TIMERS)
def test_a_timeout_expires_after_its_ticks_and_never_else(name: str) -> None:
    block = WatchdogTimer(tunable(f"failsafe.{name}.timeout"))
    limit = round(block.params[0].value / 0.004)
    table = explore_timer(block, "alive", limit)
    alive, count = table["alive"], table["count"]
    np.testing.assert_array_equal(table["update.count"], np.where(alive, 0, np.minimum(count + 1, limit)))
    np.testing.assert_array_equal(table["output.expired"], ~alive & (count + 1 >= limit))


def test_a_linger_lasts_its_ticks_and_not_longer() -> None:
    table = explore_timer(OffDelay(), "flag", 125)
    np.testing.assert_array_equal(table["update.left"], np.where(table["flag"], 125, np.maximum(table["left"] - 1, 0)))
    np.testing.assert_array_equal(table["output.lasting"], table["flag"] | (table["left"] > 0))


def meant_timeout(alive: bool, count: int, limit: int) -> tuple[bool, int]:
    now = 0 if alive else min(max(count, 0) + 1, limit) if count < limit else limit
    return not alive and now >= limit, now


def meant_linger(flag: bool, left: int, limit: int) -> tuple[bool, int]:
    return flag or left > 0, limit if flag else max(1, min(left, limit)) - 1


TIMER_EQUIVALENTS = {
    WatchdogTimer: {
        "lt: le": "maximum(count, 0) of 0 is 0 in both branches",
        "lt[0]: 0 is -1": "maximum(count, 0): no integer lies between",
        "lt[1]: limit sub 1": "count < limit: limit - 1 and one more is the limit, the other branch",
    },
    OffDelay: {
        "lt: le": "minimum and maximum of two equals",
        "lt[1]: 1 is 2": "maximum(1, left) of 1 is 1 in both branches",
        "lt[1]: limit add 1": "minimum(left, limit) of the limit is the limit in both branches",
    },
}


@pytest.mark.parametrize(
    ("block", "flag", "state", "meant"),
    [(WatchdogTimer(), "alive", "count", meant_timeout), (OffDelay(), "flag", "left", meant_linger)],
    ids=["timeout", "linger"],
)
def test_no_mutant_of_a_timer_survives(
    block: Block, flag: str, state: str, meant: Callable[[bool, int, int], tuple[bool, int]]
) -> None:
    limit = 4
    columns = combinations(**{flag: (False, True), state: (*range(-3, limit + 4), 2**31 - 1, -(2**31))})
    expected = [meant(bool(f), int(c), limit) for f, c in zip(columns[flag], columns[state], strict=True)]
    graph = graph_of(block)

    def right(candidate: dict[str, Any]) -> bool:
        out, after = on_arrays(candidate, columns | {"limit": limit}).values()
        return [(bool(a), int(b)) for a, b in zip(out, after, strict=True)] == expected

    assert right(graph)
    survivors = {what.partition(" ")[2] for what, mutant in mutants(graph) if right(mutant)}
    assert survivors == set(TIMER_EQUIVALENTS[type(block)])


def test_every_cause_asks_for_its_action_and_every_mutant_of_that_is_found() -> None:
    outer = [cause for cause in CAUSES if not cause.inner]
    # All vectors with up to two causes, and all causes at once: what is said of each and of any two together.
    size = len(outer)
    vectors = np.vstack(
        [np.eye(size, dtype=bool)[:, None] | np.eye(size, dtype=bool)[None], np.ones((1, size, size), bool)]
    )
    rows = np.unique(np.vstack([vectors.reshape(-1, size), np.zeros((1, size), bool)]), axis=0)
    columns = {cause.name: rows[:, place] for place, cause in enumerate(outer)}

    def right(candidate: dict[str, Any]) -> bool:
        out = on_arrays(candidate, columns)
        for action, port in ((LEVEL, "level"), (2, "brake"), (3, "descend"), (OFF, "off")):
            expected = np.any([columns[c.name] for c in outer if c.action == action], axis=0)
            if not np.array_equal(out[f"output.{port}"], expected):
                return False
        mask = np.sum([columns[c.name] * BIT[c.name] for c in outer], axis=0)
        return np.array_equal(out["output.mask"], mask) and np.array_equal(out["output.ready"], mask == 0)

    assert right(graph_of(RequestedActions()))
    # A mask's bits are those of different causes: there a sum is the same as an or, and an or of all of them besides.
    survivors = [what for what, mutant in mutants(graph_of(RequestedActions())) if right(mutant)]
    assert survivors == []


def test_the_names_of_a_mask() -> None:
    assert named_causes(0) == ()
    assert named_causes(BIT["imu_lost"] | BIT["tilted"]) == ("imu_lost", "tilted")
    assert len({cause.name for cause in CAUSES}) == len(CAUSES) <= 31
    assert {cause.action for cause in CAUSES} == {NONE, LEVEL, 2, 3, OFF}
    assert REFUSED not in MAY_TURN
