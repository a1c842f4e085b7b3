"""Rotors and battery by their closed forms: thrust, moment gain, delay, lag, wake, discharge, sag."""

from typing import Any

import numpy as np
import pytest

from twodof.blocks import Diagram
from twodof.blocks.library.delays import ZeroOrderHold
from twodof.compile import CompiledMachine, CompiledProgram, build
from twodof.rig.parameters import lab, paper
from twodof.rig.rig import moment_gain, rotor_moment, velocity_gain
from twodof.rig.rotors import BatteryPack, Rotors
from twodof.signals import HOVER

DT = 1e-3
PULL = {"pair_thrust": 4.0, "curve": 0.3, "arm": 0.1}


def rotors() -> Diagram:
    d = Diagram("rotors", "rotors alone")
    d.add("rotors", Rotors())
    for name in ("fore", "aft", "supply", "theta"):
        d.input(name)
        d.add(f"{name}_held", ZeroOrderHold(), u=name)
        d.connect(f"{name}_held", f"rotors.{name}")
    for name in ("thrust", "moment", "running", "load"):
        d.output(name, f"rotors.{name}")
    return d


@pytest.fixture(scope="module")
def program() -> CompiledProgram:
    return build(rotors(), DT)


def machine(program: Any, **parameters: Any) -> CompiledMachine:
    m = program.machine()
    m.set_many({f"rotors.{name}": value for name, value in {**PULL, **parameters}.items()})
    m.reset()
    return m


def test_steady_thrust_and_moment(program: CompiledProgram) -> None:
    out = machine(program).run(400, {"fore": 0.5, "aft": 0.3, "supply": 1.0})
    fore, aft = 0.5 * (0.7 + 0.3 * 0.5), 0.3 * (0.7 + 0.3 * 0.3)
    assert out["thrust"][-1] == pytest.approx(4.0 * (fore + aft), rel=1e-12)
    assert out["moment"][-1] == pytest.approx(0.1 * 4.0 * (fore - aft), rel=1e-12)
    assert out["load"][-1] == pytest.approx((fore + aft) / (2 * 0.4 * (0.7 + 0.12)), rel=1e-12)
    assert out["moment"][-1] == pytest.approx(rotor_moment({**PULL}, 0.1, 0.4), rel=1e-12)


def test_commands_are_clipped(program: CompiledProgram) -> None:
    out = machine(program).run(400, {"fore": 1.7, "aft": -0.4, "supply": 1.0})
    assert out["thrust"][-1] == pytest.approx(4.0, rel=1e-12)


@pytest.mark.parametrize("delay", [0.001, 0.009, 0.0105, 0.02, 0.0599])
def test_the_delay_is_exact_and_keeps_the_impulse(program: CompiledProgram, delay: float) -> None:
    m = machine(program, delay=delay, lag=0.0, curve=0.0)
    pulse = np.zeros(200)
    pulse[20:70] = 0.5
    out = m.run(200, {"fore": pulse, "aft": 0.0, "supply": 1.0})["thrust"] / 4.0
    assert out.sum() == pytest.approx(pulse.sum(), rel=1e-12)
    start = 20 + int(delay / DT + 1e-9)
    assert np.all(out[:start] == 0.0)
    assert out[start + 1] == pytest.approx(0.5, rel=1e-12)
    # The centre of the pulse comes later by the delay.
    assert (out * np.arange(200)).sum() / out.sum() - (pulse * np.arange(200)).sum() / pulse.sum() == pytest.approx(
        max(delay, DT) / DT, rel=1e-9
    )


def test_the_lag_is_of_first_order(program: CompiledProgram) -> None:
    m = machine(program, delay=0.001, lag=0.011, curve=0.0)
    out = m.run(100, {"fore": 0.6, "aft": 0.0, "supply": 1.0})["thrust"] / 4.0
    t = (np.arange(100) - 1) * DT  # one tick of delay
    # RK4's error of a decay with z = h / lag = .0909: z^4 / 120 of it a time constant, so .6 * 5.7e-7 / e at most.
    assert out[1:] == pytest.approx(0.6 * (1.0 - np.exp(-t[1:] / 0.011)), abs=1.5e-7)


def test_a_rotor_that_spins_down_ends_at_zero_and_not_in_subnormals(program: CompiledProgram) -> None:
    m = machine(program)
    m.run(200, {"fore": 0.4, "aft": 0.4, "supply": 1.0})
    m.run(3000, {"fore": 0.0, "aft": 0.0})
    assert m.state("rotors.fore") == 0.0
    assert m.run(60_000)["thrust"][-1] == 0.0
    assert m.state("rotors.wake") == 0.0


def test_the_trim_moment_builds_up_with_the_wake(program: CompiledProgram) -> None:
    m = machine(program, lag=0.0, delay=0.001, trim=3e-3, trim_start=-1e-3, wake_lag=1.3)
    out = m.run(6000, {"fore": HOVER, "aft": HOVER, "supply": 1.0})["moment"]
    t = (np.arange(6000) - 1) * DT
    expected = 3e-3 - 4e-3 * np.exp(-t / 1.3)
    assert out[1:] == pytest.approx(expected[1:], abs=4e-3 * DT / 1.3)  # Euler: within a step of the exponential


def test_the_wake_leaves_a_drone_that_stays_pitched(program: CompiledProgram) -> None:
    m = machine(program, lag=0.0, delay=0.001, trim=3e-3, trim_start=-1e-3, wake_lag=1.3, wake_fade=8.0, wake_start=1.0)
    out = m.run(20_000, {"fore": HOVER, "aft": HOVER, "supply": 1.0, "theta": -0.25})["moment"]
    assert out[1] == pytest.approx(3e-3, abs=4e-3 * 2.0 * DT / 1.3)
    # After 15 time constants a share of 1 / (1 + 2^2) is left, and 3e-7 of the rest.
    assert out[-1] == pytest.approx(-1e-3 + 4e-3 / 5.0, abs=1e-8)


def test_supply_scales_the_thrust(program: CompiledProgram) -> None:
    full = machine(program).run(400, {"fore": 0.4, "aft": 0.4, "supply": 1.0})["thrust"][-1]
    low = machine(program).run(400, {"fore": 0.4, "aft": 0.4, "supply": 0.8})["thrust"][-1]
    assert low == pytest.approx(0.8 * full, rel=1e-12)


@pytest.mark.parametrize(("rig", "idle", "hover"), [(paper, 130.0, 358.5), (lab, 115.0, 288.0)])
def test_the_moment_gain_depends_on_thrust_as_published_and_logged(rig: Any, idle: float, hover: float) -> None:
    values = rig()
    # Paper section 4.1 for the paper's rig, whose two numbers it was made from. The lab rig's were not: the logs give
    # 112 to 118 with M = .1 at T = 0 and 288 +- 8 at T = .4, by linear methods that are 5 % uncertain.
    tolerance = 1e-9 if rig is paper else 0.05
    pulse = rotor_moment(values, 0.1, 0.0) / 0.1 / values["inertia"]
    assert pulse == pytest.approx(idle, rel=tolerance)
    assert moment_gain(values, HOVER) == pytest.approx(hover, rel=tolerance)


def test_the_paper_rigs_cart_has_the_papers_gain() -> None:
    assert velocity_gain(paper()) == pytest.approx(4.748, rel=1e-12)


def battery() -> Diagram:
    d = Diagram("battery", "battery alone")
    d.input("load")
    d.add("battery", BatteryPack(), load="load")
    for name in ("supply", "voltage", "charge"):
        d.output(name, f"battery.{name}")
    return d


def test_the_battery_polarises_in_hover_and_recovers() -> None:
    share, time, drop = 0.7, 7.0, 0.1 * 6.0
    m = build(battery(), 0.04).machine()
    changes = {"resistance": 0.1, "polarised_share": share, "polarised_time": time, "capacity": 1e9}
    m.set_many({f"battery.{name}": value for name, value in changes.items()})
    m.reset()
    hover = 12.6 - m.run(501, {"load": 1.0})["voltage"]
    rest = 12.6 - m.run(501, {"load": 0.0})["voltage"]
    t = 0.04 * np.arange(501)
    # The load is that of the sample before. In the first sample there is none yet, in the last one at rest it is 1.
    assert hover[1:] == pytest.approx(drop * (1.0 - share * np.exp(-t[:-1] / time)), rel=1e-9)
    polarised = 1.0 - np.exp(-20.04 / time)
    # The huge pack loses 7e-11 V.
    assert rest[1:] == pytest.approx(drop * share * polarised * np.exp(-t[:-1] / time), abs=1e-10)
    # Thrust goes with the square of the voltage: the drone loses 8 % in 20 s, the discharge's 1 % among them.
    assert 1.0 - ((12.6 - hover[-1]) / (12.6 - hover[1])) ** 2 == pytest.approx(0.065, abs=0.005)


def test_the_battery_empties_at_its_current_and_sags() -> None:
    m = build(battery(), 0.04).machine()
    seconds, current, capacity = 120.0, 6.0, 1.3
    out = m.run(round(seconds / 0.04) + 2, {"load": 1.0})
    assert out["charge"][-1] == pytest.approx(1.0 - current * seconds / (3600.0 * capacity), rel=1e-12)
    assert out["supply"][1] == pytest.approx(1.0, rel=1e-3)
    assert np.all(np.diff(out["supply"][1:]) < 0.0)
    heavy = m.run(2, {"load": 2.0})["voltage"][-1]
    light = m.run(2, {"load": 0.0})["voltage"][-1]
    assert light - heavy == pytest.approx(0.03 * 6.0 * 2.0**1.5, rel=0.01)  # the charge used in 0.1 s besides
    empty = m.run(40_000, {"load": 1.5})
    assert empty["charge"][-1] == 0.0
    assert empty["supply"][-1] > 0.0
