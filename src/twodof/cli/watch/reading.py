"""How a watched drone stands: as plain data for machines, and as one line for a pipe."""

from __future__ import annotations

from math import degrees
from typing import Any

from twodof.cli.watch.watched_drone import COLUMNS, WatchedDrone
from twodof.signals import TICK_S

_SHOWN = {"theta": "estimate.theta", "q": "estimate.q", "x": "estimate.x", "v": "estimate.v"} | {
    "M": "command.M",
    "T": "command.T",
}
_TEXTS = 10


def reading(watched: WatchedDrone) -> dict[str, Any]:
    """State, latest values (SI and radians; None while unknown) and the last lines that it said."""
    row: dict[str, Any] = {"system": watched.system, "url": watched.url, "link": "heard" if watched.heard else "lost"}
    if watched.lost is not None:
        row["lost_because"] = watched.lost.what
    drone = watched.drone
    if drone is None:
        return row
    state, rig = drone.state, drone.state.rig
    latest = {name: watched.history[name].latest for name in COLUMNS}
    row |= {
        "ours": drone.ours,
        "virtual": rig.virtual,
        "rig": rig.name,
        "controller": rig.controller,
        "changed": rig.changed,
        "armed": state.armed,
        "mode": state.mode,
        "safety_switch_off": rig.safety_off,
        "rings_locked": rig.rings_locked,
        "killed": state.killed,
        "failsafe": state.safety.action,
        "failsafe_reason": state.safety.reason,
        "failsafe_in_words": state.safety.in_words(),
        "lease_holder": list(drone.lease.holder) if drone.lease.holder else None,
        "battery": {"voltage": state.battery.voltage, "charge": state.battery.charge},
        "time": watched.time,
        **{short: latest[name] for short, name in _SHOWN.items()},
        "setpoint": {name: followed(watched, f"setpoint.{name}") for name in ("theta", "q", "x")},
        "texts": [line._asdict() for line in list(watched.texts)[-_TEXTS:]],
    }
    return row


def followed(watched: WatchedDrone, name: str) -> float | None:
    """A set-point that is in use now: one that was followed in an earlier mode is not."""
    history = watched.history[name]
    current = history.newest >= watched.time - 0.5
    return history.latest if current else None


def line(watched: WatchedDrone) -> str:
    """The same in a line."""
    name = f"drone {watched.system}" if watched.system is not None else watched.url
    if not watched.heard or watched.drone is None:
        why = f": {watched.lost.what}" if watched.lost is not None else ""
        return f"{name}  link lost{why}"
    said = [name, f"t {watched.time:.1f} s", str(watched.drone.state)]
    for short, scale, unit in (("theta", degrees(1.0), "deg"), ("q", degrees(1.0), "deg/s"), ("x", 1.0, "m")):
        value = watched.history[_SHOWN[short]].latest
        if value is not None:
            said.append(f"{short} {scale * value:+.3g} {unit}")
    moment = watched.history["command.M"].latest
    return "  ".join([*said, *([] if moment is None else [f"M {moment:+.3f}"])])


def since(watched: WatchedDrone) -> float:
    """How long the failsafe has acted [s of the drone's time]."""
    drone = watched.drone
    return 0.0 if drone is None else max(0.0, (drone.tick - drone.state.safety.since) * TICK_S)
