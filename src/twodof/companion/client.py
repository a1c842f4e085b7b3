"""A client of the companion: who is there, what it wants, what it was sent."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field

from twodof.companion.frame_fields import renumbered
from twodof.companion.streams.rate_profiles import OFF
from twodof.errors import LinkLost
from twodof.link.mavlink.dialect import FIRST_OWN_ID, LAST_OWN_ID
from twodof.link.mavlink.framing import Frame
from twodof.link.transport.base import Transport

Identity = tuple[int, int]  # a system and a component
# A ground station speaks for itself and perhaps a camera or two.
MOST_IDENTITIES = 16
MOST_WISHES = 256
# Senders whose frames to a client are numbered; one beyond takes the place of the one of longest ago.
MOST_SENDERS = 64
# As long as a client is silent before it counts as gone: a ground station sends a heartbeat each second.
SILENT_S = 30.0


def is_ours(message_id: int) -> bool:
    """Whether a message is one of twodof's own."""
    return FIRST_OWN_ID <= message_id <= LAST_OWN_ID


@dataclass(frozen=True, slots=True)
class Wish:
    """What a client asked of one message: its interval [us] (EVERY, OFF), and of a batch the mask of its channels."""

    interval: int
    mask: int = 0


@dataclass(eq=False)
class CompanionClient:
    """One peer of one transport. `defaults` is what it gets unasked (`rates.profile`), `heard` when it last spoke [s],
    `came` when it did first.

    `on_board`: it is a program of the drone's own. `stays`: it is sent to even if it never speaks, as PX4's links send
    to their default address.
    """

    name: str
    transport: Transport
    peer: Hashable
    defaults: Mapping[int, int]
    heard: float
    stays: bool = False
    came: float = 0.0
    on_board: bool = False
    identities: dict[Identity, float] = field(default_factory=dict)
    wishes: dict[int, Wish] = field(default_factory=dict)
    due_once: dict[int, int] = field(default_factory=dict)  # message -> how many it has asked for by 512
    knows_ours: bool = False  # twodof's own messages; to others they would be losses
    _sequences: dict[Identity, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<client {self.name}>"

    def known_as(self, identity: Identity, now: float) -> None:
        """It spoke as `identity`, which is remembered unless it has too many."""
        self.heard = now
        if identity in self.identities or len(self.identities) < MOST_IDENTITIES:
            self.identities[identity] = now

    def forget(self) -> None:
        """It has been silent for so long that the next one to speak there is somebody else."""
        self.identities.clear()
        self.wishes.clear()
        self.due_once.clear()
        self.knows_ours = False

    def follow(self, before: "CompanionClient") -> None:
        """It is `before`, which speaks from another address now: it goes on getting what it had asked for."""
        self.wishes = before.wishes | self.wishes
        self.due_once = before.due_once | self.due_once
        self.knows_ours |= before.knows_ours

    def wish(self, message_id: int) -> int:
        """The interval [us] at which it wants a message that it may have asked for, else its default, else OFF."""
        asked = self.wishes.get(message_id)
        if asked is not None:
            return asked.interval
        return self.defaults.get(message_id, OFF) if self.understands(message_id) else OFF

    def understands(self, message_id: int) -> bool:
        """Whether it may know the message: one of twodof's own only if it has shown that it knows any."""
        return self.knows_ours or not is_ours(message_id)

    def deliver(self, frame: Frame, lost: int = 0) -> None:
        """Send it a frame, numbered so that it counts as lost only what was: `lost` of its sender on the way to us."""
        self.write(renumbered(frame, self.number((frame.system, frame.component), lost)))

    def number(self, identity: Identity, lost: int = 0) -> int:
        """The sequence number of the next frame to it in the name of `identity`."""
        number = self._sequences.pop(identity, 0)
        self._sequences[identity] = number + 1
        if len(self._sequences) > MOST_SENDERS:
            del self._sequences[next(iter(self._sequences))]
        return (number + lost) & 0xFF

    def write(self, raw: bytes) -> None:
        """Hand bytes to its transport, which drops and counts them if the client does not read."""
        try:  # noqa: SIM105 (to enter `suppress` takes half a microsecond, for each frame and client)
            self.transport.send(raw, self.peer)
        except LinkLost:
            pass
