"""A client made with MAVSDK alone: `python mavsdk_client.py URL PARAMETER VALUE LOG FIRST`; prints what it saw.

It goes through what MAVSDK's own examples do. It discovers the drone and reads its version, parameters and telemetry.
It arms, sends attitude set-points offboard, disarms, and fetches the log. FIRST is `arm` as in them, or `offboard` to
arm while set-points come. Each step is a line of JSON. It runs in a process of its own, as a native library that hangs
must not take the tests with it.
"""

from __future__ import annotations

import asyncio
import math
import sys
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TypeVar

from mavsdk.asyncio import System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.log_files import LogFilesAsync
from mavsdk.asyncio.plugins.offboard import Attitude, OffboardAsync, OffboardError
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import EulerAngle, TelemetryAsync
from mavsdk_steps import DEADLINE_S, made, say, told, within

THETA = 0.1  # rad, the set-point
THRUST = 0.4
NEAR = 0.03  # rad
STILL = 0.02  # rad

T = TypeVar("T")


async def some(stream: AsyncIterator[T], count: int) -> list[T]:
    """The next `count` of a stream."""
    return [await within(anext(stream)) for _ in range(count)]


async def until(stream: AsyncIterator[T], holds: Callable[[T], bool]) -> T:
    """The first of a stream for which `holds`."""

    async def look() -> T:
        async for value in stream:
            if holds(value):
                return value
        raise EOFError

    return await within(look())


async def look_around(system: System, name: str, value: float) -> None:
    """Read everything that needs no lease, and set a parameter."""
    info = InfoAsync(system)
    version, product = await told(info.get_version), await told(info.get_product)
    uid = (await told(info.get_identification)).hardware_uid
    software = [version.flight_sw_major, version.flight_sw_minor, version.flight_sw_patch]
    say("version", software=software, vendor=product.vendor_name, product=product.product_name, uid=uid)
    parameters = ParamAsync(system)
    found = await within(parameters.get_all_params())
    values = {p.name: p.value for p in (*found.int_params, *found.float_params)}
    say("parameters", integers=len(found.int_params), floats=len(found.float_params), values=values)
    await within(parameters.set_param_float(name, value))
    say("set", name=name, value=await within(parameters.get_param_float(name)))


async def at_rest(seen: TelemetryAsync) -> list[EulerAngle]:
    """Twenty angles of a drone at rest: one that has just been flown swings for some seconds."""
    while True:
        row = await some(seen.subscribe_attitude_euler(), 20)
        angles = [math.radians(one.pitch_deg) for one in row]
        if max(angles) - min(angles) < STILL:
            return row


async def telemetry(seen: TelemetryAsync) -> None:
    attitude = await within(at_rest(seen))
    rates = await some(seen.subscribe_attitude_angular_velocity_body(), 5)
    position = await some(seen.subscribe_position_velocity_ned(), 5)
    battery = await some(seen.subscribe_battery(), 2)
    say(
        "telemetry",
        pitch=[math.radians(a.pitch_deg) for a in attitude],
        stamps=[a.timestamp_us for a in attitude],
        rate=[r.pitch_rad_s for r in rates],
        x=[p.position.north_m for p in position],
        v=[p.velocity.north_m_s for p in position],
        voltage=battery[-1].voltage_v,
        remaining=battery[-1].remaining_percent,
        mode=(await within(anext(seen.subscribe_flight_mode()))).name,
        armed=await within(anext(seen.subscribe_armed())),
        landed=(await within(anext(seen.subscribe_landed_state()))).name,
        healthy=await within(anext(seen.subscribe_health_all_ok())),
    )


async def reached(seen: TelemetryAsync, wanted: float) -> list[float]:
    """The first ten angles in a row that are near the wanted one [rad]."""
    row: deque[float] = deque(maxlen=10)

    def stays(angle: EulerAngle) -> bool:
        row.append(math.radians(angle.pitch_deg))
        return len(row) == row.maxlen and max(abs(one - wanted) for one in row) < NEAR

    await until(seen.subscribe_attitude_euler(), stays)
    return list(row)


async def entered(offboard: OffboardAsync) -> None:
    """Offboard is on. It is asked again if refused, as MAVSDK may have stood still and streamed no set-points."""
    end = time.monotonic() + DEADLINE_S
    while True:
        try:
            return await within(offboard.start())
        except OffboardError:
            if time.monotonic() > end:
                raise


async def fly(system: System, seen: TelemetryAsync, arm_first: bool) -> None:
    action, offboard = ActionAsync(system), OffboardAsync(system)

    async def arm() -> None:
        await within(action.arm())
        await until(seen.subscribe_armed(), bool)
        say("armed")

    if arm_first:
        await arm()
    await offboard.set_attitude(Attitude(0.0, 0.0, 0.0, THRUST))
    await entered(offboard)
    mode = await until(seen.subscribe_flight_mode(), lambda mode: mode.name == "OFFBOARD")
    say("offboard", active=await offboard.is_active(), mode=mode.name)
    if not arm_first:
        await arm()
    for wanted in (THETA, -THETA):
        await offboard.set_attitude(Attitude(0.0, math.degrees(wanted), 0.0, THRUST))
        say("attitude", wanted=wanted, pitch=await reached(seen, wanted))
    await offboard.set_attitude(Attitude(0.0, 0.0, 0.0, THRUST))
    await asyncio.sleep(0.5)
    await within(offboard.stop())
    await within(action.disarm())
    await until(seen.subscribe_armed(), lambda armed: not armed)
    say("disarmed")


async def fetch(system: System, log: Path) -> None:
    files = LogFilesAsync(system)
    entries = await within(files.get_entries())
    say("logs", sizes=[e.size_bytes for e in entries], dates=[e.date for e in entries])
    async for _, progress in files.download_log_file(entries[-1], str(log)):
        last = progress.progress
    say("downloaded", size=log.stat().st_size, progress=last)


async def main(url: str, name: str, value: float, log: Path, first: str) -> None:
    async with made() as mavsdk:
        await within(mavsdk.add_any_connection(url))
        system = await mavsdk.first_autopilot(timeout_s=DEADLINE_S)
        if system is None:
            raise TimeoutError(f"nothing is found at {url}")
        await look_around(system, name, value)
        seen = TelemetryAsync(system)
        await telemetry(seen)
        # Only now: the type comes with the autopilot's heartbeat, which may be up to 1 s behind all else.
        say("discovered", system=await system.get_system_id(), autopilot=(await system.autopilot_type()).name)
        await fly(system, seen, first == "arm")
        await fetch(system, log)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], float(sys.argv[3]), Path(sys.argv[4]), sys.argv[5]))
