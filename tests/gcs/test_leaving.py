"""Leaving a drone, however: twice Ctrl-C, a callback that ends the program, a Drone that nobody has any more."""

import asyncio
import gc
import inspect
import os
import signal
import sys
import threading
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from tests.gcs.virtual import on_board
from tests.patience import PATIENCE_S
from twodof.errors import LinkLost, Rejected
from twodof.excitation import Doublet
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.drone import Drone
from twodof.gcs.loop_thread import LoopThread
from twodof.link.mavlink.messages import channel_mask

pytestmark = pytest.mark.slow


def ended(runner: LoopThread, work: Callable[[], Coroutine[Any, Any, Any]]) -> Any:
    """Return the result of `work` in the runner, or SystemExit, in a thread that is given up if it hangs."""
    found: list[Any] = []

    def do() -> None:
        try:
            found.append(runner.run(work()))
        except SystemExit as wish:
            found.append(wish)

    thread = threading.Thread(target=do, daemon=True)
    thread.start()
    thread.join(PATIENCE_S)
    assert found, "it hangs"
    return found[0]


async def one() -> int:
    return 1


def ends_s(finish: bool) -> float:
    """How long work takes that must finish though it is interrupted; work that must be broken off takes far longer."""
    return 0.05 if finish else PATIENCE_S


def test_a_callback_that_exits_is_reported() -> None:
    runner = LoopThread("test")
    reported: list[Any] = []
    try:
        loop = runner._loop
        loop.call_soon_threadsafe(loop.set_exception_handler, lambda _, context: reported.append(context["exception"]))
        loop.call_soon_threadsafe(sys.exit, 3)
        assert ended(runner, one) == 1
        assert [type(error) for error in reported] == [SystemExit]
    finally:
        runner.close()


def test_a_condition_that_ends_the_program_does() -> None:
    runner = LoopThread("test")

    async def work() -> None:
        sys.exit(3)

    try:
        runner._loop.call_soon_threadsafe(runner._loop.set_exception_handler, lambda *_: None)
        assert isinstance(ended(runner, work), SystemExit)
        assert ended(runner, one) == 1
    finally:
        runner.close()


@pytest.mark.parametrize("when", ["before it is handed over", "after", "meanwhile"])
@pytest.mark.parametrize("finish", [True, False])
def test_ctrl_c_cancels_work_unless_it_must_finish(when: str, finish: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaving must finish: a second Ctrl-C must not keep the drone armed."""
    runner, done = LoopThread("test"), []

    async def work() -> None:
        if when == "meanwhile":
            os.kill(os.getpid(), signal.SIGINT)
        await asyncio.sleep(ends_s(finish))
        done.append(True)

    hand_over = runner._loop.call_soon_threadsafe

    def interrupted(*what: Any) -> None:
        monkeypatch.undo()
        if when == "after":
            hand_over(*what)
        raise KeyboardInterrupt

    if when != "meanwhile":
        monkeypatch.setattr(runner._loop, "call_soon_threadsafe", interrupted)
    try:
        what = work()
        with pytest.raises(KeyboardInterrupt):
            runner.run(what, finish=finish)
        assert done == [True] * finish
        assert inspect.getcoroutinestate(what) == inspect.CORO_CLOSED
    finally:
        runner.close()


def test_cancelled_leaving_still_orders_to_disarm() -> None:
    """A task cancelled a second time has no time to see anything. Nothing is held afterwards: it is not a kill."""

    async def work() -> None:
        async with Peer() as peer:
            drone = await AsyncDrone.connect(peer.url)
            await drone.arm()
            peer.spoil = lambda _, sent: [] if sent.get_type() in ("COMMAND_ACK", "HEARTBEAT") else [sent]
            leaving = asyncio.get_running_loop().create_task(drone.close())
            await asyncio.sleep(0.01)
            leaving.cancel()
            await asyncio.wait([leaving])
            assert leaving.cancelled()
            await asyncio.sleep(0.01)
            orders = [got.param2 for got in peer.heard if got.get_type() == "COMMAND_LONG" and got.command == 400]
            assert orders == [0.0, 0.0, 0.0, 0.0, 0.0]
            assert not peer.armed
            assert not peer.killed

    run_virtual(work())


def test_a_drone_that_nobody_has_any_more_is_left() -> None:
    """As by a notebook's cell that is run again: it is disarmed, its lease is free, its thread ends."""
    with on_board(lockstep=True, conditions={"rings": True}) as there:
        before = set(threading.enumerate())
        drone = Drone.connect(there.url)
        (thread,) = set(threading.enumerate()) - before
        drone.run(0.5)
        drone.arm()
        del drone
        gc.collect()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
        assert not there.drone.commander.armed
        assert there.drone.commander.lease.holder is None


def test_a_lease_of_this_program_is_said_to_be_its_own() -> None:
    with (
        on_board(lockstep=True) as there,
        Drone.connect(there.url),
        pytest.raises(Rejected, match="this program has it"),
    ):
        Drone.connect(there.url)


class Forgetful(Peer):
    """The first time that it is told so it does not hear that the lease is given up."""

    def _twodof_lease(self, got: Any, frame: Any) -> None:
        if got.action != 2 or self.count("TWODOF_LEASE") > 2:
            super()._twodof_lease(got, frame)


def test_the_lease_is_given_up_over_lost_messages() -> None:
    """Else the next script would have to wait until it ends by itself."""

    async def work() -> None:
        async with Forgetful() as peer:
            async with await AsyncDrone.connect(peer.url) as drone:
                mine = drone.session.connection.system
                assert peer.holder == (mine, 190)
            told = [got.action for got in peer.heard if got.get_type() == "TWODOF_LEASE"]
            assert told == [1, 2, 2]
            assert peer.holder == (0, 0)

    run_virtual(work())


class Standing(Peer):
    """It stands disarmed. When it is killed a heartbeat of before is on its way, and comes first."""

    def _command_long(self, got: Any, frame: Any) -> None:
        if got.command == 400:
            self.heartbeat()
            asyncio.get_running_loop().call_later(0.2, super()._command_long, got, frame)
        else:
            super()._command_long(got, frame)


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_kill_of_a_disarmed_drone_is_seen(lockstep: bool) -> None:
    """In lockstep too, by one who may not let time pass; the first heartbeat that says it gets lost."""
    lost = False

    def spoil(_: int, sent: Any) -> list[Any]:
        nonlocal lost
        if sent.get_type() == "HEARTBEAT" and peer.killed and not lost:
            lost = True
            return []
        return [sent]

    async def work() -> None:
        async with peer, await AsyncDrone.connect(peer.url, take_lease=not lockstep) as drone:
            await drone.kill()
            assert peer.killed
            assert drone.state.killed

    peer = Standing(lockstep=lockstep, spoil=spoil)
    run_virtual(work())
    assert lost


class Slow(Peer):
    """Thinks for four seconds before it tells a parameter."""

    def _param_request_read(self, got: Any, frame: Any) -> None:
        asyncio.get_running_loop().call_later(4.0, super()._param_request_read, got, frame)


def test_deadlines_do_not_add_up() -> None:

    async def work() -> None:
        async with Slow() as peer:
            loop = asyncio.get_running_loop()
            peer.refuse[176] = (1, "not now")
            drone = await AsyncDrone.connect(peer.url)
            start = loop.time()
            with pytest.raises(Rejected, match="not now"):
                await drone.set_pitch(0.1, timeout=5.0)
            assert 4.0 < loop.time() - start < 5.5
            await drone.close()

    run_virtual(work())


def test_leaving_insists_over_a_lost_link() -> None:
    """The drone is not heard, and may hear: it is told to disarm for a while, and holds nothing afterwards."""

    async def work() -> None:
        async with Peer() as peer:
            drone = await AsyncDrone.connect(peer.url)
            await drone.arm()
            peer.spoil = lambda *_: []
            await asyncio.sleep(4.0)
            peer.armed, heard = True, len(peer.heard)
            with pytest.raises(LinkLost):
                await drone.close()
            told = [got.param2 for got in peer.heard[heard:] if got.get_type() == "COMMAND_LONG" and got.command == 400]
            assert len(told) > 20
            assert set(told) == {0.0}
            assert not peer.armed

    run_virtual(work())


def stop(peer: Peer) -> None:
    """A kill that comes from elsewhere."""
    peer.armed, peer.killed = False, True


def test_a_kill_holds_until_it_is_released() -> None:
    """A script that goes on after it is told so by each verb that would fly; the next one too, and may release it."""

    async def work() -> None:
        async with Peer() as peer:
            async with await AsyncDrone.connect(peer.url) as drone:
                await drone.arm()
                await drone.set_pitch(0.1)
                await drone.kill()
                assert drone.state.killed
                assert "killed" in str(drone.state)
                sent = drone.setpoints.sent
                for fly in (
                    lambda: drone.set_pitch(0.1),
                    lambda: drone.set_moment(0.1, thrust=0.4),
                    lambda: drone.set_velocity(0.1),
                    lambda: drone.excite(Doublet(0.1, 0.2, unit="rad")),
                ):
                    with pytest.raises(Rejected, match=r"the drone was killed .*release\(\)"):
                        await fly()
                assert drone.setpoints.sent == sent
            assert peer.killed
            peer.killed = False
            async with await AsyncDrone.connect(peer.url) as drone:
                await drone.arm()
                await drone.set_pitch(0.1)
                asyncio.get_running_loop().call_later(1.0, stop, peer)  # somebody else does
                start = asyncio.get_running_loop().time()
                with pytest.raises(Rejected, match="the drone was killed"):
                    await drone.run(10.0)
                assert asyncio.get_running_loop().time() - start < 2.5
                sent = drone.setpoints.sent
                await drone.run(1.0)  # time passes all the same
                assert drone.setpoints.sent == sent
            async with await AsyncDrone.connect(peer.url) as drone:
                assert drone.state.killed
                await drone.release()
                assert not drone.state.killed
                await drone.arm()

    run_virtual(work())


@pytest.mark.parametrize("turns", range(12))
def test_a_subscription_that_is_cancelled_half_way_leaves_nothing_behind(turns: int) -> None:
    """Wherever it is cancelled: nobody takes samples any more, and the drone is told that they are not wanted."""
    taken: list[Any] = []

    async def work() -> None:
        async with Peer() as peer, await AsyncDrone.connect(peer.url) as drone:

            async def look() -> None:
                async with drone.batches.to(taken.append, channel_mask(["estimate.q"])):
                    await asyncio.sleep(10.0)

            looking = asyncio.get_running_loop().create_task(look())
            for _ in range(turns):
                await asyncio.sleep(0)
            looking.cancel()
            await asyncio.wait([looking])
            before = len(taken)
            peer.send("TWODOF_BATCH", channels=1, tick=1, values=[0.0] * 60, rows=1, every=1)
            await asyncio.sleep(0.1)
            assert len(taken) == before
            asked = [got.param2 for got in peer.heard if got.get_type() == "COMMAND_LONG" and got.command == 511]
            assert asked == [] or asked[-1] == -1

    run_virtual(work())
