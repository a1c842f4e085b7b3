"""Specification of the failsafe's blocks, written a second time with plain ifs, and the cases to try them in."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from twodof.blocks import Block
from twodof.flight.declarations import COMMANDS, SET_POINTS
from twodof.flight.failsafe.causes_and_actions import BIT, CAUSES
from twodof.flight.failsafe.diagram import OutputSelector, SafeSetPoints, StandbyReset
from twodof.flight.failsafe.flags import (
    BatteryFlags,
    EstimateFlags,
    ForceConsistency,
    RangeConsistency,
    RateConsistency,
    SensorFlags,
    SetPointFlags,
    StuckCommands,
)
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, DISARMED, FLYING, LEVEL, OFF, REFUSED, Reasons

NAN, INF = math.nan, math.inf
Row = Mapping[str, Any]
BOOLS = (False, True)


def edge(*thresholds: float) -> tuple[float, ...]:
    """Values at, just below and just above each threshold and its negative, and NaN and infinities."""
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
    axes = ("acc_x", "acc_z", "gyro_y")
    sample = r["imu_new"] and all(math.isfinite(r[a]) for a in axes)
    repeats = [r[a] == r[f"last_{a}"] and r["watch_bits"] for a in axes]
    number = math.isfinite(r["dist"]) and 0.0 <= r["dist_age"] <= r["range_old"]
    then = r["x"] - r["v"] * r["dist_age"]
    good = r["dist_new"] and number and abs(r["dist"] - 0.5 - then) <= r["range_error"]
    at_end = good and abs(r["dist"] - 0.5) >= r["range_end"]
    taken = good or (r["dist_new"] and number and not r["arm"])
    return {
        "output.imu_moves": sample and not all(repeats),
        "output.axes_move": sample and not any(repeats),
        "output.range_good": r["rings"] or good,
        "output.range_moves": r["rings"] or (r["dist_new"] and not (r["dist"] == r["last_dist"] and r["watch_bits"])),
        "output.range_end": at_end and r["last_at_end"] and not r["rings"],
        "output.range_taken": taken,
        "output.range_age": r["dist_age"] if taken else 0.0,
        **{f"update.{a}": r[a] if r["imu_new"] else r[f"last_{a}"] for a in axes},
        "update.dist": r["dist"] if r["dist_new"] else r["last_dist"],
        "update.at_end": at_end if r["dist_new"] else r["last_at_end"],
    }


def summed(total: float, excess: float, limit: float) -> tuple[float, bool]:
    new = total + excess * 0.004
    return (min(new, limit) if new > 0.0 else 0.0), new >= limit


def force(r: Row) -> dict[str, Any]:
    pull = r["pull"] * r["last_thrust"] * r["sine"]
    free, share, limit = pull + r["drag"] * r["v"], r["pull_share"] * abs(pull), r["along_limit"]
    if r["rings"]:
        free, share, limit = 0.0, 0.0, 2.0 * r["along_limit"]
    slack, hit_slack = r["along_slack"] + share, r["hit_slack"] * (1.0 + 2.0 * abs(r["sine"])) + share
    # What the bearing feels: the IMU is `imu_below` and `imu_ahead` of it.
    acc_x = r["acc_x"] - r["imu_below"] * r["turning"] + r["imu_ahead"] * (r["gyro_y"] * r["gyro_y"])
    acc_z = r["acc_z"] + r["imu_below"] * (r["gyro_y"] * r["gyro_y"]) + r["imu_ahead"] * r["turning"]
    along = r["cosine"] * acc_x + r["sine"] * acc_z + free
    down = r["cosine"] * acc_z - r["sine"] * acc_x + 9.81
    hit = 0.0 if r["rings"] else along
    sums = {
        "forth": summed(r["last_forth"], along - slack, limit),
        "back": summed(r["last_back"], -along - slack, limit),
        "hit_forth": summed(r["last_hit_forth"], hit - hit_slack, r["hit_limit"]),
        "hit_back": summed(r["last_hit_back"], -hit - hit_slack, r["hit_limit"]),
        "up": summed(r["last_up"], -down - r["up_slack"], r["up_limit"]),
        "down": summed(r["last_down"], down - r["up_slack"], r["up_limit"]),
    }
    speed = r["last_speed"] - (pull + r["drag"] * r["last_speed"]) * 0.004
    return {
        "output.disagrees": any(reached for _, reached in sums.values()),
        **{f"{section}.{name}": total for section in ("output", "update") for name, (total, _) in sums.items()},
        "output.speed": r["last_speed"],
        "update.speed": speed if math.isfinite(speed) else 0.0,
        "update.thrust": 0.5 * (r["fore"] + r["aft"]),
    }


def motion(r: Row) -> dict[str, Any]:
    taken, dist, gap_before = r["last_taken"], r["last_dist"], r["last_gap_before"]
    if r["range_taken"]:
        taken, dist, gap_before = r["last_place"], r["dist"], r["last_gap"]
    place_1 = taken - r["last_low_1"]
    expected = place_1 - r["last_low_2"]
    dist_1 = dist - r["last_mean_1"]
    dist_2 = dist_1 - r["last_mean_2"]
    measured = dist_2 - r["last_mean_3"]
    gap = measured - expected
    lasting = min(abs(gap), abs(gap_before)) if gap * gap_before > 0.0 else 0.0
    apart, reached = summed(r["last_apart"], lasting - r["slack"] - r["share"] * abs(expected), r["limit"])
    watched = r["arm"] and not r["rings"]
    new = {
        "apart": apart,
        "place": r["last_place"] + r["speed"] * 0.004 - r["per_band"] * r["last_place"],
        "taken": taken,
        "gap": gap if r["range_taken"] else r["last_gap"],
        "gap_before": gap_before,
        "low_1": r["last_low_1"] + r["per_band"] * place_1,
        "low_2": r["last_low_2"] + r["per_band"] * expected,
        "mean_1": r["last_mean_1"] + r["per_band"] * dist_1,
        "mean_2": r["last_mean_2"] + r["per_band"] * dist_2,
        "mean_3": r["last_mean_3"] + r["per_band"] * measured,
    }
    return {
        "output.disagrees": reached and watched,
        "output.apart": apart,
        "update.dist": dist,
        "update.sampled": r["last_sampled"] or r["range_taken"],
        **{f"update.{name}": value if watched and r["last_sampled"] else 0.0 for name, value in new.items()},
        **({} if watched and r["last_sampled"] else {"update.mean_1": dist}),
    }


def rate(r: Row) -> dict[str, Any]:
    expected = r["turn"] * r["last_arrived"] - r["swing"] * r["sine"]
    left = (r["gyro_y"] - r["last_gyro_y"]) * r["per_dt"] - expected
    under_way = r["turn"] * abs(r["last_asked"] - r["last_arrived"])
    slack = r["turn_slack"] + r["turn_share"] * abs(expected) + under_way
    faster = summed(r["last_faster"], left - slack, r["turn_limit"])
    slower = summed(r["last_slower"], -left - slack, r["turn_limit"])

    def lift(command: float) -> float:
        return command * ((1.0 - r["curve"]) + r["curve"] * command)

    asked = lift(r["fore"]) - lift(r["aft"])
    return {
        "output.disagrees": faster[1] or slower[1],
        **{f"{section}.faster": faster[0] for section in ("output", "update")},
        **{f"{section}.slower": slower[0] for section in ("output", "update")},
        "output.turning": (r["gyro_y"] - r["last_gyro_y"]) * r["per_dt"],
        "update.gyro_y": r["gyro_y"],
        "update.asked": asked,
        "update.arrived": r["last_arrived"] + r["per_answer"] * (asked - r["last_arrived"]),
    }


def place(r: Row) -> dict[str, Any]:
    foreseen = abs(r["theta"] + r["look_ahead"] * r["q"])
    with np.errstate(all="ignore"):
        stop = abs(r["x"] + r["v"] * (r["reaction"] + abs(r["v"]) / (2.0 * r["braking"])))
    pitch_limit = r["pitch_limit"] - r["pitch_margin"] if r["last_pitch_near"] else r["pitch_limit"]
    rail_limit = r["rail_limit"] - r["rail_margin"] if r["last_rail_near"] else r["rail_limit"]
    believed = abs(r["theta"]) <= r["theta_bound"] and abs(r["q"]) <= r["q_bound"]
    believed = believed and math.isfinite(r["x"]) and math.isfinite(r["v"])
    pitch_near, rail_near = foreseen > pitch_limit, not r["rings"] and stop > rail_limit
    return {
        "output.estimate_lost": not believed,
        "output.pitch_near": pitch_near,
        "output.pitch_stop": abs(r["theta"]) >= r["pitch_end"],
        "output.rail_near": rail_near,
        "output.rail_end": not r["rings"] and abs(r["x"]) >= r["rail_end"],
        "output.tilted": abs(r["theta"]) > r["arm_tilt"],
        "update.pitch_near": pitch_near,
        "update.rail_near": rail_near,
    }


def battery(r: Row) -> dict[str, Any]:
    low, critical = (r[n] + r["margin"] if r[f"last_{n}"] else r[n] for n in ("low", "critical"))
    full, usable = (level <= r["voltage"] <= r["high"] for level in (low, critical))
    return {"output.full": full, "output.usable": usable, "update.low": not full, "update.critical": not usable}


def asked(r: Row) -> dict[str, Any]:
    numbers = all(math.isfinite(r[name]) for name in SET_POINTS)
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
    own = all(math.isfinite(r[f"user_{name}"]) for name in COMMANDS) and not r["user_late"]
    stock = all(math.isfinite(r[name]) for name in COMMANDS)
    flown = dict.fromkeys(COMMANDS, 0.0)
    if not r["stopped"]:
        if r["user_flies"] and own:
            flown = {name: r[f"user_{name}"] for name in COMMANDS}
        elif stock:
            flown = {name: r[name] for name in COMMANDS}
    return {
        **{f"output.{name}": min(1.0, max(0.0, flown[name])) for name in ("fore", "aft")},
        **{f"output.{name}": flown[name] for name in ("M", "T")},
        "output.user_lost": r["user_flies"] and not own,
        "output.command_lost": not r["stopped"] and not stock and not (r["user_flies"] and own),
    }


def standby(r: Row) -> dict[str, Any]:
    return {
        "output.user_in_reset": r["in_reset"] or not r["user_flies"],
        "output.stock_in_reset": r["in_reset"] or r["user_flies"],
        "output.user_given": True,
    }


def safe(r: Row) -> dict[str, Any]:
    state, names = r["state"], ("mode", *(name for name in SET_POINTS), "ax0")
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
    for flag, name in (("failed", "user_failed"), ("user_lost", "user_failed"), ("stuck_off", "command_stuck")):
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
    forget = state == FLYING and not (r["user_lost"] or r["command_lost"])
    return {"output.reason": reason, "update.held": 0 if forget else reason, "update.was": state}


STATES = (-1, 0, 1, 2, 3, 4, 5, 6, 7)
SMALL = (-INF, -1.5, -1.0, -0.75, -0.5, -0.0, 0.0, 0.25, 1.0, 1.5, INF, NAN)
SUMMED = MappingProxyType({"lt: le": "a sum of 0 is 0 in both branches"})
EITHER = MappingProxyType({"lt: le": "minimum and maximum of two equals: either is taken"})

MEANINGS = (
    Meaning(
        SensorFlags(),
        {
            **dict.fromkeys(
                ("acc_x", "acc_z", "gyro_y", "last_acc_x", "last_acc_z", "last_gyro_y"), (0.0, 1.0, NAN, INF)
            ),
            **dict.fromkeys(("imu_new", "rings", "watch_bits", "arm", "last_at_end"), BOOLS),
            "dist_new": (False, True, True, True),
            "dist": (
                0.5,
                0.75,
                0.25,
                above(0.75),
                below(0.25),
                0.9375,
                0.0625,
                below(0.9375),
                above(0.0625),
                NAN,
                INF,
                -INF,
            ),
            "dist_age": (0.0, 0.0, 0.0, 0.125, 0.25, above(0.25), -0.125, NAN, INF),
            "last_dist": (0.5, 0.75, 0.0, NAN),
            "x": (0.0, 0.25, 0.375, -0.375, NAN),
            "v": (0.0, 0.0, 1.0, -1.0, 2.0, NAN),
            "range_error": (0.25,),
            "range_end": (0.4375,),
            "range_old": (0.25,),
        },
        sensors,
        {},
    ),
    Meaning(
        ForceConsistency(),
        {
            "acc_x": (0.0, 0.0, 0.5, 0.5, -0.5, -0.5, 1.0, -1.0, 40.0, -40.0, NAN, INF),
            # Those beside -9.81 leave just the slack.
            "acc_z": (-9.81, -9.81, 0.75 - 9.81, 0.75 - 9.81, -0.75 - 9.81, -0.75 - 9.81, 0.0, 40.0, -40.0, NAN, INF),
            "gyro_y": (0.0, 0.0, 0.0, 2.0, -4.0, NAN),
            "turning": (0.0, 0.0, 0.0, 16.0, -32.0, NAN),
            "imu_below": (0.03125,),
            "imu_ahead": (0.0625,),
            "sine": (0.0, 0.0, 0.0, 0.5, -0.5, 0.25, NAN),
            "cosine": (1.0, 1.0, 1.0, 0.75),
            "v": (0.0, 0.0, 0.5, -0.5, NAN),
            **dict.fromkeys(("fore", "aft"), (0.0, 0.25, 1.0)),
            "rings": BOOLS,
            **dict.fromkeys(("last_forth", "last_back"), (0.0, 0.1, 0.125, below(0.125), 0.124, 0.25, 0.249, NAN)),
            **dict.fromkeys(("last_hit_forth", "last_hit_back"), (0.0, 0.125, 0.125, 0.125, below(0.125), NAN)),
            "last_speed": (0.0, 0.5, -0.25, NAN),
            "hit_slack": (0.5,),
            "hit_limit": (0.125,),
            **dict.fromkeys(("last_up", "last_down"), (0.0, 0.3, 0.375, below(0.375), 0.374, NAN)),
            "last_thrust": (0.0, 0.0, 0.5, 0.25),
            "pull": (12.0,),
            "pull_share": (0.25,),
            "drag": (0.75,),
            "along_slack": (0.5,),
            "along_limit": (0.125,),
            "up_slack": (0.75,),
            "up_limit": (0.375,),
        },
        force,
        SUMMED,
    ),
    Meaning(
        RangeConsistency(),
        {
            "speed": (0.0, 0.5, -0.25),
            "dist": (0.0, 0.0, 0.25, -0.25, 1.0, NAN),
            **dict.fromkeys(("range_taken", "arm", "rings", "last_sampled"), BOOLS),
            **dict.fromkeys(("last_place", "last_taken", "last_dist"), (0.0, 0.0, 0.25, -0.25)),
            **dict.fromkeys(("last_gap", "last_gap_before"), (0.0, 0.0625, -0.0625, 0.25, -0.25, 1.0, -1.0, NAN)),
            **dict.fromkeys(("last_low_1", "last_low_2"), (0.0, 0.0, 0.0625)),
            **dict.fromkeys(("last_mean_1", "last_mean_2", "last_mean_3"), (0.0, 0.0, -0.125)),
            "last_apart": (0.0, 0.05, 0.0625, below(0.0625), 0.0624, 0.06225, NAN),
            "per_band": (0.25,),
            "slack": (0.0625,),
            "share": (0.25,),
            "limit": (0.0625,),
        },
        motion,
        {"lt: le": "a sum or magnitude of 0 is 0 in both branches; of two equals either is the smaller"},
    ),
    Meaning(
        RateConsistency(),
        {
            **dict.fromkeys(
                ("gyro_y", "last_gyro_y"), (0.0, 0.0, 0.0, 0.024, 0.024, 0.125, -0.125, 1.0, -1.0, NAN, INF)
            ),
            "sine": (0.0, 0.0, 0.0, 0.5, -0.5, NAN),
            **dict.fromkeys(("fore", "aft"), (0.0, 0.25, 0.5, 1.0)),
            **dict.fromkeys(("last_faster", "last_slower"), (0.0, 0.5, 0.75, below(0.75), 0.74, 0.7, NAN)),
            **dict.fromkeys(("last_asked", "last_arrived"), (0.0, 0.0, 0.0, 0.125, -0.125, 0.5)),
            "turn": (128.0,),
            "curve": (0.25,),
            "swing": (8.0,),
            "turn_slack": (6.0,),
            "turn_share": (0.25,),
            "turn_limit": (0.75,),
            "per_answer": (0.25,),
            "per_dt": (250.0,),
        },
        rate,
        SUMMED,
    ),
    Meaning(
        EstimateFlags(),
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
            "voltage": edge(11.0, 10.0, 11.25, 10.25, 13.0),
            **dict.fromkeys(("last_low", "last_critical"), BOOLS),
            "low": (11.0,),
            "critical": (10.0,),
            "margin": (0.25,),
            "high": (13.0,),
        },
        battery,
        {},
    ),
    Meaning(
        SetPointFlags(),
        {
            "mode": (-(2**31), -1, 0, 1, 2, 3, 4, 5, 6, 2**31 - 1),
            **dict.fromkeys(SET_POINTS, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, -0.5, NAN, INF, -INF)),
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
        OutputSelector(),
        {
            **dict.fromkeys(("stopped", "user_flies", "user_late"), BOOLS),
            **{
                f"{who}{name}": (*(-0.5, 0.0, 0.25, 0.5, 1.0, 1.5, 0.75) * 2, NAN, INF, -INF)
                for who in ("", "user_")
                for name in COMMANDS
            },
        },
        gate,
        EITHER,
    ),
    Meaning(StandbyReset(True), dict.fromkeys(("in_reset", "user_flies"), BOOLS), standby, {}),
    Meaning(
        SafeSetPoints(),
        {
            "state": STATES,
            "timer": (0, 1, 3, 4, 5),
            "stopped": BOOLS,
            "mode": (-1, 0, 1, 2, 3, 4, 5, 6, 99),
            **dict.fromkeys(SET_POINTS, SMALL),
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
            **dict.fromkeys(("failed", "user_lost", "stuck_off", "command_lost"), BOOLS),
        },
        reasons,
        {},
    ),
)
