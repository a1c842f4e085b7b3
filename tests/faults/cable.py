"""A serial cable between two programs: two pseudo-terminals and a thread that carries the bytes, until it is pulled."""

import os
import select
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.patience import PATIENCE_S


class Cable:
    """Its ends are devices with names that stay, `one` and `other`, as an adapter's do."""

    def __init__(self, folder: Path) -> None:
        self.one, self.other = folder / "ttyOne", folder / "ttyOther"
        self._ends: list[tuple[int, int]] = []
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self.carried = 0
        self.plug()

    def plug(self) -> None:
        """Plug both ends in."""
        for name in (self.one, self.other):
            master, slave = os.openpty()
            os.set_blocking(master, False)
            name.unlink(missing_ok=True)
            name.symlink_to(os.ttyname(slave))
            self._ends.append((master, slave))
        self._stop.clear()
        self._thread = threading.Thread(target=self._carry, args=[[end[0] for end in self._ends]], daemon=True)
        self._thread.start()

    def pull(self) -> None:
        """Pull both ends: what is on its way is gone, and the devices with it."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(PATIENCE_S)
        # The names first: the system gives the number of a terminal that is gone to the next one who asks.
        for name in (self.one, self.other):
            name.unlink(missing_ok=True)
        for master, slave in self._ends:
            os.close(master)
            os.close(slave)
        self._ends.clear()

    @contextmanager
    def pulled(self) -> Iterator[None]:
        """Both ends are out within the block, also when it raises."""
        self.pull()
        try:
            yield
        finally:
            self.plug()

    def _carry(self, masters: list[int]) -> None:
        across = dict(zip(masters, reversed(masters), strict=True))
        while not self._stop.is_set():
            for master in select.select(masters, [], [], 0.05)[0]:
                try:
                    data = os.read(master, 65536)
                    self.carried += os.write(across[master], data)
                except OSError:  # nobody has it open, or it is full: a wire keeps nothing
                    self._stop.wait(0.01)
