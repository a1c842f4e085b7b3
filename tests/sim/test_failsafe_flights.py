"""The failsafe in flight: silent where nothing fails, on the rig and in real logs; safe in its time where it does."""

import functools
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.flight.failsafe.expr_arrays import tell
from tests.sim.faulty_loop import PERIOD_MS, FaultyLoop, first
from twodof.compile import build
from twodof.experiment.experiments import EXPERIMENTS, script
from twodof.experiment.flight import Laboratory
from twodof.flight.failsafe.causes_and_actions import ACTIONS, BIT, named_causes
from twodof.flight.failsafe.diagram import failsafe
from twodof.flight.starters import load_diagram
from twodof.flightlog.events import mode_at
from twodof.flightlog.files import read_log
from twodof.signals import PERIOD
from twodof.sim.closed_loop import ClosedLoop, InitialState
from twodof.sim.time_alignment import align_log

pytestmark = pytest.mark.slow

NONE, LEVEL, BRAKE, DESCEND, OFF = range(len(ACTIONS))

Signals = Mapping[str, NDArray[Any]]


@functools.cache
def loops(rig: str, precision: str, starters: tuple[str, ...] = ()) -> tuple[Laboratory, ClosedLoop, ClosedLoop]:
    """A laboratory, and its closed loop without and with the failsafe."""
    laboratory = Laboratory(rig)
    own = [load_diagram(name) for name in starters]
    pair_of = (
        ClosedLoop(rig=laboratory.parameters, controllers=own, precision=precision, failsafe=f) for f in (False, True)
    )
    return laboratory, *pair_of


def both(rig: str, precision: str, name: str, starters: tuple[str, ...] = ()) -> tuple[Signals, Signals]:
    """An experiment flown without and with the failsafe, from the same start with the same noise."""
    laboratory, *pair_of = loops(rig, precision, starters)
    experiment = EXPERIMENTS[name]
    x_start = laboratory.start(experiment)
    plan = script(experiment, x_start)
    flown = []
    for loop in pair_of:
        loop.configure({"rings": experiment.rings, "ring_place": x_start, "seed": 5})
        loop.start(InitialState(x=x_start))
        flown.append(loop.fly(plan.steps, plan.setpoints))
    return flown[0], flown[1]


def assert_same_bits(without: Signals, gated: Signals) -> None:
    for name, values in without.items():
        np.testing.assert_array_equal(gated[name], values, name)
        assert gated[name].tobytes() == values.tobytes(), name
    assert gated["action"][-1] == NONE
    assert not gated["reason"].any()


@pytest.mark.parametrize(
    ("rig", "precision"),
    [
        ("lab", "float64"),
        ("paper", "float32"),
        pytest.param("lab", "float32", marks=pytest.mark.soak),
        pytest.param("paper", "float64", marks=pytest.mark.soak),
    ],
)
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_where_nothing_fails_every_signal_has_the_bits_of_the_flight_without(
    rig: str, name: str, precision: str
) -> None:
    assert_same_bits(*both(rig, precision, name))


@pytest.mark.long
@pytest.mark.parametrize(
    "starters", [("lqr-attitude",), ("pid-attitude", "pid-position"), ("direct-motor",), ("notch-attitude",)]
)
def test_nor_does_a_healthy_controller_of_ones_own_notice_it(starters: tuple[str, ...]) -> None:
    assert_same_bits(*both("lab", "float64", "velocity-doublet", starters))


SUMS = {
    **dict.fromkeys(("force.forth", "force.back"), 0.15),
    **dict.fromkeys(("force.hit_forth", "force.hit_back"), 0.08),
    "motion.apart": 0.002,
    **dict.fromkeys(("force.up", "force.down"), 0.3),
    **dict.fromkeys(("rate.faster", "rate.slower"), 1.5),
}
"""Sums of what is not explained, and their limits with the cart free."""

REAL = {
    "free-response-impulse": (),
    "doublet-0.03": ("pitch_near", "pitch_stop"),  # after the doublets it falls onto its stops, at 245.8 s
    "attitude-steps-10deg-default": (),
    "attitude-steps-10deg-student": (),
    "rate-doublets-30dps-student": ("rate_disagrees",),  # the motors stop .75 s before the log ends, M goes on
    "velocity-doublets-0.25": (),
    "position-sweep-default": ("rate_disagrees",),  # the same
}


@pytest.mark.parametrize("name", REAL)
def test_on_the_real_flights_it_is_silent_but_at_a_stop_and_where_the_motors_stand(
    flight_data: Path, name: str
) -> None:
    """The failsafe beside each log: what the drone measured and estimated goes in, its commands pass with their bits.

    The first quarter second, in which the sensors are first heard, is disarmed. A step without a fresh sample of the
    IMU is left out. The drone had one, and only the recording lacks it (WiFi): 13 in a row in one log.
    """
    log = read_log(flight_data / f"{name}.mat")
    paired = align_log(log)
    time = paired.time
    acc, gyr, dist = log["acc"], log["gyr"], log["dist"]
    index = {c.name: np.maximum(c.index(time, "hold"), 0) for c in (acc, gyr, dist, log["x"])}
    fresh = np.diff(index["acc"], prepend=-1) + np.diff(index["gyr"], prepend=-1) > 0
    new = np.diff(index["dist"], prepend=-1) > 0
    new |= np.append(False, new[:-1] & ~fresh[:-1])  # a range in a step left out is handed over in the next
    moment, thrust = paired.value["M"], paired.value["T"]
    mode = mode_at(log, time + 0.5 * PERIOD)
    columns: dict[str, Any] = {
        "acc_x": acc.value[index["acc"], 0],
        "acc_z": acc.value[index["acc"], 2],
        "gyro_y": gyr.value[index["gyr"], 1],
        "dist": dist.value[index["dist"]],
        "dist_new": new,
        "x": log["x"].value[index["x"]],
        **{signal: paired.value[signal] for signal in ("theta", "q", "v")},
        "mode": mode,
        **{signal: paired.value[signal] for signal in ("v0", "theta0", "q0", "M")},
        "T": thrust,
        "fore": np.clip(thrust + moment, 0.0, 1.0),
        "aft": np.clip(thrust - moment, 0.0, 1.0),
    }
    columns = {signal: column[fresh] for signal, column in columns.items()}
    steps = int(fresh.sum())
    arm = np.arange(steps) > 65
    columns["mode"] = np.where(np.arange(steps) > 70, columns["mode"], 0)
    columns["thrust"] = columns["T"]
    healthy = {"setpoint_new": True, "link_new": True, "imu_new": True, "voltage": 12.0}
    rings = not (np.isin(columns["mode"], (4, 5)).any())
    program = build(failsafe(), PERIOD, log=list(SUMS))
    out = program.machine().run(steps, columns | healthy | {"arm": arm, "rings": rings})
    acts = (out["action"] != NONE) & arm
    reasons = named_causes(int(np.bitwise_or.reduce(out["reason"][arm])))
    tell(f"{name}: {int((~fresh).sum())} steps left out, acts in {int(acts.sum())} of {steps}: {reasons}")
    assert reasons == REAL[name]
    quiet = arm & (np.arange(steps) < (np.flatnonzero(acts)[0] if acts.any() else steps))
    for signal in ("fore", "aft", "M", "T"):
        np.testing.assert_array_equal(out[signal][quiet], np.asarray(columns[signal], float)[quiet])
    flown = quiet & (np.arange(steps) < steps - 250)  # in the last second the motors of some stand already
    shares = {path: float(out[path][flown].max()) / limit for path, limit in SUMS.items()}
    tell(f"{name}: of the limits " + ", ".join(f"{path} {share:.3f}" for path, share in shares.items()))
    assert max(shares.values()) < 0.4
    if REAL[name] == ("rate_disagrees",):
        # The motors run down: their vibration is there before, and at the end of the log it is not.
        begun = np.flatnonzero(acts)[0]
        assert steps - begun < 150
        vibration = np.abs(np.diff(columns["acc_z"]))
        assert vibration[-40:].mean() < 0.35 * vibration[begun - 600 : begun - 200].mean()
    elif acts.any():
        at_stop = np.abs(columns["theta"][acts][:50]).max()
        assert at_stop > 0.80
        assert time[fresh][np.flatnonzero(acts)[0]] > 240.0


def stands(out: Signals) -> NDArray[np.bool_]:
    return (out["fore"] == 0.0) & (out["aft"] == 0.0)


def test_set_points_that_come_back_are_flown_again_and_until_then_it_is_level() -> None:
    loop = FaultyLoop()
    loop.take_off(theta0=0.2)
    lost = loop.fly(2.0, setpoint_new=False)
    assert np.abs(lost["true_theta"][250:]).max() < 0.06
    back = loop.fly(2.0, setpoint_new=True)
    # At once but for the half second that levelling lasts at least: the last silent tick began it anew.
    assert first(back["action"] == NONE) == 500.0
    assert back["true_theta"][-1] == pytest.approx(0.2, abs=0.05)
    assert back["reason"][-1] == 0


def test_silence_without_end_ends_with_the_motors_off() -> None:
    loop = FaultyLoop()
    loop.take_off()
    out = loop.fly(13.0, setpoint_new=False)
    assert first(out["action"] == DESCEND) == pytest.approx(500.0 + 10_000.0, abs=PERIOD_MS)
    assert first(stands(out)) <= 500.0 + 10_000.0 + 1000.0
    again = loop.fly(1.0, setpoint_new=True)
    assert stands(again).all()


@pytest.mark.parametrize("wrong", [{"wrong": 0.0}, {"wrong": 1.0}, {"wrong": -1.0}], ids=["nan", "inf", "-inf"])
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_a_controller_that_gives_no_number_is_replaced_in_the_same_tick(
    wrong: dict[str, float], precision: str
) -> None:
    loop = FaultyLoop(own=True, precision=precision)
    law = "flight.cascade.attitude_control.law"
    loop.machine.set_many({f"{law}.at": 1000, **{f"{law}.{name}": value for name, value in wrong.items()}})
    loop.take_off(theta0=0.1)  # ticks 125 to 875
    out = loop.fly(3.0)
    failed = 1000 - 875
    assert not out["reason"][:failed].any()
    assert out["reason"][failed] == BIT["user_failed"]
    # No tick without thrust: the stock commands fly from the very tick on.
    assert np.isfinite(out["M"]).all()
    assert ((out["fore"] + out["aft"])[failed:] > 0.7).all()
    assert (out["action"][failed + 1 :] == LEVEL).all()
    assert np.abs(out["true_theta"][failed + 200 :]).max() < 0.06
    # Healthy again it is not believed, until disarmed.
    loop.machine.set(f"{law}.at", 1_000_000)
    assert (loop.fly(1.0)["action"] == LEVEL).all()
    loop.fly(0.1, arm=False, mode=0)
    assert loop.fly(1.0, arm=True)["action"][-1] == NONE


@pytest.mark.parametrize(
    "setpoints",
    [
        {"mode": 5, "x0": np.where(np.arange(3000) // 250 % 2 == 0, 5.0, -5.0)},
        {"mode": 4, "v0": np.where(np.arange(3000) // 250 % 2 == 0, 9.0, -9.0)},
        {"mode": 4, "v0": 0.5},
        {"mode": 3, "theta0": 0.2},
        {"mode": 3, "theta0": -0.75},
    ],
    ids=["x0 +-5", "v0 +-9", "v0 .5", "theta0 .2", "theta0 -.75"],
)
def test_set_points_at_the_limits_drive_neither_cart_nor_pitch_into_a_stop(setpoints: dict[str, Any]) -> None:
    loop = FaultyLoop(rings=False)
    loop.take_off(mode=5)
    out = loop.fly(12.0, **setpoints)
    farthest, fastest = np.abs(out["true_x"]).max(), np.abs(out["true_v"]).max()
    tell(f"{setpoints}: at most {farthest:.3f} m, {fastest:.2f} m/s, {np.abs(out['true_theta']).max():.2f} rad")
    assert farthest < 0.3999
    # At most .68 in 24 flights. Switched off at the rail's end it swings on, and meets a stop at up to 2.3 rad/s.
    assert np.abs(out["true_theta"][~stands(out)]).max() < 0.72
    assert_no_chatter(out)


def assert_no_chatter(out: Signals) -> None:
    """An action that is not followed by a stronger one lasts half a second at least."""
    action = out["action"]
    changes = np.flatnonzero(np.diff(action)) + 1
    for begin, end in itertools.pairwise(changes):
        if action[begin] in (LEVEL, BRAKE) and action[end] == NONE:
            begun = begin
            while begun > 0 and action[begun - 1] in (LEVEL, BRAKE):
                begun -= 1
            assert end - begun >= 125, (begun, end)


def test_on_the_stop_the_motors_are_off_until_disarmed() -> None:
    loop = FaultyLoop()
    loop.take_off()
    out = loop.fly(3.0, mode=2, q0=19.0)
    assert out["action"][-1] == OFF
    assert "pitch_stop" in named_causes(int(out["reason"][-1]))
    assert stands(loop.fly(2.0, mode=3, q0=0.0)).all()
    assert stands(loop.fly(20.0, mode=0)).all()
    # It swings out for longer than that with arm held, and does not arm by itself; after a release it does.
    loop.fly(0.1, arm=False)
    assert loop.fly(0.1, arm=True)["action"][-1] == NONE


def test_arming_is_refused_with_the_reason_and_again_until_released() -> None:
    loop = FaultyLoop()
    loop.fly(0.4)
    out = loop.fly(0.2, arm=True, mode=3, thrust=0.4)
    assert stands(out).all()
    assert set(out["reason"].tolist()) == {BIT["not_idle"]}
    assert stands(loop.fly(0.2, mode=0, thrust=0.0)).all()
    assert not loop.fly(0.1)["armed"].any()
    loop.fly(0.02, arm=False)
    assert loop.fly(0.1, arm=True)["armed"].all()


@pytest.mark.parametrize(
    ("unheard", "reason"),
    [({}, "range_lost"), ({"link_new": False}, "link_lost"), ({"imu_new": False}, "imu_lost")],
    ids=["range", "link", "imu"],
)
def test_nothing_is_armed_before_it_was_heard(unheard: dict[str, bool], reason: str) -> None:
    out = FaultyLoop(rings=False).fly(0.04, arm=True, **unheard)
    assert not out["armed"].any()
    assert reason in named_causes(int(out["reason"][0]))


def test_a_low_battery_is_said_in_flight_and_refuses_the_next() -> None:
    loop = FaultyLoop()
    loop.take_off(3.02)  # to a tick of the battery
    loop.loop.configure({"voltage_full": loop.loop.rig["voltage_full"] - 1.4})
    out = loop.fly(3.0)
    assert not out["action"].any()
    assert first(out["reason"] == BIT["battery_low"]) + PERIOD_MS == 1000.0
    loop.fly(0.1, arm=False, mode=0)
    out = loop.fly(0.2, arm=True)
    assert not out["armed"].any()
    assert "battery_low" in named_causes(int(out["reason"][-1]))
