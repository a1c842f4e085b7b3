"""Work on excitations in processes of their own: their form and values, as plain data."""

from __future__ import annotations

from typing import Any

from twodof.errors import ExperimentError
from twodof.excitation import Excitation, Multisine, from_dict


def excitation_of(given: dict[str, Any]) -> Excitation:
    """Return the excitation of a JSON form; a multisine with `peak` is Schroeder's. Raises ExperimentError."""
    if len(given) > 64:
        raise ExperimentError(f"has {len(given)} fields", "excitation", "give only the fields of its kind")
    if given.get("kind") == Multisine.kind and "peak" in given:
        return _multisine({name: value for name, value in given.items() if name not in ("kind", "version")})
    return from_dict({"version": 1, **given})


def _multisine(given: dict[str, Any]) -> Excitation:
    try:
        return Multisine.schroeder(**given)
    except TypeError as reason:
        raise ExperimentError(
            f"a value is missing or unknown: {reason}", "multisine", "give peak, period, harmonics"
        ) from reason


def drawn(given: dict[str, Any], points: int) -> dict[str, Any]:
    """Return the final form of an excitation, and its values at `points` times. Raises ExperimentError."""
    played = excitation_of(given)
    times = [played.duration * k / (points - 1) for k in range(points)]
    return {
        "excitation": played.to_dict(),
        "unit": played.unit,
        "duration": played.duration,
        "peak": played.peak,
        "time": times,
        "value": played.at(times).tolist(),
    }
