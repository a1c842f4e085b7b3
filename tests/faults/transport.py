"""A transport with seeded faults on the loop's clock: loss, delay, disorder, repetition, damage and cuts."""

import asyncio
import random
from collections.abc import Hashable
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count

from twodof.errors import LinkLost
from twodof.link.transport.base import Transport


@dataclass(frozen=True)
class Faults:
    """Faults of a packet on its way out.

    `loss`, `duplicate`, `reorder` and `damage` are probabilities (reorder: it waits `reorder_s` more, damage: one bit
    turns over); `delay` [s] holds for all, `jitter` [s] is drawn evenly from 0 and adds to it.
    """

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    reorder_s: float = 0.05
    damage: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0


class FaultyTransport(Transport):
    """Wraps a transport; what is sent through it meets with `faults`, what is received does not.

    Wrap both ends to have them both ways. `faults` may be changed while it runs. `cut()` is a cable pulled: nothing
    goes either way until `mend()`.
    """

    def __init__(self, inner: Transport, faults: Faults, seed: int) -> None:
        super().__init__(f"faulty {inner.url}")
        self.inner = inner
        self.faults = faults
        self.lost = 0
        self.whole = inner.whole
        self._chance = random.Random(seed)
        self._is_cut = False
        self._under_way: list[tuple[float, int, bytes, Hashable]] = []
        self._numbers = count()
        self._reader = asyncio.get_running_loop().create_task(self._read())

    @property
    def peers(self) -> tuple[Hashable, ...]:
        """The wrapped transport's."""
        return self.inner.peers

    def confirm(self, peer: Hashable) -> None:
        """The wrapped transport decides."""
        self.inner.confirm(peer)

    def cut(self) -> None:
        """From now on nothing goes through, either way."""
        self._is_cut = True

    def mend(self) -> None:
        """From now on it goes through again."""
        self._is_cut = False

    async def _read(self) -> None:
        try:
            while True:
                packet = await self.inner.receive(1.0)
                if packet is not None and not self._is_cut:
                    self._inbox.put(packet)
        except LinkLost as error:
            self._lose(error.what)

    def _send(self, data: bytes, peer: Hashable) -> bool:
        chance, faults, loop = self._chance, self.faults, asyncio.get_running_loop()
        if self._is_cut or chance.random() < faults.loss:
            self.lost += 1
            return True
        for _ in range(2 if chance.random() < faults.duplicate else 1):
            wait = faults.delay + faults.jitter * chance.random()
            if chance.random() < faults.reorder:
                wait += faults.reorder_s
            if chance.random() < faults.damage:
                place = chance.randrange(8 * len(data))
                data = bytes(b ^ (1 << place % 8 if at == place // 8 else 0) for at, b in enumerate(data))
            due = loop.time() + wait
            heappush(self._under_way, (due, next(self._numbers), data, peer))
            loop.call_at(due, self._deliver)
        return True

    def _deliver(self) -> None:
        """The packet due next; of two that are due at once the first that was sent, which timers do not promise."""
        _, _, data, peer = heappop(self._under_way)
        if not self._is_cut and not self.inner.closed:
            self.inner.send(data, peer)

    def _release(self) -> None:
        self._reader.cancel()

    async def close(self) -> None:
        """Close both."""
        await super().close()
        await self.inner.close()
