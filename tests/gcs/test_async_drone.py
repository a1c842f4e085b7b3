"""AsyncDrone against a drone by script, on virtual time: each verb does what it says, or says why not."""

import asyncio
from collections.abc import Callable, Coroutine
from math import pi
from typing import Any

import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer
from twodof.errors import LinkLost, ParameterError, RefusalReason, Rejected, Timeout
from twodof.excitation import Impulse
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.identity import OWN_SYSTEMS
from twodof.link.mavlink.messages import message

Flight = Callable[[Peer, AsyncDrone], Coroutine[Any, Any, None]]


def fly(flight: Flight, peer: Peer | None = None, **options: Any) -> Peer:
    """Connect to a peer, run `flight`, leave."""
    made = peer or Peer()

    async def work() -> None:
        async with made, await AsyncDrone.connect(made.url, **options) as drone:
            await flight(made, drone)

    run_virtual(work())
    return made


def test_connecting_takes_the_lease_and_leaving_disarms_and_gives_it_up() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        assert drone.ours
        assert peer.holder == (drone.session.connection.system, 190)
        assert peer.holder[0] in OWN_SYSTEMS
        await drone.arm()
        assert peer.armed
        assert drone.state.armed

    peer = fly(flight)
    assert not peer.armed
    assert peer.holder == (0, 0)


def test_leaving_by_an_exception_disarms_too() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        await drone.arm()
        raise ZeroDivisionError

    peer = Peer()
    with pytest.raises(ZeroDivisionError):
        fly(flight, peer)
    assert not peer.armed


def test_a_refusal_is_not_explained_by_what_was_said_of_another() -> None:
    """Late words about something before are not the reason; those that follow the answer are."""

    class Slow(Peer):
        def _command_long(self, got: Any, frame: Any) -> None:
            if got.command == 400 and got.param1 == 1.0:
                self.send("STATUSTEXT", severity=4, text="parameters: there is nothing to undo")
            super()._command_long(got, frame)

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.refuse[400] = (1, "the safety switch is on")
        with pytest.raises(Rejected) as refused:
            await drone.arm()
        assert refused.value.reason == "the safety switch is on"
        peer.refuse[400] = (2, "")
        with pytest.raises(Rejected) as refused:
            await drone.arm()
        assert refused.value.reason == "denied"
        del peer.refuse[400]

    fly(flight, Slow())


def test_a_refusal_is_explained_by_words_that_come_late() -> None:
    """They are a message of their own: a drone that stands still in between says nothing else either."""

    class Halting(Peer):
        def _command_long(self, got: Any, frame: Any) -> None:
            if got.command != 400 or not self.beating or got.param1 == 0.0:
                super()._command_long(got, frame)
                return
            self.send("COMMAND_ACK", command=got.command, result=1)
            self.beating = False
            asyncio.get_running_loop().call_later(2.0, self.go_on)

        def go_on(self) -> None:
            self.beating = True
            self.send("STATUSTEXT", severity=4, text="the safety switch is on")

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        with pytest.raises(Rejected, match="the safety switch is on"):
            await drone.arm()

    fly(flight, Halting())


def test_a_refusal_without_words_is_one_at_once() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.refuse[400] = (2, "")
        began = asyncio.get_running_loop().time()
        with pytest.raises(Rejected, match="denied"):
            await drone.arm()
        assert asyncio.get_running_loop().time() - began < 0.5
        del peer.refuse[400]

    fly(flight)


def test_another_on_the_same_link_is_not_taken_for_the_one_that_is_sought() -> None:
    """Its words are ignored, before ours is heard or right behind. Its time would look like a restart."""

    class Two(Peer):
        def send(self, name: str, /, **fields: Any) -> None:
            self.other("ATTITUDE", time_boot_ms=4_000_000)
            super().send(name, **fields)
            self.other("HEARTBEAT", type=2, autopilot=12, base_mode=129, system_status=4)

        def other(self, name: str, **fields: Any) -> None:
            if self._connection is not None and not self._connection.transport.closed:
                self._connection.system = 2
                self._connection.send(message(name, **fields))
                self._connection.system = 1

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        assert not drone.state.armed
        assert drone.tick < 10_000
        await drone.run(2.0)
        assert drone.messages == []

    fly(flight, Two(), drone=1)


def test_a_refusal_says_why() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.refuse[400] = (1, "the safety switch is on")
        with pytest.raises(Rejected, match="the safety switch is on"):
            await drone.arm()

    fly(flight)


def test_setpoints_are_streamed_at_50_hz_until_stopped() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        await drone.set_pitch(0.1, thrust=0.4)
        assert drone.state.mode == "offboard"
        before = peer.count("SET_ATTITUDE_TARGET")
        await drone.run(2.0)
        assert peer.count("SET_ATTITUDE_TARGET") - before == pytest.approx(100, abs=2)  # edges of the two seconds
        drone.stop_setpoints()
        before = peer.count("SET_ATTITUDE_TARGET")
        await drone.run(1.0)
        assert peer.count("SET_ATTITUDE_TARGET") == before

    fly(flight)


def test_a_setpoint_whose_mode_is_refused_is_not_sent_any_more() -> None:
    """Else it would fly in the next offboard, long after the call has failed."""

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.refuse[176] = (1, "not now")
        with pytest.raises(Rejected, match="not now"):
            await drone.set_pitch(0.1, thrust=0.4, timeout=1.0)
        sent = drone.setpoints.sent
        assert sent > 10
        await drone.run(1.0)
        assert drone.setpoints.sent == sent

    fly(flight)


def test_a_setpoint_that_the_drone_does_not_take_is_refused_at_once_with_its_reason() -> None:
    class Refusing(Peer):
        def _set_position_target_local_ned(self, _got: Any, frame: Any) -> None:
            to = {"target_system": frame.system, "target_component": frame.component}
            self.send("TWODOF_REFUSED", message_id=frame.message_id, reason=RefusalReason.RINGS, **to)

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.refuse[176] = (1, "not now")
        began = asyncio.get_running_loop().time()
        with pytest.raises(Rejected, match="moves the cart"):
            await drone.set_position(0.1, timeout=5.0)
        assert asyncio.get_running_loop().time() - began < 2.0

    fly(flight, Refusing())


def test_it_shows_which_drone_it_is_and_how_it_stands() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        assert repr(drone) == f"<drone 1 at {peer.url}: manual, disarmed>"
        await drone.arm()
        assert repr(drone).endswith("manual, armed>")

    fly(flight)


def test_in_lockstep_setpoints_follow_the_drones_time() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        await drone.set_velocity(0.2)
        start = drone.tick
        await drone.run(1.0)
        assert drone.tick == start + 250
        stamps = {one.time_boot_ms for one in peer.heard if one.get_type() == "SET_POSITION_TARGET_LOCAL_NED"}
        assert stamps >= {4 * (start + 5 * k) for k in range(50)}

    fly(flight, Peer(lockstep=True))


def test_parameters_are_read_listed_and_set_all_or_none() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        assert await drone.parameters.read("ATT_KP") == 11.0
        found = await drone.parameters.all()
        assert {name: entry.value for name, entry in found.items()} == pytest.approx(peer.parameters, rel=1e-7)
        await drone.parameters.update({"ATT_KP": 6.0, "SYS_AUTOSTART": 4002})
        assert (peer.parameters["ATT_KP"], peer.parameters["SYS_AUTOSTART"]) == (6.0, 4002)
        before = dict(peer.parameters)
        with pytest.raises(Rejected, match="ATT_KP: the value is out of range"):
            await drone.parameters.update({"RATE_KP": 0.05, "ATT_KP": 13.0})
        with pytest.raises(ParameterError, match="outside 0 to 15"):
            await drone.parameters.update({"RATE_KP": 0.05, "ATT_KP": 99.0})
        assert peer.parameters == before
        with pytest.raises(ParameterError, match="no such parameter"):
            await drone.parameters.read("NO_SUCH")
        await drone.parameters.undo()
        assert await drone.parameters.read("ATT_KP") == 11.0

    fly(flight)


def test_silence_is_a_lost_link() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.beating = False
        loop = asyncio.get_running_loop()
        start = loop.time()
        with pytest.raises(LinkLost, match="nothing was heard"):
            await drone.arm(timeout=30.0)
        assert loop.time() - start == pytest.approx(3.0, abs=1.0)  # seen at the latest at the next second
        with pytest.raises(LinkLost):
            await drone.set_pitch(0.0)

    with pytest.raises(LinkLost):  # closing cannot see it disarmed... it never was armed
        fly(_then_lost(flight))


def _then_lost(flight: Flight) -> Flight:
    async def work(peer: Peer, drone: AsyncDrone) -> None:
        await flight(peer, drone)
        raise LinkLost("told")

    return work


def test_a_kill_needs_no_lease() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.armed = True
        await drone.kill()
        assert not peer.armed

    peer = Peer()
    peer.holder = (1, 191)
    fly(flight, peer, take_lease=False)
    assert peer.holder == (1, 191)


@pytest.mark.parametrize("waits", [False, True])
def test_an_excitation_that_is_over_before_who_asked_runs_on_is_known_to_be(waits: bool) -> None:
    """A short one on a busy machine: that it is ready, that it plays and that it is done come in one go."""

    def at_once(_: int, sent: Any) -> list[Any]:
        if sent.get_type() != "TWODOF_EXCITE_STATUS" or sent.state != 3:
            return [sent]
        told = {name: getattr(sent, name) for name in ("tick", "transfer", "received", "start_tick", "end_tick")}
        return [message("TWODOF_EXCITE_STATUS", state=state, **told) for state in (2, 3, 4)][not waits :]

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        played = await drone.excite(Impulse(0.1, 0.4, unit="-"))
        assert (played.state, played.end_tick - played.start_tick) == ("done", 100)

    fly(flight, Peer(spoil=at_once))


def test_a_held_lease_is_a_refusal_that_names_the_holder() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        raise AssertionError("connected")

    peer = Peer()
    peer.holder = (245, 190)
    with pytest.raises(Rejected, match="245/190 holds the lease"):
        fly(flight, peer)


def test_waiting_for_a_condition_ends_with_it_or_at_the_timeout() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        q = drone.telemetry("q")
        await drone.wait_until(lambda: q.latest is not None and q.value > 1.0, timeout=10.0)
        assert q.value == pytest.approx(1.0, abs=0.1)
        with pytest.raises(Timeout, match="within 1 s"):
            await drone.wait_until(lambda: False, timeout=1.0)

    fly(flight)
    fly(flight, Peer(lockstep=True))


def test_leaving_disarms_what_was_armed_unseen() -> None:
    """A script that is interrupted while it arms: the drone is armed, but its heartbeat is still to come."""

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        peer.spoil = lambda _, sent: [] if sent.get_type() in ("HEARTBEAT", "COMMAND_ACK") else [sent]
        arming = asyncio.ensure_future(drone.arm(timeout=5.0))
        await asyncio.sleep(0.1)
        assert peer.armed
        assert not drone.state.armed
        arming.cancel()
        peer.spoil = lambda _, sent: [sent]

    peer = fly(flight)
    assert not peer.armed


def test_leaving_stops_a_drone_that_hears_but_is_not_heard() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        await drone.arm()
        peer.spoil = lambda *_: []
        await drone.run(10.0)

    peer = Peer()
    with pytest.raises(LinkLost):
        fly(flight, peer)
    assert not peer.armed


def test_degrees_and_millimetres_are_refused_before_anything_is_sent() -> None:
    """Bounds themselves are flown."""

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        before = len(peer.heard)
        for call, said in (
            (drone.set_pitch(10.0, 0.4), "angles are in radians: theta = 10 rad is 573 deg"),
            (drone.set_pitch(-1.6, 0.4), "radians"),
            (drone.set_pitch_rate(90.0, 0.4), "angles are in radians: q = 90 rad/s is 5157 deg/s"),
            (drone.set_position(-100.0), "x = -100 m is beyond 1 m"),
            (drone.set_velocity(5.1), "v = 5.1 m/s is beyond 5 m/s"),
        ):
            with pytest.raises(ParameterError, match=said):
                await call
        assert not [got for got in peer.heard[before:] if got.get_type().startswith(("SET_", "COMMAND"))]
        for fine in (drone.set_pitch(pi / 2, 0.4), drone.set_pitch_rate(60.0, 0.4), drone.set_position(-1.0)):
            await fine

    fly(flight)


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_drone_that_restarts_is_a_lost_link(lockstep: bool) -> None:
    """The call that waits says so, and every one after it; a stamp or two that were long on the way do not."""

    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        await drone.run(2.0)
        await drone.arm()
        for _ in range(3):
            peer.send("ATTITUDE", time_boot_ms=100)
        await drone.run(0.5)
        if not lockstep:  # an old backlog, faster than what is new
            for k in range(100):
                for _ in range(8):
                    peer.send("ATTITUDE", time_boot_ms=100 + 4 * k)
                await drone.run(0.02)
        peer.tick, peer.armed, peer.holder = 0, False, (0, 0)
        with pytest.raises(LinkLost, match="the drone has restarted"):
            await drone.run(5.0)
        for call in (drone.arm(), drone.run(0.1), drone.set_pitch(0.1, 0.4), drone.wait_until(lambda: False, 1.0)):
            with pytest.raises(LinkLost, match="the drone has restarted"):
                await call
        assert "the drone has restarted" in drone.messages[-1].text

    fly(flight, Peer(lockstep=lockstep))


def test_a_reset_of_ours_and_one_that_is_watched_are_no_restart() -> None:
    async def flight(peer: Peer, drone: AsyncDrone) -> None:
        async with await AsyncDrone.connect(peer.url, take_lease=False) as other:
            for _ in range(2):
                await drone.run(2.0)
                await drone.reset()
                await drone.run(1.0)
            assert drone.messages == []
            await other.run(0.1)
            assert other.tick < 500
            assert "the drone has restarted" in other.messages[-1].text

    fly(flight)
