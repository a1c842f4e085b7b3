"""Two clients that command at once, and commands without a signature: on the whole system, behind the companion."""

import asyncio

import pytest

from tests.faults.virtual_time import on_virtual_time
from tests.faults.whole import GROUND, Whole, silent, stands
from twodof.errors import LinkLost, RefusalReason, Rejected
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.setpoints import setpoint
from twodof.link.mavlink.framing import encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, SigningVerdict, Stamps
from twodof.link.transport import open_transport
from twodof.link.transport.base import Transport

pytestmark = pytest.mark.slow

ARM = {"command": 400, "param1": 1.0, "target_system": 1, "target_component": 1}
UNSIGNED = 25  # commands


@on_virtual_time
async def test_of_two_that_connect_at_once_one_commands_and_the_other_is_told_who() -> None:
    async with Whole() as whole:
        both = await asyncio.gather(whole.client(system=250), whole.client(system=251), return_exceptions=True)
        (pilot,) = [one for one in both if isinstance(one, AsyncDrone)]
        (refused,) = [one for one in both if isinstance(one, Rejected)]
        holder = pilot.session.connection.system
        assert f"{holder}/{GROUND} holds the lease" in str(refused)
        assert whole.drone.commander.lease.holder == (holder, GROUND)
        await pilot.close()


@pytest.mark.long
@on_virtual_time
async def test_what_the_other_commands_in_flight_is_refused_counted_and_changes_nothing_but_a_kill_stops() -> None:
    async with Whole() as whole:
        pilot = await whole.airborne(0.1)
        await pilot.withhold_tuning()
        other = await whole.client(system=251, take_lease=False)
        await other.run(1.5)  # until it has heard who holds the lease
        first, before = whole.tick, dict(whole.drone.assembly.store)
        for refused in (
            other.arm,
            other.level_hold,
            lambda: other.set_mode("manual"),
            lambda: other.parameters.set("ATT_KP", 9.0),
            lambda: other.parameters.update({"ATT_KP": 9.0, "RATE_KP": 0.08}),
            lambda: other.reset(),
        ):
            with pytest.raises(Rejected, match=r"system 250, component 190 holds|permission denied"):
                await refused()
        with pytest.raises(Rejected, match="system 250, component 190 holds"):
            await other.set_pitch(-0.3, thrust=0.8)
        other.setpoints.hold(setpoint("theta", -0.3, 0.8))  # as one would that does not ask
        await other.run(1.0)
        assert silent(whole.since(first))
        assert {round(step.asked.theta0, 3) for step in whole.since(first)} == {0.1}
        assert whole.drone.commander.refused[RefusalReason.LEASE] > 40  # .02 s apart
        assert dict(whole.drone.assembly.store) == before
        tick = whole.tick
        await other.kill()
        assert any(stands(seen) for seen in whole.steps if seen.step.tick >= tick)
        assert stands(whole.steps[-1])
        with pytest.raises(Rejected, match="killed"):
            await pilot.arm()
        other.stop_setpoints()
        await pilot.disarm()
        with pytest.raises(Rejected, match="killed by system 251, component 190"):
            await pilot.arm()
        await pilot.release()
        await pilot.arm()
        await pilot.close()
        await other.lease.take(5.0)  # given up, it goes to who asks
        assert whole.drone.commander.lease.holder == (251, GROUND)
        await other.close()


async def commands(link: Transport, *signing: object) -> None:
    for number in range(UNSIGNED):
        link.send(encode(message("COMMAND_LONG", **ARM), 251, GROUND, number, *signing))
        await asyncio.sleep(0.004)


@pytest.mark.long
@pytest.mark.parametrize("companion_has_key", [False, True])
@on_virtual_time
async def test_a_command_that_is_not_signed_is_refused_and_counted(companion_has_key: bool) -> None:
    """To the flight controller itself and by way of the companion, with and without the key there."""
    key = Key.fresh()
    signing = Signing(key, Stamps(None))
    companions = Signing(key, Stamps(None), 191) if companion_has_key else None
    async with Whole(signing=signing, companion_signing=companions) as whole:
        await whole.passes(1.0)

        def refused(why: str) -> int:
            """By the flight controller, or before it by a companion that has the key."""
            return sum(one.counts[SigningVerdict[why.upper()]] for one in (signing, companions) if one is not None)

        for url in (whole.fcu, whole.clients):
            link = await open_transport(url)
            # What the companion says in its own name is not signed either, where it has no key.
            before, begin = refused("unsigned"), whole.tick
            await commands(link)
            count = refused("unsigned") - before
            assert count >= UNSIGNED if not companion_has_key else count == UNSIGNED
            forged = refused("forged")
            await commands(link, Signing(Key.fresh(), Stamps(None)).outgoing())
            assert refused("forged") == forged + UNSIGNED
            assert not any(step.armed for step in whole.since(begin))
            assert whole.drone.commander.lease.holder is None
            await link.close()
        with pytest.raises(LinkLost):
            await whole.client(timeout=3.0, key=Key.fresh())
        pilot = await whole.airborne(0.1, key=key)
        begin = whole.tick
        link = await open_transport(whole.clients)
        await commands(link)
        assert silent(whole.since(begin))
        await pilot.close()
