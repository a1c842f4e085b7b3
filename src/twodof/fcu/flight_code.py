"""The compiled flight code, one tick at a time."""

from __future__ import annotations

from dataclasses import dataclass

from twodof.fcu.asked import Asked
from twodof.fcu.hardware import Sample


@dataclass(slots=True)
class Step:
    """One control period: what was measured and asked, and what the flight code made of it (`flight.core.OUTPUTS`)."""

    tick: int
    sample: Sample
    asked: Asked
    fore: float
    aft: float
    M: float
    T: float
    theta: float
    q: float
    x: float
    v: float
    x0: float
    v0: float
    theta0: float
    q0: float
    M_trim: float
    armed: bool
    action: int
    state: int
    reason: int
    causes: int
