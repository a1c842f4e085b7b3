"""The owner of a taken port is named in the error."""

import asyncio
import os
import socket
from contextlib import ExitStack, closing
from pathlib import Path

import pytest

from tests.fleet.drone_numbers import free_numbers
from twodof.cli.app import run
from twodof.errors import LinkError
from twodof.fleet.local_drone import port_owner, with_port_owner
from twodof.fleet.local_fleet import LocalPage
from twodof.link.transport.url import Ports


@pytest.mark.parametrize(
    ("kind", "type_", "first"),
    [("TCP", socket.SOCK_STREAM, Ports.FLIGHT_CONTROLLER), ("UDP", socket.SOCK_DGRAM, Ports.COMPANION_ONBOARD)],
)
def test_the_process_that_has_a_port_is_named(kind: str, type_: int, first: int) -> None:
    with free_numbers(1) as number:  # a port that nobody takes as soon as we have left it
        port = first + number
        with closing(socket.socket(type=type_)) as ours:
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            ours.bind(("127.0.0.1", port))
            if kind == "TCP":
                assert port_owner(kind, port) == ""  # bound, and nobody can come
                ours.listen(1)
            assert port_owner(kind, port).startswith(f"process {os.getpid()} (")
        assert port_owner(kind, port) == ""


def test_descriptors_that_are_closed_meanwhile_hide_nobody() -> None:
    """As the one with which they are listed, below or above that of the socket."""
    with ExitStack() as stack:
        below = stack.enter_context(Path("/dev/null").open())
        ours = stack.enter_context(closing(socket.socket(type=socket.SOCK_DGRAM)))
        ours.bind(("127.0.0.1", 0))
        below.close()
        assert port_owner("UDP", ours.getsockname()[1]).startswith(f"process {os.getpid()} (")


def test_a_port_that_is_taken_is_told_with_who_has_it(capfd: pytest.CaptureFixture[str]) -> None:
    with free_numbers(1) as number, closing(socket.socket(type=socket.SOCK_DGRAM)) as ours:
        ours.bind(("127.0.0.1", Ports.COMPANION_ONBOARD + number))
        assert run(["companion", "--index", str(number)]) == 2
        assert f"remedy: end process {os.getpid()} (" in capfd.readouterr().err
        assert run(["up", "--first", str(number + 1)]) == 2
        said = capfd.readouterr().err
        assert f"UDP port {Ports.COMPANION_ONBOARD + number}, where the companion of drone {number + 1} listens" in said
        assert f"process {os.getpid()} (" in said


def test_another_error_stays_as_it_is() -> None:
    error = LinkError("nobody answered", "tcp://127.0.0.1:5790", "start it")
    assert with_port_owner(error) is error
    assert with_port_owner(LinkError("is in use", "no url")).remedy == ""


@pytest.mark.long
def test_a_server_that_dies_repeats_no_token() -> None:
    said: list[str] = []

    async def serve() -> None:
        environment = {"TWODOF_LAB_COMMAND_TOKEN": "the-secret"}
        async with LocalPage([], 0, ["--the-secret"], environment, said.append) as page:
            assert not await page.listens()

    asyncio.run(serve())
    (line,) = said
    assert line.startswith("the page did not start")
    assert "the-secret" not in line
    assert "..." in line
