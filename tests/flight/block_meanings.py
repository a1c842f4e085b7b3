"""What the failsafe's blocks are meant to do, written a second time with plain ifs, and the cases to try them in."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from twodof.blocks import Block
from twodof.flight.causes import BIT, CAUSES
from twodof.flight.failsafe_machine import BRAKE, DESCEND, DISARMED, FLYING, LEVEL, OFF, REFUSED, Reasons
from twodof.flight.gate import COMMANDS, Gate, Standby
from twodof.flight.safe_setpoints import SafeSetPoints
from twodof.flight.safety_flags import SET_POINTS, BatteryFlags, PlaceFlags, SensorFlags, SetPointFlags, StuckCommands

NAN, INF = math.nan, math.inf
Row = Mapping[str, Any]
BOOLS = (False, True)


def edge(*thresholds: float) -> tuple[float, ...]:
    """Values at, just below and just above each threshold and its negative, and those that are no numbers."""
    near = [f(s * t) for t in thresholds for s in (1, -1) for f in (float, below, above)]
    return (0.0, *near, NAN, INF, -INF)


def below(value: float) -> float:
    return math.nextafter(value, -INF)


def above(value: float) -> float:
    return math.nextafter(value, INF)


@dataclass(frozen=True)
class Meaning:
    """A block, the values that each of its inputs and states is tried with, its meaning, mutants that are none."""

    block: Block
    values: Mapping[str, Sequence[Any]]
    meant: Callable[[Row], dict[str, Any]]
    equivalent: Mapping[str, str]


def sensors(r: Row) -> dict[str, Any]:
    numbers = all(math.isfinite(r[a]) for a in ("acc_x", "acc_z", "gyro_y"))
    repeats = all(r[a] == r[f"last_{a}"] for a in ("acc_x", "acc_z", "gyro_y"))
    off = abs(r["dist"] - 0.5 - r["x"])
    return {
        "output.imu_moves": r["imu_new"] and numbers and not (repeats and r["watch_bits"]),
        "output.range_good": r["rings"] or (r["dist_new"] and off <= r["range_error"]),
        "output.range_moves": r["rings"] or (r["dist_new"] and not (r["dist"] == r["last_dist"] and r["watch_bits"])),
        **{f"update.{a}": r[a] if r["imu_new"] else r[f"last_{a}"] for a in ("acc_x", "acc_z", "gyro_y")},
        "update.dist": r["dist"] if r["dist_new"] else r["last_dist"],
    }


def place(r: Row) -> dict[str, Any]:
    foreseen = abs(r["theta"] + r["look_ahead"] * r["q"])
    with np.errstate(all="ignore"):
        stop = abs(r["x"] + r["v"] * (r["reaction"] + abs(r["v"]) / (2.0 * r["braking"])))
    pitch_limit = r["pitch_limit"] - r["pitch_margin"] if r["last_pitch_near"] else r["pitch_limit"]
    rail_limit = r["rail_limit"] - r["rail_margin"] if r["last_rail_near"] else r["rail_limit"]
    believed = abs(r["theta"]) <= r["theta_bound"] and abs(r["q"]) <= r["q_bound"]
    believed = believed and math.isfinite(r["x"]) and math.isfinite(r["v"])
    pitch_near, rail_near = not foreseen <= pitch_limit, not r["rings"] and not stop <= rail_limit
    return {
        "output.estimate_lost": not believed,
        "output.pitch_near": pitch_near,
        "output.pitch_stop": not abs(r["theta"]) < r["pitch_end"],
        "output.rail_near": rail_near,
        "output.rail_end": not r["rings"] and not abs(r["x"]) < r["rail_end"],
        "output.tilted": not abs(r["theta"]) <= r["arm_tilt"],
        "update.pitch_near": pitch_near,
        "update.rail_near": rail_near,
    }


def battery(r: Row) -> dict[str, Any]:
    low, critical = (r[n] + r["margin"] if r[f"last_{n}"] else r[n] for n in ("low", "critical"))
    full, usable = r["voltage"] >= low, r["voltage"] >= critical
    return {"output.full": full, "output.usable": usable, "update.low": not full, "update.critical": not usable}


def asked(r: Row) -> dict[str, Any]:
    numbers = all(math.isfinite(r[name]) for name, _ in SET_POINTS)
    off, along_rail = r["mode"] <= 0, r["mode"] >= 4
    return {
        "output.invalid": not numbers or r["mode"] > 5,
        "output.fed": r["setpoint_new"] or off,
        "output.active": not off and (along_rail or r["thrust"] != 0.0 or r["M_open"] != 0.0),
        "output.rings_wrong": r["rings"] and along_rail,
    }


def stuck(r: Row) -> dict[str, Any]:
    moved = r["fore"] != r["last_fore"] or r["aft"] != r["last_aft"]
    some = r["fore"] != 0.0 or r["aft"] != 0.0
    needed = r["mode"] >= 2 and not r["stopped"] and some and r["imu_moves"]
    return {
        "output.moves": r["last_moves"],
        "update.fore": r["fore"],
        "update.aft": r["aft"],
        "update.moves": moved or not needed,
    }


def gate(r: Row) -> dict[str, Any]:
    own = all(math.isfinite(r[f"own_{name}"]) for name in COMMANDS) and not r["own_late"]
    stock = all(math.isfinite(r[name]) for name in COMMANDS)
    flown = dict.fromkeys(COMMANDS, 0.0)
    if not r["stopped"]:
        if r["own"] and own:
            flown = {name: r[f"own_{name}"] for name in COMMANDS}
        elif stock:
            flown = {name: r[name] for name in COMMANDS}
    return {
        **{f"output.{name}": min(1.0, max(0.0, flown[name])) for name in ("fore", "aft")},
        **{f"output.{name}": flown[name] for name in ("M", "T")},
        "output.own_lost": r["own"] and not own,
        "output.command_lost": not r["stopped"] and not stock and not (r["own"] and own),
    }


def standby(r: Row) -> dict[str, Any]:
    return {
        "output.own_in_reset": r["in_reset"] or not r["own"],
        "output.stock_in_reset": r["in_reset"] or r["own"],
        "output.own_given": True,
    }


def safe(r: Row) -> dict[str, Any]:
    state, names = r["state"], ("mode", *(name for name, _ in SET_POINTS), "ax0")
    out = dict.fromkeys(names, 0.0)
    turns = state in (LEVEL, BRAKE, DESCEND) and r["last_thrust"] > 0.0 and not r["stopped"]
    out["thrust"] = 0.0 if state == FLYING else r["last_thrust"]
    if state == FLYING:
        bounds = {name: (-r[f"{name}_limit"], r[f"{name}_limit"]) for name in ("x0", "v0", "theta0", "q0")}
        bounds |= {"thrust": (0.0, 1.0), "M_open": (-1.0, 1.0), "ax0": (-INF, INF)}
        out = {n: min(high, max(low, r[n])) if math.isfinite(r[n]) else 0.0 for n, (low, high) in bounds.items()}
    if state == DESCEND:
        out["thrust"] = r["last_thrust"] * max(0.0, 1.0 - r["timer"] * r["per_tick"])
    if state == BRAKE:
        near = min(r["rail_hold"], max(-r["rail_hold"], r["x"])) if r["x"] == r["x"] else NAN
        tilt = r["brake_x"] * (r["x"] - near) + r["brake_v"] * r["v"]
        # A speed that is no number gives no tilt; one beyond all bounds the largest.
        out["theta0"] = 0.0 if math.isnan(tilt) else min(r["brake_tilt"], max(-r["brake_tilt"], tilt))
    out["mode"] = (r["mode"] if r["mode"] <= 5 else 0) if state == FLYING else 3
    if r["stopped"] or (state in (LEVEL, BRAKE, DESCEND) and not turns):
        out["mode"] = 0
    held = 0.0 if r["stopped"] else r["last_thrust"]
    if state == FLYING and math.isfinite(r["T_flown"]):
        held = min(r["thrust_held"], max(0.0, r["T_flown"]))
    return {**{f"output.{name}": out[name] for name in names}, "update.thrust": held}


WARNING = BIT["battery_low"]
ACTING = sum(BIT[cause.name] for cause in CAUSES if cause.action)


def reasons(r: Row) -> dict[str, Any]:
    state, was = r["state"], r["last_was"]
    now = r["mask"] if state == REFUSED else r["mask"] & (WARNING if state == FLYING else ACTING)
    for flag, name in (("failed", "own_failed"), ("own_lost", "own_failed"), ("stuck_off", "command_stuck")):
        now |= BIT[name] if r[flag] else 0
    now |= BIT["command_lost"] if r["command_lost"] else 0
    if state == DISARMED:
        reason = 0
    elif state == was and state in (REFUSED, OFF):
        reason = r["last_held"]
    elif state == was or state > FLYING:
        reason = r["last_held"] | now
    else:
        reason = now
    forget = state == FLYING and not (r["own_lost"] or r["command_lost"])
    return {"output.reason": reason, "update.held": 0 if forget else reason, "update.was": state}


STATES = (-1, 0, 1, 2, 3, 4, 5, 6, 7)
SMALL = (-INF, -1.5, -1.0, -0.75, -0.5, -0.0, 0.0, 0.25, 1.0, 1.5, INF, NAN)
EITHER = MappingProxyType({"lt: le": "minimum and maximum of two equals: either is taken"})

MEANINGS = (
    Meaning(
        SensorFlags(),
        {
            **dict.fromkeys(
                ("acc_x", "acc_z", "gyro_y", "last_acc_x", "last_acc_z", "last_gyro_y"), (0.0, 1.0, NAN, INF)
            ),
            **dict.fromkeys(("imu_new", "dist_new", "rings", "watch_bits"), BOOLS),
            "dist": (0.5, 0.75, 0.25, above(0.75), below(0.25), 0.0, NAN, INF),
            "last_dist": (0.5, 0.75, 0.0, NAN),
            "x": (0.0, 0.25, NAN),
            "range_error": (0.25,),
        },
        sensors,
        {},
    ),
    Meaning(
        PlaceFlags(),
        {
            "theta": (*edge(0.25, 0.5, 0.75, 1.25), 0.125),
            "q": (0.0, 0.0, 0.0, 2.0, -2.0, 4.0, *edge(8.0)),
            "x": (*edge(0.28125, 0.21875, 0.4375, 0.375, 0.3125), 0.125, -0.125),
            "v": (0.0, 0.0, 0.0, 0.5, -0.5, 1.0, -1.0, NAN, INF),
            **dict.fromkeys(("rings", "last_pitch_near", "last_rail_near"), BOOLS),
            "pitch_limit": (0.5,),
            "pitch_margin": (0.25,),
            "look_ahead": (0.125,),
            "pitch_end": (0.75,),
            "theta_bound": (1.25,),
            "q_bound": (8.0,),
            "arm_tilt": (0.25,),
            "rail_limit": (0.375,),
            "rail_margin": (0.0625,),
            "reaction": (0.125,),
            "braking": (4.0,),
            "rail_end": (0.4375,),
        },
        place,
        {},
    ),
    Meaning(
        BatteryFlags(),
        {
            "voltage": edge(11.0, 10.0, 11.25, 10.25),
            **dict.fromkeys(("last_low", "last_critical"), BOOLS),
            "low": (11.0,),
            "critical": (10.0,),
            "margin": (0.25,),
        },
        battery,
        {},
    ),
    Meaning(
        SetPointFlags(),
        {
            "mode": (-(2**31), -1, 0, 1, 2, 3, 4, 5, 6, 2**31 - 1),
            **{name: (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, -0.5, NAN, INF, -INF) for name, _ in SET_POINTS},
            **dict.fromkeys(("setpoint_new", "rings"), BOOLS),
        },
        asked,
        {},
    ),
    Meaning(
        StuckCommands(),
        {
            "mode": (-1, 0, 1, 2, 3, 5),
            **dict.fromkeys(("imu_moves", "stopped", "last_moves"), BOOLS),
            **dict.fromkeys(("fore", "aft", "last_fore", "last_aft"), (0.0, 0.5)),
        },
        stuck,
        {},
    ),
    Meaning(
        Gate(),
        {
            **dict.fromkeys(("stopped", "own", "own_late"), BOOLS),
            **{
                f"{who}{name}": (*(-0.5, 0.0, 0.25, 0.5, 1.0, 1.5, 0.75) * 2, NAN, INF, -INF)
                for who in ("", "own_")
                for name in COMMANDS
            },
        },
        gate,
        EITHER,
    ),
    Meaning(Standby(True), dict.fromkeys(("in_reset", "own"), BOOLS), standby, {}),
    Meaning(
        SafeSetPoints(),
        {
            "state": STATES,
            "timer": (0, 1, 3, 4, 5),
            "stopped": BOOLS,
            "mode": (-1, 0, 1, 2, 3, 4, 5, 6, 99),
            **{name: SMALL for name, _ in SET_POINTS},
            "ax0": SMALL,
            "x": SMALL,
            "T_flown": SMALL,
            "last_thrust": (-1.0, 0.0, 0.25, 0.5),
            "per_tick": (0.25,),
            "thrust_held": (0.5,),
            "rail_hold": (0.125,),
            "v": SMALL,
            "brake_x": (0.5,),
            "brake_v": (0.25,),
            "brake_tilt": (0.375,),
            **{f"{name}_limit": (0.375 + 0.125 * k,) for k, name in enumerate(("x0", "v0", "theta0", "q0"))},
        },
        safe,
        EITHER,
    ),
    Meaning(
        Reasons(),
        {
            "state": STATES,
            "last_was": STATES,
            "mask": (0, 1, WARNING, BIT["tilted"], BIT["imu_lost"], WARNING | 1 | BIT["not_idle"]),
            "last_held": (0, BIT["link_lost"], BIT["tilted"]),
            **dict.fromkeys(("failed", "own_lost", "stuck_off", "command_lost"), BOOLS),
        },
        reasons,
        {},
    ),
)
