"""Estimator: pitch, pitch rate, position and velocity from the IMU at 250 Hz and the time-of-flight sensor."""

from typing import Any

from twodof.blocks import Block, Diagram, State, int32, where
from twodof.errors import ParameterError
from twodof.flight.declarations import IMU, RANGE, add_inputs, ports
from twodof.flight.joint_filter import LongitudinalFilter
from twodof.flight.separate_filters import FixedGainPosition, KalmanPosition, PitchFilter, RailAcceleration

POSITION_FILTERS = ("joint", "fixed-gain", "kalman")


class Publisher(Block):
    """Position and velocity as they are published: at 100 Hz, every second or third of the 250 Hz samples in turn.

    What is published at a sample is read from the next one on.
    """

    inputs = outputs = ports("x", "v")
    states = (State("x", unit="m"), State("v", unit="m/s"), State("phase", 0, "int32"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"x": x.x, "v": x.v}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        # 100 / 250 = 2 / 5: an accumulator that overflows twice in five samples.
        phase = x.phase + int32(2)
        due = phase >= int32(5)
        return {
            "x": where(due, u.x, x.x),
            "v": where(due, u.v, x.v),
            "phase": where(due, phase - int32(5), phase),
        }


def estimator(position_filter: str = "joint") -> Diagram:
    """Return the estimator, made for 250 Hz.

    `position_filter` is "joint": one extended Kalman filter for pitch and position, which comes closest to the drone's
    own estimates. The others, "fixed-gain" and "kalman", are fed with the pitch of a filter of its own.
    Inputs: `acc_x`, `acc_z` [m/s2] (specific force, body axes forward-right-down), `gyro_y` [rad/s] and `dist` [m].
    `dist_new` (bool) is true for one tick a sample; `dist_age` [s] is its age at that tick. Outputs of this sample:
    `theta` [rad], `q` [rad/s], `x` [m], `v` [m/s]. `x_published` and `v_published` are held at 100 Hz. Raises
    ParameterError for another filter.
    """
    if position_filter not in POSITION_FILTERS:
        raise ParameterError(
            f"no filter called {position_filter!r:.80}", "position_filter", f"use {', '.join(POSITION_FILTERS)}"
        )
    d = Diagram("estimator", "pitch by an extended Kalman filter, position by the filter chosen")
    add_inputs(d, *IMU, "dist", "dist_age", "dist_new")
    if position_filter == "joint":
        d.add("filter", LongitudinalFilter())
        for name in d.inputs:
            d.connect(name, f"filter.{name}")
        pitch = position = "filter"
    else:
        pitch, position = _separate(d, position_filter)
    d.add("publisher", Publisher(), x=f"{position}.x", v=f"{position}.v")
    d.output("theta", f"{pitch}.theta")
    d.output("q", f"{pitch}.q")
    d.output("x", f"{position}.x")
    d.output("v", f"{position}.v")
    d.output("x_published", "publisher.x")
    d.output("v_published", "publisher.v")
    return d


def _separate(d: Diagram, position_filter: str) -> tuple[str, str]:
    """Add the pitch filter and, fed with its pitch, a position filter; return their names."""
    d.add("pitch", PitchFilter(), acc_x="acc_x", acc_z="acc_z", gyro_y="gyro_y")
    d.add("rail", RailAcceleration(), acc_x="acc_x", acc_z="acc_z", theta="pitch.theta")
    position = KalmanPosition() if position_filter == "kalman" else FixedGainPosition()
    sources = {"acceleration": "rail.acceleration"} | {name: name for name in RANGE}
    d.add("position", position, inputs=sources)
    return "pitch", "position"
