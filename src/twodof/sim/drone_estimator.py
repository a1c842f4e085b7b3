"""The real drone's estimator, rebuilt from its logs: a delayed filter, and an output predictor up to the present.

It has the structure of PX4's EKF2 with its output predictor. The logs show this structure: with the drone at rest, x
and v do not respond to a range sample for 85 ms. Then both respond without a step, v most after .28 s, x after .36 s.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twodof.blocks import Block, Diagram, Param, Port, State, int32, store, where
from twodof.blocks.block import Clock
from twodof.blocks.elementary.functions import cos, sin
from twodof.flight.declarations import IMU, RANGE, add_inputs, ports
from twodof.flight.estimator import Publisher
from twodof.signals import GRAVITY, PERIOD, RAIL_CENTRE

LATE = 22
"""Delay of the filter in samples: 88 ms."""

HISTORY = LATE + 2
"""Number of steps before a start whose estimates `settled` takes."""

GAINS = {"k_theta": -0.05, "k_bias": 0.0026, "k_x": 0.378, "k_v": 1.148, "follow": 0.25, "lever": 0.017}
"""Gains of the estimator, fitted to theta, x and v of all seven logs; `follow` is EKF2's default."""

_RING = 32
_GATHER = 0.1  # EKF2's: the integral's gain over the square of the proportional one
_TURN = 0.5 / LATE  # EKF2's: the pitch follows with twice the delay
_IMU = ("acc_x", "acc_z", "gyro_y")
_OUT = ("theta_out", "x_out", "v_out")


class DelayedFilter(Block):
    """theta, gyro bias, x and v by a filter with fixed gains, `LATE` samples behind, and predicted present outputs.

    The filter integrates the IMU sample of `LATE` samples ago. A range sample of that time corrects its four states by
    the innovation times `k_theta`, `k_bias`, `k_x` and `k_v`. The outputs integrate the newest IMU sample. They follow
    the filter by its difference from the outputs of `LATE` samples ago: x and v 100 times a second, with the time
    constant `follow` and a weak integral. The states x and v are those of the IMU, `lever` under the bearing; the
    outputs those of the bearing.

    With the logged sensors as inputs, theta, x and v are within 3 mrad, 3.1 mm and 9 mm/s RMS of the drone's own.
    """

    inputs = ports(*IMU, *RANGE)
    outputs = ports("theta", "q", "x", "v")
    params = (
        Param("k_theta", GAINS["k_theta"], unit="rad/m", low=-10.0, high=10.0),
        Param("k_bias", GAINS["k_bias"], unit="rad/(m*s)", low=-10.0, high=10.0),
        Param("k_x", GAINS["k_x"], low=0.0, high=1.0),
        Param("k_v", GAINS["k_v"], unit="1/s", low=0.0, high=100.0),
        Param("follow", GAINS["follow"], unit="s", low=0.01, high=10.0),
        Param("lever", GAINS["lever"], unit="m", low=-1.0, high=1.0, text="of the IMU under the bearing, as believed"),
    )
    derived = (Port("pull"), Port("gather"))
    states = (
        State("theta", unit="rad"),
        State("bias", unit="rad/s"),
        State("x", unit="m"),
        State("v", unit="m/s"),
        *(State(name) for name in _OUT),
        *(State(f"{name}_{part}") for name in ("x", "v") for part in ("moved", "sum")),
        State("turning", unit="rad"),
        *(State(f"{name}_ring", width=_RING) for name in (*_IMU, "dist", *_OUT)),
        State("new_ring", 0, "int32", width=_RING),
        State("place", 0, "int32"),
        State("phase", 0, "int32"),
    )

    def prepare(self, p: Any, t: Clock) -> Any:
        pull = t.dt / p.follow
        return {"pull": pull, "gather": _GATHER * pull * pull}

    def _predicted(self, u: Any, x: Any, t: Clock) -> dict[str, Any]:
        """Return the outputs moved on by the newest IMU sample."""
        theta = x.theta_out + (u.gyro_y - x.bias) * t.dt + x.turning
        v = x.v_out + (cos(theta) * u.acc_x + sin(theta) * u.acc_z) * t.dt
        return {"theta_out": theta, "x_out": x.x_out + 0.5 * (x.v_out + v) * t.dt, "v_out": v}

    def _filtered(self, x: Any, p: Any, t: Clock, at: Any) -> dict[str, Any]:
        """Return the filter moved on by the samples at `at` in the rings."""
        theta = x.theta + (x.gyro_y_ring[at] - x.bias) * t.dt
        v = x.v + (cos(theta) * x.acc_x_ring[at] + sin(theta) * x.acc_z_ring[at]) * t.dt
        place = x.x + 0.5 * (x.v + v) * t.dt
        measured = x.dist_ring[at] - RAIL_CENTRE + p.lever * sin(theta)
        e = where(x.new_ring[at] != 0, measured - place, 0.0)
        return {
            "theta": theta + p.k_theta * e,
            "bias": x.bias + p.k_bias * e,
            "x": place + p.k_x * e,
            "v": v + p.k_v * e,
        }

    def _next(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        at = (x.place - int32(LATE)) & int32(_RING - 1)
        new = self._predicted(u, x, t) | self._filtered(x, p, t, at)
        # 100 / 250 = 2 / 5: an accumulator that overflows twice in five samples.
        phase = x.phase + int32(2)
        due = phase >= int32(5)
        for name in ("x", "v"):
            # What was added to an output since then counts as if it had been there.
            error = new[name] - (x[f"{name}_out_ring"][at] + x[f"{name}_moved"])
            total = x[f"{name}_sum"] + where(due, 2.5 * error, 0.0)
            step = where(due, 2.5 * (p.pull * error + p.gather * total), 0.0)
            new[f"{name}_sum"] = total
            new[f"{name}_moved"] = x[f"{name}_moved"] + step
            new[f"{name}_out"] = new[f"{name}_out"] + step
        phase = where(due, phase - int32(5), phase)
        return new | {"turning": _TURN * (new["theta"] - x.theta_out_ring[at]), "phase": phase}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        new = self._next(u, x, p, t)
        theta, q = new["theta_out"], u.gyro_y - x.bias
        return {
            "theta": theta,
            "q": q,
            "x": new["x_out"] - p.lever * sin(theta),
            "v": new["v_out"] - p.lever * cos(theta) * q,
        }

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        out = self._predicted(u, x, t)
        kept = {name: u[name] for name in (*_IMU, "dist")}
        kept |= {"theta_out": out["theta_out"]}
        kept |= {f"{name}_out": out[f"{name}_out"] - x[f"{name}_moved"] for name in ("x", "v")}
        return {
            **self._next(u, x, p, t),
            **{f"{name}_ring": store(x[f"{name}_ring"], x.place, value) for name, value in kept.items()},
            "new_ring": store(x.new_ring, x.place, where(u.dist_new, int32(1), int32(0))),
            "place": (x.place + 1) & int32(_RING - 1),
        }


def drone_estimator() -> Diagram:
    """Return the estimator `DelayedFilter` as a diagram with the ports of `flight.estimator.estimator`."""
    d = Diagram("estimator", "the drone's own, as its logs show it")
    add_inputs(d, *IMU, "dist", "dist_age", "dist_new")
    d.add("filter", DelayedFilter(), inputs={name: name for name in (*IMU, *RANGE)})
    d.add("publisher", Publisher(), x="filter.x", v="filter.v")
    for name in ("theta", "q", "x", "v"):
        d.output(name, f"filter.{name}")
    d.output("x_published", "publisher.x")
    d.output("v_published", "publisher.v")
    return d


@dataclass(frozen=True)
class SettledEstimator:
    """`states` of a settled `DelayedFilter` by name; `theta` [rad] and `x` [m] are the errors of its outputs."""

    states: Mapping[str, Any]
    theta: float
    x: float


def settled(
    theta: ArrayLike, x: ArrayLike, v: ArrayLike, velocity_bias: float = 0.0, range_rate: float = 18.35
) -> SettledEstimator:
    """Return the filter's states after the outputs theta, x and v, (`HISTORY`,) each, the latest last.

    `velocity_bias` [m/s] is a constant error of v, caused by a constant error of the gyro against which `range_rate`
    range samples per second correct pitch, x and v. So theta and x have an error too. The filter and the outputs are
    assumed to agree before the start.
    """
    theta, x, v = (np.asarray(before, dtype=np.float64) for before in (theta, x, v))
    late = LATE * PERIOD
    innovation = -velocity_bias / (range_rate * (GAINS["k_x"] + GAINS["k_v"] * late))
    bias = GAINS["k_theta"] * range_rate * innovation
    ahead = bias * PERIOD / _TURN  # of the output's pitch, which the filter's leads
    tilt = GAINS["k_v"] * range_rate * innovation / GRAVITY - ahead
    x_step, v_step = -velocity_bias * PERIOD, GRAVITY * tilt * PERIOD
    gather = _GATHER * (PERIOD / GAINS["follow"]) ** 2

    turned = np.diff(theta) / PERIOD
    x_imu = x[1:] + GAINS["lever"] * np.sin(theta[1:])
    v_imu = v[1:] + GAINS["lever"] * np.cos(theta[1:]) * turned
    a = np.diff(v_imu, prepend=v_imu[0]) / PERIOD - v_step / PERIOD
    sine, cosine = np.sin(theta[1:]), np.cos(theta[1:])
    ago = np.arange(LATE + 1, 0, -1)
    rings = {
        "acc_x": cosine * a + GRAVITY * sine,
        "acc_z": sine * a - GRAVITY * cosine,
        "gyro_y": turned + bias,
        "theta_out": theta[1:],
        "x_out": x_imu + ago * x_step,
        "v_out": v_imu + ago * v_step,
    }
    numbers = {
        "theta": theta[1] + ahead,
        "bias": bias,
        "x": x_imu[0] + ago[0] * x_step,
        "v": v_imu[0] + ago[0] * v_step,
        "theta_out": theta[-1],
        "x_out": x_imu[-1],
        "v_out": v_imu[-1],
        "x_sum": x_step / gather,
        "v_sum": v_step / gather,
        "turning": bias * PERIOD,
    }
    # Place 0 is written next, so the latest stands last.
    filled = {f"{name}_ring": np.concatenate((np.zeros(_RING - len(y)), y)).tolist() for name, y in rings.items()}
    states = {name: float(value) for name, value in numbers.items()}
    return SettledEstimator(states | filled, tilt, velocity_bias * late - (1.0 - 0.5 * GAINS["k_x"]) * innovation)
