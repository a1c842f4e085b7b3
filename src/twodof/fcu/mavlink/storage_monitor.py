"""Keeping: says in words when what the vehicle keeps, its parameters and logs, cannot be written."""

from __future__ import annotations

from twodof.errors import TwodofError
from twodof.fcu.control.flight_code import ControlStep
from twodof.fcu.mavlink.service import Service
from twodof.fcu.onboard_log.logger import OnboardLogger
from twodof.fcu.parameters.parameter_store import ParameterStore

LOOK_TICKS = 250
ERROR, WARNING = 3, 4
"""MAV_SEVERITY."""


class StorageMonitor(Service):
    """Looks once a second and puts (MAV_SEVERITY, text) into `remarks`, each trouble once."""

    def __init__(self, store: ParameterStore, log: OnboardLogger | None, remarks: list[tuple[int, str]]) -> None:
        self._store, self._log, self._remarks = store, log, remarks
        self._said: dict[str, TwodofError | None] = {}
        self._dropped = 0

    def after(self, step: ControlStep) -> None:
        """Says what is new."""
        if step.tick % LOOK_TICKS:
            return
        self._look("parameters are not stored", self._store.failure)
        if self._log is not None:
            self._look("no on-board log", self._log.failure)
            if self._log.dropped != self._dropped:
                count, self._dropped = self._log.dropped - self._dropped, self._log.dropped
                self._remarks.append((WARNING, f"on-board log: the disk is too slow, {count} steps are missing"))

    def _look(self, what: str, failure: TwodofError | None) -> None:
        said = self._said.get(what)
        if failure is not None and (said is None or str(said) != str(failure)):
            self._remarks.append((ERROR, f"{what}: {failure}"))
        self._said[what] = failure
