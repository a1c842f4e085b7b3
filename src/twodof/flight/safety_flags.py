"""Thresholds: measurements, estimates and set-points become flags, where they might chatter with a hysteresis."""

from __future__ import annotations

from functools import reduce
from operator import and_
from typing import Any

from twodof.blocks import Block, Param, Port, State, int32, where
from twodof.flight.cascade import OFF, POSITION, RATE, VELOCITY
from twodof.flight.finite import finite
from twodof.flight.position_filter import RAIL_CENTRE

SET_POINTS = (("x0", "m"), ("v0", "m/s"), ("theta0", "rad"), ("q0", "rad/s"), ("thrust", ""), ("M_open", ""))
"""The set-points that are numbers, with their units."""


class SensorFlags(Block):
    """Which sensors are alive.

    The IMU: a sample of finite numbers came in this tick and differs from the last one in a bit at least (its noise
    moves all three axes; the same bits again are a driver that repeats itself). The range sensor: `range_good`, a
    sample came that lies within `range_error` of the position as published before; `range_moves`, one that differs
    from the last. With the cart locked the range is not needed, and both are true. `watch_bits` off takes repeated
    samples for good, for simulations without noise only.
    """

    inputs = (
        Port("acc_x", unit="m/s2"),
        Port("acc_z", unit="m/s2"),
        Port("gyro_y", unit="rad/s"),
        Port("imu_new", "bool"),
        Port("dist", unit="m"),
        Port("dist_new", "bool"),
        Port("x", unit="m"),
        Port("rings", "bool"),
    )
    outputs = (Port("imu_moves", "bool"), Port("range_good", "bool"), Port("range_moves", "bool"))
    states = (
        State("acc_x", unit="m/s2"),
        State("acc_z", unit="m/s2"),
        State("gyro_y", unit="rad/s"),
        State("dist", unit="m"),
    )
    params = (
        Param(
            "range_error", 0.15, unit="m", low=0.02, high=1.0, text="range further from the estimate is not believed"
        ),
        Param("watch_bits", True, "bool", text="a sensor that repeats itself to the bit is stuck"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        moved = (u.acc_x != x.acc_x) | (u.acc_z != x.acc_z) | (u.gyro_y != x.gyro_y)
        numbers = finite(u.acc_x) & finite(u.acc_z) & finite(u.gyro_y)
        return {
            "imu_moves": u.imu_new & numbers & (moved | ~p.watch_bits),
            "range_good": u.rings | (u.dist_new & (abs(u.dist - RAIL_CENTRE - u.x) <= p.range_error)),
            "range_moves": u.rings | (u.dist_new & ((u.dist != x.dist) | ~p.watch_bits)),
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {
            "acc_x": where(u.imu_new, u.acc_x, x.acc_x),
            "acc_z": where(u.imu_new, u.acc_z, x.acc_z),
            "gyro_y": where(u.imu_new, u.gyro_y, x.gyro_y),
            "dist": where(u.dist_new, u.dist, x.dist),
        }


class PlaceFlags(Block):
    """Where pitch and cart are, and whether the estimates are believed.

    `pitch_near`: |theta + look_ahead q| above `pitch_limit`, until below it by `pitch_margin`; `pitch_stop`: |theta| at
    `pitch_end`. `rail_near`: the place where the cart could be stopped, x + v reaction + v |v| / (2 braking), is beyond
    `rail_limit`, until inside by `rail_margin`; `rail_end`: |x| at `rail_end`. A locked cart is near no end.
    `estimate_lost`: theta, q, x or v is no number, |theta| > `theta_bound` or |q| > `q_bound`. Each is written so that
    a NaN raises it.
    """

    inputs = (
        Port("theta", unit="rad"),
        Port("q", unit="rad/s"),
        Port("x", unit="m"),
        Port("v", unit="m/s"),
        Port("rings", "bool"),
    )
    outputs = tuple(
        Port(name, "bool") for name in ("estimate_lost", "pitch_near", "pitch_stop", "rail_near", "rail_end", "tilted")
    )
    states = (State("pitch_near", False, "bool"), State("rail_near", False, "bool"))
    params = (
        Param("pitch_limit", 0.80, unit="rad", low=0.2, high=0.87, text="pitch beyond which it is levelled"),
        Param("pitch_margin", 0.10, unit="rad", low=0.01, high=0.3, text="hysteresis of the pitch limit"),
        Param("look_ahead", 0.06, unit="s", low=0.0, high=0.2, text="the pitch is foreseen by this time"),
        Param("pitch_end", 0.85, unit="rad", low=0.2, high=0.87, text="pitch at which the motors stop"),
        Param("theta_bound", 1.2, unit="rad", low=0.9, high=3.0, text="no pitch beyond it is believed"),
        Param("q_bound", 30.0, unit="rad/s", low=5.0, high=60.0, text="no pitch rate beyond it is believed"),
        Param("arm_tilt", 0.30, unit="rad", low=0.02, high=0.8, text="largest pitch at arming"),
        Param("rail_limit", 0.37, unit="m", low=0.05, high=0.40, text="beyond which the cart is braked"),
        Param("rail_margin", 0.03, unit="m", low=0.005, high=0.1, text="hysteresis of the rail's limit"),
        Param("reaction", 0.25, unit="s", low=0.0, high=0.5, text="time until braking takes hold"),
        Param("braking", 3.0, unit="m/s2", low=0.5, high=10.0, text="deceleration that braking is trusted with"),
        Param("rail_end", 0.395, unit="m", low=0.05, high=0.45, text="place at which the motors stop"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        theta, q = abs(u.theta), abs(u.q)
        foreseen = abs(u.theta + p.look_ahead * u.q)
        stopped_at = abs(u.x + u.v * (p.reaction + abs(u.v) / (2.0 * p.braking)))
        believed = (theta <= p.theta_bound) & (q <= p.q_bound) & finite(u.x) & finite(u.v)
        return {
            "estimate_lost": ~believed,
            "pitch_near": ~(foreseen <= where(x.pitch_near, p.pitch_limit - p.pitch_margin, p.pitch_limit)),
            "pitch_stop": ~(theta < p.pitch_end),
            "rail_near": ~u.rings & ~(stopped_at <= where(x.rail_near, p.rail_limit - p.rail_margin, p.rail_limit)),
            "rail_end": ~u.rings & ~(abs(u.x) < p.rail_end),
            "tilted": ~(theta <= p.arm_tilt),
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        now = self.output(u, x, p, t)
        return {"pitch_near": now["pitch_near"], "rail_near": now["rail_near"]}


class BatteryFlags(Block):
    """`full` and `usable`: the voltage is above the low and the critical threshold.

    Once below one it counts as below until it is above by `margin`; NaN is below.
    """

    inputs = (Port("voltage", unit="V"),)
    outputs = (Port("full", "bool"), Port("usable", "bool"))
    states = (State("low", False, "bool"), State("critical", False, "bool"))
    params = (
        Param("low", 11.1, unit="V", low=0.0, high=60.0, text="low voltage: no arming (3.7 V a cell)"),
        Param("critical", 10.5, unit="V", low=0.0, high=60.0, text="critical voltage: it descends (3.5 V a cell)"),
        Param("margin", 0.2, unit="V", low=0.01, high=2.0, text="hysteresis of both"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {
            "full": u.voltage >= where(x.low, p.low + p.margin, p.low),
            "usable": u.voltage >= where(x.critical, p.critical + p.margin, p.critical),
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        now = self.output(u, x, p, t)
        return {"low": ~now["full"], "critical": ~now["usable"]}


class SetPointFlags(Block):
    """What the set-points ask for.

    `invalid`: one is infinite or NaN. `fed`: a set-point came in this tick, or none is needed since the mode is off.
    `active`: the motors are asked for something. `rings_wrong`: a mode that moves the cart, which is locked.
    """

    inputs = (
        Port("mode", "int32"),
        *(Port(name, unit=unit) for name, unit in SET_POINTS),
        Port("setpoint_new", "bool"),
        Port("rings", "bool"),
    )
    outputs = (Port("invalid", "bool"), Port("fed", "bool"), Port("active", "bool"), Port("rings_wrong", "bool"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        off = u.mode <= int32(OFF)
        along_rail = u.mode >= int32(VELOCITY)
        return {
            "invalid": ~reduce(and_, [finite(u[name]) for name, _ in SET_POINTS]) | (u.mode > int32(POSITION)),
            "fed": u.setpoint_new | off,
            "active": ~off & (along_rail | (u.thrust != 0.0) | (u.M_open != 0.0)),
            "rings_wrong": u.rings & along_rail,
        }


class StuckCommands(Block):
    """`moves`: the commands that flew differ from those before in a bit, or need not, or the IMU gave nothing new.

    In a closed loop with thrust noise alone moves them; commands that stand still come of a controller that does.
    """

    inputs = (
        Port("mode", "int32"),
        Port("imu_moves", "bool"),
        Port("stopped", "bool"),
        Port("fore"),
        Port("aft"),
    )
    outputs = (Port("moves", "bool"),)
    states = (State("fore"), State("aft"), State("moves", True, "bool"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.moves

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        moved = (u.fore != x.fore) | (u.aft != x.aft)
        standing = (u.fore == 0.0) & (u.aft == 0.0)
        needed = (u.mode >= int32(RATE)) & ~u.stopped & ~standing & u.imu_moves
        return {"fore": u.fore, "aft": u.aft, "moves": moved | ~needed}
