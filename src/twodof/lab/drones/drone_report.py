"""Report of a drone's state for clients, as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone_state import DroneState, explanation_of
from twodof.gcs.recording import seconds


def lost_report(number: int, url: str, why: str, last: Mapping[str, Any]) -> dict[str, Any]:
    """Return the state of a drone that is not heard: its `last` report, if any, and `why` it is lost."""
    unknown = _of_state(DroneState()) | {"system": number, "name": f"drone {number}", "ours": False, "time": 0.0}
    unknown |= {"lease_holder": None, "tuning_withheld": False, "setpoint": None, "excitation": None, "recording": ""}
    return {**unknown, **last, "url": url, "link": "lost", "why_lost": why, "ours_leases": False}


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
        "link": "heard",
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
        "failsafe_reason": _in_words(safety.reason) if fails else "",
        "warnings": [_in_words(cause) for cause in safety.causes],
        "controller": rig.controller,
        "changed_parameters": rig.changed,
        "rings_locked": rig.rings_locked,
        "seed": rig.seed,
        "battery": {"voltage": _known(state.battery.voltage), "charge": _known(state.battery.charge)},
        "rig": rig.name,
    }


def _in_words(cause: str) -> str:
    return explanation_of("TWODOF_CAUSE", cause).rstrip(".") or cause


def _known(value: float) -> float | None:
    return round(value, 4) if isfinite(value) else None
