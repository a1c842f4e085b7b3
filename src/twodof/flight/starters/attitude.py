"""Starter diagrams for the template attitude_control: the stock loops, a PID, an LQR, a notch, and an empty one."""

from collections.abc import Sequence

from twodof.blocks import Diagram
from twodof.blocks.library import (
    Constant,
    DiscreteIntegrator,
    Gain,
    Logic,
    MatrixGain,
    Mux,
    Notch,
    Pid,
    Saturation,
    Sum,
    Switch,
    UnitDelay,
)
from twodof.flight.cascade import AttitudeLoop, RateLoop
from twodof.flight.gains import DEFAULT, Gains
from twodof.flight.templates import ATTITUDE, Template
from twodof.models.lqr import LqrGains, attitude_lqr, rate_lqr


def with_ports(template: Template, name: str, text: str) -> Diagram:
    """Return a diagram with the inputs of `template`, still without parts."""
    d = Diagram(name, text)
    for port in template.inputs:
        d.input(port.name, port.kind, unit=port.unit)
    return d


def tuned(d: Diagram, name: str, value: float | Sequence[float], unit: str, low: float, high: float, text: str) -> None:
    """Declare a tunable parameter of the diagram, a number or an array, to which parameters of its parts are bound."""
    width = len(value) if isinstance(value, Sequence) else None
    d.param(
        name,
        list(value) if isinstance(value, Sequence) else value,
        width=width,
        unit=unit,
        low=low,
        high=high,
        text=text,
    )


def rate_gains(d: Diagram, gains: Gains) -> tuple[float, float, float]:
    """Declare the gains of the rate loop as parameters q_kp, q_ki, q_kd; return their values."""
    kp, ki, kd = gains.rate
    tuned(d, "q_kp", kp, "s/rad", 0.0, 1.0, "rate P")
    tuned(d, "q_ki", ki, "1/rad", 0.0, 5.0, "rate I")
    tuned(d, "q_kd", kd, "s2/rad", 0.0, 0.05, "rate D")
    return kp, ki, kd


def pitch_loop(d: Diagram, kp: float) -> None:
    """Add a part `q_0_used`: theta_kp (theta_0 - theta) within +-20 rad/s, or q_0 if the attitude loop is open."""
    tuned(d, "theta_kp", kp, "1/s", 0.0, 50.0, "attitude P")
    d.add("pitch_error", Sum("+-", unit="rad"), a="theta_0", b="theta", position=(160.0, 20.0))
    d.add("pitch_gain", Gain(1.0, unit="rad/s"), params={"k": "theta_kp"}, u="pitch_error", position=(280.0, 20.0))
    d.add("rate_limit", Saturation(-20.0, 20.0, unit="rad/s"), u="pitch_gain", position=(400.0, 20.0))
    d.add(
        "q_0_used",
        Switch(unit="rad/s"),
        condition="FLAG_ATTITUDE_ENABLED",
        a="rate_limit",
        b="q_0",
        position=(520.0, 60.0),
    )


HOVER_MOMENT = 0.4
"""Largest moment in hover, at T = .4, that neither stops a rotor pair nor changes the thrust."""

VIBRATION = 38.0
"""Centre of the band in which the airframe vibrates in hover, by the spectra of the drone's logs [Hz]."""


NOTCHED = Gains((0.068, 0.16, 0.00065), 8.0, DEFAULT.velocity, DEFAULT.position)
"""Gains for the loop with the notch, which costs some 5 deg of phase at the crossover. With them and the paper's model
the loop opened at M has its crossover at 28 rad/s, a phase margin of 44 deg and a gain margin of 6.5 dB. The default
gains without notch give 34 rad/s, 34 deg and 5.7 dB.
"""


def stock_attitude(gains: Gains = DEFAULT) -> Diagram:
    """Return the attitude and rate loops made of the stock cascade's own blocks: the same bits as the stock loops."""
    d = with_ports(ATTITUDE, "stock_attitude", "attitude P and rate PID of the stock cascade, as they fly")
    d.add(
        "attitude",
        AttitudeLoop(gains.attitude),
        theta0="theta_0",
        theta="theta",
        q0="q_0",
        closed="FLAG_ATTITUDE_ENABLED",
        position=(200.0, 60.0),
    )
    d.add("rate", RateLoop(*gains.rate), q0="attitude.q0", q="q", in_reset="FLAG_RESET_INT", position=(400.0, 100.0))
    d.output("M", "rate.M")
    return d


def pid_attitude(gains: Gains = DEFAULT, anti_windup: str = "none") -> Diagram:
    """Return the laws of the stock loops in library blocks: equal to the stock loops up to rounding, easy to change.

    With `anti_windup` "clamping" or "back-calculation" M is limited to +-.4, where a rotor pair stops in hover, and the
    rate's integral does not wind up. The time constant of back-calculation is that of the integral, Kp/Ki. Raises
    DiagramError for another `anti_windup`.
    """
    d = with_ports(ATTITUDE, "pid_attitude", "attitude P and rate PID, block by block")
    pitch_loop(d, gains.attitude)
    d.add("error", Sum("+-", unit="rad/s"), a="q_0_used", b="q", position=(680.0, 130.0))
    limit = 1.0 if anti_windup == "none" else HOVER_MOMENT
    kp, ki, _ = gains.rate
    _rate_pid(d, gains, limit, anti_windup, min(100.0, ki / kp) if kp > 0.0 else 5.0)
    d.output("M", "pid")
    return d


def notch_attitude(gains: Gains = NOTCHED) -> Diagram:
    """Return `pid_attitude` with a notch filter on q at the vibration's 38 Hz, M limited to +-.4 and anti-windup."""
    d = with_ports(ATTITUDE, "notch_attitude", "attitude P, rate PID with anti-windup, and a notch against vibration")
    pitch_loop(d, gains.attitude)
    tuned(d, "notch_hz", VIBRATION, "Hz", 10.0, 120.0, "frequency of the notch: the airframe's vibration")
    tuned(d, "notch_width", 0.3, "", 0.0, 2.0, "damping of its poles: the band is 2 notch_width notch_hz wide")
    tuned(d, "notch_depth", 0.1, "", 0.0, 1.0, "gain at its frequency")
    d.add(
        "notch",
        Notch(VIBRATION, 0.3, 0.1, unit="rad/s"),
        params={"frequency": "notch_hz", "width": "notch_width", "depth": "notch_depth"},
        u="q",
        position=(480.0, 230.0),
    )
    d.add("error", Sum("+-", unit="rad/s"), a="q_0_used", b="notch", position=(680.0, 130.0))
    _rate_pid(d, gains, HOVER_MOMENT, "back-calculation")
    d.output("M", "pid")
    return d


def empty_attitude() -> Diagram:
    """Return a diagram with all ports of the template that gives no moment, to begin from."""
    d = with_ports(ATTITUDE, "empty_attitude", "no moment, whatever comes in")
    d.add("moment", Constant(0.0), position=(300.0, 100.0))
    d.output("M", "moment")
    return d


def lqr_attitude(attitude: LqrGains | None = None, rate: LqrGains | None = None) -> Diagram:
    """Return an LQR with integral action and the moments within the delay as states; a second one follows q_0.

    `attitude` and `rate` have gains on the same number of past moments; by default they are those of
    `twodof.models.lqr` for the paper's drone (w_n 3.437 rad/s, xi .0836, mu 358.5, tau 20 ms: five steps). M is limited
    to +-1. The past moments are the limited ones, so the prediction uses what the actuator does. The integrals are
    limited too.
    """
    pitch = attitude_lqr() if attitude is None else attitude
    turn = rate_lqr() if rate is None else rate
    steps = len(pitch.history)
    d = with_ports(ATTITUDE, "lqr_attitude", f"LQR on theta, q, the integral and the last {steps} moments")
    tuned(d, "k_theta", pitch.state[0], "1/rad", 0.0, 10.0, "attitude: gain on the pitch error")
    tuned(d, "k_q", pitch.state[1], "s/rad", 0.0, 1.0, "attitude: gain on the pitch rate")
    tuned(d, "k_i", pitch.integral, "1/rad/s", 0.0, 20.0, "attitude: gain on the integral of the pitch error")
    tuned(d, "k_past", pitch.history, "", -2.0, 2.0, "attitude: gains on the past moments, the latest first")
    tuned(d, "rate_k", turn.state[0], "s/rad", 0.0, 1.0, "rate mode: gain on the rate error")
    tuned(d, "rate_k_i", turn.integral, "1/rad", 0.0, 20.0, "rate mode: gain on the integral of the rate error")
    tuned(d, "rate_k_past", turn.history, "", -2.0, 2.0, "rate mode: gains on the past moments, the latest first")
    d.add("error", Sum("+-", unit="rad"), a="theta_0", b="theta", position=(160.0, 0.0))
    d.add("rate_error", Sum("+-", unit="rad/s"), a="q_0", b="q", position=(160.0, 320.0))
    # Each integral runs only while its loop is closed.
    d.add("in_rate_mode", Logic("not"), a="FLAG_ATTITUDE_ENABLED", position=(180.0, 230.0))
    d.add("clear", Logic("or"), a="FLAG_RESET_INT", b="in_rate_mode", position=(320.0, 90.0))
    d.add("rate_clear", Logic("or"), a="FLAG_RESET_INT", b="FLAG_ATTITUDE_ENABLED", position=(320.0, 400.0))
    for prefix, limit, unit, row in (("", 0.3, "rad*s", 40.0), ("rate_", 1.0, "rad", 340.0)):
        d.add(
            f"{prefix}integral",
            DiscreteIntegrator("backward", limits=(-limit, limit), reset=True, unit=unit),
            u=f"{prefix}error",
            clear=f"{prefix}clear",
            position=(460.0, row),
        )
    for name, source, bound, row in (
        ("on_theta", "error", "k_theta", 0.0),
        ("on_integral", "integral", "k_i", 70.0),
        ("on_q", "q", "k_q", 140.0),
        ("on_rate", "rate_error", "rate_k", 300.0),
        ("on_rate_integral", "rate_integral", "rate_k_i", 370.0),
    ):
        d.add(name, Gain(1.0), params={"k": bound}, u=source, position=(620.0, row))
    newest = [f"past_{i}" for i in range(1, steps + 1)]
    for i, name in enumerate(newest):
        d.add(name, UnitDelay(0.0), u=newest[i - 1] if i else "limit", position=(160.0 + 90.0 * i, 600.0))
    mux = Mux(steps)
    d.add("past", mux, position=(640.0, 480.0))
    for port, name in zip(mux.inputs, newest, strict=True):
        d.connect(name, f"past.{port.name}")
    for name, bound, row in (("on_past", "k_past", 220.0), ("on_rate_past", "rate_k_past", 500.0)):
        d.add(name, MatrixGain([[0.0] * steps]), params={"K": bound}, u="past", position=(760.0, row))
    d.add("attitude", Sum("++--"), a="on_theta", b="on_integral", c="on_q", d="on_past", position=(900.0, 60.0))
    d.add("rate", Sum("++-"), a="on_rate", b="on_rate_integral", c="on_rate_past", position=(900.0, 360.0))
    d.add("mode", Switch(), condition="FLAG_ATTITUDE_ENABLED", a="attitude", b="rate", position=(1020.0, 180.0))
    _limits(d, 1.0)
    d.add("limit", Saturation(-1.0, 1.0), params={"low": "M_low", "high": "M_high"}, u="mode", position=(1180.0, 200.0))
    d.output("M", "limit")
    return d


def _rate_pid(d: Diagram, gains: Gains, limit: float, anti_windup: str, tracking: float = 5.0) -> None:
    """Add the PID `pid` from the rate's `error` to the moment, limited to +-`limit`."""
    kp, ki, kd = rate_gains(d, gains)
    tuned(d, "q_n", 100.0, "rad/s", 1.0, 1000.0, "corner of the derivative's filter")
    _limits(d, limit)
    bound = {"Kp": "q_kp", "Ki": "q_ki", "Kd": "q_kd", "N": "q_n", "low": "M_low", "high": "M_high"}
    if anti_windup == "back-calculation":
        tuned(d, "tracking", tracking, "1/s", 0.0, 100.0, "how fast the integral follows the limited moment")
        bound["Kb"] = "tracking"
    d.add(
        "pid",
        Pid(kp, ki, kd, 100.0, limits=(-limit, limit), anti_windup=anti_windup, reset="integral", unit="rad/s"),
        params=bound,
        e="error",
        clear="FLAG_RESET_INT",
        position=(800.0, 170.0),
    )


def _limits(d: Diagram, limit: float) -> None:
    tuned(d, "M_low", -limit, "", -1.0, 0.0, "smallest moment")
    tuned(d, "M_high", limit, "", 0.0, 1.0, "largest moment")
