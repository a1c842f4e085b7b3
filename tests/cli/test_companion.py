"""`twodof companion`: says where it is reached once it is, ends when told, runs an app and ends with it."""

import asyncio
import json
import os
import signal
import sys
from pathlib import Path

import pytest

from tests.cli.program import Shell
from tests.companion.scripted import Listener, Vehicle, until
from tests.patience import PATIENCE_S
from twodof.link.transport import open_transport
from twodof.link.transport.url import parse

pytestmark = pytest.mark.slow


async def started(*arguments: str) -> asyncio.subprocess.Process:
    """The command as a process."""
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "twodof.cli", "companion", *arguments),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )


async def flight_controller() -> tuple[Vehicle, str]:
    """A flight controller by script on TCP, and its URL."""
    transport = await open_transport("tcpin://127.0.0.1:0")
    return Vehicle(transport), transport.url.replace("in:", ":")


def test_it_routes_and_ends_on_a_signal() -> None:
    async def work() -> None:
        vehicle, url = await flight_controller()
        process = await started("--fcu", url, "--onboard", "tcpin://127.0.0.1:0", "--json")
        try:
            assert process.stdout is not None
            said = json.loads(await asyncio.wait_for(process.stdout.readline(), PATIENCE_S))
            assert (said["fcu"], said["system"], said["serve"][0]["rates"]) == (url, 1, "onboard")
            port = parse(said["serve"][0]["url"]).port
            async with Listener(await open_transport(f"tcp://127.0.0.1:{port}")) as client:
                await until(lambda: len(client.heard("ATTITUDE")) > 5)
                client.command(400, 1.0)
                await until(lambda: bool(client.heard("COMMAND_ACK")))
            process.send_signal(signal.SIGTERM)
            assert await asyncio.wait_for(process.wait(), PATIENCE_S) == 0
        finally:
            await _gone(process)
            await vehicle.close()

    asyncio.run(work())


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "status", "words"),
    [
        pytest.param("print('I fly')", 0, "I fly", id="ends", marks=pytest.mark.soak),
        pytest.param("import os; print('I fly', flush=True); os._exit(9)", 1, "crashed 1 times", id="crashes"),
    ],
)
def test_an_app_runs_and_reports_its_status(tmp_path: Path, text: str, status: int, words: str) -> None:
    file = tmp_path / "app.py"
    file.write_text(f"async def main(drone):\n    {text}\n")

    async def work() -> None:
        vehicle, url = await flight_controller()
        process = await started(
            *("--fcu", url, "--onboard", "tcpin://127.0.0.1:0", "run", str(file), "--restarts", "0")
        )
        try:
            _, said = await asyncio.wait_for(process.communicate(), PATIENCE_S)
            assert process.returncode == status, said.decode()
            assert words in said.decode()
            assert "I fly" in said.decode()
        finally:
            await _gone(process)
            await vehicle.close()

    asyncio.run(work())


async def _gone(process: asyncio.subprocess.Process) -> None:
    if process.returncode is None:
        os.kill(process.pid, signal.SIGKILL)
    await process.communicate()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["run", "no-such-app.py"], "does not exist"),
        (["--fcu", "gopher://x"], "is not a kind of link"),
        (["--onboard", "udp://10.0.0.2:1?bind=2"], "bind=0.0.0.0:2"),
        (["--index", "200"], "--index"),
        (["--index", "10"], "say where this one serves"),
    ],
)
def test_a_mistake_is_told_with_its_remedy(arguments: list[str], complaint: str, shell: Shell) -> None:
    assert complaint in shell(["companion", *arguments], 2).err
