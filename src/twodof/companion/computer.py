"""How the companion's computer is: load and memory from /proc, what passes over its links."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from twodof.link.mavlink.messages import message

MOST_CORES, MOST_LINKS = 8, 6
NO_CORE, NO_NUMBER, NO_TEMPERATURE, NO_FAN = 255, 2**32 - 1, 127, 32767
MIB, KIB = 1 << 20, 1 << 10


class Traffic(NamedTuple):
    """Bytes that a link has sent and received so far, and the most it carries [byte/s], 0 if nobody knows."""

    sent: int
    received: int
    most: float = 0.0


class ComputerStatus:
    """Reads /proc (`root` in its place, for tests); rates are those since it was last asked. `clock` gives seconds."""

    def __init__(
        self,
        links: Callable[[], Sequence[Traffic]] = tuple,
        clock: Callable[[], float] = time.monotonic,
        root: Path = Path("/proc"),
    ) -> None:
        self._links = links
        self._clock = clock
        self._root = root
        self._started = self._last = clock()
        self._busy: list[tuple[int, int]] = []
        self._traffic: list[Traffic] = []

    def status(self) -> Any:
        """ONBOARD_COMPUTER_STATUS; what cannot be read is told as unknown."""
        now = self._clock()
        since, self._last = max(now - self._last, 1e-3), now
        used, total = self._memory()
        links = [*self._links()][:MOST_LINKS]
        before = self._traffic if len(self._traffic) == len(links) else links
        self._traffic = links
        sent = [round((one.sent - old.sent) / since / KIB) for one, old in zip(links, before, strict=True)]
        received = [round((one.received - old.received) / since / KIB) for one, old in zip(links, before, strict=True)]
        most = [round(one.most / KIB) or NO_NUMBER for one in links]
        return message(
            "ONBOARD_COMPUTER_STATUS",
            time_usec=int(time.time() * 1e6),
            uptime=int((now - self._started) * 1e3) & 0xFFFFFFFF,
            cpu_cores=_filled(self._loads(), MOST_CORES, NO_CORE),
            cpu_combined=[NO_CORE] * 10,
            gpu_cores=[NO_CORE] * 4,
            gpu_combined=[NO_CORE] * 10,
            temperature_board=NO_TEMPERATURE,
            temperature_core=[NO_TEMPERATURE] * 8,
            fan_speed=[NO_FAN] * 4,
            ram_usage=used,
            ram_total=total,
            storage_type=[NO_NUMBER] * 4,
            storage_usage=[NO_NUMBER] * 4,
            storage_total=[NO_NUMBER] * 4,
            link_tx_rate=_filled(sent, MOST_LINKS, NO_NUMBER),
            link_rx_rate=_filled(received, MOST_LINKS, NO_NUMBER),
            link_tx_max=_filled(most, MOST_LINKS, NO_NUMBER),
            link_rx_max=_filled(most, MOST_LINKS, NO_NUMBER),
        )

    def _loads(self) -> list[int]:
        """Load of each core [%] since it was last asked."""
        rows = [line.split() for line in self._lines("stat") if line.startswith("cpu") and line[3:4].isdigit()]
        times = [[int(word) for word in row[1:9] if word.isdigit()] for row in rows[:MOST_CORES]]
        busy = [(sum(row), sum(row) - sum(row[3:5])) for row in times]  # all, and all but idle and waiting for a disk
        before, self._busy = self._busy, busy
        if len(before) != len(busy):
            return []
        return [
            round(100 * (working - old_working) / max(all_time - old_all, 1))
            for (all_time, working), (old_all, old_working) in zip(busy, before, strict=True)
        ]

    def _memory(self) -> tuple[int, int]:
        """Memory in use and in all [MiB]."""
        rows = dict(line.split()[:2] for line in self._lines("meminfo") if len(line.split()) >= 2)
        try:
            total, free = int(rows["MemTotal:"]), int(rows["MemAvailable:"])
        except (KeyError, ValueError):
            return NO_NUMBER, NO_NUMBER
        return (total - free) * KIB // MIB, total * KIB // MIB

    def _lines(self, name: str) -> list[str]:
        try:
            with (self._root / name).open("rb") as file:
                return file.read(65_536).decode("ascii", "replace").splitlines()
        except OSError:  # no /proc: another system
            return []


def _filled(values: Sequence[int], length: int, unknown: int) -> list[int]:
    rows = [min(max(value, 0), unknown) for value in values][:length]
    return rows + [unknown] * (length - len(rows))
