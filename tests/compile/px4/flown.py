"""Publications of commander, sensors and pilot for a work item in flight, and the host's outputs for its inputs."""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from tests.compile.px4.build import Bench
from twodof.blocks import Diagram
from twodof.compile import build
from twodof.compile.px4.controller import DT

PERIOD = 4000
STALE, NOT_FINITE, REFUSED, NO_SETPOINT, SHARED = 1, 2, 4, 8, 16
SQRT2 = np.float32(math.sqrt(2.0))


def quaternion(theta: float) -> list[float]:
    """Pitch alone."""
    return [math.cos(theta / 2), 0.0, math.sin(theta / 2), 0.0]


def mode(bench: Bench, armed: bool = True, rates: bool = True, attitude: bool = True, rail: bool = False) -> None:
    """Publish the commander's mode."""
    bench.publish("actuator_armed", armed=armed)
    bench.publish(
        "vehicle_control_mode",
        flag_control_rates_enabled=rates,
        flag_control_attitude_enabled=attitude,
        flag_control_velocity_enabled=rail,
        flag_control_position_enabled=rail,
    )


def measure(bench: Bench, theta: float, q: float, stamp: int | None = None) -> None:
    """Attitude and gyro, as the estimator and the sensors give them; the gyro makes the module run."""
    bench.publish("vehicle_attitude", q=quaternion(theta))
    bench.publish("vehicle_angular_velocity", xyz=[0.0, q, 0.0], timestamp_sample=stamp or bench.now)


def fly(bench: Bench, steps: int, theta_0: float = 0.1, thrust: float = 0.4, every: int = PERIOD) -> None:
    """Samples of a swinging drone under a held set-point."""
    for k in range(steps):
        bench.at(bench.now + every)
        bench.publish("vehicle_attitude_setpoint", q_d=quaternion(theta_0), thrust_body=[0.0, 0.0, -thrust])
        measure(bench, 0.05 * math.sin(0.3 * k), 0.2 * math.cos(0.3 * k))


def replayed(
    diagram: Diagram, log: tuple[str, ...], rows: Any, changes: Mapping[int, Mapping[str, Any]] | None = None
) -> dict[str, Any]:
    """Return the host's outputs for the inputs in the module's messages, with parameters that change at some rows."""
    machine = build(diagram, DT, "float32", log).machine()
    inputs = {name: np.ascontiguousarray(rows[f"in_{name.lower()}"]) for name in diagram.inputs}
    changes = {0: {}, **(changes or {})}
    parts = []
    for start, end in pairwise([*sorted(changes), len(rows)]):
        machine.set_many(changes[start])
        if start == 0:
            machine.reset()  # initial states may be parameters
        parts.append(machine.run(end - start, {name: column[start:end] for name, column in inputs.items()}))
    return {path: np.concatenate([part[path] for part in parts]) for path in parts[0]}
