"""Two clients at one virtual drone over real links: one commands, the other is refused in everything but the stop."""

from typing import Any

import pytest

from tests.faults.virtual_time import run_virtual
from twodof.errors import RefusalReason
from twodof.excitation import Impulse
from twodof.link.connection import Connection
from twodof.link.mavlink.messages import excite, message
from twodof.link.mavlink.setpoints import SetPoint, setpoint_message
from twodof.link.transport import open_transport
from twodof.signals import ATTITUDE
from twodof.sim.virtual_drone import VirtualDrone

DRONE = {"target_system": 1, "target_component": 1}
ACCEPTED, TEMPORARILY_REJECTED, IN_PROGRESS = 0, 1, 5


def command(number: int, *params: float) -> Any:
    named = {f"param{place}": value for place, value in enumerate(params, start=1)}
    return message("COMMAND_LONG", command=number, **DRONE, **named)


class Client:
    """One that says something and hears everything that comes of it, while time stands still."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.grants = 0

    async def say(self, *sent: Any) -> list[Any]:
        """All answers, as messages."""
        for one in sent:
            self.connection.send(one)
        heard = []
        while (received := await self.connection.receive(0.05)) is not None:
            heard.append(received.message)
        return heard

    async def ack(self, sent: Any) -> tuple[int, str]:
        """MAV_RESULT of the last acknowledgement, and all texts."""
        heard = await self.say(sent)
        results = [one.result for one in heard if one.get_type() == "COMMAND_ACK"]
        return results[-1], texts(heard)

    async def grant(self, until: int) -> list[Any]:
        """Lets time run; every message that came."""
        self.grants += 1
        return await self.say(message("TWODOF_GRANT", until=until, number=self.grants, **DRONE))


def texts(heard: list[Any]) -> str:
    return "".join(one.text for one in heard if one.get_type() == "STATUSTEXT")


async def armed(drone: VirtualDrone, pilot: Client) -> None:
    """Flown in attitude mode by the pilot."""
    await pilot.say(message("TWODOF_LEASE", action=1, duration_ms=30_000, **DRONE))
    await pilot.grant(50)
    assert (await pilot.ack(command(400, 1)))[0] == IN_PROGRESS
    heard = await pilot.grant(51)
    assert [one.result for one in heard if one.get_type() == "COMMAND_ACK"] == [ACCEPTED]
    await pilot.say(setpoint_message(SetPoint(ATTITUDE, theta0=0.1, thrust=0.4), 0, **DRONE))
    assert (await pilot.ack(command(176, 1, 6)))[0] == ACCEPTED
    await pilot.grant(60)
    assert drone.commander.armed


COMMANDS = {
    "arm": [command(400, 1)],
    "mode": [command(176, 1, 4, 3)],
    "restart": [command(246, 1)],
    "set-point": [setpoint_message(SetPoint(ATTITUDE, theta0=0.5, thrust=0.9), 0, **DRONE)],
    "sticks": [message("MANUAL_CONTROL", target=1, x=1000, z=1000)],
    "open loop": [message("TWODOF_OPENLOOP", M=1.0, T=1.0, openloop=1, enableM=1, enableT=1, **DRONE)],
    "excitation": [
        *excite(Impulse(0.1, 0.2), 0, 5, 1, 1),
        message("TWODOF_EXCITE", action=1, transfer=5, thrust=0.9, **DRONE),
    ],
    "grant": [message("TWODOF_GRANT", until=1000, number=9, **DRONE)],
    "reset": [message("TWODOF_RIG_RESET", seed=99, noise=0.0, **DRONE)],
    "give up": [message("TWODOF_LEASE", action=2, **DRONE)],
    "ask": [message("TWODOF_LEASE", action=1, duration_ms=1000, **DRONE)],
    "parameter": [message("PARAM_SET", param_id="ATT_KP", param_value=3.0, param_type=9, **DRONE)],
}
SAID_WHO = {"arm", "mode", "set-point", "excitation", "grant", "reset", "give up", "ask"}
"""Answered with who holds the lease: of set-points one refusal a second is, and a restart is refused while armed."""


async def _both(work: Any) -> None:
    async with VirtualDrone("paper", {"rings": True}, lockstep=True) as drone:
        await drone.listen("memin://two-clients")
        async with (
            Connection(await open_transport("mem://two-clients"), 250, 190) as one,
            Connection(await open_transport("mem://two-clients"), 245, 190) as two,
        ):
            pilot, other = Client(one), Client(two)
            await armed(drone, pilot)
            await work(drone, pilot, other)


def flown(drone: VirtualDrone) -> tuple[Any, ...]:
    step = drone.controller.latest
    assert step is not None
    return step.asked[:10]


def test_all_that_commands_is_refused_to_the_other_and_changes_nothing() -> None:
    async def work(drone: VirtualDrone, pilot: Client, other: Client) -> None:
        before, gain = flown(drone), drone.assembly.store["ATT_KP"]
        await pilot.say(message("TWODOF_LEASE", action=1, duration_ms=30_000, tuning_withheld=1, **DRONE))
        for name, sent in COMMANDS.items():
            tick = drone.controller.tick
            heard = await other.say(*sent)
            assert all(one.result == TEMPORARILY_REJECTED for one in heard if one.get_type() == "COMMAND_ACK"), name
            assert name not in SAID_WHO or "system 250, component 190" in texts(heard), name
            assert drone.controller.tick == tick, name
            await pilot.say(setpoint_message(SetPoint(ATTITUDE, theta0=0.1, thrust=0.4), 0, **DRONE))
            await pilot.grant(tick + 5)
            assert flown(drone) == before, name
            assert drone.commander.lease.holder == (250, 190), name
        assert drone.commander.armed
        assert drone.assembly.store["ATT_KP"] == gain
        assert drone.commander.refused[RefusalReason.LEASE] >= 3
        assert drone.rig.seed != 99

    run_virtual(_both(work))


@pytest.mark.parametrize(
    "stop", [command(400, 0), command(400, 0, 21196), command(185, 1)], ids=["disarm", "forced", "terminate"]
)
def test_the_stop_acts_in_the_next_tick_whoever_says_it(stop: Any) -> None:
    async def work(drone: VirtualDrone, pilot: Client, other: Client) -> None:
        assert (await other.ack(stop))[0] == ACCEPTED
        await pilot.grant(drone.controller.tick + 1)
        step = drone.controller.latest
        assert step is not None
        assert (step.fore, step.aft, step.armed) == (0.0, 0.0, False)

    run_virtual(_both(work))
