"""Requests for one message: command 512 and the older commands that ask for a particular one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from twodof.fcu.command.result import ACCEPTED, DENIED, TEMPORARILY_REJECTED, UNSUPPORTED, CommandResult
from twodof.fcu.mavlink.addressing import whole
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand
from twodof.fcu.mavlink.service import Link
from twodof.fcu.mavlink.telemetry.encoders import TelemetryEncoders

REQUEST_MESSAGE = 512
OLD_FORMS = {410: 242, 519: 300, 520: 148}
"""Command -> the message that it asks for: HOME_POSITION, PROTOCOL_VERSION, AUTOPILOT_VERSION."""

Builder = Callable[[ReceivedCommand], Iterable[Any] | None]


class MessageRequests:
    """Answers a request with what a builder registered for the message gives, or with a stream's message as of now."""

    def __init__(self, link: Link, commands: CommandService, telemetry: TelemetryEncoders) -> None:
        self._link = link
        self._telemetry = telemetry
        self._builders: dict[int, Builder] = {}
        commands.on(REQUEST_MESSAGE, lambda command: self._send(command, whole(command.params[0], -1)))
        for number, message_id in OLD_FORMS.items():
            commands.on(number, partial(self._send_old, message_id))

    def on(self, message_id: int, builder: Builder) -> None:
        """Registers who gives the message; None from it says that the request's other parameters make no sense."""
        self._builders[message_id] = builder

    @property
    def supported(self) -> tuple[int, ...]:
        """Ids of the messages that are given."""
        return tuple(sorted({*self._builders, *self._telemetry.messages}))

    def _send_old(self, message_id: int, command: ReceivedCommand) -> CommandResult:
        # Their first parameter is 1 or left out; the others, which a builder may read, do not exist.
        return self._send(command._replace(params=(float(message_id), *(0.0,) * 6)), message_id)

    def _send(self, command: ReceivedCommand, message_id: int) -> CommandResult:
        builder = self._builders.get(message_id)
        if builder is None:
            if message_id not in self._telemetry.messages:
                return CommandResult(UNSUPPORTED)
            now = self._telemetry.message(message_id)
            if now is None:
                return CommandResult(TEMPORARILY_REJECTED, "nothing was measured yet: let time run")
            built: Iterable[Any] | None = [now]
        else:
            built = builder(command)
        if built is None:
            return CommandResult(DENIED)
        for one in built:
            self._link.send(one, command.peer)
        return CommandResult(ACCEPTED)
