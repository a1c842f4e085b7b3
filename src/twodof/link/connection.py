"""Connection: messages over one transport for one system and component, signed if asked, and counted.

Flight controller and ground both use it. It answers TIMESYNC and PING by itself and does nothing else on its own:
heartbeats, leases and the meaning of silence belong to its user. Its statistics are loss per sender, round trip and
clock offset.
"""

import asyncio
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any, NamedTuple, Self

from twodof.errors import LinkError, LinkLost
from twodof.link.mavlink.framing import Frame, FramingCounts, Parser, decode, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Admission, Signing
from twodof.link.transport.base import Packet, Transport

# A sequence number is one byte: what is behind by more than half of its range is ahead.
_RANGE, _HALF = 256, 128
WINDOW = 64
MOST_SENDERS = 256
MOST_ASKED = 16


@dataclass(slots=True)
class SenderCounts:
    """Frames of one system and component: `lost` is gaps in their sequence that were not filled later."""

    received: int = 0
    lost: int = 0
    duplicated: int = 0
    reordered: int = 0
    restarts: int = 0
    _last: int = -1
    _seen: int = 0  # bit n: the frame n before the last has come

    @property
    def loss(self) -> float:
        """Fraction of the frames sent that were lost, 0 to 1."""
        sent = self.received - self.duplicated + self.lost
        return self.lost / sent if sent > 0 else 0.0

    def count(self, sequence: int) -> None:
        """Count a frame by its sequence number.

        A frame up to WINDOW behind the newest was late, or is a second copy. A frame further behind, but not far ahead,
        comes from a sender that restarted.
        """
        self.received += 1
        ahead = (sequence - self._last) % _RANGE
        if self._last < 0:
            self._last, self._seen = sequence, 1
        elif 0 < ahead < _HALF:
            self.lost += ahead - 1
            self._last, self._seen = sequence, (self._seen << ahead | 1) & (1 << WINDOW) - 1
        elif (behind := (_RANGE - ahead) % _RANGE) >= WINDOW:
            self.restarts += 1
            self._last, self._seen = sequence, (1 << WINDOW) - 1
        elif self._seen >> behind & 1:
            self.duplicated += 1
        else:
            # Before the first frame that came nothing was counted as lost.
            self.reordered += 1
            self.lost = max(0, self.lost - 1)
            self._seen |= 1 << behind


@dataclass(slots=True)
class RoundTrips:
    """Round trips [s] of TIMESYNC and PING: their number, the last, the least and an exponentially weighted mean."""

    count: int = 0
    last: float = 0.0
    least: float = float("inf")
    mean: float = 0.0
    offset: float = 0.0  # the other clock minus ours [s], from the quickest round trip
    _asked: dict[int, float] = field(default_factory=dict)

    def asked(self, token: int, now: float) -> None:
        """Note that the request `token` was sent at `now` [s]; if there are too many, forget the oldest."""
        self._asked[token] = now
        if len(self._asked) > MOST_ASKED:
            del self._asked[next(iter(self._asked))]

    def answered(self, token: int, now: float, theirs: float | None = None) -> float | None:
        """Return the round trip [s] of the answer to request `token` at `now` [s]; None for an unknown request.

        `theirs` is the other clock in the answer [s].
        """
        sent = self._asked.pop(token, None)
        if sent is None or now < sent:
            return None
        self.last = now - sent
        self.mean = self.last if self.count == 0 else self.mean + 0.1 * (self.last - self.mean)
        self.count += 1
        if self.last < self.least:
            self.least = self.last
            if theirs is not None:
                self.offset = theirs - (sent + now) / 2.0
        return self.last


class LinkStatistics:
    """All counts of received frames of one link."""

    def __init__(self) -> None:
        self.senders: dict[tuple[int, int], SenderCounts] = {}
        self.round_trips = RoundTrips()

    def __repr__(self) -> str:
        received = sum(one.received for one in self.senders.values())
        trip = f", round trip {1e3 * self.round_trips.last:.3g} ms" if self.round_trips.count else ""
        return f"<{received} frames of {len(self.senders)} senders, {100.0 * self.loss:.2g} % lost{trip}>"

    def count(self, frame: Frame) -> None:
        """Count an accepted frame, of the first MOST_SENDERS senders."""
        sender = self.senders.get((frame.system, frame.component))
        if sender is None and len(self.senders) < MOST_SENDERS:
            sender = self.senders[frame.system, frame.component] = SenderCounts()
        if sender is not None:
            sender.count(frame.sequence)

    @property
    def loss(self) -> float:
        """Fraction of all senders' frames that were lost, 0 to 1."""
        lost = sum(one.lost for one in self.senders.values())
        sent = lost + sum(one.received - one.duplicated for one in self.senders.values())
        return lost / sent if sent > 0 else 0.0


# A parser holds at most one frame.
MOST_PARSERS = 64
# Frames of one peer that were taken before their turn and have not come in it yet.
MOST_AGAIN = 64
# A frame that is not continued for this long is given up: 280 bytes take 49 ms at 57600 baud.
BROKEN_OFF_S = 0.1
# A stream is parsed in pieces, up to so many bytes before other tasks get a turn. A packet, a wrong checksum and an
# answer of ours count as bytes too. That takes half a millisecond to two, whatever comes.
PIECE, MOST_LOOKED_THROUGH = 512, 8192
A_PACKET, A_CHECKSUM, AN_ANSWER = 32, 16, 256
_TIMESYNC, _PING = 111, 4


class Received(NamedTuple):
    """A message, the frame it came in, and the peer that `Connection.send` takes as `to`."""

    message: Any
    frame: Frame
    peer: Hashable


class Connection:
    """Messages over `transport` as `system` and `component` (1 to 255 each).

    With `signing` all sent messages are signed, and received frames without a signature by its key are only counted.
    `clock` gives the time [s] for statistics and round trips. Closing the connection closes the transport.
    """

    def __init__(
        self,
        transport: Transport,
        system: int,
        component: int,
        signing: Signing | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.transport = transport
        self.system = system
        self.component = component
        self.signing = signing
        self._admission = Admission(signing)
        self.statistics = LinkStatistics()
        self._clock = clock
        self._parsers: OrderedDict[Hashable, Parser] = OrderedDict()
        self._counts = FramingCounts()  # of all parsers
        self._sequences: OrderedDict[Hashable, int] = OrderedDict()
        self._frames: deque[tuple[Frame, Hashable]] = deque()
        self._rest: Packet | None = None  # of a stream, not looked through yet
        self._again: dict[Hashable, list[bytes]] = {}  # taken before their turn, in which they come once more
        self._tired = False  # whether a look ended before all was looked through
        self._answers = 0
        transport.let_stops_go_first()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the transport and keep the time stamps of signing."""
        await self.transport.close()
        if self.signing is not None:
            self.signing.close()

    @property
    def framing(self) -> dict[str, int]:
        """Counts over all peers: frames, unknown, bad_checksum, mavlink1_refused, rubbish_bytes."""
        return asdict(self._counts)

    def send(self, sent: Any, to: Hashable | None = None) -> None:
        """Send a message to the peer `to`, or to all; each peer has its own sequence numbers, so it can count losses.

        Raises LinkError, with the name of the field, if a value does not fit its type, and LinkLost once the link is
        gone.
        """
        if self.transport.closed:
            raise LinkLost("the link is closed", self.transport.url, "open it again")
        for peer in self.transport.peers if to is None else (to,):
            sequence = self._sequences.get(peer, 0)
            signing = (self.signing.outgoing(),) if self.signing is not None else ()
            raw = encode(sent, self.system, self.component, sequence, *signing)
            self._sequences[peer] = (sequence + 1) & 0xFF
            self._sequences.move_to_end(peer)
            if len(self._sequences) > MOST_PARSERS:
                self._sequences.popitem(last=False)
            self.transport.send(raw, peer)

    async def receive(self, timeout: float) -> Received | None:
        """Return the next known message, None if none comes within `timeout` [s]; with 0 it does not wait.

        Raises LinkLost when the link is gone, after all messages that had arrived.
        """
        loop = asyncio.get_running_loop()
        end = loop.time() + timeout
        while True:
            found = self._next_frame()
            if found is not None:
                got = decode(found[0])
                if got is not None:
                    return Received(got, *found)
                if not self._frames:
                    await asyncio.sleep(0)
                continue
            left = end - loop.time()
            if left <= 0.0:
                return None
            if self._tired:
                await asyncio.sleep(0)
                continue
            begun = not self.transport.whole and any(parser.waiting for parser in self._parsers.values())
            packet = await self.transport.receive(min(left, BROKEN_OFF_S) if begun else left)
            if packet is not None:
                self._rest = packet
            elif begun:
                for peer in [*self._parsers]:
                    self._take(b"", peer, whole=True)

    def receive_now(self) -> Received | None:
        """Return the next message if it is found in bounded time, else None; `receive` may still find one then.

        Raises LinkLost when the link is gone, after all messages that had arrived.
        """
        left = MOST_LOOKED_THROUGH // A_PACKET
        while left > 0 and (found := self._next_frame()) is not None:
            got = decode(found[0])
            if got is not None:
                return Received(got, *found)
            left -= 1
        return None

    def ping(self, to: Hashable | None = None) -> None:
        """Send a TIMESYNC request. Its answer, once received, updates `statistics.round_trips`."""
        now = self._clock()
        token = int(now * 1e9)
        self.statistics.round_trips.asked(token, now)
        self.send(message("TIMESYNC", tc1=0, ts1=token), to)

    def _next_frame(self) -> tuple[Frame, Hashable] | None:
        """Return the next frame; None if there is none, or none was found before other tasks must get a turn."""
        looked, self._tired = 0, False
        while (packet := self.transport.receive_ahead()) is not None:
            self._take_ahead(packet)
        while not self._frames:
            if looked > MOST_LOOKED_THROUGH:
                self._tired = True
                return None
            packet = self._rest or self.transport.receive_now()
            if packet is None:
                return None
            self._rest = None
            if packet.ahead:
                self._take_ahead(packet)
                continue
            data, peer, _ = packet
            if len(data) > PIECE and not self.transport.whole:
                data, self._rest = data[:PIECE], Packet(data[PIECE:], peer)
            answers = self._answers
            bad = self._take(data, peer)
            looked += len(data) + A_PACKET + A_CHECKSUM * bad + AN_ANSWER * (self._answers - answers)
        return self._frames.popleft()

    def _take(self, data: bytes, peer: Hashable, whole: bool = False) -> int:
        """Cut data into frames and keep the accepted ones; return the number of wrong checksums."""
        whole = whole or self.transport.whole
        key: Hashable = None if self.transport.whole else peer  # datagrams leave nothing behind
        parser = self._parsers.get(key)
        if parser is None:
            parser = self._parsers[key] = Parser(self.signing is None, self._counts)
            if len(self._parsers) > MOST_PARSERS:
                self._parsers.popitem(last=False)
        else:
            self._parsers.move_to_end(key)
        bad, again = self._counts.bad_checksum, self._again.get(peer)
        for frame in parser.feed(data, whole):
            if again and frame.raw in again:
                again.remove(frame.raw)
            elif self._lets_in(frame, peer):
                self._frames.append((frame, peer))
        if again == []:
            del self._again[peer]
        return self._counts.bad_checksum - bad

    def _take_ahead(self, packet: Packet) -> None:
        """Take a kill or a disarm before everything that came earlier."""
        again = self._again.setdefault(packet.peer, [])
        again.append(packet.data)
        if len(again) > MOST_AGAIN:  # a stream that breaks off in them: they will not come
            del again[0]
        if len(self._again) > MOST_PARSERS:
            del self._again[next(iter(self._again))]
        for frame in Parser(mavlink1=self.signing is None).feed(packet.data, whole=True):
            if self._lets_in(frame, packet.peer):
                self._frames.appendleft((frame, packet.peer))

    def _lets_in(self, frame: Frame, peer: Hashable) -> bool:
        """Return True if a frame has the signature it needs, and is not a TIMESYNC or PING that is answered here."""
        if not self._admission.admits(frame, self._clock(), partial(self.ping, peer)):
            return False
        if frame.known:
            self.transport.confirm(peer)
        self.statistics.count(frame)
        return frame.message_id not in (_TIMESYNC, _PING) or not self._answer(frame, peer)

    def _answer(self, frame: Frame, peer: Hashable) -> bool:
        """Answer a TIMESYNC or PING, or take the answer to ours; return False for any other frame."""
        got = decode(frame)
        if got is None:
            return False
        now = self._clock()
        target = (getattr(got, "target_system", 0), getattr(got, "target_component", 0))
        there = {"target_system": frame.system, "target_component": frame.component}
        answer = None
        if frame.message_id == _TIMESYNC and target in ((0, 0), (self.system, 0), (self.system, self.component)):
            if got.tc1:
                return self.statistics.round_trips.answered(got.ts1, now, got.tc1 * 1e-9) is not None
            answer = message("TIMESYNC", tc1=max(1, int(now * 1e9)), ts1=got.ts1, **there)
        elif frame.message_id == _PING and target == (0, 0):
            answer = message("PING", time_usec=got.time_usec, seq=got.seq, **there)
        if answer is None:
            return False
        self._answers += 1
        with suppress(LinkError):  # who asks and goes gets no answer, nor does anybody once we have no stamps left
            self.send(answer, peer)
        return True
