"""Independent programs at the other end: pymavlink's mavutil with its own `common`, its parser and its signing."""

import asyncio
import os
import sys
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S
from twodof.link.connection import Connection
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, Stamps
from twodof.link.transport import open_transport
from twodof.link.transport.tcp import TcpTransport
from twodof.link.transport.udp import UdpTransport

pytestmark = pytest.mark.slow

CLIENT = Path(__file__).with_name("mavutil_client.py")


@pytest.mark.parametrize("signed", [False, True], ids=["plain", "signed"])
@pytest.mark.parametrize(("scheme", "theirs"), [("udpin", "udpout"), ("tcpin", "tcp")])
def test_mavutil_commands_and_is_answered(scheme: str, theirs: str, signed: bool) -> None:
    key = Key.fresh()
    environment = {**os.environ, "MAVLINK20": "1", "MAVLINK_DIALECT": "common"}

    async def work() -> str:
        transport = await open_transport(f"{scheme}://:0")
        assert isinstance(transport, UdpTransport | TcpTransport)
        async with Connection(transport, 1, 1, Signing(key, Stamps(None)) if signed else None) as drone:
            client = await asyncio.create_subprocess_exec(
                sys.executable,
                str(CLIENT),
                f"{theirs}:127.0.0.1:{transport.port}",
                *([key.secret.hex()] if signed else []),
                env=environment,
                stdout=asyncio.subprocess.PIPE,
            )
            try:
                while True:
                    got = await drone.receive(PATIENCE_S)
                    assert got is not None, "no command came"
                    if got.message.get_type() == "COMMAND_LONG":
                        drone.send(message("COMMAND_ACK", command=got.message.command), to=got.peer)
                        break
                said, _ = await asyncio.wait_for(client.communicate(), PATIENCE_S)
            finally:
                if client.returncode is None:
                    client.kill()
                    await client.wait()
            counts = drone.statistics.senders[255, 190]
            assert (counts.received, counts.lost) == (6, 0)
            assert drone.framing["rubbish_bytes"] == 0
            return said.decode()

    assert asyncio.run(work()) == f"COMMAND_ACK 400 0 {signed} 0\n"
