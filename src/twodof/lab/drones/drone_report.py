"""Report of a drone's state for clients, as plain data."""

from __future__ import annotations

from math import isfinite
from typing import Any

from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone_state import explanation_of
from twodof.gcs.recording import seconds


def report(drone: AsyncDrone) -> dict[str, Any]:
    """Return the state of a connected drone.

    `time` is the drone's time as in its logs [s]; the battery's voltage is in V, its charge 0 to 1, both None while
    unknown.
    """
    state, holder = drone.state, drone.lease.holder
    safety, rig = state.safety, state.rig
    fails = safety.action != "none" and (state.armed or bool(safety.reason))
    return {
        "system": drone.session.system,
        "name": rig.name or f"drone {drone.session.system}",
        "url": drone.url,
        "link": "heard",
        "why_lost": "",
        "ours": drone.ours,
        "lease_holder": None if holder is None else list(holder),
        "ours_leases": drone.lease.ours,
        "tuning_withheld": drone.lease.tuning_withheld,
        "time": seconds(drone.tick),
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
