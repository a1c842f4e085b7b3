"""Small diagrams: two whose modules are golden files, and others whose modules fly on the bench."""

from typing import Any

from twodof.blocks import Block, Diagram, Param, Port, State, int32, to_real, where
from twodof.blocks import library as lib
from twodof.flight.starters import starter


class Damper(Block):
    """M = kp (theta_0 - theta) - kd q + bias, the integral of the error with a weight that an integer divides."""

    inputs = (
        Port("theta_0", unit="rad"),
        Port("theta", unit="rad"),
        Port("q", unit="rad/s"),
        Port("reset", "bool"),
        Port("closed", "bool"),
    )
    outputs = (Port("M"), Port("error", unit="rad"), Port("count", "int32"))
    states = (State("sum", "sum_0"), State("count", 0, "int32"))
    params = (
        Param("gains", [0.5, 0.08], width=2, low=0.0, high=4.0, text="of pitch and pitch rate"),
        Param("ki", 0.3, unit="1/rad", low=0.0, high=5.0, text="integral"),
        Param("share", 4, "int32", low=1, high=16, text="the integral's divisor"),
        Param("integrating", True, "bool", text="whether the integral is in use"),
        Param("sum_0", 0.0, unit="rad*s", low=-1.0, high=1.0, text="the integral at the start", tunable=False),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        error = where(u.closed, u.theta_0 - u.theta, 0.0)
        integral = where(p.integrating, p.ki * x.sum, 0.0)
        return {"M": p.gains[0] * error - p.gains[1] * u.q + integral, "error": error, "count": x.count}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        step = (u.theta_0 - u.theta) * t.dt
        return {"sum": where(u.reset, 0.0, x.sum + step / to_real(p.share)), "count": x.count + int32(1)}


def pitch() -> Diagram:
    """An attitude controller with parameters of all types, an array and one that is fixed."""
    d = Diagram("pitch", "pitch damper; a test's diagram")
    d.input("theta_0", unit="rad")
    d.input("q_0", unit="rad/s")
    d.input("theta", unit="rad")
    d.input("q", unit="rad/s")
    d.input("FLAG_RESET_INT", "bool")
    d.input("FLAG_ATTITUDE_ENABLED", "bool")
    d.add(
        "damper",
        Damper(),
        theta_0="theta_0",
        theta="theta",
        q="q",
        closed="FLAG_ATTITUDE_ENABLED",
        inputs={"reset": "FLAG_RESET_INT"},
    )
    d.add("feed", lib.Gain(0.01), u="q_0")
    d.add("sum", lib.Sum("++"), a="damper.M", b="feed")
    d.output("M", "sum")
    return d


PITCH_LOG = ("damper.error", "damper.count")


def rail() -> Diagram:
    """A position controller without states."""
    d = Diagram("rail", "proportional position controller; a test's diagram")
    for name, unit in (("x_0", "m"), ("vx_0", "m/s"), ("x", "m"), ("vx", "m/s"), ("ax_0", "m/s2")):
        d.input(name, unit=unit)
    d.input("FLAG_RESET_INT_VEL", "bool")
    d.input("FLAG_POSITION_ENABLED", "bool")
    d.param("kp", 1.5, unit="1/s", low=0.0, high=10.0, text="position P")
    d.param("k_pitch", -0.25, unit="rad*s/m", low=-2.0, high=0.0, text="pitch for a speed")
    d.add("error", lib.Sum("+-"), a="x_0", b="x")
    d.add("gain", lib.Gain(1.5), u="error", params={"k": "kp"})
    d.add("chosen", lib.Switch(), condition="FLAG_POSITION_ENABLED", a="gain", b="vx_0")
    d.add("slip", lib.Sum("+-"), a="chosen", b="vx")
    d.add("pitch", lib.Gain(-0.25), u="slip", params={"k": "k_pitch"})
    d.add("hover", lib.Constant(0.4))
    d.output("thrust", "hover")
    d.output("theta_0", "pitch")
    return d


def attitude_alone() -> Diagram:
    """M = theta_0 - theta, without an input that says whether attitude is controlled."""
    d = Diagram("alone")
    d.input("theta_0", unit="rad")
    d.input("theta", unit="rad")
    d.add("error", lib.Sum("+-"), a="theta_0", b="theta")
    d.output("M", "error")
    return d


def overflowing() -> Diagram:
    """M grows by 1e12 at each step, and so is infinite at the fourth."""
    d = Diagram("overflow")
    d.input("q", unit="rad/s")
    d.add("grow", lib.UnitDelay(1.0))
    d.add("gain", lib.Gain(1e12), u="grow")
    d.add("zero", lib.Gain(0.0), u="q")
    d.add("sum", lib.Sum("++"), a="gain", b="zero")
    d.connect("sum", "grow.u")
    d.output("M", "sum")
    return d


def both() -> Diagram:
    """The stock position controller above the stock attitude controller, in one diagram."""
    d = Diagram("both")
    above, below = starter("stock-position"), starter("stock-attitude")
    for part in (above, below):
        for name, port in part.inputs.items():
            if name != "theta_0":
                d.input(name, port.kind, port.width, port.unit)
    d.add("above", above, inputs={name: name for name in above.inputs})
    d.add("below", below, inputs={n: "above.theta_0" if n == "theta_0" else n for n in below.inputs})
    d.output("M", "below.M")
    d.output("thrust", "above.thrust")
    d.output("theta_0", "above.theta_0")
    return d


def motors() -> Diagram:
    """fore = thrust_0 + M_0, aft = thrust_0 - M_0."""
    d = Diagram("mixer")
    for name, unit in (("M_0", ""), ("thrust_0", ""), ("acc_z", "m/s2"), ("gyro_y", "rad/s")):
        d.input(name, unit=unit)
    d.add("fore", lib.Sum("++"), a="thrust_0", b="M_0")
    d.add("aft", lib.Sum("+-"), a="thrust_0", b="M_0")
    for n, source in enumerate(("fore", "aft", "fore", "aft"), 1):
        d.output(f"motor_{n}", source)
    return d
