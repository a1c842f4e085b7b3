"""Several parameters at once: all or none, at one tick; repeated without harm."""

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.mavlink.world import CLIENT, World
from twodof.fcu.command.command_lease import rejected
from twodof.fcu.mavlink.parameter_service import (
    BEGIN,
    COMMIT,
    DOES_NOT_EXIST,
    INT32,
    LONGEST_TICKS,
    MOST_OPEN,
    NO_ERROR,
    OUT_OF_RANGE,
    PERMISSION_DENIED,
    READ_FAIL,
    REAL32,
    ROLL_BACK,
    TYPE_MISMATCH,
)
from twodof.fcu.parameters.parameter_store import ParametersChanged
from twodof.link.mavlink.messages import message

US = {"target_system": 1, "target_component": 1}
OTHER = (251, 1)
GOOD = {"RATE_KP": 0.0625, "RATE_KI": 0.25, "ATT_KP": 8.0}


def transact(world: World, action: int, number: int = 1, count: int = 0, source: Any = CLIENT) -> Any:
    """The vehicle's answer."""
    fields = {"transaction": number, "count": count, "action": action}
    world.say(message("TWODOF_PARAM_TRANSACTION", **US, **fields), source=source)
    answers = world.taken("TWODOF_PARAM_TRANSACTION")
    assert len(answers) == 1
    assert (answers[0].transaction, answers[0].action) == (number, action)
    return answers[0]


def put(world: World, name: str, value: float, kind: int = REAL32, source: Any = CLIENT) -> None:
    world.say(message("PARAM_SET", param_id=name, param_value=value, param_type=kind, **US), source=source)


def put_all(world: World, values: dict[str, float], source: Any = CLIENT) -> None:
    for name, value in values.items():
        put(world, name, value, source=source)


def test_all_take_effect_together() -> None:
    world = World()
    before, revision = dict(world.store), world.store.revision
    assert transact(world, BEGIN).result == NO_ERROR
    put_all(world, GOOD)
    assert dict(world.store) == before
    assert world.taken("PARAM_VALUE") == []
    answer = transact(world, COMMIT, count=3)
    assert (answer.result, answer.count, answer.param_id) == (NO_ERROR, 3, "")
    assert {name: world.store[name] for name in GOOD} == GOOD
    assert world.store.revision == revision + 1
    assert {one.param_id for one in world.taken("PARAM_VALUE", None)} >= set(GOOD)


def test_one_that_is_refused_refuses_all() -> None:
    for name, value, kind, error in (
        ("VEL_KP", 1e6, REAL32, OUT_OF_RANGE),
        ("NONSENSE", 1.0, REAL32, DOES_NOT_EXIST),
        ("VEL_KP", 1.0, INT32, TYPE_MISMATCH),
    ):
        world = World()
        before = dict(world.store)
        transact(world, BEGIN)
        put_all(world, GOOD)
        put(world, name, value, kind)
        answer = transact(world, COMMIT, count=4)
        assert (answer.result, answer.param_id) == (error, name)
        assert dict(world.store) == before
        assert name in world.texts()


def test_one_that_is_missing_refuses_all_and_may_be_tried_anew() -> None:
    world = World()
    before = dict(world.store)
    transact(world, BEGIN)
    put(world, "RATE_KP", 0.0625)
    answer = transact(world, COMMIT, count=3)
    assert (answer.result, answer.count) == (READ_FAIL, 1)
    assert dict(world.store) == before
    transact(world, BEGIN, number=2)
    put_all(world, GOOD)
    put(world, "RATE_KP", 0.0625)  # one that comes twice counts once
    assert transact(world, COMMIT, number=2, count=3).result == NO_ERROR


def test_a_commit_may_overtake_what_belongs_to_it() -> None:
    world = World()
    before = dict(world.store)
    transact(world, BEGIN)
    put(world, "RATE_KP", 0.0625)
    put(world, "RATE_KI", 0.25)
    assert transact(world, COMMIT, count=3).result == READ_FAIL
    put(world, "ATT_KP", 8.0)  # comes late, and does not act alone
    assert dict(world.store) == before
    assert transact(world, COMMIT, count=3).result == NO_ERROR
    assert {name: world.store[name] for name in GOOD} == GOOD


def test_a_commit_that_comes_again_is_answered_again_and_not_done_again() -> None:
    world = World()
    transact(world, BEGIN)
    put_all(world, GOOD)
    transact(world, COMMIT, count=3)
    put(world, "RATE_KP", 0.05)
    again = transact(world, COMMIT, count=3)
    assert (again.result, again.count) == (NO_ERROR, 3)
    assert world.store["RATE_KP"] == 0.05


def test_roll_back_forgets() -> None:
    world = World()
    before = dict(world.store)
    transact(world, BEGIN)
    put_all(world, GOOD)
    assert transact(world, ROLL_BACK).result == NO_ERROR
    assert transact(world, COMMIT, count=3).result == READ_FAIL
    assert dict(world.store) == before
    put(world, "RATE_KP", 0.0625)  # and is over
    assert world.store["RATE_KP"] == 0.0625


def test_senders_do_not_mix() -> None:
    world = World()
    transact(world, BEGIN)
    put_all(world, GOOD)
    put(world, "ATT_KP", 9.0, source=OTHER)  # no transaction of its own: at once
    assert world.store["ATT_KP"] == 9.0
    assert transact(world, COMMIT, count=3, source=OTHER).result == READ_FAIL
    transact(world, BEGIN, source=OTHER)
    put(world, "VEL_KP", 1.5, source=OTHER)
    assert transact(world, COMMIT, count=3).result == NO_ERROR
    assert world.store["VEL_KP"] != 1.5
    assert transact(world, COMMIT, count=1, source=OTHER).result == NO_ERROR
    assert world.store["VEL_KP"] == 1.5


def test_one_that_is_not_for_tuning_makes_the_whole_a_command_and_its_refusal_says_so() -> None:
    world = World()
    transact(world, BEGIN)
    put_all(world, GOOD | {"M_MAX": 0.5})
    assert transact(world, COMMIT, count=4).result == NO_ERROR
    assert world.commander.asked == [("take", CLIENT, "M_MAX (not for tuning)")]
    world.commander.verdict = rejected("system 7 holds the lease")
    transact(world, BEGIN, number=2)
    put_all(world, GOOD | {"M_MAX": 0.25})
    answer = transact(world, COMMIT, number=2, count=4)
    assert (answer.result, answer.param_id) == (PERMISSION_DENIED, "M_MAX")
    assert world.store["M_MAX"] == 0.5


def test_what_is_never_ended_is_forgotten() -> None:
    world = World(profile={})
    transact(world, BEGIN)
    put_all(world, GOOD)
    for tick in (1, LONGEST_TICKS + 2):
        world.controller.tick = tick
        world.run()
    assert transact(world, COMMIT, count=3).result == READ_FAIL
    for system in range(2, 3 * MOST_OPEN):
        transact(world, BEGIN, source=(system, 1))
    ended = [transact(world, ROLL_BACK, source=(system, 1)).result for system in range(2, 3 * MOST_OPEN)]
    assert ended == [READ_FAIL] * (2 * MOST_OPEN - 2) + [NO_ERROR] * MOST_OPEN, "those that began last"


@settings(max_examples=30)
@given(st.data())
def test_any_order_of_anything_leaves_a_whole_set(data: st.DataObject) -> None:
    """Whatever two senders do, what is in force is always what some prefix of whole changes gives."""
    world = World(profile={})
    wholes = [dict(world.store)]
    world.store.bus.subscribe(ParametersChanged, lambda _: wholes.append(dict(world.store)))
    names = [*GOOD]
    for _ in range(data.draw(st.integers(1, 12))):
        source = data.draw(st.sampled_from([CLIENT, OTHER]))
        if data.draw(st.booleans()):
            put(world, data.draw(st.sampled_from(names)), data.draw(st.floats(0.0, 0.125, width=32)), source=source)
        else:
            action, number = data.draw(st.integers(0, 5)), data.draw(st.integers(0, 2))
            fields = {"transaction": number, "count": data.draw(st.integers(0, 3)), "action": action}
            world.say(message("TWODOF_PARAM_TRANSACTION", **US, **fields), source=source)
        assert dict(world.store) == wholes[-1]
