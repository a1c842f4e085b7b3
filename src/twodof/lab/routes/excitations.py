"""Excitations: the ready-made ones, and what one would do before it is flown."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter
from pydantic import Field

from twodof.errors import TwodofError
from twodof.experiment import EXPERIMENTS
from twodof.experiment.experiments import UNIT
from twodof.experiment.prediction import LOOP_MODES, predicted
from twodof.flight.gains import DEFAULT, GAIN_NAMES, Gains
from twodof.gcs.async_drone import AsyncDrone
from twodof.lab.access import computes
from twodof.lab.current_lab import CurrentLab
from twodof.lab.lab import Lab
from twodof.lab.routes.commands import AskedExcitation, excitation_of
from twodof.rig.parameters import NAMES
from twodof.signals import HOVER

router = APIRouter(prefix="/api/excitations", tags=["excitations"])
PREDICT_S = 30.0
"""The first time it compiles the closed loop."""
_LOOPS = {mode: loop for loop, mode in LOOP_MODES.items()}


class AskedPreview(AskedExcitation):
    """An excitation, and for which drone and from which place on the rail [m] its motion is predicted; 0: for none."""

    drone: Annotated[int, Field(ge=0, le=255)] = 0
    x: Annotated[float, Field(ge=-0.4, le=0.4, allow_inf_nan=False)] = 0.0
    points: Annotated[int, Field(ge=2, le=5000)] = 1000


@router.get("")
async def excitations() -> list[dict[str, Any]]:
    """The ready-made ones, the paper's first: loop, thrust and rings are those of their experiments."""
    return [
        {
            "name": one.name,
            "text": one.text,
            "loop": _LOOPS[one.mode],
            "thrust": one.thrust,
            "rings": one.rings,
            "excitation": one.excitation.to_dict(),
        }
        for one in EXPERIMENTS.values()
    ]


@router.post("/preview")
@computes
async def preview(lab: CurrentLab, asked: AskedPreview) -> dict[str, Any]:
    """The values of an excitation at `points` times over its duration [s], in its unit; nothing is flown.

    `excitation` is its final form. `motion` is what it does to the drone that is asked for, with the drone's gains. The
    identified model that guards its tuning predicts it, else its virtual rig (`experiment.prediction`). It is null
    where it cannot be, and `why` says so.
    """
    played = excitation_of(asked.excitation)
    times = [played.duration * k / (asked.points - 1) for k in range(asked.points)]
    motion, why = await _motion(lab, asked, played.to_dict(), played.unit)
    return {
        "excitation": played.to_dict(),
        "unit": played.unit,
        "duration": played.duration,
        "peak": played.peak,
        "time": times,
        "value": played.at(times).tolist(),
        "motion": motion,
        "why": why,
    }


async def _motion(
    lab: Lab, asked: AskedPreview, excitation: dict[str, Any], unit: str
) -> tuple[dict[str, Any] | None, str]:
    """The motion as plain data, or None and why there is none."""
    if asked.drone == 0:
        return None, "no drone is named"
    own = lab.drones[asked.drone]
    state = own.state
    loop: str = asked.loop or next(loop for loop, mode in LOOP_MODES.items() if UNIT[mode] == unit)
    rig = state["rig"] if state["rig"] in NAMES else "lab"
    name = lab.models.chosen(asked.drone)
    try:
        model = None if name is None else (name, lab.models.read(name))
        gains = await _gains(own.drone)
        thrust = HOVER if asked.thrust is None else asked.thrust
        given = (excitation, loop, rig, thrust, asked.x, state["rings_locked"], gains, model)
        found: dict[str, Any] = await lab.workbench.do(predicted, *given, seconds=PREDICT_S)
    except TwodofError as error:
        return None, str(error)
    return found, ""


async def _gains(drone: AsyncDrone) -> Gains:
    """Those that the drone flies now, as it told; asked for once, since it tells of each change."""
    known = drone.parameters.known
    if not set(GAIN_NAMES) <= known.keys():
        known = await drone.parameters.all()
    return Gains.flown({"parameters": {name: known[name].value for name in GAIN_NAMES if name in known}}) or DEFAULT
