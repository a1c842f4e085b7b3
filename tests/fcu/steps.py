"""Steps made up for tests of what is kept of them."""

from dataclasses import fields
from typing import Any, get_type_hints

import numpy as np

from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.control.hardware import ControlInput, SensorSample
from twodof.signals import MODES

MADE = [field.name for field in fields(ControlStep) if field.name not in ("tick", "sample", "asked")]


def plain_step(tick: int, armed: bool = False, mode: int = 3) -> ControlStep:
    """A step whose numbers depend on its tick."""
    sample = SensorSample(
        0.1 * tick, 0.0, -9.81, 0.0, np.sin(0.1 * tick), 0.0, True, 0.5, tick % 14 == 0, 0.01, 12.0, 0.9
    )
    rest: dict[str, Any] = {name: 1e-3 * tick + place for place, name in enumerate(MADE)}
    rest |= {"armed": armed, "action": 0, "state": 2, "reason": 0, "causes": 0}
    return ControlStep(tick=tick, sample=sample, asked=ControlInput(mode=mode, arm=armed), **rest)


def any_step(tick: int, rng: np.random.Generator) -> ControlStep:
    """A step of any bits: infinities, NaNs, subnormals, -0."""

    def number(kind: type) -> Any:
        if kind is float:
            special = (np.nan, np.inf, -np.inf, -0.0, 5e-324)
            wild = float(np.frombuffer(rng.bytes(8), np.float64)[0])
            return special[rng.integers(5)] if rng.random() < 0.1 else wild
        return bool(rng.integers(2)) if kind is bool else int(rng.integers(-(2**31), 2**31))

    def filled(shape: type) -> dict[str, Any]:
        return {name: number(kind) for name, kind in get_type_hints(shape).items() if kind in (float, bool, int)}

    made = {name: value for name, value in filled(ControlStep).items() if name != "tick"}
    asked = filled(ControlInput) | {"mode": int(rng.integers(len(MODES)))}
    return ControlStep(tick=tick, sample=SensorSample(**filled(SensorSample)), asked=ControlInput(**asked), **made)


def numbers_of(step: ControlStep) -> dict[str, Any]:
    """Every number of a step by its name in the log."""
    return {
        **step.sample._asdict(),
        **{f"asked_{name}": value for name, value in step.asked._asdict().items()},
        **{name: getattr(step, name) for name in MADE},
    }
