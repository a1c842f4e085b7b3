"""Commands to a drone, and its excitations. The server takes the lease with the first command; a kill needs none."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from types import MappingProxyType
from typing import Annotated, Any, Literal

from fastapi import Body
from pydantic import Field

from twodof.errors import Rejected, Timeout, TwodofError
from twodof.excitation import from_dict
from twodof.experiment.experiments import LOOP_MODES, UNIT
from twodof.experiment.prediction import predicted
from twodof.flight.gains import DEFAULT, Gains
from twodof.gcs.async_drone import AsyncDrone
from twodof.lab.access import CLIENT, WATCHERS_MAY, lab_router
from twodof.lab.answers import Finite, RequestBody
from twodof.lab.flights import drawn, experiments
from twodof.lab.lab import CurrentLab, LabServer
from twodof.lab.routes.session import NamedDrone
from twodof.rig.parameters import NAMES
from twodof.signals import HOVER

router = lab_router("/api", "commands")


class ModeRequest(RequestBody):
    """Mode to enter."""

    mode: Literal["manual", "rate", "attitude", "position", "hold", "offboard"]


class ResetRequest(RequestBody):
    """Restart of a virtual drone: seed and gain of its noise, place on the rail [m], rings locked or not."""

    seed: int = Field(default=1, ge=0, lt=2**32)
    x: float = Field(default=0.0, ge=-0.5, le=0.5)
    noise: float = Field(default=1.0, ge=0.0, le=100.0)
    rings: bool = False


class SetpointRequest(RequestBody):
    """Set-point of one loop: theta [rad], q [rad/s], M [-1 to 1], v [m/s], x [m].

    `thrust` is 0 to 1, for theta, q and M; left out, it stays unchanged. `acceleration` [m/s^2] is fed forward, for v
    and x.
    """

    loop: Literal["theta", "q", "M", "v", "x"]
    value: Finite
    thrust: float | None = Field(default=None, ge=0.0, le=1.0)
    acceleration: Finite | None = None


class ExcitationRequest(RequestBody):
    """Excitation as in the reference, the loop to whose set-point it is added, and the thrust during it."""

    excitation: dict[str, Any]
    loop: Literal["theta", "q", "M", "v", "x"] | None = None
    thrust: float | None = Field(default=None, ge=0.0, le=1.0)


_FOLLOW: Mapping[str, Callable[[AsyncDrone, float, float | None], Awaitable[None]]] = MappingProxyType(
    {
        "theta": AsyncDrone.set_pitch,
        "q": AsyncDrone.set_pitch_rate,
        "M": AsyncDrone.set_moment,
        "v": AsyncDrone.set_velocity,
        "x": AsyncDrone.set_position,
    }
)


@router.post("/drones/{number}/arm")
async def arm(one: NamedDrone) -> dict[str, Any]:
    """Arm the drone and wait until it confirms that. 409 with the reason against it."""
    async with one.commanded() as drone:
        await drone.arm()
    return one.state


@router.post("/drones/{number}/disarm")
async def disarm(one: NamedDrone) -> dict[str, Any]:
    """Stop the set-points, disarm the drone and wait until it confirms that. Needs no lease."""
    await one.drone.disarm()
    return one.state


@router.post("/drones/{number}/kill", dependencies=[WATCHERS_MAY])
async def kill(one: NamedDrone) -> dict[str, Any]:
    """Stop the motors now, under any lease; repeat the order until the drone confirms it. It holds until `release`.

    Clients that only watch may stop the motors too. All clients and the flight's log get a text that names the client.
    """
    drone = one.drone
    try:
        await drone.kill()
    finally:  # also where it is not seen to stop
        drone.texts.note("critical", f"the emergency stop was pressed by {CLIENT.get()}")
    return one.state


@router.post("/drones/{number}/release")
async def release(one: NamedDrone) -> dict[str, Any]:
    """Allow arming again after a kill."""
    async with one.commanded() as drone:
        await drone.release()
    return one.state


@router.post("/drones/{number}/lease")
async def take_lease(one: NamedDrone) -> dict[str, Any]:
    """Take the lease. 409 if another client holds and renews it."""
    async with one.commanded():
        pass
    return one.state


@router.delete("/drones/{number}/lease")
async def give_up_lease(one: NamedDrone) -> dict[str, Any]:
    """Give up the lease, to a script for instance. 409 while the drone is armed under it."""
    await one.connection.pilot.give_up()
    return one.state


@router.post("/drones/{number}/mode")
async def mode(one: NamedDrone, asked: ModeRequest) -> dict[str, Any]:
    """Change the mode and wait until the drone confirms it. `hold` levels the drone and ends the set-points."""
    async with one.commanded() as drone:
        await (drone.level_hold() if asked.mode == "hold" else drone.set_mode(asked.mode))
    return one.state


@router.post("/drones/{number}/reset")
async def reset(one: NamedDrone, asked: Annotated[ResetRequest | None, Body()] = None) -> dict[str, Any]:
    """Restart a virtual drone at tick 0, at rest. 409 for a real drone, and while the drone is armed."""
    how = ResetRequest() if asked is None else asked
    async with one.commanded() as drone:
        await drone.reset(how.seed, how.x, how.noise, how.rings)
    return one.state


@router.put("/drones/{number}/setpoint")
async def setpoint(one: NamedDrone, asked: SetpointRequest) -> dict[str, Any]:
    """Follow a set-point, which the server repeats until another one replaces it or `hold` ends it."""
    async with one.commanded() as drone:
        await _FOLLOW[asked.loop](drone, asked.value, asked.acceleration if asked.loop in ("v", "x") else asked.thrust)
        one.connection.asked = asked.model_dump()
    return one.state


@router.delete("/drones/{number}/setpoint")
async def stop_setpoint(one: NamedDrone) -> dict[str, Any]:
    """Stop sending set-points: after .5 s the drone levels itself."""
    one.drone.stop_setpoints()
    return one.state


@router.post("/drones/{number}/excitation")
async def excite(one: NamedDrone, asked: ExcitationRequest) -> dict[str, Any]:
    """Play an excitation on board, added to the set-point of its loop. Return its first and last tick at its start."""
    played = await asyncio.to_thread(from_dict, {"version": 1, **asked.excitation})
    async with one.commanded() as drone:
        playback = await drone.excite(played, asked.loop, asked.thrust, wait=False)
    return {"start_tick": playback.start_tick, "end_tick": playback.end_tick, "duration": played.duration}


@router.delete("/drones/{number}/excitation")
async def stop_excitation(one: NamedDrone) -> dict[str, Any]:
    """Stop the excitation; the set-point before it is held."""
    async with one.commanded() as drone:
        await drone.stop_excitation()
    return one.state


excitations_router = lab_router("/api/excitations", "excitations")
PREDICT_S = 30.0
"""Longest time for a prediction [s]."""


class PreviewRequest(ExcitationRequest):
    """Excitation, with the drone (0: none) and its place on the rail [m] for a prediction of the motion."""

    drone: Annotated[int, Field(ge=0, le=255)] = 0
    x: Annotated[float, Field(ge=-0.4, le=0.4)] = 0.0
    points: Annotated[int, Field(ge=2, le=5000)] = 1000


@excitations_router.get("")
async def excitations() -> list[dict[str, Any]]:
    """List the ready-made excitations with loop, thrust and rings of their experiments, the paper's first."""
    return [*experiments()]


@excitations_router.post("/preview", dependencies=[WATCHERS_MAY])
async def preview(lab: CurrentLab, asked: PreviewRequest) -> dict[str, Any]:
    """Return the values of an excitation at `points` times over its duration [s]; nothing is flown.

    `excitation` is its final form. `motion` is the predicted motion of the drone with its gains, by the identified
    model that guards its tuning, else by its virtual rig. Without a prediction it is null, and `why` has the reason.
    `again` is true if the prediction will come later: ask again.
    """
    shown = await lab.log_bench.do(drawn, asked.excitation, asked.points)
    motion, why, again = await _motion(lab, asked, shown["excitation"], shown["unit"])
    return {**shown, "motion": motion, "why": why, "again": again}


async def _motion(
    lab: LabServer, asked: PreviewRequest, excitation: dict[str, Any], unit: str
) -> tuple[dict[str, Any] | None, str, bool]:
    """Return the motion as plain data, or None, the reason, and True if it will come later."""
    if asked.drone == 0:
        return None, "no drone is named", False
    if not await lab.is_warm():
        return None, "the virtual rig is being compiled; the prediction appears by itself", True
    own = lab.drones[asked.drone]
    state = own.state
    loop: str = asked.loop or next(loop for loop, mode in LOOP_MODES.items() if UNIT[mode] == unit)
    rig = state["rig"] if state["rig"] in NAMES else "lab"
    name = lab.models.chosen(asked.drone)
    try:
        model = None if name is None else (name, lab.models.read(name))
        entries = await own.connection.parameters.entries()
        known = {"parameters": {entry.name: entry.value for entry in entries}}
        gains = Gains.from_provenance(known) or DEFAULT
        thrust = HOVER if asked.thrust is None else asked.thrust
        given = (excitation, loop, rig, thrust, asked.x, state["rings_locked"], gains, model)
        return await lab.workbench.do(predicted, *given, seconds=PREDICT_S), "", False
    except Timeout:
        return None, f"this computer is too slow: the prediction took longer than {PREDICT_S:g} s", False
    except TwodofError as error:
        return None, str(error), isinstance(error, Rejected)
