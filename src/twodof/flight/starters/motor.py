"""Starter diagrams for the template motor_control: the stock mixer, one that keeps the moment, the rate loop on the
motors, and an empty one."""

from twodof.blocks import Diagram
from twodof.blocks.library import Abs, Constant, DynamicSaturation, Gain, Pid, Saturation, Sum, Switch
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.starters.build import pitch_loop, rate_gains, with_ports
from twodof.flight.templates import AFT_MOTORS, FORE_MOTORS, MOTOR


def stock_motor() -> Diagram:
    """The stock mixer on single motors: thrust +- moment, each clipped to 0 .. 1."""
    d = with_ports(MOTOR, "stock_motor", "fore motors thrust + moment, aft motors thrust - moment")
    motor_pairs(d, "thrust_0", "M_0")
    return d


def direct_motor(gains: Gains = DEFAULT) -> Diagram:
    """The attitude and rate loops straight on the motors, from the raw gyro; thrust is given up before moment is.

    It follows theta_0 or q_0 by itself, as the level above asks for, and flies M_0 in open loop. The moment is
    kept within +-.5; the thrust gives way, so that no motor is asked for more than 1 or less than 0.
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
    """All the ports; each motor the thrust that is asked for, so no moment: the place to begin."""
    d = with_ports(MOTOR, "empty_motor", "the thrust asked for on every motor, no moment")
    d.add("each", Gain(1.0), u="thrust_0", position=(300.0, 100.0))
    for motor in sorted((*FORE_MOTORS, *AFT_MOTORS)):
        d.output(motor, "each")
    return d


def motor_pairs(d: Diagram, thrust: str, moment: str) -> None:
    """The motors' commands: thrust + moment on the fore pair, thrust - moment on the aft one."""
    d.add("fore_sum", Sum("++"), a=thrust, b=moment, position=(1620.0, 180.0))
    d.add("aft_sum", Sum("+-"), a=thrust, b=moment, position=(1620.0, 300.0))
    d.add("fore", Saturation(0.0, 1.0), u="fore_sum", position=(1740.0, 190.0))
    d.add("aft", Saturation(0.0, 1.0), u="aft_sum", position=(1740.0, 310.0))
    for motor in sorted((*FORE_MOTORS, *AFT_MOTORS)):
        d.output(motor, "fore" if motor in FORE_MOTORS else "aft")
