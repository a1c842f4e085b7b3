"""A port of this machine that another program has."""

from __future__ import annotations

import asyncio
import socket

import pytest

from tests.fleet.drone_numbers import free_numbers
from twodof.errors import LinkLost
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.transport.url import Port


def test_a_taken_port_is_named_where_no_drone_answers_either() -> None:
    """A client calls the drone at the port that it listens at; nobody is there, so what stood in the way is told."""
    with free_numbers(1) as number, socket.socket(type=socket.SOCK_DGRAM) as other:
        port = Port.ONBOARD + number
        other.bind(("127.0.0.1", port))
        with pytest.raises(LinkLost, match="in use") as caught:
            asyncio.run(AsyncDrone.connect(f"udpin://127.0.0.1:{port}", timeout=0.3))
    assert str(port) in caught.value.where
    assert str(Port.COMPANION_ONBOARD + number) in caught.value.what
    assert "end who has it" in caught.value.remedy
