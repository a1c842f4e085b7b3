"""The rig as one diagram: battery, rotors, dynamics, turbulence and sensors, for a base tick of 1 ms."""

from twodof.blocks import Block, Diagram, Param
from twodof.blocks.library.delays import ZeroOrderHold
from twodof.rig.dynamics import Dynamics, Turbulence
from twodof.rig.rotors import BatteryPack, Rotors
from twodof.rig.sensors import Imu, NoiseSource, RangeSensor

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
