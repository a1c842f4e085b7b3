"""Laws of the starters: stock loops to the bit, anti-windup, notch, mixer and LQR."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.compile import build
from twodof.flight.core import core
from twodof.flight.starters import starter
from twodof.flight.starters.attitude import NOTCHED, notch_attitude, pid_attitude
from twodof.models.lqr import attitude_lqr, rate_lqr
from twodof.signals import ATTITUDE, OFF, OPEN_LOOP, PERIOD, POSITION, RATE, VELOCITY

pytestmark = pytest.mark.slow

Signals = dict[str, NDArray[Any]]


def sensors(steps: int) -> Signals:
    """Everything the core reads, moving, through all modes, with resets."""
    rng = np.random.default_rng(11)
    modes = np.repeat([OFF, ATTITUDE, OPEN_LOOP, RATE, VELOCITY, POSITION, ATTITUDE, OFF], steps // 8)
    return {
        "acc_x": rng.standard_normal(steps),
        "acc_z": -9.81 + rng.standard_normal(steps),
        "gyro_y": rng.standard_normal(steps),
        "dist": 0.5 + 0.1 * rng.standard_normal(steps),
        "dist_new": np.arange(steps) % 13 == 3,
        "dist_age": rng.uniform(0.0, 0.01, steps),
        "mode": modes,
        "in_reset": rng.random(steps) < 0.02,
        "thrust": np.full(steps, 0.4),
        "use_trim": np.ones(steps, bool),
        **{name: 0.1 * rng.standard_normal(steps) for name in ("x0", "v0", "ax0", "theta0", "q0", "M_open")},
    }


def flown(controllers: list[str], precision: str = "float64", steps: int = 1600) -> Signals:
    made: Signals = (
        build(core(controllers=[starter(name) for name in controllers]), PERIOD, precision)
        .machine()
        .run(steps, sensors(steps))
    )
    return made


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(
    ("controllers", "inside"),
    [
        (["stock-attitude"], {"q0"}),
        (["stock-position"], {"v0"}),
        (["stock-attitude", "stock-position"], {"q0", "v0"}),
        # What the motors are given is M and T but for the clipping, and with its own rounding.
        (["stock-motor"], {"M", "T", "M_trim"}),
        (["stock-attitude", "stock-position", "stock-motor"], {"q0", "v0", "M", "T", "M_trim"}),
    ],
)
def test_the_stock_starters_in_the_core_give_its_bits(controllers: list[str], inside: set[str], precision: str) -> None:
    stock, own = flown([], precision), flown(controllers, precision)
    steps = slice(None)
    if "M_trim" in inside:
        # The trim is the mean of what flies; where M is clipped, that is another. Open loop then flies another M.
        steps = slice(0, 400)
        assert np.array_equal(sensors(1600)["mode"][steps] <= ATTITUDE, np.ones(400, bool))
    for name in set(stock) - inside:
        assert stock[name][steps].tobytes() == own[name][steps].tobytes(), name
    assert set(stock) == set(own)


def test_set_points_inside_a_users_controller_are_0_and_given_ones_are_seen() -> None:
    own = flown(["stock-attitude", "stock-position"])
    mode, given = sensors(1600)["mode"], sensors(1600)
    assert np.array_equal(own["q0"], np.where(mode == RATE, given["q0"], 0.0))
    assert np.array_equal(own["v0"], np.where(mode == VELOCITY, given["v0"], 0.0))


@pytest.mark.parametrize(("ours", "name"), [("pid", "attitude"), ("pid", "position")])
def test_the_library_drawing_is_the_stock_law_up_to_rounding(ours: str, name: str) -> None:
    steps = 5000
    rng = np.random.default_rng(2)
    diagrams = [starter(f"{kind}-{name}") for kind in ("stock", ours)]
    size = np.where(np.arange(steps) < steps // 2, 0.2, 5.0)  # large enough for every limit
    inputs: dict[str, Any] = {
        port: np.repeat(rng.random(steps // 50) < 0.5, 50)
        if declared.kind == "bool"
        else size * rng.standard_normal(steps)
        for port, declared in diagrams[0].inputs.items()
    }
    if name == "position":
        inputs["ax_0"] = 0.0  # the stock loops have no feed-forward
    stock, own = (build(d, PERIOD).machine().run(steps, inputs) for d in diagrams)
    for output in stock:
        # Sums of thousands of terms of order 1 in another order: some 1e-16 each.
        np.testing.assert_allclose(own[output], stock[output], rtol=1e-12, atol=1e-12)


def run(diagram: Diagram, steps: int, **inputs: Any) -> NDArray[np.float64]:
    return np.asarray(build(diagram, PERIOD).machine().run(steps, inputs)["M"])


def test_the_acceleration_is_fed_forward_by_the_mass() -> None:
    out = build(starter("pid-position"), PERIOD).machine().run(1, {"ax_0": 1.5, "FLAG_RESET_INT_VEL": True})
    assert out["theta_0"][0] == pytest.approx(-np.arctan(0.534 * 1.5 / (0.4 * 6.3386)), rel=1e-14)
    assert out["thrust"][0] == pytest.approx(0.4 / np.cos(out["theta_0"][0]), rel=1e-14)


def test_anti_windup_lets_go_of_the_limit_at_once() -> None:
    # Two seconds of a rate error that no moment can answer, then its opposite.
    q = np.where(np.arange(1000) < 500, -20.0, 0.5)
    with_it = run(starter("notch-attitude"), 1000, q=q)
    wound = starter("notch-attitude")
    wound_pid = build(wound, PERIOD).machine()
    wound_pid.set("tracking", 0.0)
    without = np.asarray(wound_pid.run(1000, {"q": q})["M"])
    assert with_it[499] == without[499] == 0.4
    # Without it the integral has gathered ki 20 2 s = 6.4, 16 times the limit, and M stays there.
    assert without[-1] == 0.4
    # With it the integral stands at limit - kp e: M turns to its sign within the tracking time, 1 / 5 s.
    assert with_it[550] < 0.0


def gain_at(machine_of: Callable[[], Any], hertz: float) -> float:
    """The gain from q to M of the steady oscillation at a frequency, by projection on one second of it."""
    steps = np.arange(1000)
    phase = 2.0 * np.pi * hertz * steps * PERIOD
    out = np.asarray(machine_of().run(1000, {"q": 1e-3 * np.sin(phase), "FLAG_RESET_INT": True})["M"])
    window = slice(750, 1000)
    return float(2.0 / 250.0 * abs(np.dot(out[window], np.exp(-1j * phase[window]))) / 1e-3)


def test_the_notch_takes_the_vibration_out_and_leaves_the_crossover() -> None:
    notched, plain = (build(d, PERIOD) for d in (notch_attitude(NOTCHED), pid_attitude(NOTCHED)))
    ratio = {hertz: gain_at(notched.machine, hertz) / gain_at(plain.machine, hertz) for hertz in (4.0, 38.0)}
    assert ratio[38.0] == pytest.approx(0.1, rel=0.01)  # its depth
    assert 0.98 < ratio[4.0] < 1.0  # 1 / sqrt(1 + (2 .3 r / (1 - r^2))^2), r = 4 / 38: .998


def test_the_lqr_is_its_law_and_remembers_what_was_flown() -> None:
    """Against the law written out: M from the errors, the integrals and the last five limited moments."""
    pitch, turn = attitude_lqr(), rate_lqr()
    rng = np.random.default_rng(5)
    steps = 600
    attitude = np.repeat(rng.random(steps // 60) < 0.6, 60)
    reset = rng.random(steps) < 0.05
    theta_0, q_0, theta, q = (s * rng.standard_normal(steps) for s in (0.5, 2.0, 0.5, 2.0))
    machine = build(starter("lqr-attitude"), PERIOD).machine()
    out = machine.run(
        steps,
        {
            "theta_0": theta_0,
            "q_0": q_0,
            "theta": theta,
            "q": q,
            "FLAG_RESET_INT": reset,
            "FLAG_ATTITUDE_ENABLED": attitude,
        },
    )
    past = [0.0] * 5
    angle, rate = 0.0, 0.0
    for k in range(steps):
        if reset[k] or not attitude[k]:
            angle = 0.0
        if reset[k] or attitude[k]:
            rate = 0.0
        angle = float(np.clip(angle + PERIOD * (theta_0[k] - theta[k]), -0.3, 0.3))
        rate = float(np.clip(rate + PERIOD * (q_0[k] - q[k]), -1.0, 1.0))
        if attitude[k]:
            moment = pitch.state[0] * (theta_0[k] - theta[k]) - pitch.state[1] * q[k] + pitch.integral * angle
            moment -= float(np.dot(pitch.history, past))
        else:
            moment = turn.state[0] * (q_0[k] - q[k]) + turn.integral * rate - float(np.dot(turn.history, past))
        moment = float(np.clip(moment, -1.0, 1.0))
        assert out["M"][k] == pytest.approx(moment, abs=1e-12), k
        past = [moment, *past[:4]]
    assert np.abs(out["M"]).max() == 1.0  # the limit was met, and the memory is of what came after it


def motors(name: str, **inputs: Any) -> list[float]:
    out = build(starter(name), PERIOD).machine().run(1, inputs)
    return [float(out[f"motor_{n}"][0]) for n in (1, 2, 3, 4)]


def test_a_moment_lifts_the_fore_motors_1_and_3() -> None:
    assert motors("stock-motor", M_0=0.1, thrust_0=0.4) == [0.5, pytest.approx(0.3), 0.5, pytest.approx(0.3)]
    assert motors("stock-motor", M_0=-0.7, thrust_0=0.4) == [0.0, 1.0, 0.0, 1.0]


def test_the_direct_mixer_flies_the_pid_on_the_gyro() -> None:
    """With the clamping of `pid_attitude`, within +-.5; the thrust of .5 leaves room for every moment."""
    rng, steps = np.random.default_rng(4), 2000
    flags = {name: np.repeat(rng.random(steps // 50) < 0.5, 50) for name in ("FLAG_RESET_INT", "FLAG_ATTITUDE_ENABLED")}
    read = flags | {name: rng.standard_normal(steps) for name in ("theta_0", "q_0", "theta")}
    gyro = 2.0 * rng.standard_normal(steps)
    pid = build(pid_attitude(anti_windup="clamping"), PERIOD).machine()
    pid.set_many({"M_low": -0.5, "M_high": 0.5})
    moment = pid.run(steps, {**read, "q": gyro})["M"]
    direct = build(starter("direct-motor"), PERIOD).machine()
    out = direct.run(steps, {**read, "gyro_y": gyro, "thrust_0": 0.5, "M_0": 0.3, "FLAG_RATE_ENABLED": True})
    np.testing.assert_allclose((out["motor_1"] - out["motor_2"]) / 2.0, moment, atol=1e-15)
    assert np.ptp(moment) == 1.0


@pytest.mark.parametrize("thrust", [0.0, 0.1, 0.4, 0.95])
@pytest.mark.parametrize("moment", [-0.5, -0.2, 0.0, 0.3])
def test_the_direct_mixer_keeps_the_moment(moment: float, thrust: float) -> None:
    fore, aft, same_fore, same_aft = motors("direct-motor", M_0=moment, thrust_0=thrust)
    assert (fore, aft) == (same_fore, same_aft)
    assert min(fore, aft) >= 0.0
    assert max(fore, aft) <= 1.0
    assert (fore - aft) / 2.0 == pytest.approx(moment, abs=1e-15)
    wanted = min(max(thrust, abs(moment)), 1.0 - abs(moment))
    assert (fore + aft) / 2.0 == pytest.approx(wanted, abs=1e-15)
