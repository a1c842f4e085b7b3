"""Ready-made model structures of pitch, velocity and rail, each a diagram like those of a user.

They are the paper's G_q and G_v, both at once, the free response with dry friction, and the course's three-state model.
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from twodof.blocks.block import Block
from twodof.blocks.diagram import Diagram
from twodof.blocks.library import Constant, Sum
from twodof.models.around_plant import Bend, InputDelay, Offset
from twodof.models.dry_friction import CartPush, Lift, PitchPendulum, Rail
from twodof.models.structure import Structure
from twodof.models.zero_order_hold import (
    ZohLongitudinal,
    ZohPitchAndVelocity,
    ZohPitchRate,
    ZohPitchRateLag,
    ZohPlant,
    ZohPushedPitchRate,
    ZohVelocity,
)
from twodof.signals import PERIOD

# A change of the initial state or of an offset that matters, for step sizes and for telling "no effect" from "small".
_SCALES: Mapping[str, float] = {
    **dict.fromkeys(("theta_0", "x_0", "v_0", "u_0", "a_x_bias", "curve", "asymmetry"), 0.1),
    **dict.fromkeys(("theta_trim", "theta_bias", "x_bias", "v_bias", "u_bias"), 0.02),
    **dict.fromkeys(("M_trim", "q_trim"), 0.01),
    **dict.fromkeys(("q_bias", "xi"), 0.05),
    **dict.fromkeys(("tau", "dead_time", "lag", "rotor_delay"), 0.004),
    "q_0": 1.0,
    "coulomb": 0.2,
    "hardening": 2.0,
}

ROTOR_LAG = (0.012, 0.005)
"""Lag of the rotors [s], mean and standard deviation. Closed-loop flights of the real drone gave .0126 to .0147 s, each
to .0005 s, and its calibration .0123 s. The deviation is ten times that of a flight: other motors have other lags."""

RAIL_WALK: Mapping[str, tuple[float, float]] = MappingProxyType({"theta_0": (6.5e-4, 1.6), "v_0": (0.004, 4.0)})
"""Pushes at the pitch [rad/sqrt(s)] and at the speed along the rail [m/s/sqrt(s)]: density, and factor of a deviation.

White noise of a gyro of .01 rad/s, as in the real drone's level holds, moves its integral by 6.3e-4. Real carts meet
forces of .07 m/s2 that last .2 s (docs/explanation/physics.md, section 9), which is .044. Virtual rails have none, so
little is taken for likely where a short flight does not tell it.
"""

# Wide bounds that keep a search inside what the model can mean; a fit can narrow or widen them.
_BOUNDS: Mapping[str, tuple[float, float]] = {
    "w_n": (0.05, 60.0),
    "xi": (-1.0, 5.0),
    "mu": (1.0, 5000.0),
    "lag": (0.0005, 0.2),
    "k_v": (0.0, 50.0),
    "p_v": (-5.0, 50.0),
    "coulomb": (0.0, 20.0),
}


def pitch_rate(lag: bool = False, ring: int = 64) -> Structure:
    """Make G_q, paper equation (5), from M to theta and q with an exact zero-order hold and fractional delay.

    With `lag` the delay has two parts, a pure `dead_time` and the rotors' first-order `lag`. Their sum is the paper's
    `tau`, which an estimate gives too. `lag` has a prior of 12 +- 5 ms (`ROTOR_LAG`), because a short flight hardly
    tells a longer lag from a larger gain. For other rotors give `fit` another `prior`. `ring` bounds the delay to `ring
    - 2` steps. On q alone `theta_0` and `M_trim` have the same effect: estimate only one of them.
    """
    if lag:
        return about_trim(
            "pitch_rate_lag",
            "angular rate from moment behind the rotors' lag, linear",
            ZohPitchRateLag(ring),
            ("w_n", "xi", "mu", "dead_time", "lag", "theta_0", "q_0"),
            {"dead_time": 0.01},
            ring,
            sums={"tau": ("dead_time", "lag")},
            prior={"lag": ROTOR_LAG},
        )
    return about_trim(
        "pitch_rate",
        "angular rate from moment, linear",
        ZohPitchRate(ring),
        ("w_n", "xi", "mu", "tau", "theta_0", "q_0"),
        {"tau": 0.015},
        ring,
    )


def pitch_on_cart(ring: int = 64) -> Structure:
    """Make `pitch_rate(lag=True)` with cart and bearing: from M, theta and the measured q (`gyro`) to q.

    The cart's acceleration pushes the pitch (see `CartPush`), rattling within the rings' `play` or free on the rail
    (a large `play`). Hold the cart's parameters at those of the machine's calibration, and estimate the bearing's dry
    friction `coulomb` with a prior. `M_u` is the pitch acceleration per speed along a free rail, and `bend` the lack of
    effect of a large moment; both are 0 unless estimated. The measured q moves the cart alone, so the structure does
    not explain q by q itself.
    """
    diagram = Diagram("pitch_on_cart", "angular rate from moment behind the rotors' lag, on a cart with play")
    diagram.input("M")
    diagram.input("theta", unit="rad")
    diagram.input("gyro", unit="rad/s")
    plant, cart, second = ZohPitchRateLag(ring), CartPush(), ZohPushedPitchRate()
    _offer(diagram, "M_trim", 0.0, "", "constant part of M that moves nothing")
    _offer(diagram, "dead_time", 0.01, "s", "delay of the input", (0.0, (ring - 2) * PERIOD))
    for param in (*plant.params, *cart.params):
        if param.name not in diagram.params:
            _offer(diagram, param.name, float(param.value), param.unit, param.text, (param.low, param.high))
    _offer(diagram, "bend", 0.0, "", "share of M^3 that a large moment lacks")
    diagram.add("bent", Bend(), params={"bend": "bend"}, u="M")
    diagram.add("trim", Offset("", -1.0), params={"offset": "M_trim"}, u="bent")
    diagram.add("plant", plant, params={param.name: param.name for param in plant.params}, M="trim")
    diagram.add("cart", cart, params={param.name: param.name for param in cart.params}, theta="theta", q="gyro")
    diagram.add("pushed", second, params={"w_n": "w_n", "xi": "xi"}, push="cart")
    diagram.add("sum", Sum(unit="rad/s"), a="plant.q", b="pushed.q")
    diagram.output("q", "sum")
    return Structure(
        diagram,
        ("w_n", "xi", "mu", "dead_time", "lag", "coulomb", "theta_0", "q_0"),
        local=("M_trim", "theta_0", "q_0"),
        scale={
            **{own: size for own, size in _SCALES.items() if own in diagram.params},
            "play": 1e-4,
            "coupling": 0.1,
            "bend": 0.1,
            "wake": 1.0,
        },
        sums={"tau": ("dead_time", "lag")},
        delay="dead_time",
        prior={"lag": ROTOR_LAG},
        measured=("theta", "gyro"),
    )


def velocity() -> Structure:
    """Make G_v and G_x, paper equation (9), from theta to x and v with an exact zero-order hold.

    `theta_trim` is subtracted from theta: the pitch at which the cart would not accelerate (a rail that is not level,
    a biased estimate). From v alone it cannot be told from `v_bias` unless friction is visible: both are 0 by default.
    """
    return about_trim("velocity", "velocity from pitch, linear friction", ZohVelocity(), ("k_v", "p_v", "v_0"))


def rail(thrust: bool = False, ring: int = 64) -> Structure:
    """Make G_v without small angles, from the measured q to theta, x and v (see `Rail`): for gyro and raw range.

    `tau` [s] is the age of the measured position at its stamp, `q_trim` the gyro's bias. With `thrust` the commands M
    and T are inputs too; the thrust, which a hard manoeuvre raises (see `Lift`), follows them after `rotor_delay` [s].
    `supply` is the battery's part in it: a tired one gives less than the thrust at which k_v is stated.
    """
    diagram = Diagram("rail_thrust" if thrust else "rail", "cart on its rail from the measured pitch rate")
    diagram.input("q", unit="rad/s")
    _offer(diagram, "q_trim", 0.0, "rad/s", "bias of the gyro")
    diagram.add("trim", Offset("rad/s", -1.0), params={"offset": "q_trim"}, u="q")
    _offer(diagram, "tau", 0.0, "s", "age of the measured position", (0.0, (ring - 2) * PERIOD))
    diagram.add("delay", InputDelay(ring), params={"tau": "tau"}, u="trim")
    if thrust:
        diagram.input("M")
        diagram.input("T")
        _offer(diagram, "curve", 0.3, "", "quadratic share of the thrust curve", (0.0, 1.0))
        _offer(diagram, "rotor_delay", 0.02, "s", "from command to thrust", (0.0, (ring - 2) * PERIOD))
        _offer(diagram, "supply", 1.0, "", "thrust over that at which k_v is stated, by the battery", (0.1, 10.0))
        diagram.add("lift", Lift(), params={"curve": "curve", "supply": "supply"}, M="M", T="T")
        diagram.add("rotors", InputDelay(ring), params={"tau": "rotor_delay"}, u="lift")
    else:
        diagram.add("rotors", Constant(1.0))
    sources, wanted = {"q": "delay", "lift": "rotors"}, ("k_v", "p_v", "theta_0", "x_0", "v_0")
    return _with_outputs(diagram, Rail(), sources, wanted, pushed=RAIL_WALK)


def pitch_and_velocity(ring: int = 64) -> Structure:
    """Make G_q, G_v and G_x as one plant from M to theta, q, x and v (paper Figure 6 with the attitude loop open)."""
    return about_trim(
        "pitch_and_velocity",
        "pitch and velocity from moment, linear",
        ZohPitchAndVelocity(ring),
        ("w_n", "xi", "mu", "tau", "k_v", "p_v", "theta_0", "q_0", "x_0", "v_0"),
        {"tau": 0.015},
        ring,
    )


def longitudinal(ring: int = 64) -> Structure:
    """Make the course's three-state longitudinal model from M to u, q, theta and a_x (see `plant.Longitudinal`)."""
    return about_trim(
        "longitudinal",
        "three-state longitudinal model",
        ZohLongitudinal(ring),
        ("X_u", "X_q", "M_u", "M_q", "X_d", "M_d"),
        ring=ring,
    )


def free_response(ring: int = 64, substeps: int = 1) -> Structure:
    """Make pitch with gravity, hardening spring and friction (see `PitchPendulum`), from M to theta and q.

    By default everything but the asymmetry of the friction and the delay is estimated.
    """
    return about_trim(
        "free_response",
        "pitch with hardening spring and dry friction",
        PitchPendulum(),
        ("w_n", "xi", "mu", "coulomb", "hardening", "theta_0", "q_0"),
        {"tau": 0.015, "coulomb": 0.1, "mu": 130.0},
        ring,
        substeps=substeps,
    )


def about_trim(
    name: str,
    text: str,
    plant: Block,
    estimate: Sequence[str],
    values: Mapping[str, float] = MappingProxyType({}),
    ring: int = 64,
    longest: float | None = None,
    **options: Any,
) -> Structure:
    """Make the diagram input - trim -> delay -> plant -> + bias -> outputs, with all parameters on the outside.

    `longest` [s] bounds the delay, by default what the ring holds at the control period.
    """
    diagram = Diagram(name, text)
    input, unit = plant.inputs[0].name, plant.inputs[0].unit
    diagram.input(input, unit=unit)
    trim = _offer(diagram, f"{input}_trim", 0.0, unit, f"constant part of {input} that moves nothing")
    source = diagram.add("trim", Offset(unit, -1.0), params={"offset": trim}, u=input)
    # The ring holds this many steps of the control period; at a smaller step the delay reaches less far.
    delay = str(plant.plant_delays[input]) if isinstance(plant, ZohPlant) else "tau"
    most = (ring - 2) * PERIOD if longest is None else longest
    _offer(diagram, delay, values.get(delay, 0.0), "s", "delay of the input", (0.0, most))
    if not isinstance(plant, ZohPlant):
        source = diagram.add("delay", InputDelay(ring), params={"tau": "tau"}, u=source)
    return _with_outputs(diagram, plant, {input: source}, estimate, values, delay=delay, **options)


def _with_outputs(
    diagram: Diagram,
    plant: Block,
    sources: Mapping[str, str],
    estimate: Sequence[str],
    values: Mapping[str, float] = MappingProxyType({}),
    **options: Any,
) -> Structure:
    """Add the plant, a bias behind each of its outputs, and say what is local and on which scale."""
    bound = {param.name: param.name for param in plant.params}
    for param in plant.params:
        if param.name not in diagram.params:
            guess = values.get(param.name, float(param.value))
            _offer(diagram, param.name, guess, param.unit, param.text, (param.low, param.high))
    diagram.add("plant", plant, params=bound)
    for destination, source in sources.items():
        diagram.connect(source, f"plant.{destination}")
    for port in plant.outputs:
        bias = _offer(diagram, f"{port.name}_bias", 0.0, port.unit, f"bias of the measured {port.name}")
        diagram.add(f"bias_{port.name}", Offset(port.unit), params={"offset": bias}, u=f"plant.{port.name}")
        diagram.output(port.name, f"bias_{port.name}")
    return Structure(
        diagram,
        tuple(estimate),
        local=tuple(own for own in diagram.params if own.endswith(("_0", "_trim", "_bias"))),
        scale={own: size for own, size in _SCALES.items() if own in diagram.params},
        at_rest=tuple(speed for speed in ("q_0", "v_0") if "coulomb" in bound and speed in bound),
        **options,
    )


def _offer(
    diagram: Diagram, name: str, value: float, unit: str, text: str, bounds: tuple[float, float] = (-math.inf, math.inf)
) -> str:
    low, high = _BOUNDS.get(name, bounds)
    return diagram.param(name, value, unit=unit, low=low, high=high, text=text)
