"""Gain scheduling: the moment that acts is the one asked for, at any thrust."""

import math

import pytest

from twodof.blocks.reference.interpreter import Reference
from twodof.design.schedule import gain_ratio, scheduled_motor
from twodof.errors import ParameterError
from twodof.flight.templates import MOTOR, check_template
from twodof.models.plant import thrust_curve
from twodof.rig.rotors import lift
from twodof.signals import PERIOD


def test_ratio_is_that_of_two_measured_gains() -> None:
    # mu at rest counts one pair and a pulse of M = .1; against the platform's 115 and 288 rad/s2
    curve = thrust_curve(115.0, 288.0)
    assert gain_ratio(0.4, curve) == 1.0
    idle = 0.5 * 288.0 * gain_ratio(0.0, curve) * (1.0 - curve + 0.1 * curve) / (1.0 - curve)
    assert idle == pytest.approx(115.0, rel=1e-12)


@pytest.mark.parametrize("thrust", [0.2, 0.4, 0.6])
def test_the_same_moment_acts_at_any_thrust(thrust: float) -> None:
    curve = 0.3
    diagram = scheduled_motor(curve)
    check_template(diagram, MOTOR.name)
    machine = Reference(diagram, PERIOD).machine()
    given = {port.name: False if port.kind == "bool" else 0.0 for port in MOTOR.inputs}
    for moment in (-0.1, 0.05, 0.12):
        out = machine.step({**given, "M_0": moment, "thrust_0": thrust, "FLAG_RATE_ENABLED": True})
        acting = lift(out["motor_1"], curve) - lift(out["motor_2"], curve)
        at_hover = lift(0.4 + moment, curve) - lift(0.4 - moment, curve)
        assert acting == pytest.approx(at_hover, rel=1e-12)
        open_loop = machine.step({**given, "M_0": moment, "thrust_0": thrust})
        assert open_loop["motor_1"] - open_loop["motor_2"] == pytest.approx(2.0 * moment, rel=1e-12)


@pytest.mark.parametrize("curve", [-0.1, 1.5, math.nan, "x", True])
def test_refuses_a_curve_that_cannot_be(curve: object) -> None:
    with pytest.raises(ParameterError) as caught:
        scheduled_motor(curve)  # type: ignore[arg-type]
    assert caught.value.remedy
