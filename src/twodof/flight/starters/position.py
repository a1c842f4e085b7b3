"""Starter diagrams for the templates position_control and motor_control."""

from twodof.blocks import Diagram
from twodof.blocks.library import (
    Abs,
    Constant,
    Divide,
    DynamicSaturation,
    Gain,
    Pid,
    Product,
    Saturation,
    Sum,
    Switch,
    Trigonometry,
)
from twodof.flight.cascade import PositionLoop, Projection, VelocityLoop
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.starters.attitude import pitch_loop, rate_gains, tuned, with_ports
from twodof.flight.templates import AFT_MOTORS, FORE_MOTORS, MOTOR, POSITION

MASS = 0.534
"""Mass of drone and cart [kg]."""


def stock_position(gains: Gains = DEFAULT) -> Diagram:
    """Return position loop, velocity loop and projection made of the stock cascade's own blocks."""
    d = with_ports(POSITION, "stock_position", "position P, velocity PI and projection of the stock cascade")
    d.add(
        "position",
        PositionLoop(gains.position),
        x0="x_0",
        x="x",
        v0="vx_0",
        closed="FLAG_POSITION_ENABLED",
        position=(200.0, 40.0),
    )
    d.add(
        "velocity",
        VelocityLoop(*gains.velocity),
        v0="position.v0",
        v="vx",
        in_reset="FLAG_RESET_INT_VEL",
        position=(460.0, 130.0),
    )
    d.add("projection", Projection(), force="velocity.force", position=(720.0, 150.0))
    d.output("thrust", "projection.T")
    d.output("theta_0", "projection.theta0")
    return d


def pid_position(gains: Gains = DEFAULT) -> Diagram:
    """Return the laws of the stock loops in library blocks, with feed-forward of the acceleration set-point ax_0."""
    d = with_ports(POSITION, "pid_position", "position P and velocity PI, block by block, with feed-forward of ax_0")
    kp, ki = gains.velocity
    tuned(d, "x_kp", gains.position, "1/s", 0.0, 10.0, "position P")
    tuned(d, "vx_kp", kp, "N*s/m", 0.0, 20.0, "velocity P")
    tuned(d, "vx_ki", ki, "N/m", 0.0, 20.0, "velocity I")
    tuned(d, "mass", MASS, "kg", 0.0, 5.0, "mass that ax_0 accelerates; 0: no feed-forward")
    tuned(d, "T_bar", 0.4, "", 0.05, 1.0, "thrust when level")
    tuned(d, "eta_T", 6.3386, "N", 0.1, 100.0, "force of full thrust")
    d.add("x_error", Sum("+-", unit="m"), a="x_0", b="x", position=(160.0, 20.0))
    d.add("x_gain", Gain(1.0, unit="m/s"), params={"k": "x_kp"}, u="x_error", position=(280.0, 20.0))
    d.add("vx_limit", Saturation(-1.0, 1.0, unit="m/s"), u="x_gain", position=(400.0, 20.0))
    d.add(
        "vx_0_used",
        Switch(unit="m/s"),
        condition="FLAG_POSITION_ENABLED",
        a="vx_limit",
        b="vx_0",
        position=(520.0, 60.0),
    )
    d.add("vx_error", Sum("+-", unit="m/s"), a="vx_0_used", b="vx", position=(680.0, 130.0))
    d.add(
        "pi",
        Pid(kp, ki, reset="integral", unit="m/s", output_unit="N"),
        params={"Kp": "vx_kp", "Ki": "vx_ki"},
        e="vx_error",
        clear="FLAG_RESET_INT_VEL",
        position=(800.0, 170.0),
    )
    d.add("feed_forward", Gain(1.0, unit="N"), params={"k": "mass"}, u="ax_0", position=(800.0, 260.0))
    d.add("force", Sum("++", unit="N"), a="pi", b="feed_forward", position=(940.0, 190.0))
    d.add("T_level", Constant(0.4), params={"value": "T_bar"}, position=(800.0, 330.0))
    d.add("full", Constant(6.3386, unit="N"), params={"value": "eta_T"}, position=(800.0, 390.0))
    d.add("lift", Product("**", unit="N"), a="T_level", b="full", position=(940.0, 370.0))
    # theta > 0 pushes towards -x.
    d.add("slope", Divide(), a="force", b="lift", position=(1060.0, 200.0))
    d.add("tilt", Trigonometry("atan", unit="rad"), u="slope", position=(1180.0, 210.0))
    d.add("pitch", Gain(-1.0, unit="rad"), u="tilt", position=(1300.0, 210.0))
    d.add("upright", Trigonometry("cos", input_unit="rad"), u="pitch", position=(1420.0, 340.0))
    d.add("thrust_up", Divide(), a="T_level", b="upright", position=(1550.0, 310.0))
    d.output("thrust", "thrust_up")
    d.output("theta_0", "pitch")
    return d


def empty_position() -> Diagram:
    """Return a diagram with all ports of the template, pitch set-point 0 and the hover's thrust, to begin from."""
    d = with_ports(POSITION, "empty_position", "level and hovering, whatever comes in")
    d.add("hover", Constant(0.4), position=(300.0, 60.0))
    d.add("level", Constant(0.0, unit="rad"), position=(300.0, 140.0))
    d.output("thrust", "hover")
    d.output("theta_0", "level")
    return d


def stock_motor() -> Diagram:
    """Return the stock mixer for single motors: thrust + moment fore, thrust - moment aft, clipped to 0 .. 1."""
    d = with_ports(MOTOR, "stock_motor", "fore motors thrust + moment, aft motors thrust - moment")
    motor_pairs(d, "thrust_0", "M_0")
    return d


def direct_motor(gains: Gains = DEFAULT) -> Diagram:
    """Return attitude and rate loops that command the motors, from the raw gyro.

    It follows theta_0 or q_0, as the mode says, and M_0 in open loop. The moment is limited to +-.5. The thrust is
    reduced or raised so that no motor's command is above 1 or below 0.
    """
    d = with_ports(MOTOR, "direct_motor", "attitude P, rate PID on the gyro, and a mixer that keeps the moment")
    pitch_loop(d, gains.attitude)
    kp, ki, kd = rate_gains(d, gains)
    d.add("error", Sum("+-", unit="rad/s"), a="q_0_used", b="gyro_y", position=(680.0, 130.0))
    d.add(
        "pid",
        Pid(kp, ki, kd, 100.0, limits=(-0.5, 0.5), anti_windup="clamping", reset="integral", unit="rad/s"),
        params={"Kp": "q_kp", "Ki": "q_ki", "Kd": "q_kd"},
        e="error",
        clear="FLAG_RESET_INT",
        position=(800.0, 170.0),
    )
    d.add("asked", Switch(), condition="FLAG_RATE_ENABLED", a="pid", b="M_0", position=(940.0, 230.0))
    d.add("moment", Saturation(-0.5, 0.5), u="asked", position=(1080.0, 250.0))
    d.add("least", Abs(), u="moment", position=(1200.0, 330.0))
    d.add("one", Constant(1.0), position=(1200.0, 410.0))
    d.add("most", Sum("+-"), a="one", b="least", position=(1320.0, 390.0))
    d.add("thrust", DynamicSaturation(), u="thrust_0", low="least", high="most", position=(1450.0, 300.0))
    motor_pairs(d, "thrust", "moment")
    return d


def empty_motor() -> Diagram:
    """Return a diagram with all ports of the template and thrust_0 on each motor, so no moment, to begin from."""
    d = with_ports(MOTOR, "empty_motor", "the thrust asked for on every motor, no moment")
    d.add("each", Gain(1.0), u="thrust_0", position=(300.0, 100.0))
    for motor in sorted((*FORE_MOTORS, *AFT_MOTORS)):
        d.output(motor, "each")
    return d


def motor_pairs(d: Diagram, thrust: str, moment: str) -> None:
    """Add the four motors' outputs: thrust + moment for the fore pair, thrust - moment for the aft pair."""
    d.add("fore_sum", Sum("++"), a=thrust, b=moment, position=(1620.0, 180.0))
    d.add("aft_sum", Sum("+-"), a=thrust, b=moment, position=(1620.0, 300.0))
    d.add("fore", Saturation(0.0, 1.0), u="fore_sum", position=(1740.0, 190.0))
    d.add("aft", Saturation(0.0, 1.0), u="aft_sum", position=(1740.0, 310.0))
    for motor in sorted((*FORE_MOTORS, *AFT_MOTORS)):
        d.output(motor, "fore" if motor in FORE_MOTORS else "aft")
