"""What the vehicle is asked to stream: one MAV_CMD_SET_MESSAGE_INTERVAL at a time, since no answer says to which."""

from collections.abc import Callable
from dataclasses import dataclass, field

from twodof.companion.client import Wish

ANSWER_S = 0.5
TRIES = 4
# A vehicle that did not answer is asked again, as it may have been busy, or not there.
AGAIN_S = 5.0
ACCEPTED = 0


@dataclass(slots=True)
class _Pending:
    wish: Wish
    waiting: list[Callable[[int], None]] = field(default_factory=list)
    not_before: float = 0.0


class IntervalRequests:
    """Asks the vehicle by `send(message id, wish)`; what it accepted is in `granted`."""

    def __init__(self, send: Callable[[int, Wish], None], granted: dict[int, Wish]) -> None:
        self.granted = granted
        self._send = send
        self._pending: dict[int, _Pending] = {}
        self._asked: int | None = None
        self._wish = Wish(0)
        self._tries = 0
        self._until = 0.0

    def want(self, message_id: int, wish: Wish, now: float, then: Callable[[int], None] | None = None) -> None:
        """Ask for it if need be; `then` is called with the MAV_RESULT, at once if the vehicle does so already."""
        pending = self._pending.get(message_id)
        if pending is None and self.granted.get(message_id) == wish:
            if then is not None:
                then(ACCEPTED)
            return
        if pending is None:
            pending = self._pending[message_id] = _Pending(wish)
        pending.wish, pending.not_before = wish, now
        if then is not None:
            pending.waiting.append(then)
        self.poll(now)

    def forget(self, message_id: int) -> None:
        """Nobody wants it and nobody has: no more is known of it, unless it is being asked just now."""
        if message_id != self._asked:
            self._pending.pop(message_id, None)
            self.granted.pop(message_id, None)

    @property
    def known(self) -> set[int]:
        """Ids of the messages that were asked for, or will be."""
        return {*self.granted, *self._pending}

    def restart(self) -> None:
        """The vehicle has forgotten everything, and what was asked of it is not answered any more."""
        self.granted.clear()
        self._pending.clear()
        self._asked = None

    def answered(self, result: int, now: float) -> None:
        """An ACK of MAV_CMD_SET_MESSAGE_INTERVAL to us."""
        number, self._asked = self._asked, None
        if number is None:
            return
        pending = self._pending.get(number)
        if result == ACCEPTED:
            self.granted[number] = self._wish
        if pending is not None and (pending.wish == self._wish or result != ACCEPTED):
            del self._pending[number]
            for then in pending.waiting:
                then(result)
        self.poll(now)

    def poll(self, now: float) -> None:
        """Ask the next question that waits, and again where no answer came."""
        if self._asked is not None and now >= self._until:
            if self._tries < TRIES:
                self._ask(self._asked, now)
                return
            pending = self._pending.get(self._asked)
            if pending is not None:
                pending.waiting.clear()  # who asked hears nothing, as from a vehicle that is not there
                pending.not_before = now + AGAIN_S
            self._asked = None
        if self._asked is None:
            for number, pending in self._pending.items():
                if pending.not_before <= now:
                    self._tries = 0
                    self._wish = pending.wish
                    self._ask(number, now)
                    return

    def _ask(self, number: int, now: float) -> None:
        self._asked = number
        self._tries += 1
        self._until = now + ANSWER_S
        self._send(number, self._wish)
