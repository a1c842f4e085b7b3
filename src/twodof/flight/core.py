"""The flight core: sensors and set-points in, rotor commands out, at 250 Hz; one diagram."""

from __future__ import annotations

from typing import Any

from twodof.blocks import Block, Diagram, Port, State
from twodof.flight.cascade import cascade
from twodof.flight.estimator import estimator
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.level_hold import ArmingReset, LevelHold
from twodof.flight.mixer import Mixer

PERIOD = 0.004
"""The core's period [s]."""

INPUTS: tuple[tuple[str, str, str, str], ...] = (
    ("acc_x", "real", "m/s2", "specific force along the body's x axis"),
    ("acc_z", "real", "m/s2", "specific force along the body's z axis (down)"),
    ("gyro_y", "real", "rad/s", "pitch rate"),
    ("dist", "real", "m", "time-of-flight range; x = dist - 0.50"),
    ("dist_new", "bool", "", "a range sample is handed over in this tick"),
    ("dist_age", "real", "s", "its age at this tick"),
    ("mode", "int32", "", "index into signals.MODES"),
    ("in_reset", "bool", "", "hold the integrals in reset (besides the reset at arming, which is inside)"),
    ("x0", "real", "m", "position set-point, in position mode"),
    ("v0", "real", "m/s", "velocity set-point, in velocity mode"),
    ("theta0", "real", "rad", "pitch set-point, in attitude mode"),
    ("q0", "real", "rad/s", "pitch-rate set-point, in rate mode"),
    ("thrust", "real", "", "thrust in open-loop, rate and attitude mode"),
    ("M_open", "real", "", "moment in open loop"),
    ("use_trim", "bool", "", "add the trim moment that the last level hold found to M_open"),
)
"""Name, type, unit, meaning of each input of the core."""

OUTPUTS: tuple[tuple[str, str, str], ...] = (
    ("fore", "", "command of the fore rotor pair, 0 to 1"),
    ("aft", "", "command of the aft rotor pair, 0 to 1"),
    ("M", "", "normalised moment commanded"),
    ("T", "", "normalised thrust commanded"),
    ("theta", "rad", "estimated pitch of this sample; the cascade reads that of the sample before"),
    ("q", "rad/s", "estimated pitch rate"),
    ("x", "m", "estimated position as published at 100 Hz"),
    ("v", "m/s", "estimated velocity as published at 100 Hz"),
    ("x0", "m", "position set-point in use"),
    ("v0", "m/s", "velocity set-point in use"),
    ("theta0", "rad", "pitch set-point in use"),
    ("q0", "rad/s", "pitch-rate set-point in use"),
    ("M_trim", "", "trim moment that the last level hold found"),
)
"""Name, unit, meaning of each output of the core."""


class PreviousPitch(Block):
    """The pitch of the sample before: the drone's estimator publishes after the controller has read."""

    inputs = (Port("theta", unit="rad"),)
    outputs = (Port("theta", unit="rad"),)
    states = (State("theta", unit="rad"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.theta

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.theta


def core(gains: Gains = DEFAULT, position_filter: str = "joint") -> Diagram:
    """What flies: estimator, level hold, cascade, mixer, with the ports `INPUTS` and `OUTPUTS`, made for 250 Hz.

    Parameter paths: `estimator.filter...` (of the joint filter; else `estimator.pitch...`, `estimator.position...`),
    `cascade.rate.kp` and so on (see `cascade`), `hold.settle`, `hold.window`, `arming.samples`. Raises
    ParameterError for an unknown position filter.
    """
    d = Diagram("flight", "estimator, level hold, cascade and mixer at 250 Hz")
    for name, kind, unit, _ in INPUTS:
        d.input(name, kind, unit=unit)
    d.add("estimator", estimator(position_filter))
    for name in ("acc_x", "acc_z", "gyro_y", "dist", "dist_new", "dist_age"):
        d.connect(name, f"estimator.{name}")
    d.add("previous", PreviousPitch(), theta="estimator.theta")
    d.add("arming", ArmingReset(), mode="mode", thrust="thrust", in_reset="in_reset")
    d.add("hold", LevelHold(), mode="mode", thrust="thrust", excitation="M_open", use_trim="use_trim")
    d.add(
        "cascade",
        cascade(gains),
        mode="mode",
        in_reset="arming",
        M_open="hold.M_open",
        x="estimator.x_published",
        v="estimator.v_published",
        theta="previous.theta",
        q="estimator.q",
    )
    for name in ("x0", "v0", "theta0", "q0", "thrust"):
        d.connect(name, f"cascade.{name}")
    d.connect("cascade.M", "hold.M")
    d.add("mixer", Mixer(), T="cascade.T", M="cascade.M")
    for name in ("fore", "aft"):
        d.output(name, f"mixer.{name}")
    for name in ("M", "T", "x0", "v0", "theta0", "q0"):
        d.output(name, f"cascade.{name}")
    d.output("theta", "estimator.theta")
    d.output("q", "estimator.q")
    d.output("x", "estimator.x_published")
    d.output("v", "estimator.v_published")
    d.output("M_trim", "hold.M_trim")
    return d
