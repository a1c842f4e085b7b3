"""Reads EVENTs with libevents' own Python parser (the copy that pyulog brings), as a client of PX4 does."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any, NamedTuple

from pyulog.libevents_parse.health_and_arming_checks import HealthAndArmingChecks
from pyulog.libevents_parse.parser import Parser


class Read(NamedTuple):
    """An event in words."""

    name: str
    group: str
    text: str
    level: int


class Reader:
    """A client that has the definitions; `checks` are the results of the last report, None before."""

    def __init__(self, definitions: bytes) -> None:
        self._parser = Parser()
        self._parser.load_definitions(json.loads(definitions))
        self._checks = HealthAndArmingChecks(False)

    def read(self, events: Iterable[Any]) -> list[Read]:
        """EVENT messages in words; reports of checks are taken in on the way."""
        found = []
        for event in events:
            parsed = self._parser.parse(event.id, bytes(event.arguments))
            assert parsed is not None, f"event {event.id} is not described"
            self._checks.handle_event(parsed)
            found.append(Read(parsed.name(), parsed.group(), parsed.message(), event.log_levels & 0xF))
        return found

    def shown(self, events: Iterable[Any]) -> list[str]:
        """What a person sees of them: as QGroundControl and MAVSDK choose it."""
        return [one.text for one in self.read(events) if one.group == "default" and one.level <= 7]

    @property
    def checks(self) -> Any:
        """Results of the last whole report."""
        return self._checks.results

    def failing(self) -> dict[str, str]:
        """Message -> name of the health component, of each check that fails."""
        return {
            check.message: check.health_component.name if check.health_component else "none"
            for check in self.checks.checks
        }
