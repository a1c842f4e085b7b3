"""The failsafe as a whole: ports, hostile inputs in many instances, and its cost on the processor."""

import functools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.flight.failsafe.expr_arrays import tell
from tests.toolchains import need
from twodof.compile import build
from twodof.compile.cortex_m7.report import measure
from twodof.compile.machine import CompiledProgram, Instances
from twodof.errors import DiagramError
from twodof.flight.core import OUTPUTS, core
from twodof.flight.declarations import FAILSAFE_INPUTS as SAFETY_INPUTS
from twodof.flight.declarations import INPUTS
from twodof.flight.failsafe.causes_and_actions import BIT, BRAKE, CAUSES, DESCEND, LEVEL, NONE, OFF, named_causes
from twodof.flight.failsafe.diagram import OUTPUTS as SAFETY_OUTPUTS
from twodof.flight.failsafe.diagram import STATES, failsafe
from twodof.flight.failsafe.state_machine import DISARMED, FLYING, MAY_TURN
from twodof.flight.failsafe.state_machine import OFF as OFF_STATE
from twodof.flight.starters import starter
from twodof.flight.templates import PERIOD as TEMPLATE_PERIOD
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

INSTANCES, STEPS = 64, 2500


def test_the_ports_are_those_that_are_documented() -> None:
    diagram = core(failsafe=True)
    rows = (*INPUTS, *SAFETY_INPUTS)
    assert list(diagram.inputs) == [name for name, *_ in rows]
    assert [(p.kind, p.unit) for p in diagram.inputs.values()] == [(kind, unit) for _, kind, unit, _ in rows]
    assert sorted(diagram.outputs) == sorted(name for name, *_ in (*OUTPUTS, *SAFETY_OUTPUTS))
    assert PERIOD == TEMPLATE_PERIOD


def hostile(rng: np.random.Generator, kind: str, sound: float, wild: NDArray[Any]) -> NDArray[Any]:
    """An input for STEPS steps for INSTANCES instances: mostly `sound`, in `wild` stretches anything at all."""
    shape = (STEPS, INSTANCES)
    if kind == "bool":
        return np.where(wild, rng.random(shape) < 0.5, bool(sound))
    if kind == "int32":
        return np.where(wild, rng.choice([-(2**31), -1, 0, 1, 2, 3, 4, 5, 6, 2**31 - 1], shape), int(sound))
    special = [np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1e308, -1e308, 0.1, -0.5, 0.9, 1.5, -9.81, 12.0]
    usual = sound + 0.01 * rng.standard_normal(shape)
    return np.where(wild, rng.choice(special, shape), usual)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_whatever_comes_in_the_motors_get_numbers_in_0_to_1_and_only_when_armed(precision: str) -> None:
    """Feed 64 instances with NaN, infinities, any mode and flag; check every step."""
    rng = np.random.default_rng(1)
    diagram = failsafe()
    sound = {
        "arm": 1,
        "setpoint_new": 1,
        "link_new": 1,
        "imu_new": 1,
        "dist_new": 1,
        "user_given": 1,
        "voltage": 12.0,
        "acc_z": -9.81,
        "dist": 0.5,
        "mode": 3,
        "thrust": 0.4,
        **{f"{who}{what}": 0.4 for who in ("", "user_") for what in ("fore", "aft", "T")},
    }
    inputs = {}
    for name, port in diagram.inputs.items():
        # One input in a hundred is wild at a time, for a while: of some forty a third of the time none.
        stretches = rng.random((STEPS // 20, INSTANCES)) < 0.01
        inputs[name] = hostile(rng, port.kind, sound.get(name, 0.0), np.repeat(stretches, 20, axis=0))
    # Disarmed, armed idle, flown, again and again.
    phase = np.arange(STEPS)[:, None] % 250
    inputs["arm"] &= phase >= 40
    for name in ("thrust", "M_open", "mode"):
        inputs[name] = np.where(phase < 60, 0, inputs[name])
    with np.errstate(over="ignore"):
        program = build(diagram, PERIOD, precision)
        assert isinstance(program, CompiledProgram)
        machine = Instances(program, INSTANCES)
        # Wild stretches last 80 ms: shorter timers, so that descending is seen, too.
        machine.set_many({"battery_critical.timeout": 0.02, "descent": 0.1, "machine.level_limit": 1.0})
        out = machine.run(STEPS, inputs)
    state, arm = out["state"], inputs["arm"]
    commands = np.stack([out["fore"], out["aft"]])
    assert np.isfinite(commands).all()
    assert (commands >= 0.0).all()
    assert (commands <= 1.0).all()
    assert (commands[:, ~arm] == 0.0).all()
    assert (state[~arm] == DISARMED).all()
    assert (commands[:, ~np.isin(state, MAY_TURN)] == 0.0).all()
    latched = (state[:-1] == OFF_STATE) & arm[1:]
    assert (state[1:][latched] == OFF_STATE).all()
    assert np.isfinite(
        np.stack([out[f"safe_{name}"] for name in ("x0", "v0", "theta0", "q0", "thrust", "M_open")])
    ).all()
    assert out["safe_mode"].max() <= 5
    # The experiment reaches what it speaks of: every state was seen, and motors turned and were stopped.
    assert set(np.unique(state).tolist()) == set(range(len(STATES)))
    assert (state[:, :] == FLYING).mean() > 0.02
    assert latched.sum() > 500


def imu_at_rest(rng: np.random.Generator, n: int) -> dict[str, NDArray[Any]]:
    """Return n IMU samples at rest and level: all three axes move."""
    noise = {name: 0.01 * rng.standard_normal(n) for name in ("acc_x", "acc_z", "gyro_y")}
    return noise | {"acc_z": noise["acc_z"] - 9.81}


def test_it_costs_less_than_a_percent_of_the_processors_time() -> None:
    need("arm-none-eabi-gcc", "qemu-system-arm")
    program = build(failsafe(), PERIOD, "float32", target="cortex-m7")
    n = 500
    rng = np.random.default_rng(0)
    healthy = {"setpoint_new": True, "link_new": True, "imu_new": True, "rings": True, "voltage": 12.0}
    asked = {"arm": np.arange(n) > 2, "mode": np.where(np.arange(n) > 4, 3, 0), "thrust": 0.4 * (np.arange(n) > 4)}
    report = measure(program, n, healthy | asked | imu_at_rest(rng, n) | {"fore": 0.4, "aft": 0.4, "T": 0.4})
    tell(f"{report.instructions.mean():.0f} instructions a step, at most {report.instructions.max()}")
    tell(f"{report.step.flash} bytes of flash, {report.ram} of RAM, {report.stack} of stack")
    # 216 MHz (an STM32F7 of a Pixhawk 4; later boards are faster), 250 Hz, and at most two cycles an instruction.
    assert 2.0 * report.instructions.max() < 0.01 * 216e6 * PERIOD


NAN = float("nan")
ALONE: dict[str, tuple[dict[str, Any], int, int]] = {
    "setpoint_lost": ({"setpoint_new": False}, 125, LEVEL),
    "setpoint_invalid": ({"v0": NAN}, 1, LEVEL),
    "pitch_near": ({"theta": -0.81}, 1, LEVEL),
    "rings_wrong": ({"rings": True}, 1, LEVEL),
    "user_failed": ({"user_T": NAN}, 2, LEVEL),
    "rail_near": ({"x": 0.372, "dist": 0.872}, 1, BRAKE),
    "link_lost": ({"link_new": False}, 750, DESCEND),
    "battery_critical": ({"voltage": 9.0}, 125, DESCEND),
    "range_lost": ({"dist": 0.7}, 60, DESCEND),
    "imu_lost": ({"imu_new": False}, 5, OFF),
    "estimate_lost": ({"q": 31.0}, 1, OFF),
    "pitch_stop": ({"theta": 0.86}, 1, OFF),
    "rail_end": ({"x": -0.396, "dist": 0.104}, 1, OFF),
    "brake_failed": ({"x": 0.372, "dist": 0.872}, 750, OFF),
    "step_late": ({"step_late": True}, 2, OFF),
    "command_stuck": ({"fore": 0.4, "aft": 0.4}, 127, OFF),
    "command_lost": ({"T": NAN}, 2, OFF),
    "battery_low": ({"voltage": 11.0}, 250, NONE),
    "force_disagrees": ({"acc_x": 8.0}, 4, OFF),
    "rate_disagrees": ({"gyro_y": 2.0}, 1, OFF),
}
"""Cause -> what is wrong, from which tick of it on it acts (the first is 1), what it does.

Commands that stand still differ in their first tick from those before, and what they did is known in the next.
"""


@functools.cache
def program() -> Any:
    """The failsafe alone, compiled."""
    return build(failsafe(), PERIOD)


@functools.cache
def whole(position_filter: str, precision: str) -> Any:
    """The flight code with the failsafe, compiled."""
    return build(core(position_filter=position_filter, failsafe=True), PERIOD, precision)


def flown(steps: int, motion_limit: float = 0.1, **changes: Any) -> dict[str, NDArray[Any]]:
    """The failsafe over 1 s in which it arms and all is well, then `steps` with `changes`; what it did in these.

    The cart of most changes jumps, which `motion_limit` allows.
    """
    n = 250 + steps
    rng = np.random.default_rng(3)
    late = np.arange(n) >= 250
    inputs: dict[str, Any] = {
        **dict.fromkeys(("setpoint_new", "link_new", "imu_new", "dist_new"), True),
        **{
            name: 0.4 + 0.01 * rng.standard_normal(n)
            for name in ("fore", "aft", "T", "user_fore", "user_aft", "user_T")
        },
        "arm": np.arange(n) >= 10,
        "mode": np.where(np.arange(n) >= 20, 5, 0),
        **imu_at_rest(rng, n),
        "dist": np.full(n, 0.5),
        "voltage": 12.0,
        "user_given": "user_T" in changes,
    }
    noise = 0.004 * rng.standard_normal(n)
    for name, value in changes.items():
        before = inputs.get(name, 0.0 if name not in ("rings", "step_late") else False)
        inputs[name] = np.where(late, value, before)
    inputs["dist"] = inputs["dist"] + noise
    machine = program().machine()
    machine.set("motion.limit", motion_limit)
    out = machine.run(n, inputs)
    assert (out["action"][20:250] == NONE).all()
    assert not out["reason"][20:250].any()
    return {name: column[250:] for name, column in out.items()}


@pytest.mark.parametrize("cause", ALONE)
def test_each_cause_alone_gives_its_action_in_its_tick_and_says_so(cause: str) -> None:
    changes, ticks, action = ALONE[cause]
    out = flown(800, **changes)
    said = np.flatnonzero(out["reason"] & BIT[cause])
    begun = np.flatnonzero(out["action"] >= action) if action != NONE else said
    assert begun[0] + 1 == ticks
    assert out["action"][begun[0]] == action
    # What the gate sees is said a tick before the state machine acts on it; the gate has acted by then.
    assert said[0] in (begun[0], begun[0] - 1)
    if action == OFF:
        assert not out["fore"][said[0] :].any()
        assert not out["aft"][said[0] :].any()


def test_two_ranges_at_the_end_of_the_rail_stop_the_motors_wherever_the_estimate_is() -> None:
    out = flown(10, x=0.33, dist=0.91)
    assert np.flatnonzero(out["action"] == OFF)[0] + 1 == 2
    assert out["reason"][-1] & BIT["rail_end"]


def test_a_range_step_that_the_estimate_follows_is_seen() -> None:
    out = flown(25, motion_limit=0.002, x=0.09, dist=0.59)
    begun = np.flatnonzero(out["action"])
    assert begun[0] + 1 <= 20
    assert out["action"][begun[0]] == DESCEND
    assert out["reason"][-1] == BIT["range_lost"]


def test_each_cause_of_the_table_is_tried() -> None:
    assert set(ALONE) == {cause.name for cause in CAUSES} - {"not_idle", "tilted"}
    for cause in CAUSES:
        assert cause.name not in ALONE or ALONE[cause.name][2] == cause.action


@pytest.mark.long
def test_commands_from_outside_fly_and_are_watched_like_those_inside() -> None:
    """A user's whole core, stepped beside the gate as a sandbox would be: the bits of the same controller inside."""
    own = starter("lqr-attitude")
    inside = build(core(controllers=[own], failsafe=True), PERIOD).machine()
    sandbox = build(core(controllers=[own]), PERIOD).machine()
    gate = build(core(failsafe=True, outside=True), PERIOD).machine()
    rng = np.random.default_rng(4)
    healthy = {**dict.fromkeys(("setpoint_new", "link_new", "imu_new", "rings"), True), "voltage": 12.0}
    flown = []
    for k in range(500):
        asked = {"mode": 3 if k >= 20 else 0, "thrust": 0.4 if k >= 20 else 0.0}
        seen = {
            "acc_x": 0.1 * rng.standard_normal(),
            "acc_z": -9.81 + 0.1 * rng.standard_normal(),
            "gyro_y": 0.01 * rng.standard_normal(),
            "dist": 0.5,
        }
        theirs = sandbox.step(seen | asked)
        commands = {f"user_{name}": theirs[name] for name in ("fore", "aft", "M", "T")}
        if k >= 400:
            commands["user_aft"] = NAN
        late = {"user_late": k >= 400}
        expected = inside.step(seen | asked | healthy | late | {"arm": k >= 10})
        out = gate.step(seen | asked | healthy | commands | {"user_given": True, "arm": k >= 10})
        assert out["user_flies"] == (10 <= k <= 400)
        assert [out[name] for name in ("fore", "aft", "M", "T", "action", "reason")] == [
            expected[name] for name in ("fore", "aft", "M", "T", "action", "reason")
        ], k
        flown.append(out["M"])
    assert len(set(flown[20:])) == 480
    with pytest.raises(DiagramError, match="failsafe=True"):
        core(outside=True)


class AtRest:
    """The flight code on a rig that does not move, stretch after stretch."""

    def __init__(self, position_filter: str, precision: str) -> None:
        self.machine = whole(position_filter, precision).machine()
        self.rng = np.random.default_rng(6)

    def fly(self, seconds: float, arm: bool, **changes: Any) -> dict[str, NDArray[Any]]:
        """`seconds` armed or not, with `changes`; nothing is asked for in the first ticks."""
        n = round(seconds / PERIOD)
        asked = arm & (np.arange(n) >= 5)
        healthy = {**dict.fromkeys(("setpoint_new", "link_new", "imu_new", "rings"), True), "voltage": 12.0}
        dist = {"dist": 0.5 + 0.004 * self.rng.standard_normal(n), "dist_new": np.arange(n) % 14 == 0, "dist_age": 0.0}
        flown = {"arm": arm, "mode": np.where(asked, 3, 0), "thrust": np.where(asked, 0.4, 0.0)}
        return self.machine.run(n, healthy | imu_at_rest(self.rng, n) | dist | flown | changes)


@pytest.mark.parametrize(
    ("position_filter", "precision"),
    [("joint", "float64"), ("joint", "float32"), ("fixed-gain", "float64"), ("kalman", "float64")],
)
@pytest.mark.parametrize("wrong", ["acc_x", "acc_z", "gyro_y", "dist", "dist_age"])
def test_numbers_that_are_none_stop_the_motors_and_when_they_are_numbers_again_it_arms_again(
    wrong: str, position_filter: str, precision: str
) -> None:
    """Give 3 s of NaN in one signal in flight; estimator and loops restart afterwards."""
    rig = AtRest(position_filter, precision)
    rig.fly(1.0, False)
    assert rig.fly(0.5, True)["fore"][-100:].min() > 0.2
    for none in (NAN, float("inf"), -float("inf"), 1e30):
        out = rig.fly(3.0 if np.isnan(none) else 0.5, True, **{wrong: none})
        assert np.isfinite(out["fore"]).all()
        if wrong in ("acc_x", "acc_z", "gyro_y"):  # the range is not needed where the rings lock the cart
            assert not out["fore"].any()
            assert out["state"][-1] == OFF_STATE
            rig.fly(0.1, False, **{wrong: none})
            refused = set(named_causes(int(rig.fly(0.1, True, **{wrong: none})["reason"][-1])))
            assert refused >= {"imu_lost", "estimate_lost"} or none == 1e30
            assert len(refused) == 2 or not np.isnan(none)  # NaN says just what is true of it
        rig.fly(1.0, False)
        again = rig.fly(0.5, True)
        assert again["reason"][-1] == 0, named_causes(int(again["reason"][-1]))
        assert again["fore"][-100:].min() > 0.2
