"""Excitations on board: the very bits of their definition at every tick, and every reason not to play."""

import json
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.command.cockpit import ME, OTHER, Cockpit, Rig, armed
from twodof.errors import ExperimentError
from twodof.excitation import KINDS, Doublet, Excitation, Impulse, Multisine, Prbs, Steps, Sweep, ThreeTwoOneOne
from twodof.experiment.experiments import EXPERIMENTS, script
from twodof.fcu.command import excitation_player
from twodof.fcu.command.excitation_player import (
    DONE,
    LOOPS,
    MOST_EFFORT,
    PLAYING,
    READY,
    REFUSED,
    STOPPED,
    prepare,
    written_out,
)
from twodof.fcu.control.hardware import ControlInput
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.flight.failsafe.state_machine import BRAKE
from twodof.flight.failsafe.state_machine import OFF as STOPPED_BY_FAILSAFE
from twodof.link.mavlink import modes
from twodof.link.mavlink.setpoints import SetPoint
from twodof.signals import ATTITUDE, OPEN_LOOP, PERIOD, POSITION, RATE, VELOCITY

pytestmark = pytest.mark.slow

M, Q, THETA, V, X = range(5)
PULSE = Impulse(0.1, 0.02, lead=0.008, settle=0.02)  # 12 ticks
VALUES = PULSE.at(np.arange(12) * PERIOD)
ONE_OF_EACH = (
    PULSE,
    Doublet(0.03, 0.6, repeat=3, pause=0.1),
    ThreeTwoOneOne(0.1, 0.3),
    Steps((0.1, 0.0, -0.1), 0.25),
    Sweep(0.15, 0.1, 1.0, 5.0, law="logarithmic"),
    Prbs(0.05, 0.06, 7),
    Multisine.schroeder(0.1, 4.0, range(1, 20)),
)


def ready(excitation: Excitation = PULSE, cockpit: Cockpit | None = None, transfer: int = 7) -> Cockpit:
    cockpit = cockpit or armed()
    assert cockpit.commander.excitation.define(ME, transfer, written_out(excitation)).accepted
    return cockpit


@pytest.mark.parametrize("excitation", ONE_OF_EACH, ids=lambda one: one.kind)
def test_the_bits_at_a_tick_do_not_depend_on_how_many_are_written_out(excitation: Excitation) -> None:
    """The script of an experiment computes the rest after it too, so in an array of another length."""
    values = written_out(excitation).values
    for longer in (1, 3, 250, 1001):
        there = excitation.at(np.arange(len(values) + longer) * PERIOD)
        np.testing.assert_array_equal(there[: len(values)], values)
        assert not there[len(values) :].any()


def test_all_kinds_are_among_those() -> None:
    assert {one.kind for one in ONE_OF_EACH} == set(KINDS)


@pytest.mark.parametrize("excitation", ONE_OF_EACH, ids=lambda one: one.kind)
def test_over_the_wire_it_is_the_same(excitation: Excitation) -> None:
    prepared = prepare(excitation.to_json().encode())
    np.testing.assert_array_equal(prepared.values, written_out(excitation).values)
    assert prepared.unit == excitation.unit


@pytest.mark.parametrize("name", sorted(EXPERIMENTS))
def test_what_is_asked_is_what_the_script_of_the_experiment_says(name: str) -> None:
    """Every ready-made experiment, tick by tick: mode, set-point, thrust and trim, from arming to disarming."""
    experiment = EXPERIMENTS[name]
    plan = script(experiment, -0.0625)
    commander_of = Cockpit(rig=Rig(rings=experiment.rings), lockstep=True)
    commander = commander_of.commander
    thrust, loop = float(np.float32(experiment.thrust)), (OPEN_LOOP, RATE, ATTITUDE, VELOCITY, POSITION).index
    hold = SetPoint(ATTITUDE, theta0=0.0, thrust=thrust) if experiment.rings else SetPoint(POSITION, x0=-0.0625)
    commander_of.run(plan.armed)
    assert commander.arming.arm(ME).result == 5
    commander_of.run()
    assert commander.arming.answer.accepted
    if thrust:
        commander.setpoint(ME, SetPoint(ATTITUDE, theta0=0.0, thrust=0.0))
        assert commander.set_mode(ME, modes.OFFBOARD).accepted
        for tick in range(plan.hold, plan.begin, 100):
            commander_of.run(max(0, tick - 1 - commander_of.tick))
            assert commander.setpoint(ME, hold, tick).accepted
    commander_of.run(max(0, plan.begin - 300 - commander_of.tick))
    ready(experiment.excitation, commander_of)
    where = loop(("off", "open-loop", "rate", "attitude", "velocity", "position").index(experiment.mode))
    assert commander.excitation.start(ME, 7, where, thrust, plan.begin).accepted
    commander_of.run(plan.end - commander_of.tick)
    assert commander.arming.disarm(ME).accepted
    commander_of.run(plan.steps - plan.end)
    asked = [step.asked for step in commander_of.steps]
    mode = np.array([one.mode for one in asked])
    np.testing.assert_array_equal(mode, plan.setpoints["mode"])
    np.testing.assert_array_equal([one.arm for one in asked], plan.arm)
    read = {"M_open": OPEN_LOOP, "q0": RATE, "theta0": ATTITUDE, "v0": VELOCITY, "x0": POSITION}
    for name, reader in read.items():  # each where the mode reads it
        given_ = np.array([getattr(one, name) for one in asked])
        wanted = np.asarray(plan.setpoints.get(name, np.zeros(plan.steps)))
        np.testing.assert_array_equal(given_[mode == reader], wanted[mode == reader])
    used = (mode >= OPEN_LOOP) & (mode <= ATTITUDE)
    np.testing.assert_array_equal(
        np.array([one.thrust for one in asked])[used], np.asarray(plan.setpoints["thrust"])[used]
    )
    trimmed = np.array([one.use_trim for one in asked])
    np.testing.assert_array_equal(trimmed[mode == OPEN_LOOP], np.asarray(plan.setpoints["use_trim"])[mode == OPEN_LOOP])
    assert all(step.asked.setpoint_new for step in commander_of.steps[plan.begin : plan.end])


@pytest.mark.parametrize("ahead", [0, 1, 7])
def test_it_begins_at_its_tick_and_its_base_is_held_after_its_end(ahead: int) -> None:
    cockpit = ready()
    start = cockpit.tick + ahead
    assert cockpit.commander.excitation.start(ME, 7, M, 0.4, start if ahead else 0).accepted
    asked = [cockpit.run() for _ in range(ahead + 30)]
    assert [one.mode for one in asked] == [0] * ahead + [OPEN_LOOP] * 30
    assert [one.M_open for one in asked[ahead:]] == [*VALUES, *[0.0] * 18]
    assert all(one.setpoint_new and one.use_trim and one.thrust == 0.4 for one in asked[ahead:])
    player = cockpit.commander.excitation.player
    assert (player.state, player.start, player.end) == (DONE, start, start + 12)
    assert cockpit.commander.custom_mode == modes.OFFBOARD


def test_it_is_added_to_the_set_point_in_use_of_its_loop_and_else_to_nothing() -> None:
    cockpit = ready(Impulse(0.1, 0.02, unit="rad"))
    cockpit.commander.setpoint(ME, SetPoint(ATTITUDE, theta0=0.25, thrust=0.5))
    cockpit.commander.set_mode(ME, modes.OFFBOARD)
    cockpit.run()
    assert cockpit.commander.excitation.start(ME, 7, THETA).accepted
    asked = cockpit.run()
    assert (asked.theta0, asked.thrust) == (0.25 + 0.1, 0.5)  # the thrust in use
    cockpit.run(20)
    cockpit.commander.setpoint(ME, SetPoint(RATE, q0=0.1))
    cockpit.run()
    ready(Impulse(0.1, 0.02, unit="rad"), cockpit, transfer=8)
    assert cockpit.commander.excitation.start(ME, 8, THETA).accepted
    assert cockpit.run().theta0 == 0.1


def test_without_any_thrust_in_use_it_flies_with_that_of_a_level_hold() -> None:
    cockpit = ready()
    assert cockpit.commander.excitation.start(ME, 7, M).accepted
    assert cockpit.run().thrust == 0.375


def test_an_impulse_at_no_thrust_is_flown_without_the_trim() -> None:
    cockpit = ready(Impulse(0.1, 0.02))
    assert cockpit.commander.excitation.start(ME, 7, M, 0.0).accepted
    asked = cockpit.run()
    assert (asked.mode, asked.thrust, asked.M_open, asked.use_trim) == (OPEN_LOOP, 0.0, 0.1, False)


def test_set_points_do_not_act_while_it_plays_and_take_over_after_it() -> None:
    cockpit = ready()
    cockpit.commander.setpoint(ME, SetPoint(RATE, q0=0.0, thrust=0.4))
    cockpit.commander.set_mode(ME, modes.OFFBOARD)
    cockpit.commander.excitation.start(ME, 7, M, 0.4)
    for value in VALUES:
        assert cockpit.commander.setpoint(ME, SetPoint(RATE, q0=1.0)).accepted
        assert (cockpit.run().mode, cockpit.steps[-1].asked.M_open) == (OPEN_LOOP, value)
    assert cockpit.run().mode == OPEN_LOOP
    cockpit.commander.setpoint(ME, SetPoint(RATE, q0=1.0))
    assert cockpit.run().mode == RATE


def test_a_start_that_comes_twice_is_done_once() -> None:
    cockpit = ready()
    for _ in range(2):
        assert cockpit.commander.excitation.start(ME, 7, M, 0.4).accepted
    asked = []
    for _ in range(20):
        asked.append(cockpit.run().M_open)
        cockpit.commander.excitation.start(ME, 7, M, 0.4)
    assert asked == [*VALUES, *[0.0] * 8]


def test_not_armed_nothing_plays() -> None:
    cockpit = Cockpit()
    cockpit.run(2)
    ready(cockpit=cockpit)
    assert "not armed" in cockpit.commander.excitation.start(ME, 7, M, 0.4).text
    start = cockpit.tick + 5
    assert cockpit.commander.excitation.start(ME, 7, M, 0.4, start).accepted  # armed by then, perhaps
    assert cockpit.run(20).mode == 0
    assert cockpit.commander.excitation.player.state == REFUSED
    assert cockpit.commander.excitation.player.reason == "not armed"


def failing(cockpit: Cockpit, acts: int, *causes: str) -> ControlInput:
    cockpit.failsafe.acts, cockpit.failsafe.causes = acts, sum(BIT[cause] for cause in causes)
    return cockpit.run()


@pytest.mark.parametrize(
    ("stop", "reason"),
    [
        (lambda one: one.commander.set_mode(ME, modes.HOLD), "mode hold was chosen"),
        (lambda one: one.commander.excitation.stop(ME), "by command"),
        (lambda one: one.commander.arming.disarm(OTHER), "disarmed"),
        (lambda one: one.commander.arming.kill(OTHER), "killed"),
        (lambda one: failing(one, BRAKE, "rail_near", "link_lost"), "brake: rail_near, link_lost"),
        (
            lambda one: failing(one, STOPPED_BY_FAILSAFE, "imu_lost", "rail_end"),
            "the motors were stopped: imu_lost, rail_end",
        ),
    ],
)
def test_it_is_stopped_with_the_reason_and_does_not_come_back(stop: Callable[[Cockpit], object], reason: str) -> None:
    cockpit = ready()
    cockpit.commander.excitation.start(ME, 7, M, 0.4)
    cockpit.run(5)
    assert cockpit.commander.excitation.player.state == PLAYING
    stop(cockpit)
    player = cockpit.commander.excitation.player
    assert player.state == STOPPED
    assert reason in player.reason
    assert cockpit.run().M_open == 0.0
    assert not cockpit.commander.excitation.start(ME, 7, M, 0.4).accepted


def test_one_that_waits_is_forgotten_with_the_disarming() -> None:
    cockpit = ready()
    cockpit.commander.excitation.start(ME, 7, M, 0.4, cockpit.tick + 20)
    cockpit.commander.arming.disarm(ME)
    cockpit.arm()
    assert cockpit.run(40).mode == 0


def test_loops_are_those_of_the_experiments() -> None:
    assert [(one.name, one.unit) for one in LOOPS] == [
        ("M_open", "-"),
        ("q0", "rad/s"),
        ("theta0", "rad"),
        ("v0", "m/s"),
        ("x0", "m"),
    ]


# Definitions from outside.

JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**400), 10**400) | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)
ODD = st.sampled_from([1e-9, 5e-324, 1e-3, 125, 3600.0, 16, True, [1, 2, 3], [0.1] * 3, [9999, 10_000], 1e308])
FIELDS = ("amplitude", "width", "period", "step", "levels", "hold", "clock", "order", "seed", "start_hz", "end_hz")
MORE_FIELDS = ("length", "law", "harmonics", "amplitudes", "phases", "unit", "lead", "settle", "pause", "repeat")


@settings(max_examples=40)
@given(
    base=st.sampled_from(ONE_OF_EACH),
    damage=st.dictionaries(st.sampled_from((*FIELDS, *MORE_FIELDS, "kind", "version", "else")), JSON | ODD, max_size=4),
)
def test_any_damage_to_a_definition_gives_a_definition_or_an_error_with_a_reason(
    base: Excitation, damage: dict[str, object]
) -> None:
    text = json.dumps(base.to_dict() | damage).encode()
    try:
        prepared = prepare(text)
    except ExperimentError:
        return
    assert np.isfinite(prepared.values).all()
    assert len(prepared.values) <= 900_000


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"{", "excitation: is not JSON (write it with to_json)"),
        (b"[]", "excitation: is not a table of values (write it with to_json)"),
        (
            Sweep(0.1, 5e-324, 1.0, 5.0, law="logarithmic").to_json().encode(),
            "sweep: a value is not finite (choose other frequencies)",
        ),
    ],
)
def test_what_is_no_definition_is_refused_in_these_words(data: bytes, what: str) -> None:
    with pytest.raises(ExperimentError) as refused:
        prepare(data)
    assert str(refused.value) == what


@pytest.mark.parametrize("name", ["lead", "settle", "period", "pause", "repeat", "harmonics"])
@pytest.mark.parametrize("number", [10**400, -(10**400), 1e9, -1e9])
def test_numbers_beyond_all_bounds_are_refused_and_no_fault(name: str, number: float) -> None:
    value = [number] if name == "harmonics" else number
    with pytest.raises(ExperimentError):
        prepare(json.dumps(Multisine.schroeder(0.1, 4.0, range(1, 20)).to_dict() | {name: value}).encode())


def test_a_new_definition_has_neither_start_nor_end_yet() -> None:
    cockpit = ready()
    assert cockpit.commander.excitation.start(ME, 7, M, 0.4).accepted
    cockpit.run(20)
    assert cockpit.commander.excitation.player.end > cockpit.commander.excitation.player.start > 0
    ready(cockpit=cockpit, transfer=8)
    assert (cockpit.commander.excitation.player.start, cockpit.commander.excitation.player.end) == (0, 0)


def test_before_any_definition_there_is_none() -> None:
    player = Cockpit().commander.excitation.player
    assert (player.state, player.transfer, player.reason, player.start, player.end) == (0, 0, "", 0, 0)
    assert (player.playing, player.waiting, player.unit, player.revision) == (False, False, "", 0)


@pytest.mark.parametrize("fault", [ZeroDivisionError, KeyError, IndexError, MemoryError, TypeError, ValueError])
def test_whatever_fails_in_writing_one_out_is_a_refusal(
    fault: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A definition from a link must not end the control loop."""

    def fails(values: object) -> None:
        raise fault("here")

    monkeypatch.setattr(excitation_player, "from_dict", fails)
    with pytest.raises(ExperimentError, match=r"excitation: cannot be sampled: .*here.* \(write it with to_json"):
        prepare(b"{}")


def test_a_disarming_leaves_a_definition_that_has_not_begun() -> None:
    cockpit = ready()
    revision = cockpit.commander.excitation.player.revision
    cockpit.commander.arming.disarm(ME)
    cockpit.run(2)
    assert (cockpit.commander.excitation.player.state, cockpit.commander.excitation.player.revision) == (
        READY,
        revision,
    )
    assert cockpit.arm().accepted
    assert cockpit.commander.excitation.start(ME, 7, M, 0.4).accepted
    assert [cockpit.run().M_open for _ in VALUES] == [*VALUES]


def test_none_begins_between_a_disarming_and_its_tick_nor_in_the_tick_that_arms() -> None:
    cockpit = ready()
    cockpit.commander.arming.disarm(ME)
    assert cockpit.commander.excitation.start(ME, 7, M, 0.4).text == "excitation refused: not armed"
    cockpit.run(2)
    assert cockpit.commander.arming.arm(ME).result == 5
    assert cockpit.commander.excitation.define(ME, 8, written_out(PULSE)).accepted
    assert cockpit.commander.excitation.start(ME, 8, M, 0.4, cockpit.tick).accepted
    assert cockpit.run().mode == 0
    assert (cockpit.commander.armed, cockpit.commander.excitation.player.reason) == (True, "not armed")


LINES = list(range(1, 501))
WITH_500_LINES = {"kind": "multisine", "harmonics": LINES, "period": 1.0, "repeat": 1}
# 500 (64 500 + t / .004) cosines, 10^8 at t = 672 s.


@pytest.mark.parametrize(
    ("fields", "over"),
    [
        ({"period": 672.0}, "period"),
        ({"lead": 671.0}, "lead"),
        ({"settle": 671.0}, "settle"),
        ({"pause": 671.0}, "pause"),
        ({"repeat": 336, "pause": 1.0}, "pause"),
        ({"repeat": 2, "period": 336.0}, "period"),
    ],
)
def test_the_effort_of_a_multisine_is_its_cosines(
    fields: dict[str, float], over: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(excitation_player, "from_dict", lambda values: values)
    monkeypatch.setattr(excitation_player, "written_out", lambda values: "written out")
    just = WITH_500_LINES | fields
    assert prepare(json.dumps(just).encode()) == "written out"
    with pytest.raises(ExperimentError) as refused:
        prepare(json.dumps(just | {over: just[over] + 0.1}).encode())
    assert str(refused.value) == (
        "multisine: 1e+08 cosines are too many to be computed on board"
        " (give fewer or lower harmonics, or less time: at most 1e+08 cosines)"
    )


@pytest.mark.parametrize("lines", [[], 5, None, "1", {}, [True] * 3, [[1]], [1e9], [-1e9], LINES * 100])
def test_harmonics_that_are_none_are_refused_by_who_reads_them(lines: object) -> None:
    with pytest.raises(ExperimentError) as refused:
        prepare(json.dumps(Multisine.schroeder(0.1, 4.0, range(1, 20)).to_dict() | {"harmonics": lines}).encode())
    assert "cosines" not in str(refused.value)


def test_a_usual_multisine_is_far_from_the_bound() -> None:
    usual = Multisine.schroeder(0.1, 100.0, range(1, 100, 2))
    assert len(usual.harmonics) * (64 * 100 + usual.duration / PERIOD) < 0.1 * MOST_EFFORT
    assert len(prepare(usual.to_json().encode()).values) == 25_000
