"""Report of a drone's state for clients, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone_state import DroneState
from twodof.gcs.recording import seconds
from twodof.link.mavlink import dialect

_LINK_LOST = "lost"
_HEARD = "heard"


def lost_report(number: int, url: str, why: str, last: Mapping[str, Any]) -> dict[str, Any]:
    """Return the state of a drone that is not heard: its `last` report, if any, and `why` it is lost."""
    unknown = _of_state(DroneState()) | {"system": number, "name": f"drone {number}", "ours": False, "time": 0.0}
    unknown |= {"lease_holder": None, "tuning_withheld": False, "setpoint": None, "excitation": None, "recording": ""}
    return {**unknown, **last, "url": url, "link": _LINK_LOST, "why_lost": why, "ours_leases": False}


def report(drone: AsyncDrone) -> dict[str, Any]:
    """Return the state of a connected drone.

    `time` is the drone's time as in its logs [s]; the battery's voltage is in V, its charge 0 to 1, both None while
    unknown.
    """
    holder = drone.lease.holder
    return _of_state(drone.state) | {
        "system": drone.session.system,
        "name": drone.state.rig.name or f"drone {drone.session.system}",
        "url": drone.url,
        "link": _HEARD,
        "why_lost": "",
        "ours": drone.ours,
        "lease_holder": None if holder is None else list(holder),
        "ours_leases": drone.lease.ours,
        "tuning_withheld": drone.lease.tuning_withheld,
        "time": seconds(drone.tick),
    }


def _of_state(state: DroneState) -> dict[str, Any]:
    safety, rig = state.safety, state.rig
    fails = safety.action != "none" and (state.armed or bool(safety.reason))
    return {
        "autopilot": state.autopilot,
        "virtual": rig.virtual,
        "lockstep": rig.lockstep,
        "armed": state.armed,
        "mode": state.mode,
        "safety_switch": "off" if rig.safety_off else "on",
        "killed": state.killed,
        "killed_by": None if safety.killed_by is None else list(safety.killed_by),
        "failsafe": safety.action if fails else "none",
        "failsafe_reason": in_words(safety.reason) if fails else "",
        "warnings": [in_words(cause) for cause in safety.causes],
        "controller": rig.controller,
        "changed_parameters": rig.changed,
        "rings_locked": rig.rings_locked,
        "seed": rig.seed,
        "battery": {"voltage": _known(state.battery.voltage), "charge": _known(state.battery.charge)},
        "rig": rig.name,
    }


def in_words(causes: str) -> str:
    """Return the dialect's descriptions of causes of the failsafe, whose names `causes` lists."""
    rows = {row.name.removeprefix("TWODOF_CAUSE_").lower(): row for row in _causes()}
    named = [one.strip() for one in causes.split(",") if one.strip()]
    return "; ".join(rows[one].description.rstrip(".") if one in rows else one for one in named)


def _causes() -> list[Any]:
    return [*dialect.load().enums.get("TWODOF_CAUSE", {}).values()]


def _known(value: float) -> float | None:
    return round(value, 4) if isfinite(value) else None
