"""Where a key is set, a frame without its signature changes only the counters of what was refused."""

import asyncio
import itertools
import random
from collections import deque
from collections.abc import Hashable, Iterator, Mapping, Sequence, Set
from contextlib import ExitStack, contextmanager
from enum import Enum
from types import SimpleNamespace
from unittest.mock import patch

import pytest

from tests.faults.virtual_time import on_virtual_time
from tests.faults.whole import GROUND, Seen, Whole, run, tell
from tests.link.mavlink.test_framing import random_message
from twodof.companion.component import ComputerStatus
from twodof.errors import LinkLost
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.connection import Connection
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, SigningVerdict, Stamps
from twodof.link.transport import open_transport
from twodof.link.transport.base import Packet, Transport

pytestmark = pytest.mark.slow

KEY, OTHER_KEY = Key(bytes(range(32))), Key(bytes(32))
PILOT, DRONE, COMPANION = (250, GROUND), (1, 1), (1, 191)
EVERY_S, FORGED_S = 0.25, 8.0
BURST, TURNS = 40, 30
# The lease and the link end 3 s after the pilot's last word, and the drone descends for 1 s at most.
OFF_MS = 4100.0


def signing(link: int = 0, key: Key = KEY) -> Signing:
    """On the clock of the loop, so that two runs are the same."""
    loop = asyncio.get_running_loop()
    return Signing(key, Stamps(None, lambda: 10**13 + round(loop.time() * 1e5)), link)


async def fly(whole: Whole) -> AsyncDrone:
    """A pilot in the air, in a level hold, which asks for nothing more of it."""
    link = await whole.open()
    with patch("twodof.gcs.async_drone.identity", lambda *_: (PILOT[0], signing(1))):
        drone = await whole.client_over(link, key=KEY)
    await drone.run(0.5)
    await drone.arm(timeout=30.0)
    await drone.level_hold(timeout=30.0)
    await drone.run(1.0)
    assert whole.steps[-1].step.armed
    return drone


def off(seen: Seen) -> bool:
    """Return whether the drone is disarmed."""
    return not seen.step.armed


@pytest.mark.long
@pytest.mark.parametrize("through", ["fcu", "clients"])
@on_virtual_time
async def test_an_unsigned_frame_does_not_stand_in_for_a_pilot_that_died(through: str) -> None:
    async with Whole(signing=signing()) as whole:
        drone = await fly(whole)
        (link,) = (one for one in whole.faulty if not one.closed)
        intruder = await open_transport(getattr(whole, through))
        link.cut()
        died = whole.tick
        for number in range(round(FORGED_S / EVERY_S)):
            intruder.send(encode(message("RADIO_STATUS", rssi=9), *PILOT, number))
            await whole.passes(EVERY_S)
        tell("the pilot died, RADIO_STATUS in its name goes on", "motors off", whole.ms(died, off), OFF_MS)
        assert drone.session.system


@on_virtual_time
async def test_an_unsigned_frame_does_not_keep_the_telemetry_of_a_drone_alive_that_is_silent() -> None:
    async with Whole(signing=signing()) as whole:
        drone = await fly(whole)
        (link,) = (one for one in whole.faulty if not one.closed)
        link.cut()
        for number in range(20):
            link._inbox.put(Packet(encode(message("RADIO_STATUS", rssi=9), *DRONE, number), link.inner.peers[0]))
            await whole.passes(EVERY_S)
        with pytest.raises(LinkLost, match=r"nothing was heard of drone 1 for 3 s"):
            await drone.telemetry("theta").next(timeout=2.0)
        with pytest.raises(LinkLost):
            assert not drone.theta


# What is no state: counters of what was refused, when bytes came last, names that are numbered, and Python's tools.
LEFT_OUT = frozenset(
    {"packets_in", "bytes_in", "bad_checksum", "frames", "mavlink1_refused", "rubbish_bytes"}
    | {"unknown", "timing", "_clock", "_loop", "_fullest", "_waiter", "_parsers", "_finished", "_busy"}
    | {"_traffic", "_bytes", "url", "name", "_number", "_fed", "parsers"}
)
OURS = ("twodof.link", "twodof.fcu", "twodof.companion", "twodof.gcs")
PLAIN = (int, float, str, bytes, bool, Enum, type(None))


def state(found: object, seen: dict[int, object], path: str = "") -> Iterator[tuple[str, object]]:
    """Every number and text that can be reached from an object of ours, with the path to it."""
    if isinstance(found, PLAIN):
        yield path, repr(found)
        return
    if id(found) in seen:
        return
    seen[id(found)] = found
    if isinstance(found, Mapping):
        yield f"{path}#", len(found)
        for place, (key, value) in enumerate(found.items()):
            if key in (SigningVerdict.UNSIGNED, SigningVerdict.FORGED):
                continue
            plain = isinstance(key, PLAIN) or (isinstance(key, tuple) and all(isinstance(one, PLAIN) for one in key))
            name = repr(key) if plain else str(place)
            yield from state(value, seen, f"{path}[{name}]")
    elif isinstance(found, Sequence | deque | Set):
        yield f"{path}#", len(found)
        for place, value in enumerate(found):
            yield from state(value, seen, f"{path}[{place}]")
    elif type(found).__module__.startswith(OURS):
        names = [
            *getattr(found, "__dict__", ()),
            *itertools.chain(*(getattr(one, "__slots__", ()) for one in type(found).__mro__)),
        ]
        for name in names:
            if name not in LEFT_OUT:
                yield from state(getattr(found, name, None), seen, f"{path}.{name}")


def frames_of_every_kind() -> list[bytes]:
    """Each message of the dialect in the names of those who are believed: unsigned, MAVLink 1, with another key."""
    chance, made = random.Random(1), []
    other = Signing(OTHER_KEY, Stamps(None, lambda: 10**13))
    for name in dialect.classes():
        for source in (PILOT, DRONE, COMPANION):
            sent = random_message(name, chance)
            for field in ("target_system", "target_component"):
                if hasattr(sent, field):
                    setattr(sent, field, 1)
            made.append(encode(sent, *source, chance.randrange(256)))
            made.append(encode(sent, *source, chance.randrange(256), other.outgoing()))
            if sent.id < 256:
                made.append(bytes(sent.pack(dialect.load().MAVLink(None, *source), force_mavlink1=True)))
    return made


async def flown(hostile: list[bytes]) -> tuple[list[object], dict[str, object]]:
    """A flight in which these come from everywhere: its steps, and everything that is known of it."""
    with patch("tests.faults.whole._numbers", itertools.count()):
        whole = Whole(signing=signing(), companion_signing=signing(191))
    async with whole:
        drone = await fly(whole)
        (own,) = (one for one in whole.faulty if not one.closed)
        at_fcu, at_companion = await open_transport(whole.fcu), await open_transport(whole.clients)
        await whole.passes(0.5)
        (fcu,) = (one.transport for one in whole.drone.server.connections)
        (port,) = (one.transport for one in whole.companion.ports)
        line = whole.companion.line.transport
        assert line is not None
        points: list[tuple[Transport, Hashable]] = [(fcu, at_fcu), (fcu, line), (port, at_companion), (port, own.inner)]
        points += [(line, fcu), (own, own.inner.peers[0])]
        for turn in range(TURNS):
            for raw in hostile[turn * BURST : (turn + 1) * BURST]:
                for transport, peer in points:
                    transport._inbox.put(Packet(raw, peer))
            await whole.passes(0.012)
        await whole.passes(0.002)  # between two control periods
        seen: dict[int, object] = {}
        for one in (at_fcu, at_companion):
            while one.receive_now() is not None:
                pass
        parts = {"fcu": whole.drone.assembly, "companion": whole.companion, "client": drone}
        known = dict(itertools.chain(*(state(part, seen, name) for name, part in parts.items())))
        await drone.close()
        return [(one.step, one.theta, one.x) for one in whole.steps], known


@contextmanager
def the_same_each_time() -> Iterator[None]:
    """Fix all values that come from clocks, the processor and chance."""
    virtual = None, lambda: asyncio.get_running_loop().time()
    with ExitStack() as stack:
        stack.enter_context(patch.object(Connection.__init__, "__defaults__", virtual))
        stack.enter_context(patch("secrets.randbelow", lambda _: 7))
        stack.enter_context(patch("time.time", lambda: 1.7e9))
        # By it the server lets others have a turn: where, depends on how fast the computer is.
        stack.enter_context(patch("twodof.fcu.server.time", SimpleNamespace(monotonic=lambda: 0.0)))
        stack.enter_context(patch("time.thread_time_ns", lambda: 0))
        stack.enter_context(patch.object(ComputerStatus, "status", lambda _: message("ONBOARD_COMPUTER_STATUS")))
        yield


@pytest.mark.long
def test_nothing_unsigned_changes_anything_but_the_counters_of_what_was_refused() -> None:
    """Each from a stranger's address and the pilot's or drone's, to flight controller, companion, client."""
    hostile = frames_of_every_kind()
    with the_same_each_time():
        (steps, calm), (attacked_steps, attacked) = run(flown([])), run(flown(hostile))
    differ = {name for name in calm.keys() | attacked.keys() if calm.get(name) != attacked.get(name)}
    assert not differ, sorted(differ)
    assert steps == attacked_steps
    assert len(hostile) < BURST * TURNS
    assert len(calm) > 1500
