"""A bad network under the assembled thing: packets are lost, delayed or repeated, and still all is done once."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.faults.transport import Faults
from tests.faults.virtual_time import on_virtual_time
from tests.faults.whole import LEVEL, PERIOD_S, Whole, acts, silent, stands, tell
from twodof.excitation import Doublet
from twodof.flightlog.files import read_log
from twodof.flightlog.steps import BOOT, shift
from twodof.flightlog.ulog_file import scan_ulog
from twodof.gcs import full_rate
from twodof.gcs.async_drone import AsyncDrone
from twodof.link.mavlink.framing import Parser, decode
from twodof.link.signing import Key, Signing, SigningVerdict, Stamps
from twodof.link.transport import open_transport

pytestmark = pytest.mark.slow

# On both ways between client and companion. In all but the first three the line to the flight controller is bad,
# too, in most ways at once.
NETWORKS = {
    "30 % loss": Faults(loss=0.3),
    "200 ms jitter": Faults(jitter=0.2),
    "duplicates": Faults(duplicate=0.5, jitter=0.02),
    "reordering": Faults(reorder=0.3, reorder_s=0.1),
    "all together": Faults(loss=0.1, duplicate=0.1, reorder=0.1, jitter=0.1),
    "all together, and worse": Faults(loss=0.3, duplicate=0.1, reorder=0.1, jitter=0.2),
}
DAILY = ("30 % loss", "reordering")
LINE = Faults(loss=0.03, duplicate=0.1, reorder=0.1, jitter=0.02)
DOUBLET = Doublet(0.1, 0.4, unit="rad")
# A set-point comes each 20 ms, the last may be 20 ms old when they end, and jitter may hold one back by .2 s.
LEVEL_MS = 1000.0
LEVEL_RAD = 0.06  # as in tests/sim/test_failsafe_flights.py: the wake alone moves the pitch by .03


@pytest.mark.long
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in DAILY else [pytest.mark.soak]) for name in NETWORKS]
)
@on_virtual_time
async def test_a_flight_over_a_bad_network_loses_nothing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # All calls get a minute: in the 5 s of a subscription are ten tries, of which with .51^10 none comes through.
    monkeypatch.setattr(full_rate, "TIMEOUT_S", 60.0)
    faults = NETWORKS[name]
    line = LINE if "all" in name or name == "reordering" else None
    async with Whole(faults, line, seed=2, state=tmp_path / "drone") as whole:
        drone = await whole.client()
        await drone.parameters.update({"ATT_KP": 9.0, "RATE_KP": 0.08}, timeout=60.0)
        recorded = tmp_path / "flight.mcap"
        async with drone.record(recorded, ["estimate.theta"]) as recording:
            await drone.run(0.5)
            await drone.arm(timeout=60.0)
            await drone.set_pitch(0.1, thrust=0.4, timeout=60.0)
            await drone.run(1.0)
            begin = whole.tick
            played = await drone.excite(DOUBLET, timeout=60.0)
            await drone.run(1.0)
            assert silent(whole.since(begin))  # neither link nor set-points count as lost
            _, wanted = DOUBLET.samples(PERIOD_S)
            asked = [step.asked.theta0 for step in whole.since(played.start_tick)[: len(wanted)]]
            expected = 0.1 + wanted
            np.testing.assert_allclose(asked, expected, atol=1e-6)  # float32 on the wire
        recorded_all = recording.acknowledged.samples
        assert recorded_all == recording.samples > 0
        drone.stop_setpoints()
        last = whole.tick
        await whole.passes(2.0)
        tell(name, "level", whole.ms(last, acts(LEVEL)), LEVEL_MS)
        assert abs(whole.steps[-1].theta) < LEVEL_RAD
        await drone.disarm(timeout=60.0)
        await whole.passes(1.0)
        assert stands(whole.steps[-1])
        await drone.close(timeout=60.0)
        flown = whole.since(0)
        whole.drone.assembly.log.flush()
    (log,) = (tmp_path / "drone" / "logs").glob("*.ulg")
    rows = scan_ulog(log.read_bytes(), "log").topic("twodof_step")
    ticks = rows["tick"].tolist()
    assert ticks == [*range(ticks[0], ticks[-1] + 1)]  # each step of the flight, none missing
    assert {step.tick for step in flown if step.armed} <= set(ticks)
    assert [flown[tick].theta for tick in ticks] == rows["theta"].tolist()
    stored = json.loads((tmp_path / "drone" / "parameters.json").read_text())["parameters"]
    assert (stored["ATT_KP"], stored["RATE_KP"]) == (9.0, 0.08)
    theta = read_log(recorded)["theta"]
    heard = np.rint((theta.time - BOOT - shift("theta")) / PERIOD_S).astype(int)
    assert [np.float32(flown[tick].theta) for tick in heard] == theta.value.tolist()  # what came is in it, rightly
    assert 0 < len(theta) <= recorded_all


@on_virtual_time
async def test_replayed_signed_packets_do_nothing_and_are_counted(tmp_path: Path) -> None:
    """All that a client ever sent comes again: in flight, after it, and to a flight controller that was restarted."""
    key, stamps = Key.fresh(), tmp_path / "stamps.json"
    signing = Signing(key, Stamps(stamps))
    async with Whole(signing=signing) as whole:
        link = await whole.open()
        sent: list[bytes] = []
        deliver = link.inner.send
        link.inner.send = lambda data, to=None: (sent.append(data), deliver(data, to))[1]
        drone = await AsyncDrone.over(link, key=key)
        await drone.run(0.5)
        await drone.arm()
        await drone.set_pitch(0.1, thrust=0.4)
        await drone.run(1.0)
        intruder = await open_transport(whole.clients)
        begin, before = whole.tick, [*sent]
        for data in before:
            intruder.send(data)
        await drone.run(0.5)
        assert signing.counts[SigningVerdict.REPEATED] == len(before)
        assert silent(whole.since(begin))
        assert {step.asked.theta0 for step in whole.since(begin)} == {whole.steps[-1].step.asked.theta0}
        await drone.close()
        commands = {decode(frame).get_type() for data in sent for frame in Parser().feed(data, whole=True)}
        assert {"COMMAND_LONG", "SET_ATTITUDE_TARGET", "TWODOF_LEASE"} <= commands
        accepted, lease = signing.counts[SigningVerdict.ACCEPTED], whole.drone.commander.lease
        for data in sent:
            intruder.send(data)
        await whole.passes(1.0)
        assert signing.counts[SigningVerdict.ACCEPTED] == accepted
        assert whole.drone.commander.lease == lease
        assert not any(step.armed for step in whole.since(whole.tick - 250))
    restarted = Signing(key, Stamps(stamps))
    async with Whole(signing=restarted) as whole:
        intruder = await open_transport(whole.clients)
        for data in sent:
            intruder.send(data)
        await whole.passes(1.0)
        assert restarted.counts[SigningVerdict.ACCEPTED] == 0
        assert restarted.counts[SigningVerdict.REPEATED] == len(sent)
        assert whole.drone.commander.lease.holder is None
        assert not any(step.armed for step in whole.since(0))
