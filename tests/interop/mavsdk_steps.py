"""Shared code of the clients made with MAVSDK: each step is a line of JSON, and each wait has a deadline."""

from __future__ import annotations

import asyncio
import ctypes
import json
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from mavsdk.asyncio import Configuration, Mavsdk
from mavsdk.plugins.info import InfoError, InfoResult

DEADLINE_S = 100.0
ANSWER_S = 5.0
"""After so long MAVSDK asks again, and gives a command up after the fourth time; its own is half a second."""

T = TypeVar("T")


def say(step: str, **saw: Any) -> None:
    """A step, and what was seen in it."""
    sys.stdout.write(json.dumps({"step": step} | saw) + "\n")
    sys.stdout.flush()


async def within(what: Awaitable[T]) -> T:
    """Its result; TimeoutError if it does not come."""
    return await asyncio.wait_for(what, DEADLINE_S)


def made() -> Mavsdk:
    """MAVSDK as a ground station that waits for answers of a machine that stands still for a second or two.

    What sets that is in its library, and has no call in Python.
    """
    mavsdk = Mavsdk(Configuration.create_manual(245, 190, True))
    core = mavsdk._mavsdk
    core._lib.mavsdk_set_timeout_s(ctypes.c_void_p(core._handle), ctypes.c_double(ANSWER_S))
    return mavsdk


async def told(ask: Callable[[], Awaitable[T]]) -> T:
    """Ask until the drone's description has come; MAVSDK itself gives up after half a second."""
    end = time.monotonic() + DEADLINE_S
    while True:
        try:
            return await within(ask())
        except InfoError as error:
            if error.result != InfoResult.INFORMATION_NOT_RECEIVED_YET or time.monotonic() > end:
                raise
