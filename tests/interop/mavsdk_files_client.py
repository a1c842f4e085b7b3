"""A client made with MAVSDK alone, for what the vehicle keeps: `python mavsdk_files_client.py URL FOLDER`; prints JSON.

It lists, fetches, compares, sends and removes files. It asks for the component's metadata and has the
log streamed, and is told what happens. Like mavsdk_client.py it runs in a process of its own.
"""

from __future__ import annotations

import asyncio
import base64
import sys
from pathlib import Path

from mavsdk.asyncio import System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.component_metadata import ComponentMetadataAsync
from mavsdk.asyncio.plugins.ftp import FtpAsync
from mavsdk.asyncio.plugins.log_streaming import LogStreamingAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.action import ActionError
from mavsdk.plugins.ftp import FtpError
from mavsdk_steps import DEADLINE_S, made, say, within

# Two parts of a log: the second before it began, and what came in the next quarter of one.
STREAMED_BYTES = 300_000
FORGOTTEN_S = 10.0
ULOG = b"ULog\x01\x12\x35"
"""What a log begins with."""


async def files(ftp: FtpAsync, folder: Path) -> None:
    """Down and up again."""
    for path in ("/", "/etc/extras"):
        listed = await within(ftp.list_directory(path))
        say(
            "list",
            path=path,
            entries=[[entry.entry_type.name, entry.name, entry.size_bytes] for entry in listed.entries],
        )
    for burst in (False, True):
        target = folder / str(burst)
        target.mkdir()
        async for _ in ftp.download("/etc/extras/parameters.json", str(target), burst):
            pass
        say("fetched", burst=burst, text=(target / "parameters.json").read_text())
    same = await within(
        ftp.are_files_identical(str(folder / "True" / "parameters.json"), "/etc/extras/parameters.json")
    )
    say("identical", same=bool(same))
    (folder / "attitude_control.json").write_text("x" * 5000)
    async for _ in ftp.upload(str(folder / "attitude_control.json"), "/controllers"):
        pass
    listed = await within(ftp.list_directory("/controllers"))
    say("sent", entries=[[entry.name, entry.size_bytes] for entry in listed.entries])
    await within(ftp.remove_file("/controllers/attitude_control.json"))
    for path in ("/controllers/attitude_control.json", "/../etc/passwd"):
        try:
            await within(ftp.remove_file(path))
        except FtpError as refused:
            say("refused", path=path, why=str(refused))


async def metadata(system: System) -> None:
    """Fetch the description of the parameters."""
    plugin = ComponentMetadataAsync(system)
    updates = plugin.subscribe_metadata_available()
    asked = asyncio.create_task(within(anext(updates)))
    await asyncio.sleep(0.1)
    await plugin.request_autopilot_component()
    update = await asked
    say("metadata", type=update.type.name, text=update.json_metadata)


async def refusal(system: System) -> None:
    """Kill, try to arm, and print the texts that come."""
    action, texts = ActionAsync(system), TelemetryAsync(system).subscribe_status_text()
    first = asyncio.create_task(within(anext(texts)))
    await asyncio.sleep(0.1)
    await within(action.kill())
    try:
        await within(action.arm())
    except ActionError as refused:
        say("not armed", why=str(refused))
    for told in (await first, await within(anext(texts))):
        say("text", text=told.text, level=told.type.name)


async def stream(system: System, target: Path) -> None:
    """The beginning of a log while it is written.

    MAVSDK forgets a stream when it has heard no heartbeat for 3 s, for example if the drone's machine stood still. Then
    it is asked for again, which begins another log.
    """
    plugin = LogStreamingAsync(system)
    data = b""
    while len(data) < STREAMED_BYTES:
        pieces = plugin.subscribe_log_streaming_raw()
        following = asyncio.create_task(within(anext(pieces)))
        await asyncio.sleep(0.1)
        await within(plugin.start_log_streaming())
        while len(data) < STREAMED_BYTES and (await asyncio.wait([following], timeout=FORGOTTEN_S))[0]:
            data += base64.b64decode(following.result().data_base64)
            data = data[max(0, data.rfind(ULOG)) :]
            following = asyncio.create_task(within(anext(pieces)))
        following.cancel()
    target.write_bytes(data)
    await within(plugin.stop_log_streaming())
    say("streamed", size=len(data))


async def main(url: str, folder: Path) -> None:
    async with made() as mavsdk:
        await within(mavsdk.add_any_connection(url))
        system = await mavsdk.first_autopilot(timeout_s=DEADLINE_S)
        if system is None:
            raise TimeoutError(f"nothing is found at {url}")
        await files(FtpAsync(system), folder)
        await metadata(system)
        await stream(system, folder / "streamed.ulg")
        await refusal(system)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], Path(sys.argv[2])))
