"""AsyncDrone with a scripted drone on virtual time: verbs, refusals and bounds."""

import asyncio
from collections.abc import Callable, Coroutine
from math import inf, nan, pi
from typing import Any

import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer, flight
from twodof.errors import LinkLost, ParameterError, RefusalReason, Rejected, Timeout
from twodof.excitation import Impulse
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.session import OWN_SYSTEMS
from twodof.link.mavlink.messages import message


@pytest.mark.parametrize("unseen", [False, True])
def test_leaving_disarms_and_gives_the_lease_up(unseen: bool) -> None:
    """Also if the script is interrupted while it arms, before a heartbeat shows it."""
    peer = Peer()

    async def work() -> None:
        async with peer, await AsyncDrone.connect(peer.url) as drone:
            assert peer.holder == (drone.session.connection.system, 190)
            assert peer.holder[0] in OWN_SYSTEMS
            if unseen:
                peer.spoil = lambda _, sent: [] if sent.get_type() in ("HEARTBEAT", "COMMAND_ACK") else [sent]
            arming = asyncio.ensure_future(drone.arm(timeout=5.0))
            await asyncio.sleep(0.1)
            assert (peer.armed, drone.state.armed) == (True, not unseen)
            arming.cancel()
            peer.spoil = lambda _, sent: [sent]

    run_virtual(work())
    assert not peer.armed
    assert peer.holder == (0, 0)


class Talkative(Peer):
    """Sends a text about something else before it answers an order to arm."""

    def _command_long(self, got: Any, frame: Any) -> None:
        if got.command == 400 and got.param1 == 1.0:
            self.send("STATUSTEXT", severity=4, text="parameters: there is nothing to undo")
        super()._command_long(got, frame)


@pytest.mark.parametrize(
    ("refusal", "reason"), [((1, "the safety switch is on"), "the safety switch is on"), ((2, ""), "denied")]
)
@flight(Talkative)
async def test_a_refusal_has_its_own_reason_only(
    peer: Peer, drone: AsyncDrone, refusal: tuple[int, str], reason: str
) -> None:
    peer.refuse[400] = refusal
    began = asyncio.get_running_loop().time()
    with pytest.raises(Rejected) as refused:
        await drone.arm()
    assert refused.value.reason == reason
    assert asyncio.get_running_loop().time() - began < 0.5
    del peer.refuse[400]


class Halting(Peer):
    """Stands still for two seconds between a refusal and its reason."""

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


@flight(Halting)
async def test_a_refusal_is_explained_by_a_late_text(peer: Peer, drone: AsyncDrone) -> None:
    with pytest.raises(Rejected, match="the safety switch is on"):
        await drone.arm()


class Two(Peer):
    """Shares its link with an armed drone 2 whose time would look like a restart."""

    def send(self, name: str, /, **fields: Any) -> None:
        self.other("ATTITUDE", time_boot_ms=4_000_000)
        super().send(name, **fields)
        self.other("HEARTBEAT", type=2, autopilot=12, base_mode=129, system_status=4)

    def other(self, name: str, **fields: Any) -> None:
        if self._connection is not None and not self._connection.transport.closed:
            self._connection.system = 2
            self._connection.send(message(name, **fields))
            self._connection.system = 1


@flight(Two, drone=1)
async def test_another_drone_on_the_link_is_ignored(peer: Peer, drone: AsyncDrone) -> None:
    assert not drone.state.armed
    assert drone.tick < 10_000
    await drone.run(2.0)
    assert drone.messages == []


@flight()
async def test_setpoints_are_streamed_at_50_hz_until_stopped(peer: Peer, drone: AsyncDrone) -> None:
    await drone.set_pitch(0.1, thrust=0.4)
    assert drone.state.mode == "offboard"
    before = peer.count("SET_ATTITUDE_TARGET")
    await drone.run(2.0)
    assert peer.count("SET_ATTITUDE_TARGET") - before == pytest.approx(100, abs=2)  # edges of the two seconds
    drone.stop_setpoints()
    before = peer.count("SET_ATTITUDE_TARGET")
    await drone.run(1.0)
    assert peer.count("SET_ATTITUDE_TARGET") == before


@flight()
async def test_a_setpoint_stops_when_its_mode_is_refused(peer: Peer, drone: AsyncDrone) -> None:
    """Else it would fly in the next offboard, long after the call has failed."""
    peer.refuse[176] = (1, "not now")
    with pytest.raises(Rejected, match="not now"):
        await drone.set_pitch(0.1, thrust=0.4, timeout=1.0)
    sent = drone.setpoints.sent
    assert sent > 10
    await drone.run(1.0)
    assert drone.setpoints.sent == sent


class Refusing(Peer):
    """Refuses set-points that move the cart."""

    def _set_position_target_local_ned(self, _got: Any, frame: Any) -> None:
        to = {"target_system": frame.system, "target_component": frame.component}
        self.send("TWODOF_REFUSED", message_id=frame.message_id, reason=RefusalReason.RINGS, **to)


@flight(Refusing)
async def test_a_refused_setpoint_raises_its_reason_at_once(peer: Peer, drone: AsyncDrone) -> None:
    peer.refuse[176] = (1, "not now")
    began = asyncio.get_running_loop().time()
    with pytest.raises(Rejected, match="moves the cart"):
        await drone.set_position(0.1, timeout=5.0)
    assert asyncio.get_running_loop().time() - began < 2.0


@pytest.mark.parametrize("waits", [False, True])
@flight()
async def test_an_excitation_that_ends_at_once_is_done(peer: Peer, drone: AsyncDrone, waits: bool) -> None:
    """On a busy machine a short one is ready, plays and is done in one go."""

    def at_once(_: int, sent: Any) -> list[Any]:
        if sent.get_type() != "TWODOF_EXCITE_STATUS" or sent.state != 3:
            return [sent]
        told = {name: getattr(sent, name) for name in ("tick", "transfer", "received", "start_tick", "end_tick")}
        return [message("TWODOF_EXCITE_STATUS", state=state, **told) for state in (2, 3, 4)][not waits :]

    peer.spoil = at_once
    played = await drone.excite(Impulse(0.1, 0.4, unit="-"))
    assert (played.state, played.end_tick - played.start_tick) == ("done", 100)


@pytest.mark.parametrize("lockstep", [False, True])
@flight(lambda lockstep: Peer(lockstep=lockstep))
async def test_a_wait_ends_with_its_condition_or_timeout(peer: Peer, drone: AsyncDrone, lockstep: bool) -> None:
    q = drone.telemetry("q")
    await drone.wait_until(lambda: q.latest is not None and q.value > 1.0, timeout=10.0)
    assert q.value == pytest.approx(1.0, abs=0.1)
    with pytest.raises(Timeout, match="within 1 s"):
        await drone.wait_until(lambda: False, timeout=1.0)


Call = Callable[[AsyncDrone], Coroutine[Any, Any, None]]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda drone: drone.set_pitch(10.0, 0.4), "angles are in radians: theta = 10 rad is 573 deg"),
        (lambda drone: drone.set_pitch(-1.6, 0.4), "radians"),
        (lambda drone: drone.set_pitch(0.1, 1.5), r"thrust = 1\.5 is outside 0 to 1"),
        (lambda drone: drone.set_pitch_rate(90.0, 0.4), "angles are in radians: q = 90 rad/s is 5157 deg/s"),
        (lambda drone: drone.set_position(-100.0), "x = -100 m is beyond 1 m"),
        (lambda drone: drone.set_velocity(5.1), "v = 5.1 m/s is beyond 5 m/s"),
        (lambda drone: drone.set_moment(5.0), "M = 5 is outside -1 to 1"),
        (lambda drone: drone.set_moment(-1.01), "outside -1 to 1"),
        (lambda drone: drone.set_moment(nan), "not a finite number"),
        *((lambda drone, s=s: drone.run(s), "give 0 or more seconds") for s in (-1, -1e-9, inf, nan)),
    ],
)
@flight()
async def test_a_number_beyond_its_bounds_is_never_sent(peer: Peer, drone: AsyncDrone, call: Call, said: str) -> None:
    before = len(peer.heard)
    with pytest.raises(ParameterError, match=said):
        await call(drone)
    assert not [got for got in peer.heard[before:] if got.get_type().startswith(("SET_", "COMMAND", "TWODOF_OPEN"))]


@flight()
async def test_the_bounds_themselves_are_flown(peer: Peer, drone: AsyncDrone) -> None:
    for call in (drone.set_pitch(pi / 2, 0.4), drone.set_pitch_rate(60.0, 0.4), drone.set_position(-1.0)):
        await call


@pytest.mark.parametrize("lockstep", [False, True])
@flight(lambda lockstep: Peer(lockstep=lockstep))
async def test_a_drone_that_restarts_is_a_lost_link(peer: Peer, drone: AsyncDrone, lockstep: bool) -> None:
    """In the waiting call and in later ones; a few late stamps are ignored."""
    await drone.run(2.0)
    await drone.arm()
    for _ in range(3):
        peer.send("ATTITUDE", time_boot_ms=100)
    await drone.run(0.5)
    if not lockstep:  # an old backlog, faster than the new messages
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


@flight()
async def test_a_reset_is_a_restart_for_watchers_only(peer: Peer, drone: AsyncDrone) -> None:
    async with await AsyncDrone.connect(peer.url, take_lease=False) as other:
        for _ in range(2):
            await drone.run(2.0)
            await drone.reset()
            await drone.run(1.0)
        assert drone.messages == []
        await other.run(0.1)
        assert other.tick < 500
        assert "the drone has restarted" in other.messages[-1].text
