"""Telemetry: values as messages carry them, bounded streams, callbacks that fall over, numbers that are none."""

import asyncio
from math import cos, nan, sin
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.faults.virtual_time import run_virtual
from tests.gcs.peer import Peer, flight
from tests.link.batches import batch
from twodof.errors import LogError, Timeout
from twodof.gcs.async_drone import AsyncDrone
from twodof.gcs.full_rate import BatchRows, TruthRows
from twodof.gcs.telemetry import DECODERS, TelemetrySample
from twodof.link.mavlink.messages import channel_mask, message
from twodof.signals import TOPICS


def decoded(name: str, **fields: Any) -> dict[str, tuple[float, Any]]:
    return {topic: (time, value) for topic, time, value in DECODERS[name](message(name, **fields))}


def test_messages_of_common_become_topics_in_si_units() -> None:
    assert decoded("ATTITUDE", time_boot_ms=12, pitch=0.1, pitchspeed=-2.0) == {
        "estimate.theta": (0.012, 0.1),
        "estimate.q": (0.012, -2.0),
    }
    target = decoded("ATTITUDE_TARGET", q=[cos(0.05), 0.0, sin(0.05), 0.0], body_pitch_rate=0.3, thrust=0.4)
    assert target["setpoint.theta"][1] == pytest.approx(0.1, abs=1e-15)
    assert (target["setpoint.q"][1], target["setpoint.thrust"][1]) == (0.3, -0.4)
    imu = decoded("HIGHRES_IMU", time_usec=8000, xacc=1.0, zacc=-9.8, ygyro=0.2)
    assert imu["imu.acc"] == (0.008, (1.0, 0.0, -9.8))
    assert decoded("TWODOF_TOF", time_usec=1000, distance=0.5, valid=0) == {}
    assert decoded("LOCAL_POSITION_NED", x=nan, vx=0.1) == {"estimate.v": (0.0, 0.1)}


def test_a_batch_gives_the_newest_sample_of_each_topic() -> None:
    mask = channel_mask(["imu.gyro_x", "imu.gyro_y", "imu.gyro_z", "tof.distance", "estimate.q"])
    rows = np.array([[1, 2, 3, 0.5, 4], [5, 6, 7, nan, 8]], dtype=np.float32)
    (sent,) = batch(10, mask, rows)
    found = {topic: (time, value) for topic, time, value in DECODERS["TWODOF_BATCH"](sent)}
    assert found == {
        "imu.gyro": (pytest.approx(0.044), (5.0, 6.0, 7.0)),
        "tof.distance": (pytest.approx(0.040), 0.5),
        "estimate.q": (pytest.approx(0.044), 8.0),
    }


def test_every_topic_comes_from_some_message_or_batch() -> None:
    carried = {row.mavlink for row in TOPICS if row.mavlink != "HEARTBEAT"}  # the mode is in batches
    assert carried <= set(DECODERS)


def test_rows_count_what_is_lost_and_keep_each_tick_once() -> None:
    rows = BatchRows(("estimate.q",))
    mask = channel_mask(["estimate.q"])
    for first in (20, 0, 0, 35):
        (sent,) = batch(first, mask, np.arange(first, first + 10, dtype=np.float32)[:, None])
        rows.take(sent)
    assert rows.ticks.tolist() == [*range(10), *range(20, 30), *range(35, 45)]
    assert rows.values[:, 0].tolist() == rows.ticks.tolist()
    assert rows.lost == 15


class Late(Peer):
    """Ends a subscription two seconds after it is told to, and then sends first what it has left."""

    def _command_long(self, got: Any, frame: Any) -> None:
        if got.command == 511 and got.param2 == -1.0:
            asyncio.get_running_loop().call_later(2.0, self.end, got, frame)
        else:
            super()._command_long(got, frame)

    def end(self, got: Any, frame: Any) -> None:
        (sent,) = batch(self.tick, channel_mask(["estimate.q"]), np.array([[0.5]], dtype=np.float32))
        self.send("TWODOF_BATCH", **{name: getattr(sent, name) for name in sent.fieldnames})
        super()._command_long(got, frame)


def test_the_last_rows_are_waited_for() -> None:
    async def work() -> None:
        async with Late() as peer, await AsyncDrone.connect(peer.url) as drone:
            async with drone.batch(["estimate.q"]) as rows:
                await drone.run(0.1)
            assert rows.values.tolist()[0] == [0.5]

    run_virtual(work())


@flight()
async def test_a_slow_reader_loses_the_oldest_and_holds_nobody_up(peer: Peer, drone: AsyncDrone) -> None:
    q = drone.telemetry("q")
    with q.stream(size=10) as slow, q.stream() as quick:
        await drone.run(1.0)
        assert slow.lost == pytest.approx(40, abs=3)  # of 50 in a second, less what was under way at its edges
        assert quick.lost == 0
        first = await slow.next()
        times = [first.time, *[(await slow.next()).time for _ in range(9)]]
        assert np.diff(times) == pytest.approx(0.02)
        assert times[-1] == q.latest.time


def test_a_callback_that_raises_is_reported_and_harms_nobody() -> None:
    async def work() -> None:
        said: list[str] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: said.append(repr(context["exception"])))
        async with Peer() as peer, await AsyncDrone.connect(peer.url) as drone:
            seen: list[TelemetrySample] = []
            signal = drone.telemetry("estimate.theta")
            signal.on(lambda sample: 1 / 0)
            end = signal.on(seen.append)
            await drone.run(0.2)
            assert len(seen) == len(said) > 5
            assert said[0].startswith("ZeroDivisionError")
            end()
            count = len(seen)
            await drone.run(0.2)
            assert len(seen) == count

    run_virtual(work())


@flight()
async def test_missing_signals_time_out_and_unknown_ones_raise(peer: Peer, drone: AsyncDrone) -> None:
    with pytest.raises(Timeout, match=r"no imu\.acc has come"):
        _ = drone.telemetry("acc").value
    with pytest.raises(Timeout, match=r"waiting for imu\.acc"):
        await drone.telemetry("imu.acc").next(timeout=1.0)
    with pytest.raises(LogError, match="no such signal"):
        drone.telemetry("altitude")


def test_true_states_are_sorted_without_copies() -> None:
    rows = TruthRows()
    came = [*range(7, 3000), 2999, 5, 3005]
    for count, tick in enumerate(came):
        rows.take(SimpleNamespace(step=tick, theta=0.1 * tick, q=0.0, x=0.0, v=-tick))
        if count in (0, 1023, 1500):
            assert len(rows) == count + 1
    assert rows.ticks.tolist() == [5, *range(7, 3000), 3005]
    assert rows.values[:, 3].tolist() == [-5.0, *(-float(tick) for tick in range(7, 3000)), -3005.0]
    assert rows.lost == 1 + 5
