"""Requests for one message: command 512 and the older commands that ask for a particular one."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

from twodof.fcu.command.result import DONE, CommandResult, denied, rejected, unsupported
from twodof.fcu.mavlink.addressing import whole
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand
from twodof.fcu.mavlink.service import Link
from twodof.fcu.mavlink.telemetry.encoders import TelemetryEncoders
from twodof.link.mavlink.dialect import message_id
from twodof.link.mavlink.enums import MavCmd

OLD_FORMS = {
    MavCmd.GET_HOME_POSITION: "HOME_POSITION",
    MavCmd.REQUEST_PROTOCOL_VERSION: "PROTOCOL_VERSION",
    MavCmd.REQUEST_AUTOPILOT_CAPABILITIES: "AUTOPILOT_VERSION",
}

Builder = Callable[[ReceivedCommand], Iterable[Any] | None]


class MessageRequests:
    """Answers a request with what a builder registered for the message gives, or with a stream's message as of now."""

    def __init__(self, link: Link, commands: CommandService, telemetry: TelemetryEncoders) -> None:
        self._link = link
        self._telemetry = telemetry
        self._builders: dict[int, Builder] = {}
        commands.on(MavCmd.REQUEST_MESSAGE, lambda command: self._send(whole(command.params[0], -1), command))
        for command, name in OLD_FORMS.items():
            commands.on(command, partial(self._send_old, message_id(name)))

    def on(self, name: str, builder: Builder) -> None:
        """Registers who gives a message; None from it says that the request's other parameters make no sense."""
        self._builders[message_id(name)] = builder

    @property
    def supported(self) -> tuple[int, ...]:
        """Ids of the messages that are given."""
        return tuple(sorted({*self._builders, *self._telemetry.messages}))

    def _send_old(self, number: int, command: ReceivedCommand) -> CommandResult:
        # Their first parameter is 1 or left out; the others, which a builder may read, do not exist.
        return self._send(number, command._replace(params=(float(number), *(0.0,) * 6)))

    def _send(self, number: int, command: ReceivedCommand) -> CommandResult:
        builder = self._builders.get(number)
        built: Iterable[Any] | None
        if builder is not None:
            built = builder(command)
        elif number in self._telemetry.messages:
            now = self._telemetry.message(number)
            if now is None:
                return rejected("nothing was measured yet: let time run")
            built = [now]
        else:
            return unsupported()
        if built is None:
            return denied()
        for one in built:
            self._link.send(one, command.peer)
        return DONE
