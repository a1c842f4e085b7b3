"""The rig as one diagram, for a base tick of 1 ms, and its steady states without a simulation."""

from collections.abc import Mapping
from math import copysign, inf, sin, sqrt

from twodof.blocks import Block, Diagram, Param
from twodof.blocks.library.delays import ZeroOrderHold
from twodof.rig.dynamics import Dynamics, Turbulence
from twodof.rig.rotors import BatteryPack, Rotors, lift
from twodof.rig.sensors import Imu, NoiseSource, RangeSensor
from twodof.signals import GRAVITY, HOVER, PERIOD, Q_AGE

BASE_DT = 0.001
"""The base tick [s]."""

SAMPLE = (4, 0)
"""Rate of the IMU, of the range sensor's interface and of the flight code: 250 Hz."""

SLOW = (40, 0)
"""Rate of the battery: 25 Hz."""

PARTS: tuple[tuple[str, type[Block], tuple[int, int]], ...] = (
    ("battery", BatteryPack, SLOW),
    ("rotors", Rotors, (1, 0)),
    ("turbulence", Turbulence, SAMPLE),
    ("dynamics", Dynamics, (1, 0)),
    ("noise_source", NoiseSource, SAMPLE),
    ("imu", Imu, SAMPLE),
    ("range", RangeSensor, SAMPLE),
)
"""Name, block and rate of each part."""

MEASUREMENTS = ("acc_x", "acc_z", "gyro_y", "dist", "dist_new", "dist_age")
"""Outputs of the rig that the flight code may read."""

TRUTH = ("theta", "q", "x", "v")
"""True states of the rig, which the flight code may not read."""


def rig_params() -> dict[str, Param]:
    """Return the rig's parameters by name; parts that name the same one share it (`noise`, `seed`, starts)."""
    return {param.name: param for _, block, _ in PARTS for param in block.params}


def rig() -> Diagram:
    """Return the diagram of the rig. Inputs `fore` and `aft`: the commands of the rotor pairs, in [0, 1].

    Outputs. The measurements: `acc_x`, `acc_z` [m/s2], `gyro_y` [rad/s], `dist` [m], `dist_new`, `dist_age` [s]. The
    truth: `theta` [rad], `q` [rad/s], `x` [m], `v` [m/s]. `load` (thrust over that of hover), `voltage` [V], `charge`.
    The blocks' parameters are those of the diagram, by the same names. Their values are the blocks' defaults, not those
    of a calibrated set (see `parameters`).
    """
    d = Diagram("rig", "fore and aft rotor pairs, pitch, cart, battery and sensors")
    d.input("fore")
    d.input("aft")
    d.params.update(rig_params())
    for name, block, rate in PARTS:
        d.add(name, block(), rate=rate, params={param.name: param.name for param in block.params})
    # Held here, so that the rotors and the dynamics are continuous and see their inputs at each stage of a step.
    for source, to in (("battery.supply", "rotors.supply"), ("turbulence.moment", "dynamics.gust")):
        held = d.add(f"{to.split('.')[1]}_held", ZeroOrderHold(), u=source)
        d.connect(held, to)
    for name in ("fore", "aft"):
        held = d.add(f"{name}_held", ZeroOrderHold(), u=name)
        d.connect(held, f"rotors.{name}")
    d.connect("rotors.load", "battery.load", "turbulence.load", "imu.load")
    for port in ("load_fore", "load_aft"):
        d.connect(f"rotors.{port}", f"imu.{port}")
    for port in ("thrust", "moment", "running"):
        d.connect(f"rotors.{port}", f"dynamics.{port}")
    d.connect("dynamics.theta", "rotors.theta")
    for port in ("theta", "q", "v"):
        d.connect(f"dynamics.{port}", f"imu.{port}")
    for source, port in (("n0", "n_x"), ("n1", "n_z"), ("n2", "n_q")):
        d.connect(f"noise_source.{source}", f"imu.{port}")
    d.connect("noise_source.n3", "range.n")
    d.connect("dynamics.x", "range.x")
    for port in ("acc_x", "acc_z", "gyro_y"):
        d.output(port, f"imu.{port}")
    for port in ("dist", "dist_new", "dist_age"):
        d.output(port, f"range.{port}")
    for port in TRUTH:
        d.output(port, f"dynamics.{port}")
    d.output("load", "rotors.load")
    d.output("voltage", "battery.voltage")
    d.output("charge", "battery.charge")
    return d


def rotor_moment(rig: Mapping[str, float], moment: float, thrust: float = HOVER) -> float:
    """Return the pitch moment [N m] of the rotors in steady state for the commands `moment` M and `thrust` T."""
    fore, aft = (min(1.0, max(0.0, thrust + sign * moment)) for sign in (1.0, -1.0))
    curve = rig["curve"]
    return float(rig["arm"] * rig["pair_thrust"] * (lift(fore, curve) - lift(aft, curve)))


def restoring_moment(rig: Mapping[str, float], theta: float, running: float = 1.0) -> float:
    """Return the moment [N m] that holds the drone at pitch `theta` [rad] against gravity and springs, no friction.

    `running` in [0, 1] leads from the stiffness with the rotors at rest to that in hover.
    """
    gravity = rig["mass_drone"] * GRAVITY * rig["offset"] * sin(theta)
    linear = rig["spring"] - rig["softening"] * running
    return float(gravity + theta * (linear + (1.0 - running) * rig["hardening"] * theta**2))


def stiffness(rig: Mapping[str, float], running: float = 1.0) -> float:
    """Return the pitch stiffness [N m/rad] for small angles, by gravity and springs (see `restoring_moment`)."""
    gravity = rig["mass_drone"] * GRAVITY * rig["offset"]
    return float(gravity + rig["spring"] - rig["softening"] * running)


def trim_moment(rig: Mapping[str, float], moment: float, theta: float = 0.0) -> float:
    """Return the wake's moment [N m] (the rig's parameter `trim`) under which M = `moment` holds `theta` at T = .4."""
    return restoring_moment(rig, theta) - rotor_moment(rig, moment)


def rail_force(rig: Mapping[str, float], theta: float, speed: float = 0.0, acceleration: float = 0.0) -> float:
    """Return the steady push [N] along the rail (`rail_force`) under which a flight in hover has these means.

    The means are the pitch `theta` [rad], `speed` [m/s] and `acceleration` [m/s2]. Dry friction is taken to bear as
    much of the push as it can: a push of up to `rail_coulomb` is returned as 0.
    """
    mass = rig["mass_drone"] + rig["mass_cart"]
    thrust = 2.0 * rig["pair_thrust"] * lift(HOVER, rig["curve"])
    push = thrust * sin(theta) + mass * acceleration + rig["rail_viscous"] * speed
    return float(copysign(max(0.0, abs(push) - rig["rail_coulomb"]), push))


def moment_gain(rig: Mapping[str, float], thrust: float) -> float:
    """Return mu [rad/s2], the pitch acceleration per unit of M, for small M at `thrust`; at 0 from one pair alone."""
    curve = rig["curve"]
    slope = 1.0 - curve + 2.0 * curve * thrust
    pairs = 2.0 if thrust > 0.0 else 1.0
    return float(pairs * rig["arm"] * rig["pair_thrust"] * slope / rig["inertia"])


def velocity_gain(rig: Mapping[str, float]) -> float:
    """Return k_v [m/s2 per rad]: the thrust of hover over the moved mass."""
    return float(2.0 * rig["pair_thrust"] * lift(HOVER, rig["curve"]) / (rig["mass_drone"] + rig["mass_cart"]))


def velocity_damping(rig: Mapping[str, float]) -> float:
    """Return p_v [1/s]: linear friction of the rail over the moved mass."""
    return float(rig["rail_viscous"] / (rig["mass_drone"] + rig["mass_cart"]))


def model_parameters(rig: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of the paper's models for small angles, in SI: docs/explanation/physics.md section 8.

    Of the pitch: w_n and xi with the rotors at rest, `w_n_run` and `xi_run` with them running, mu at the hover's
    thrust, and tau. If running rotors take all stiffness away, `w_n_run` is 0 and `xi_run` infinite. Of the velocity:
    k_v and p_v. Dry friction (`coulomb`, `coulomb_run`, `rail_coulomb`) and `hardening` are divided by the moved
    inertia or mass.
    """
    inertia, mass = rig["inertia"], rig["mass_drone"] + rig["mass_cart"]
    w_n, w_n_run = (sqrt(max(0.0, stiffness(rig, running)) / inertia) for running in (0.0, 1.0))
    return {
        "w_n": w_n,
        "xi": rig["viscous_idle"] / (2.0 * inertia * w_n),
        "w_n_run": w_n_run,
        "xi_run": rig["viscous_run"] / (2.0 * inertia * w_n_run) if w_n_run > 0.0 else inf,
        "mu": moment_gain(rig, HOVER),
        "tau": rig["delay"] + rig["lag"] - Q_AGE,
        "k_v": velocity_gain(rig),
        "p_v": velocity_damping(rig),
        "coulomb": rig["coulomb_idle"] / inertia,
        "coulomb_run": rig["coulomb_run"] / inertia,
        "rail_coulomb": rig["rail_coulomb"] / mass,
        "hardening": rig["hardening"] / inertia,
    }


def gyro_walk(rig: Mapping[str, float]) -> float:
    """Return the density [rad/sqrt(s)] at which the integrated gyro walks: its vibration has nothing at 0 Hz."""
    return sqrt(PERIOD * (rig["gyro_idle"] ** 2 + rig["gyro_step"] ** 2 / 12.0))


def cart_parameters(rig: Mapping[str, float]) -> dict[str, float]:
    """Return the cart's parameters of `pitch_on_cart`, in SI: docs/explanation/physics.md, equations (1) and (2)."""
    inertia, mass = rig["inertia"], rig["mass_drone"] + rig["mass_cart"]
    return {
        "coupling": rig["mass_drone"] * rig["offset"] / inertia,
        "lever": rig["mass_drone"] * rig["offset"] / mass,
        "k_v": velocity_gain(rig),
        "p_v": velocity_damping(rig),
        "rail_coulomb": rig["rail_coulomb"] / mass,
        "wake_fade": rig["wake_fade"],
        "wake_lag": rig["wake_lag"],
    }
