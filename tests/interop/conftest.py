"""A virtual drone in real time, with the rings closed, as processes: what other people's clients are let loose on."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from bench.stack.programs import free_port, port, running


@pytest.fixture(scope="module")
def fcu_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where the flight controller listens, by TCP."""
    folder = tmp_path_factory.mktemp("fcu")
    with running("fcu", "--listen", "tcpin://127.0.0.1:0", "--rings", "--state", "state", urls=1, folder=folder) as fcu:
        yield f"tcp://127.0.0.1:{port(fcu.urls[0])}"


@pytest.fixture(scope="module")
def companion_port(fcu_url: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """The UDP port of this machine to which a companion sends, as PX4's simulation does to 14540."""
    there = free_port(socket.SOCK_DGRAM)
    command = ("companion", "--fcu", fcu_url, "--onboard", f"udp://127.0.0.1:{there}?bind=127.0.0.1:0")
    with running(*command, urls=1, folder=tmp_path_factory.mktemp("companion")):
        yield there
