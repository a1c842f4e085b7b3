"""User controllers that are tuned while they fly: at one tick, with what `prepare` derives; what is kept of it."""

import math
import time
from pathlib import Path

import pytest

from tests.fcu.flights import Script, controller, exhausting, fly
from tests.fcu.parameters.tuned import KIND, tuned
from tests.fcu.steps import plain_step
from twodof.blocks import Diagram
from twodof.errors import ControllerFault, ParameterError
from twodof.fcu.control.flight_code import FlightCode
from twodof.fcu.control.sandbox import BUDGET_NS
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.parameter_store import MOST_TUNED, ParametersRelisted, ParameterStore
from twodof.fcu.parameters.table import user_parameters
from twodof.flight.failsafe.causes_and_actions import ACTIONS, BIT
from twodof.flight.starters import starter
from twodof.flightlog.ulog_file import scan_ulog
from twodof.signals import TICK_US

pytestmark = pytest.mark.slow

NONE, LEVEL = ACTIONS.index("none"), ACTIONS.index("level")
AT, UNTIL = 300, 400
ABOVE, BELOW = f"{KIND}.law.above", f"{KIND}.law.below"
BOTH = pytest.mark.parametrize("trusted", [False, True], ids=["sandbox", "inside"])


@pytest.mark.long
@BOTH
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_change_acts_in_the_next_tick_and_runs_prepare(trusted: bool, precision: str) -> None:
    left, changed = (controller(FlightCode([tuned()], trusted, precision=precision)) for _ in range(2))
    for made in (left, changed):
        fly(made, AT)
    changed.code.set_parameters({ABOVE: 1.0})
    steps = [fly(made, UNTIL) for made in (left, changed)]
    assert [step.M for step in steps[0][:AT]] == [step.M for step in steps[1][:AT]]
    before, after = steps[0][AT].M, steps[1][AT].M
    assert 2.0 * after == pytest.approx(before, rel=1e-6)  # the gain is above / below
    assert changed.code.parameter(ABOVE) == 1.0
    assert changed.latest is not None
    assert changed.latest.action == NONE


@BOTH
def test_a_value_of_which_prepare_makes_nan_is_handled_as_a_moment_that_is_no_number(trusted: bool) -> None:
    made = controller(FlightCode([tuned()], trusted))
    fly(made, AT)
    made.code.set_parameters({ABOVE: 0.0, BELOW: 0.0})
    steps = fly(made, UNTIL)
    for step in steps[AT:]:
        assert math.isfinite(step.M)
        assert step.armed
        assert step.fore > 0.0
    assert all(step.action == LEVEL and step.reason == BIT["user_failed"] for step in steps[AT + 1 :])


@BOTH
@pytest.mark.parametrize("wrong", [{ABOVE: 11.0}, {ABOVE: math.nan}, {f"{KIND}.law.not_there": 1.0}])
def test_a_value_that_cannot_be_changes_nothing_of_what_comes_with_it(trusted: bool, wrong: dict[str, float]) -> None:
    code = FlightCode([tuned()], trusted)
    before = code.parameter("ATT_KP"), code.parameter(ABOVE)
    with pytest.raises(ParameterError):
        code.set_parameters({"ATT_KP": 3.0, "failsafe.battery.low": 9.0, **wrong})
    assert (code.parameter("ATT_KP"), code.parameter(ABOVE)) == before
    assert code.parameter("failsafe.battery.low") != 9.0


def test_what_has_stopped_in_its_sandbox_takes_gains_and_begins_anew_with_its_own_once_disarmed() -> None:
    made = controller(FlightCode([_exhausting()], fuel=15_000), Script(disarm_at=AT + 50))
    fly(made, AT + 10)
    assert "fuel" in made.code.user_fault
    made.code.set_parameters({"ATT_KP": 3.0, f"{KIND}.gain": 0.5})
    assert "fuel" in made.code.user_fault, "armed, it stays stopped"
    fly(made, AT + 60)
    assert made.code.user_fault == ""
    assert made.code.parameter(f"{KIND}.gain") == 0.5
    assert made.code.parameter("ATT_KP") == 3.0
    made.code.reset()
    assert made.code.parameter(f"{KIND}.gain") == 0.5


def _exhausting() -> Diagram:
    """It has a parameter, and runs out of fuel at its step `AT`."""
    d = exhausting(AT)
    d.param("gain", 1.0, low=0.0, high=1.0)
    return d


def test_values_are_there_after_a_restart_for_the_very_same_diagram_alone(tmp_path: Path) -> None:
    path = tmp_path / "parameters.json"
    (own,) = user_parameters([tuned()])
    with ParameterStore(path) as store:
        assert store.carry([own]) == ()
        store.update({"TMI_LAW_ABOVE": 5.0, "TMI_LAW_WEIGHT_1": 0.25, "TMI_LAW_INVERTED": 1, "RATE_KP": 0.07})
    with ParameterStore(path) as again:
        assert "TMI_LAW_ABOVE" not in again
        (said,) = again.carry([own])
        assert "flies as it was tuned before" in said
        assert again.user_values()[ABOVE] == 5.0
        assert again.user_values()[f"{KIND}.law.weights"] == [1 / 3, 0.25]
        assert again.changed().keys() == {"TMI_LAW_ABOVE", "TMI_LAW_WEIGHT_1", "TMI_LAW_INVERTED", "RATE_KP"}
    other = tuned()
    other.param("one_more", 1.0)
    with ParameterStore(path) as last:
        (said,) = last.carry(user_parameters([other]))
        assert "another diagram: 3 stored values of an earlier one are left out" in said
        assert last.changed() == {"RATE_KP": 0.07}
        (said,) = last.carry([own])
        assert "TMI_LAW_ABOVE" in said, "and they are not lost by that"
        last.reset()
    with ParameterStore(path) as reset:
        assert reset.carry([own]) == ()
        assert reset.changed() == {}


def test_what_was_tuned_longest_ago_is_forgotten(tmp_path: Path) -> None:
    path = tmp_path / "parameters.json"
    found = []
    for number in range(MOST_TUNED + 2):
        d = tuned()
        d.param(f"number{number}", 1.0)
        found += user_parameters([d])
    with ParameterStore(path) as store:
        for own in found:
            store.carry([own])
            store.update({"TMI_LAW_ABOVE": 5.0})
    with ParameterStore(path) as again:
        remembered = []
        for own in found:
            again.carry([own])
            remembered.append(again["TMI_LAW_ABOVE"] == 5.0)
    assert remembered == [False] * 2 + [True] * MOST_TUNED


def test_the_list_changes_with_what_flies_and_nothing_else_does() -> None:
    store, (own,), relisted = ParameterStore(values={"RATE_KP": 0.07}), user_parameters([tuned()]), []
    store.bus.subscribe(ParametersRelisted, lambda _: relisted.append(len(store.rows)))
    count, digest, revision = len(store.rows), store.hash_check(), store.revision
    store.carry([own])
    assert relisted == [count + len(own.rows)]
    assert store.hash_check() != digest
    assert store.revision > revision
    assert [store.index(row.name) for row in store.rows] == [*range(len(store))]
    assert store["RATE_KP"] == 0.07
    store.update({"TMI_LAW_ABOVE": 5.0}, armed=True)
    store.carry([own])
    assert len(relisted) == 1, "the same once more is no change"
    store.carry([])
    assert (len(store.rows), store.hash_check(), store["RATE_KP"]) == (count, digest, 0.07)
    assert store.user_values() == {}


def test_a_sandbox_that_stops_in_prepare_is_replaced_and_takes_the_value_once_it_begins_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = controller(FlightCode([tuned()]), Script(disarm_at=AT + 50))
    fly(made, AT)
    sandbox = made.code.sandbox
    assert sandbox is not None

    def stops() -> None:
        raise ControllerFault("it used up its fuel", "prepare")

    monkeypatch.setattr(sandbox.machine.instance, "prepare", stops)
    made.code.set_parameters({ABOVE: 3.0, "ATT_KP": 3.0})
    assert "fuel" in made.code.user_fault
    steps = fly(made, AT + 40)
    assert all(step.action == LEVEL and step.armed and math.isfinite(step.M) for step in steps[AT + 1 :])
    fly(made, AT + 60)
    assert made.code.user_fault == ""
    assert (made.code.parameter(ABOVE), made.code.parameter("ATT_KP")) == (3.0, 3.0)


def test_in_real_time_the_time_of_a_change_is_part_of_the_next_step(monkeypatch: pytest.MonkeyPatch) -> None:
    made, now = controller(FlightCode([tuned()]), lockstep=False), 0
    fly(made, AT)
    monkeypatch.setattr(time, "thread_time_ns", lambda: now)
    sandbox = made.code.sandbox
    assert sandbox is not None
    prepare = sandbox.machine.instance.prepare

    def slow() -> None:
        nonlocal now
        now += BUDGET_NS + 1
        prepare()

    monkeypatch.setattr(sandbox.machine.instance, "prepare", slow)
    made.code.set_parameters({ABOVE: 3.0})
    steps = fly(made, UNTIL)
    assert all(step.action == LEVEL and step.reason == BIT["user_failed"] for step in steps[AT + 1 :])


@BOTH
def test_a_state_begins_at_the_parameter_that_is_set(trusted: bool) -> None:
    code = FlightCode([starter("lqr-attitude")], trusted)
    code.set_parameters({f"{KIND}.integral.initial": 0.125})
    code.reset()
    machine = code.machine if code.sandbox is None else code.sandbox.machine
    states = [path for path in machine.program.states if ".integral." in path]
    assert 0.125 in [machine.state(path) for path in states]


def test_a_log_lists_what_flies_and_notes_what_begins_to_fly_in_its_midst(tmp_path: Path) -> None:
    store, own = ParameterStore(values={"SDLOG_MODE": 2}), user_parameters([tuned()])
    names = {row.name for one in own for row in one.rows}
    with OnboardLogger(tmp_path, store, lockstep=True) as log:
        for tick in range(10):
            log.step(plain_step(tick))
        store.carry(own)
        store.update({"TMI_LAW_ABOVE": 5.0})
        for tick in range(10, 20):
            log.step(plain_step(tick))
        log.end()
        log.step(plain_step(20))
        log.end()
        store.carry([])
        log.step(plain_step(21))
    found = [scan_ulog(one.path.read_bytes(), "") for one in log.logs()]
    assert [names & one.parameters.keys() for one in found] == [set(), names, set()]
    assert {name for _, name, _ in found[0].changes} == names
    assert found[0].changes[-1] == (9 * TICK_US, "TMI_LAW_ABOVE", 5.0)
    assert found[1].parameters["TMI_LAW_ABOVE"] == 5.0
