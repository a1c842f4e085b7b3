"""Stuck peers: silent, dying at every message, talking rubbish, answering wrongly. Each call ends in time, rightly."""

import asyncio
import inspect
import random
import socket
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from twodof.errors import LinkError, LinkLost, LogError, ParameterError, Rejected, Timeout
from twodof.excitation import Doublet
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone import Drone
from twodof.gcs.files import AsyncFiles, AsyncLogs, LogEntry
from twodof.gcs.parameters import AsyncParameters
from twodof.gcs.telemetry import AsyncSignal

pytestmark = pytest.mark.slow

CALL_S = 6.0
# A call may notice at its next look, which is at most a second later; words for a refusal take .3 s.
LATE_S = 1.5
# Two subscriptions of 5 s each, and three seconds for the end of each: the last rows come then.
RECORD_S = 16.0
# It waits .6 s of the drone's time: 2 s of ours without any of it, where it is granted and where it passes by itself;
# and 2 s more where a grant was answered before: the patience of a call begins anew with every slice of its time.
WAIT_S = 4.2
EXCITATION = Doublet(0.1, 0.2, unit="rad")
ENTRY = LogEntry(0, 1280, 0)
PARTS = {
    "": AsyncDrone,
    "parameters.": AsyncParameters,
    "logs.": AsyncLogs,
    "files.": AsyncFiles,
    "telemetry.": AsyncSignal,
}
# Every public call that waits for the drone; `over` is `connect` on a link that is open.
PUBLIC = {
    part + name
    for part, kind in PARTS.items()
    for name, _ in inspect.getmembers(kind, inspect.iscoroutinefunction)
    if not name.startswith("_") and name != "over"
} | {"batch", "record", "truth"}
Spoil = Callable[[int, Any], list[Any] | None]


def calls(drone: AsyncDrone, folder: Path) -> dict[str, Callable[[], Awaitable[Any]]]:
    """Every call that waits for the drone, with a deadline of CALL_S at most."""

    async def batch() -> None:
        async with drone.batch(["estimate.q"]):
            pass

    async def truth() -> None:
        async with drone.truth():
            pass

    async def record() -> None:
        async with drone.record(folder / f"{len(list(folder.iterdir()))}.mcap"):
            pass

    here = drone.tick
    made = {
        "parameters.read": lambda: drone.parameters.read("ATT_KP", CALL_S),
        "parameters.all": lambda: drone.parameters.all(CALL_S),
        "parameters.describe": lambda: drone.parameters.describe(CALL_S),
        "parameters.update": lambda: drone.parameters.update({"ATT_KP": 6.0, "RATE_KP": 0.05}, CALL_S),
        "parameters.set": lambda: drone.parameters.set("ATT_KP", 7.0, CALL_S),
        "parameters.undo": lambda: drone.parameters.undo(CALL_S),
        "files.write": lambda: drone.files.write("/controllers/x.json", b"{}" * 200, CALL_S),
        "files.read": lambda: drone.files.read("/controllers/x.json", CALL_S),
        "files.list": lambda: drone.files.list("/controllers", CALL_S),
        "version": lambda: drone.version(CALL_S),
        "stop_excitation": lambda: drone.stop_excitation(CALL_S),
        "files.remove": lambda: drone.files.remove("/controllers/x.json", CALL_S),
        "fly_controller": lambda: drone.fly_controller("attitude_control", b"{}", CALL_S),
        "arm": lambda: drone.arm(CALL_S),
        "level_hold": lambda: drone.level_hold(CALL_S),
        "set_pitch": lambda: drone.set_pitch(0.1, timeout=CALL_S),
        "set_mode": lambda: drone.set_mode("attitude", CALL_S),
        "set_pitch_rate": lambda: drone.set_pitch_rate(0.1, timeout=CALL_S),
        "set_velocity": lambda: drone.set_velocity(0.1, timeout=CALL_S),
        "set_position": lambda: drone.set_position(0.1, timeout=CALL_S),
        "set_moment": lambda: drone.set_moment(0.1, timeout=CALL_S),
        "excite": lambda: drone.excite(EXCITATION, timeout=CALL_S, wait=False),
        "run": lambda: drone.run(0.1),
        "run_until": lambda: drone.run_until(drone.tick + 25),
        "telemetry.next": lambda: drone.telemetry("theta").next(timeout=CALL_S),
        "wait_until": lambda: drone.wait_until(lambda: drone.tick > here + 125, timeout=0.6),
        "batch": batch,
        "truth": truth,
        "active_controller": lambda: drone.active_controller(CALL_S),
        "record": record,
        "command": lambda: drone.command("REQUEST_AUTOPILOT_CAPABILITIES", 1.0, timeout=CALL_S),
        "withhold_tuning": lambda: drone.withhold_tuning(False, CALL_S),
        "stream": lambda: drone.stream("ATTITUDE", 50.0, CALL_S),
        "logs.list": lambda: drone.logs.list(CALL_S),
        "logs.download": lambda: drone.logs.download(ENTRY, folder / "log.ulg", CALL_S),
        "reset": lambda: drone.reset(timeout=CALL_S),
        "disarm": lambda: drone.disarm(CALL_S),
        "kill": lambda: drone.kill(CALL_S),
        "release": lambda: drone.release(CALL_S),
    }
    if drone.session.lockstep:
        del made["telemetry.next"]  # nothing comes while time stands still
    return made


class Conversation:
    """Connects to a spoilt peer and makes every call: what each ended in, and how long it took."""

    def __init__(self, folder: Path, spoil: Spoil | None = None, lockstep: bool = False) -> None:
        self.folder = folder
        self.peer = Peer(lockstep=lockstep, spoil=spoil)
        self.ended: dict[str, BaseException | None] = {}
        self.took: dict[str, float] = {}
        run_virtual(self._talk())

    async def _talk(self) -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: None)  # messages that are refused are counted, not printed
        async with self.peer:
            connected: list[AsyncDrone] = []

            async def connect() -> None:
                connected.append(await AsyncDrone.connect(self.peer.url, timeout=CALL_S))

            await self._end("connect", connect)
            if connected:
                for name, call in calls(connected[0], self.folder).items():
                    await self._end(name, call)
                await self._end("close", connected[0].close)
        left = asyncio.all_tasks() - {asyncio.current_task()}
        assert left == set(), "something was left running"

    async def _end(self, name: str, call: Callable[[], Awaitable[Any]]) -> None:
        loop = asyncio.get_running_loop()
        start = loop.time()
        try:
            await call()
            self.ended[name] = None
        except (LinkError, LogError, ParameterError, Rejected, Timeout) as error:
            self.ended[name] = error
        self.took[name] = loop.time() - start

    def check(self) -> None:
        """Every call ended in time."""
        longest = {"record": RECORD_S, "wait_until": WAIT_S}
        late = {name: took for name, took in self.took.items() if took > longest.get(name, CALL_S) + LATE_S}
        assert late == {}

    @property
    def failed(self) -> dict[str, BaseException]:
        """Calls that ended in an error."""
        return {name: error for name, error in self.ended.items() if error is not None}


@pytest.mark.parametrize("lockstep", [False, True])
def test_with_a_sound_peer_every_call_succeeds(tmp_path: Path, lockstep: bool) -> None:
    talk = Conversation(tmp_path, lockstep=lockstep)
    assert talk.failed == {}
    assert (tmp_path / "log.ulg").read_bytes() == talk.peer.log
    assert talk.peer.files.keys() == {"/controllers/attitude_control.json", "/etc/extras/parameters.json"}
    assert set(talk.ended) == PUBLIC - ({"telemetry.next"} if lockstep else set())


def test_one_that_says_nothing_is_no_drone(tmp_path: Path) -> None:
    talk = Conversation(tmp_path, spoil=lambda *_: [])
    talk.check()
    assert isinstance(talk.ended["connect"], LinkLost)
    assert talk.took["connect"] == pytest.approx(CALL_S, abs=0.1)


EACH = pytest.mark.parametrize(
    ("lockstep", "stride"),
    [
        (False, 47),
        (True, 11),
        pytest.param(False, 7, marks=pytest.mark.soak),
        pytest.param(True, 1, marks=pytest.mark.soak),
    ],
)
"""Of the messages after the first ones, of which most are telemetry in real time, every so many; in the soak each call
meets several."""


@EACH
def test_one_that_dies_at_any_message(tmp_path: Path, lockstep: bool, stride: int) -> None:
    """The link ends instead of message i: the call that waits, and each one after it, ends in LinkLost at once."""
    total = Conversation(tmp_path, lockstep=lockstep).peer.sent
    for last in [*range(0, 40, 1 + stride // 5), *range(40, total, stride)]:
        folder = tmp_path / str(last)
        folder.mkdir()
        talk = Conversation(folder, lambda count, sent, last=last: [sent] if count < last else None, lockstep)
        talk.check()
        names = list(talk.failed)
        # The last ones are about the end of the lease, which ends by itself too.
        assert names or last >= total - 2, last
        assert all(type(error) is LinkLost for error in talk.failed.values()), (last, talk.failed)
        late = {name: talk.took[name] for name in names if talk.took[name] > 0.0}
        assert sum(late.values()) < LATE_S, (last, late)
        first = list(talk.ended).index(names[0]) if names else 0
        assert names == list(talk.ended)[first : first + len(names)], last


@EACH
def test_one_that_falls_silent_at_any_message(tmp_path: Path, lockstep: bool, stride: int) -> None:
    """The link stays, nothing more comes: LinkLost 3 s later, or where time stands still at the call's own deadline."""
    total = Conversation(tmp_path, lockstep=lockstep).peer.sent
    for last in range(0, total, 2 * stride + 1):
        folder = tmp_path / str(last)
        folder.mkdir()
        talk = Conversation(folder, lambda count, sent, last=last: [sent] if count < last else [], lockstep)
        talk.check()
        talk.failed.pop("parameters.undo", None)  # Rejected: no change came through that could be undone
        assert all(isinstance(error, LinkLost | Timeout) for error in talk.failed.values()), (last, talk.failed)
        assert "connect" in talk.failed or "close" in talk.ended


def test_one_that_talks_rubbish_is_no_drone(tmp_path: Path) -> None:
    chance = random.Random(1)
    talk = Conversation(tmp_path, spoil=lambda *_: [chance.randbytes(60)])
    talk.check()
    assert isinstance(talk.ended["connect"], LinkLost)


def spoilt(sent: Any, chance: random.Random) -> Any:
    """The message with one field after another set to what is wrong, now and then."""
    for name, kind, length in zip(sent.fieldnames, sent.fieldtypes, _lengths(sent), strict=True):
        if chance.random() > 0.3 or kind == "char":
            continue
        bits = {"8": 8, "1": 16, "3": 32, "6": 64}.get(kind.strip("uint_")[:1], 0)
        if kind in ("float", "double"):
            values: list[Any] = [0.0, -1.0, 1e30, float("nan"), float("inf")]
        elif kind.startswith("uint"):
            values = [0, 1, (1 << bits) - 1]
        else:
            values = [-(1 << bits - 1), -1, 0, (1 << bits - 1) - 1]
        value = chance.choice(values)
        setattr(sent, name, [value] * length if length else value)
    return sent


def _lengths(sent: Any) -> list[int]:
    lengths = dict(zip(sent.ordered_fieldnames, sent.array_lengths, strict=True))
    return [0 if kind == "char" else lengths[name] for name, kind in zip(sent.fieldnames, sent.fieldtypes, strict=True)]


@pytest.mark.soak
@pytest.mark.parametrize("lockstep", [False, True])
def test_one_that_answers_wrongly_for_long(tmp_path: Path, lockstep: bool) -> None:
    for seed in range(1000, 2000):
        folder = tmp_path / str(seed)
        folder.mkdir()
        test_one_that_answers_wrongly(folder, lockstep, seed)


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("seed", [1])
def test_one_that_answers_wrongly(tmp_path: Path, lockstep: bool, seed: int) -> None:
    """Any field of any message after the first heartbeat may hold anything: every call still ends, in time."""
    chance = random.Random(seed)
    talk = Conversation(tmp_path, lambda count, sent: [spoilt(sent, chance) if count else sent], lockstep)
    talk.check()


@pytest.mark.parametrize("lockstep", [False, True])
def test_calls_end_though_time_stands_still(lockstep: bool) -> None:
    """One that refuses every mode is asked again .1 s later, of its own time: which never comes."""
    stuck = False

    def spoil(_: int, sent: Any) -> list[Any]:
        if stuck and sent.get_type() == "COMMAND_ACK":
            sent.result = 1
        return [sent] if not stuck or sent.get_type() in ("COMMAND_ACK", "HEARTBEAT") else []

    async def call() -> float:
        nonlocal stuck
        async with Peer(lockstep=lockstep, spoil=spoil) as peer, await AsyncDrone.connect(peer.url, CALL_S) as drone:
            stuck, start = True, asyncio.get_running_loop().time()
            with pytest.raises((Rejected, Timeout)):
                await drone.set_velocity(0.1, timeout=2.0)
            took, stuck = asyncio.get_running_loop().time() - start, False
            return took

    assert run_virtual(call()) == pytest.approx(2.0, abs=LATE_S)


def test_an_excitation_is_stopped_in_time_though_time_stands_still() -> None:
    stuck = False

    def spoil(_: int, sent: Any) -> list[Any]:
        kind = sent.get_type()
        over = kind == "TWODOF_EXCITE_STATUS" and sent.state == 4  # this peer's end at once
        return [] if over or (stuck and kind not in ("COMMAND_ACK", "HEARTBEAT")) else [sent]

    async def call() -> float:
        nonlocal stuck
        async with Peer(lockstep=True, spoil=spoil) as peer, await AsyncDrone.connect(peer.url, CALL_S) as drone:
            await drone.arm()
            await drone.excite(EXCITATION, thrust=0.4, wait=False)
            stuck, start = True, asyncio.get_running_loop().time()
            with pytest.raises(Timeout):
                await drone.stop_excitation(2.0)
            took, stuck = asyncio.get_running_loop().time() - start, False
            return took

    assert run_virtual(call()) == pytest.approx(2.0, abs=LATE_S)


def test_an_excitation_that_plays_unconfirmed_is_told() -> None:
    silent = False

    def spoil(_: int, sent: Any) -> list[Any]:
        kind = sent.get_type()
        return [] if kind == "TWODOF_EXCITE_STATUS" and sent.state != 2 and (silent or sent.state == 4) else [sent]

    async def call() -> str:
        nonlocal silent
        async with Peer(spoil=spoil) as peer, await AsyncDrone.connect(peer.url, CALL_S) as drone:
            await drone.arm()
            silent = True
            with pytest.raises(Timeout, match="sending an excitation"):
                await drone.excite(EXCITATION, thrust=0.4, wait=False, timeout=2.0)
            assert drone.exciter.playback is None
            silent = False
            peer.send("TWODOF_EXCITE_STATUS", state=3, transfer=1, tick=peer.tick, start_tick=peer.tick, received=1)
            await asyncio.sleep(0.1)
            return drone.exciter.playback.state if drone.exciter.playback else ""

    assert run_virtual(call()) == "playing"


def test_a_server_that_accepts_and_says_nothing_holds_nobody_up() -> None:
    """The synchronous face, over TCP and in real time."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        before = set(threading.enumerate())
        # Which of the two it was that the time did not suffice for depends on how fast this machine connects.
        with pytest.raises(LinkLost, match=r"no drone was heard within|no answer within 0\.3 s"):
            Drone.connect(f"tcp://127.0.0.1:{server.getsockname()[1]}", timeout=0.3)
        assert set(threading.enumerate()) <= before
