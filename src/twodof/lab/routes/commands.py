"""Commands: what a drone is told to do. The server takes the lease with the first one; a kill needs none."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body
from pydantic import Field

from twodof.errors import ExperimentError
from twodof.excitation import Excitation, Multisine, from_dict
from twodof.lab.access import stops
from twodof.lab.access.lab_client import CurrentClient
from twodof.lab.current_lab import CurrentLab
from twodof.lab.request_body import Finite, RequestBody
from twodof.lab.routes.drones import Number

router = APIRouter(prefix="/api", tags=["commands"])


class AskedMode(RequestBody):
    """A mode by its name."""

    mode: Literal["manual", "rate", "attitude", "position", "hold", "offboard"]


class AskedReset(RequestBody):
    """How a virtual drone begins anew: seed and gain of its noise, place on the rail [m], rings locked or not."""

    seed: int = Field(default=1, ge=0, lt=2**32)
    x: float = Field(default=0.0, ge=-0.5, le=0.5, allow_inf_nan=False)
    noise: float = Field(default=1.0, ge=0.0, le=100.0, allow_inf_nan=False)
    rings: bool = False


class AskedSetpoint(RequestBody):
    """What a loop is to follow, in SI units and rad: theta [rad], q [rad/s], M [-1 to 1], v [m/s], x [m].

    `thrust` is 0 to 1, for theta, q and M; without it, it stays. `acceleration` [m/s^2] is fed forward, for v and x.
    """

    loop: Literal["theta", "q", "M", "v", "x"]
    value: Finite
    thrust: float | None = Field(default=None, ge=0.0, le=1.0, allow_inf_nan=False)
    acceleration: Finite | None = None


class AskedExcitation(RequestBody):
    """An excitation as `excitation` in the reference describes it, the loop it is added to, the thrust meanwhile."""

    excitation: dict[str, Any]
    loop: Literal["theta", "q", "M", "v", "x"] | None = None
    thrust: float | None = Field(default=None, ge=0.0, le=1.0, allow_inf_nan=False)


@router.post("/drones/{number}/arm")
async def arm(lab: CurrentLab, number: Number) -> dict[str, Any]:
    """Arm it, and see that it is. 409 with what speaks against it."""
    async with lab.drones[number].commanded() as drone:
        await drone.arm()
    return lab.drones[number].state


@router.post("/drones/{number}/disarm")
async def disarm(lab: CurrentLab, number: Number) -> dict[str, Any]:
    """Disarm it, and see that it is; set-points are sent no more. Needs no lease."""
    await lab.drones[number].drone.disarm()
    return lab.drones[number].state


@router.post("/drones/{number}/kill")
@stops
async def kill(lab: CurrentLab, number: Number, client: CurrentClient) -> dict[str, Any]:
    """Motors off, now, whoever commands it; said again until it is seen. It stays so until `release`.

    Who may only watch may stop it too. Who did is told to all clients, and stands in the flight's log.
    """
    drone = lab.drones[number].drone
    try:
        await drone.kill()
    finally:  # also where it is not seen to stop
        drone.texts.note("critical", f"the emergency stop was pressed by {client}")
    return lab.drones[number].state


@router.post("/drones/{number}/release")
async def release(lab: CurrentLab, number: Number) -> dict[str, Any]:
    """Let it be armed again after a kill."""
    async with lab.drones[number].commanded() as drone:
        await drone.release()
    return lab.drones[number].state


@router.post("/drones/{number}/lease")
async def take_lease(lab: CurrentLab, number: Number) -> dict[str, Any]:
    """Become the one who commands it. 409 where somebody else does and keeps it."""
    async with lab.drones[number].commanded():
        pass
    return lab.drones[number].state


@router.delete("/drones/{number}/lease")
async def give_up_lease(lab: CurrentLab, number: Number) -> dict[str, Any]:
    """Let others command it, a script for instance. 409 while it is armed by us."""
    await lab.drones[number].connection.pilot.give_up()
    return lab.drones[number].state


@router.post("/drones/{number}/mode")
async def mode(lab: CurrentLab, number: Number, asked: AskedMode) -> dict[str, Any]:
    """Change the mode, and see that it is changed. `hold` levels it and ends the set-points."""
    async with lab.drones[number].commanded() as drone:
        await (drone.level_hold() if asked.mode == "hold" else drone.set_mode(asked.mode))
    return lab.drones[number].state


@router.post("/drones/{number}/reset")
async def reset(lab: CurrentLab, number: Number, asked: Annotated[AskedReset | None, Body()] = None) -> dict[str, Any]:
    """Start a virtual drone anew: tick 0, at rest. 409 for a real one, and while it is armed."""
    how = AskedReset() if asked is None else asked
    async with lab.drones[number].commanded() as drone:
        await drone.reset(how.seed, how.x, how.noise, how.rings)
    return lab.drones[number].state


@router.put("/drones/{number}/setpoint")
async def setpoint(lab: CurrentLab, number: Number, asked: AskedSetpoint) -> dict[str, Any]:
    """Follow a set-point, which the server keeps alive until another one takes its place or `hold` ends it."""
    async with lab.drones[number].commanded() as drone:
        match asked.loop:
            case "theta":
                await drone.set_pitch(asked.value, asked.thrust)
            case "q":
                await drone.set_pitch_rate(asked.value, asked.thrust)
            case "M":
                await drone.set_moment(asked.value, asked.thrust)
            case "v":
                await drone.set_velocity(asked.value, asked.acceleration)
            case "x":
                await drone.set_position(asked.value, asked.acceleration)
        lab.drones[number].connection.asked = asked.model_dump()
    return lab.drones[number].state


@router.delete("/drones/{number}/setpoint")
async def stop_setpoint(lab: CurrentLab, number: Number) -> dict[str, Any]:
    """Send set-points no more: after .5 s the drone levels itself."""
    lab.drones[number].drone.stop_setpoints()
    return lab.drones[number].state


@router.post("/drones/{number}/excitation")
async def excite(lab: CurrentLab, number: Number, asked: AskedExcitation) -> dict[str, Any]:
    """Play an excitation on board, added to what its loop follows. Answers when it starts: its first and last tick."""
    played = excitation_of(asked.excitation)
    async with lab.drones[number].commanded() as drone:
        playback = await drone.excite(played, asked.loop, asked.thrust, wait=False)
    return {"start_tick": playback.start_tick, "end_tick": playback.end_tick, "duration": played.duration}


@router.delete("/drones/{number}/excitation")
async def stop_excitation(lab: CurrentLab, number: Number) -> dict[str, Any]:
    """Stop what plays; the set-point before it is held."""
    async with lab.drones[number].commanded() as drone:
        await drone.stop_excitation()
    return lab.drones[number].state


def excitation_of(given: dict[str, Any]) -> Excitation:
    """The excitation that JSON describes; a multisine may have its `peak` for amplitudes and phases, which then are
    Schroeder's. Raises ExperimentError."""
    if len(given) > 64:
        raise ExperimentError(f"has {len(given)} fields", "excitation", "give those of its kind")
    if given.get("kind") == Multisine.kind and "peak" in given:
        return _multisine({name: value for name, value in given.items() if name not in ("kind", "version")})
    return from_dict({"version": 1, **given})


def _multisine(given: dict[str, Any]) -> Excitation:
    try:
        return Multisine.schroeder(**given)
    except TypeError as reason:
        raise ExperimentError(
            f"a value is missing or strange: {reason}", "multisine", "give peak, period, harmonics"
        ) from reason
