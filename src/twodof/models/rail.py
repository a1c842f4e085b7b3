"""The cart from raw measurements: pitch by integrating the gyro, position as the range sensor sees it.

The on-board estimates of pitch and velocity are filtered with what the flight itself excites (acceleration tilts the
gravity they lean on), so a model between them takes on the filter's errors. Gyro and range sensor have errors of their
own, but those are nearly white.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twodof.blocks.block import Block, Clock, Param, Port, State, library_block
from twodof.blocks.diagram import Diagram
from twodof.blocks.elementary import sin
from twodof.blocks.expr import where
from twodof.models.structure import Structure


@library_block("models.RailFromGyro")
class RailFromGyro(Block):
    """theta' = q - q_bias, v' = -k_v sin(theta) - p_v v - coulomb sign(v): paper equation (9) without the small angle,
    and with dry friction on the bars, which the paper neglects. x' = v, seen `x_age` late: x - x_age v."""

    inputs = (Port("q", unit="rad/s"),)
    outputs = (Port("x", unit="m"), Port("v", unit="m/s"), Port("theta", unit="rad"))
    states = (
        State("theta", initial="theta_0", unit="rad", continuous=True),
        State("x", initial="x_0", unit="m", continuous=True),
        State("v", initial="v_0", unit="m/s", continuous=True),
    )
    params = (
        Param("k_v", 4.748, unit="m/s2", low=0.0, high=50.0, text="thrust over mass"),
        Param("p_v", 1.168, unit="1/s", low=-5.0, high=50.0, text="viscous friction over mass"),
        Param("coulomb", 0.0, unit="m/s2", low=0.0, high=5.0, text="dry friction over mass"),
        Param("x_age", 0.0, unit="s", low=-0.2, high=0.2, text="age of a range beyond its stamp"),
        Param("q_bias", 0.0, unit="rad/s", text="bias of the gyro"),
        Param("theta_0", 0.0, unit="rad", text="pitch at the start"),
        Param("x_0", 0.0, unit="m", text="position at the start"),
        Param("v_0", 0.0, unit="m/s", text="velocity at the start"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """The states, x as the sensor sees it."""
        return {"x": x.x - p.x_age * x.v, "v": x.v, "theta": x.theta}

    def derivative(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """The class's equations."""
        against = where(x.v > 0.0, p.coulomb, where(x.v < 0.0, -p.coulomb, 0.0))
        return {
            "theta": u.q - p.q_bias,
            "x": x.v,
            "v": -p.k_v * sin(x.theta) - p.p_v * x.v - against,
        }


_SCALES: Mapping[str, float] = {
    "coulomb": 0.05,
    "q_bias": 0.05,
    "x_age": 0.02,
    "theta_0": 0.1,
    "x_0": 0.1,
    "v_0": 0.1,
}


def rail_from_gyro() -> Structure:
    """G_v and G_x, paper equation (9), from the pitch rate q to the position x; also gives v and theta.

    By default k_v, p_v, the range's age and the start are estimated; `coulomb` and `q_bias` can be. Dry and viscous
    friction have much the same effect in one doublet, and so have the bias and the start: these need a long record.
    """
    plant = RailFromGyro()
    diagram = Diagram("rail_from_gyro", "position from pitch rate")
    diagram.input("q", unit="rad/s")
    for param in plant.params:
        diagram.param(param.name, float(param.value), unit=param.unit, low=param.low, high=param.high, text=param.text)
    diagram.add("plant", plant, params={param.name: param.name for param in plant.params}, q="q")
    for port in plant.outputs:
        diagram.output(port.name, f"plant.{port.name}")
    return Structure(
        diagram,
        ("k_v", "p_v", "x_age", "theta_0", "x_0", "v_0"),
        local=("q_bias", "theta_0", "x_0", "v_0"),
        scale=_SCALES,
    )
