"""Hostile MAVLink against the assembled flight controller and its companion: crash, leak, arm and change nothing.

A sound frame from a client that may command does what it says: it may arm. So there are two cases. In the first
somebody holds the lease, everything comes from others, and the safety switch is off. Then a sound frame may do no more
than a damaged one. In the second nobody holds the lease. Then the safety switch keeps the motors off, and the messages
that change parameters by design are left out.
"""

from __future__ import annotations

import asyncio
import gc
import random
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from tests.faults.hostile import COMMANDS, Hostile
from tests.faults.whole import GROUND, NONE, Seen, Whole, run
from twodof.companion.companion import Companion
from twodof.companion.links import Serve
from twodof.excitation import Doublet
from twodof.fcu.mavlink.ftp import MOST_CLIENTS, MOST_SESSIONS
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import encode
from twodof.link.mavlink.messages import message
from twodof.link.transport import open_transport

pytestmark = pytest.mark.slow

Campaign = Callable[[int, int, Path], None]
PILOT = (250, GROUND)
PITCH = 0.125  # through a quaternion of float32
BURST = 64  # frames in a control period: 16000 a second
CHANGES_PARAMETERS = ("PARAM_SET", "TWODOF_PARAM_TRANSACTION")
PREFLIGHT_STORAGE = 245  # which resets them
# After a warm-up; a queue that is full once, a dictionary that is resized. One object in fifteen frames is too many.
MOST_OBJECTS, FRAMES_PER_OBJECT = 2_000, 15
MOST_GROWN_BYTES = 12 << 20


@dataclass
class Held:
    """Resources that a process holds."""

    objects: int
    tasks: int
    threads: int
    files: int
    bytes: int

    @classmethod
    def now(cls) -> Held:
        """Now."""
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        tasks, files = len(asyncio.all_tasks()), len([*Path("/proc/self/fd").iterdir()])
        return cls(len(gc.get_objects()), tasks, threading.active_count(), files, pages * 4096)


@cache
def recorded() -> list[bytes]:
    """Return the frames of a client in a flight that uses every function."""
    sent: list[bytes] = []

    async def work() -> None:
        with TemporaryDirectory() as folder:
            await fly(Path(folder))

    async def fly(folder: Path) -> None:
        async with Whole(state=folder) as whole:
            link = await whole.open()
            deliver = link.inner.send
            link.inner.send = lambda data, to=None: (sent.append(data), deliver(data, to))[1]
            drone = await whole.client_over(link)
            await drone.parameters.all()
            await drone.parameters.update({"ATT_KP": 9.0, "RATE_KP": 0.08})
            await drone.parameters.undo()
            async with drone.batch(["estimate.theta", "estimate.q"]):
                await drone.arm()
                await drone.set_pitch(0.1, thrust=0.4)
                await drone.excite(Doublet(0.1, 0.2, unit="rad"))
                await drone.set_moment(0.01, thrust=0.4)
                await drone.level_hold()
            await drone.disarm()
            (log,) = await drone.logs.list()
            await drone.logs.download(log, folder / "log.ulg", 60.0)
            await drone.files.write("/controllers/attitude_control.json", b"{}" * 300)
            await drone.files.read("/controllers/attitude_control.json")
            await drone.reset(rings=True)
            await drone.kill()
            await drone.close()

    run(work())
    return sent


def strangers(chance: random.Random) -> tuple[int, int]:
    """Anybody but the pilot."""
    while True:
        source = chance.choice(
            [(1, 1), (1, 191), (251, 190), (245, 190), (chance.randrange(256), chance.randrange(256))]
        )
        if source != PILOT:
            return source


def anybody(chance: random.Random) -> tuple[int, int]:
    """Mostly clients that take part."""
    return chance.choice([PILOT, (245, 190), (1, 191), (chance.randrange(256), chance.randrange(256))])


def at_rest(seen: Seen) -> bool:
    """Return whether the drone is disarmed and its motors stand."""
    return not (seen.step.armed or seen.step.fore or seen.step.aft)


def undisturbed(seen: Seen) -> bool:
    """It flies what its pilot asked for."""
    step = seen.step
    return step.armed and step.action == NONE and abs(step.theta0 - PITCH) < 1e-6 and step.fore > 0.0


async def attack(
    whole: Whole, hostile: Hostile, url: str, count: int, fine: Callable[[Seen], bool] = at_rest
) -> tuple[Held, Held]:
    """Sends `count` frames; what is held after a fifth of them, and at the end. Asserts that each step is `fine`."""
    link = await open_transport(url)
    early = None
    for number in range(0, count, BURST):
        for _ in range(min(BURST, count - number)):
            link.send(hostile.next())
        await asyncio.sleep(0.004)
        assert all(fine(seen) for seen in whole.steps), number
        whole.steps.clear()
        while link.receive_now() is not None:
            pass
        if early is None and number >= count // 5:
            await whole.passes(1.0)
            early = Held.now()
    await whole.passes(1.0)
    whole.steps.clear()
    while link.receive_now() is not None:
        pass
    assert early is not None
    end = Held.now()
    await link.close()
    return early, end


def bounded(count: int, early: Held, end: Held) -> None:
    """Assert that `count` frames leave nothing behind."""
    assert end.objects - early.objects < min(MOST_OBJECTS, count // FRAMES_PER_OBJECT), (early, end)
    assert end.tasks == early.tasks
    assert end.threads <= early.threads + 2  # one may have waited for its first work
    # An on-board log, an upload, and what readers of files hold open at most.
    assert end.files <= early.files + 2 + MOST_CLIENTS * MOST_SESSIONS
    assert end.bytes - early.bytes < MOST_GROWN_BYTES, (early, end)


def under_a_pilot(count: int, seed: int, folder: Path) -> None:
    """Whatever others send, behind the companion, while somebody holds the lease."""
    sound = recorded()

    async def work() -> None:
        async with Whole(state=folder) as whole:
            pilot = await whole.client()
            await pilot.withhold_tuning()
            before, revision = dict(whole.drone.assembly.store), whole.drone.assembly.store.revision
            hostile = Hostile(seed, sound, strangers)
            bounded(count, *await attack(whole, hostile, whole.clients, count))
            store = whole.drone.assembly.store
            assert (dict(store), store.revision) == (before, revision)
            assert whole.drone.commander.lease.holder == PILOT
            assert whole.companion.line.sent_bytes > 10 * count  # the companion passed them on
            assert whole.drone.assembly.px4.vehicle.refused > count // 100
            await pilot.release()  # a kill needs no lease, and holds until it is released
            await pilot.arm()  # it could have been
            assert whole.steps[-1].step.armed
            await pilot.parameters.set("ATT_KP", 9.0)
            await pilot.close()

    run(work())


def in_flight(count: int, seed: int, folder: Path) -> None:
    """Others send while the pilot flies; no commands, since a disarming or a kill is obeyed for everybody."""
    sound = recorded()

    async def work() -> None:
        async with Whole(state=folder) as whole:
            pilot = await whole.airborne(PITCH)
            await pilot.withhold_tuning()
            store, revision = whole.drone.assembly.store, whole.drone.assembly.store.revision
            whole.steps.clear()
            avoid = frozenset(dialect.message_id(name) for name in ("COMMAND_LONG", "COMMAND_INT"))
            hostile = Hostile(seed, sound, strangers, avoid)
            bounded(count, *await attack(whole, hostile, whole.clients, count, undisturbed))
            assert store.revision == revision
            await pilot.close()

    run(work())


def with_nobody(count: int, seed: int, folder: Path) -> None:
    """Whatever anybody sends, on the flight controller's own link, while nobody holds the lease."""
    sound = recorded()

    async def work() -> None:
        async with Whole(state=folder, safety_off=False) as whole:
            store = whole.drone.assembly.store
            before, revision = dict(store), store.revision
            avoid = frozenset(dialect.message_id(name) for name in CHANGES_PARAMETERS)
            commands = tuple(number for number in COMMANDS if number != PREFLIGHT_STORAGE)
            hostile = Hostile(seed, sound, anybody, avoid, commands)
            bounded(count, *await attack(whole, hostile, whole.fcu, count))
            assert (dict(store), store.revision) == (before, revision)
            await whole.passes(3.0)
            client = await whole.client()
            assert await client.parameters.read("ATT_KP") == before["ATT_KP"]
            await client.close()

    run(work())


def from_the_vehicle(count: int, seed: int, folder: Path) -> None:
    """Whatever comes down the line in the vehicle's name or another's: the companion goes on, its clients with it."""
    sound, place = recorded(), f"vehicle-{seed}"

    async def work() -> None:
        async with Companion(f"mem://{place}", [Serve(f"memin://ground-{place}")]):
            vehicle = await open_transport(f"memin://{place}")
            client = await open_transport(f"mem://ground-{place}")
            hostile = Hostile(seed, sound, vehicles)
            early = None
            for number in range(0, count, BURST):
                for _ in range(BURST):
                    vehicle.send(hostile.next())
                client.send(encode(message("HEARTBEAT", type=6, autopilot=8), 250, GROUND, number & 0xFF))
                await asyncio.sleep(0.004)
                for end in (client, vehicle):
                    while end.receive_now() is not None:
                        pass
                if early is None and number >= count // 5:
                    early = Held.now()
            assert early is not None
            bounded(count, early, Held.now())
            passed = client.counts.packets_in
            assert passed > count // 10
            vehicle.send(encode(message("STATUSTEXT", severity=6, text="still there"), 1, 1, 0))
            await asyncio.sleep(0.1)
            assert client.counts.packets_in > passed
            await client.close()
            await vehicle.close()

    run(work())


def vehicles(chance: random.Random) -> tuple[int, int]:
    """Mostly the vehicle."""
    return chance.choice([(1, 1), (1, 1), (1, 191), (250, 190), (chance.randrange(256), chance.randrange(256))])


@pytest.mark.long
@pytest.mark.parametrize("campaign", [under_a_pilot, in_flight, with_nobody, from_the_vehicle])
def test_hostile_frames_crash_leak_arm_and_change_nothing(campaign: Campaign, tmp_path: Path) -> None:
    campaign(3_000, 1, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize("campaign", [under_a_pilot, in_flight, with_nobody, from_the_vehicle])
def test_hostile_frames_for_long(campaign: Campaign, tmp_path: Path) -> None:
    for seed in range(10):
        folder = tmp_path / str(seed)
        folder.mkdir()
        campaign(250_000, 100 + seed, folder)
