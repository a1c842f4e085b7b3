"""Lockstep: TWODOF_GRANT lets time run, TWODOF_TICK reports the tick reached; TWODOF_RIG_RESET restarts time."""

from bisect import insort
from collections.abc import Callable, Hashable
from math import inf
from typing import Any, NamedTuple

from twodof.errors import RefusalReason, TwodofError
from twodof.fcu.command.command_lease import DONE, CommandResult, denied, unsupported
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.service import MASK_32, Service, Vehicle, source, unwrap
from twodof.link.connection import Received
from twodof.link.mavlink.messages import message

REFUSED_FLAG = 16
"""TWODOF_RIG_FLAG_REFUSED."""

MOST_SEEDS = 2**32
MOST_GRANTS = 256
"""Most grants that wait for their answer; beyond that the earliest are answered together with the last."""


class Grant(NamedTuple):
    """A grant of time up to the tick `until` that is not answered yet."""

    until: int
    number: int
    peer: Hashable


class LockstepService(Service):
    """Service that grants ticks and answers when they have run. It is the last service, so its answer comes last.

    `rig` makes the TWODOF_RIG that answers a reset; its argument is a mask of further flags.
    """

    def __init__(self, vehicle: Vehicle, rig: Callable[[int], Any]) -> None:
        super().__init__(vehicle, {"TWODOF_GRANT": self._grant, "TWODOF_RIG_RESET": self._reset})
        self._controller = vehicle.controller
        self._rig = rig
        self._waiting: list[Grant] = []

    def after(self, step: ControlStep) -> None:
        self._answer_waiting(self._controller.tick)

    def restart(self) -> None:
        self._answer_waiting(inf)  # what was granted is void, and answered

    def gone(self, peer: Hashable) -> None:
        self._waiting = [grant for grant in self._waiting if grant.peer != peer]

    def _grant(self, received: Received) -> None:
        got, controller = received.message, self._controller
        if not controller.lockstep:
            self._vehicle.refuse(received, unsupported("grant refused: time runs by itself"))
            return
        result = self._vehicle.take(source(received), "grant")
        if result.accepted:
            until = unwrap(got.until, controller.tick)
            controller.grant(until)
            grant = Grant(min(until, controller.granted), got.number, received.peer)
            if grant.until <= controller.tick:
                self._answer(grant.number, grant.peer)
            elif len(self._waiting) < MOST_GRANTS:
                insort(self._waiting, grant, key=lambda one: one.until)
        else:
            self._vehicle.refuse(received, result)
            self._answer(got.number, received.peer)

    def _answer_waiting(self, tick: float) -> None:
        """Answer the grants of time up to `tick`."""
        while self._waiting and self._waiting[0].until <= tick:
            grant = self._waiting.pop(0)
            self._answer(grant.number, grant.peer)

    def _answer(self, number: int, peer: Hashable) -> None:
        controller = self._controller
        until = max(controller.granted, controller.tick) & MASK_32
        self._vehicle.send(message("TWODOF_TICK", tick=controller.tick & MASK_32, until=until, number=number), peer)

    def _reset(self, received: Received) -> None:
        result = self._vehicle.take(source(received), "reset")
        if result.accepted:
            result = self._begin_again(received.message)
        if not result.accepted:
            self._vehicle.refuse(received, result)
        self._vehicle.send(self._rig(0 if result.accepted else REFUSED_FLAG), received.peer)

    def _begin_again(self, got: Any) -> CommandResult:
        if got.seed >= MOST_SEEDS:
            return denied(f"reset refused: seed {got.seed} is above {MOST_SEEDS - 1}", RefusalReason.INVALID)
        try:
            self._controller.reset(got.seed, got.x, got.noise, got.rings != 0)
        except TwodofError as reason:
            code = RefusalReason.ARMED if self._vehicle.commander.armed else RefusalReason.INVALID
            return denied(f"reset refused: {reason}", code)
        return DONE
