"""Modes: which there are, which is in force, and changing it, as PX4 numbers them."""

from collections.abc import Iterable
from typing import Any

from twodof.fcu.command.commander import Commander
from twodof.fcu.command.result import CommandResult, denied, unsupported
from twodof.fcu.mavlink.addressing import VehicleAddress, source, whole
from twodof.fcu.mavlink.commands.command_service import CommandService, ReceivedCommand
from twodof.fcu.mavlink.commands.message_requests import MessageRequests
from twodof.fcu.mavlink.service import Service
from twodof.fcu.mavlink.telemetry.encoders import TelemetryEncoders
from twodof.link.connection import Received
from twodof.link.mavlink.enums import MavCmd
from twodof.link.mavlink.messages import message
from twodof.link.mavlink.modes import BY_NUMBER, MODES

_CUSTOM = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


class ModeService(Service):
    """SET_MODE and the commands 176 and 262; AVAILABLE_MODES on request; two messages for the streams."""

    def __init__(
        self,
        us: VehicleAddress,
        commands: CommandService,
        requests: MessageRequests,
        telemetry: TelemetryEncoders,
        commander: Commander,
    ) -> None:
        self._us = us
        self._commands = commands
        self._commander = commander
        commands.on(MavCmd.DO_SET_MODE, self._set)
        commands.on(MavCmd.DO_SET_STANDARD_MODE, self._set_standard)
        requests.on("AVAILABLE_MODES", self._available)
        telemetry.add("CURRENT_MODE", self._current)
        # The list is the same for as long as the flight controller runs.
        telemetry.add("AVAILABLE_MODES_MONITOR", lambda: message("AVAILABLE_MODES_MONITOR", seq=0))

    def handle(self, received: Received) -> bool:
        """Takes SET_MODE, which is acknowledged as command 176, as in PX4."""
        if received.message.get_type() != "SET_MODE":
            return False
        got = received.message
        if got.target_system == self._us.system and got.base_mode & _CUSTOM:
            number = got.custom_mode
            params = (float(got.base_mode), float(number >> 16 & 0xFF), float(number >> 24), *(0.0,) * 4)
            command = ReceivedCommand(MavCmd.DO_SET_MODE, params, source(received), received.peer)
            self._commands.acknowledge(command, self._commander.set_mode(command.source, number))
        return True

    def _current(self) -> Any:
        number = self._commander.custom_mode
        standard = BY_NUMBER[number].standard_mode if number in BY_NUMBER else 0
        return message("CURRENT_MODE", standard_mode=standard, custom_mode=number, intended_custom_mode=number)

    def _set(self, command: ReceivedCommand) -> CommandResult:
        base, main, sub = (whole(value, -1) for value in command.params[:3])
        if base < 0 or not base & _CUSTOM or not 0 <= main <= 255:
            return denied("a mode is asked for with base mode 1 and PX4's main and sub mode")
        return self._commander.set_mode(command.source, main << 16 | (max(sub, 0) & 0xFF) << 24)

    def _set_standard(self, command: ReceivedCommand) -> CommandResult:
        wanted = whole(command.params[0])
        for row in MODES:
            if wanted > 0 and row.standard_mode == wanted:
                return self._commander.set_mode(command.source, row.custom_mode)
        return unsupported()

    def _available(self, command: ReceivedCommand) -> Iterable[Any] | None:
        """All modes, or the one whose number from 1 is the second parameter."""
        wanted = whole(command.params[1])
        if not 0 <= wanted <= len(MODES):
            return None
        return [
            message(
                "AVAILABLE_MODES",
                number_modes=len(MODES),
                mode_index=place,
                standard_mode=row.standard_mode,
                custom_mode=row.custom_mode,
                properties=row.properties,
                mode_name=row.name.encode()[:34],
            )
            for place, row in enumerate(MODES, start=1)
            if wanted in (0, place)
        ]
