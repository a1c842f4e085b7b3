"""Batches: every sample of the channels asked for, NaN where there was none, within a tenth of a second."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.mavlink.world import World
from twodof.fcu.mavlink.streams import BATCH, LATEST_TICKS, channel_readers, published
from twodof.flightlog.steps import is_published
from twodof.link.mavlink.dialect import MavResult
from twodof.link.mavlink.messages import batch_rows, channel_bits, channel_mask
from twodof.signals import TOPICS

ALL = sum(channel_bits().values())


def subscribe(world: World, mask: int, micros: float = 0.0, **options: Any) -> int:
    return world.command(511, BATCH, micros, float(mask & 0xFFFF), float(mask >> 16), **options)


def rows(world: World, peer: str = "client") -> tuple[np.ndarray, np.ndarray]:
    """Ticks and samples of all batches that were sent."""
    got = [batch_rows(one) for one in world.taken("TWODOF_BATCH", peer)]
    return np.concatenate([ticks for ticks, _ in got]), np.concatenate([values for _, values in got])


def test_there_is_a_reader_for_every_channel_and_a_channel_for_every_number_on_board() -> None:
    assert set(channel_readers(World().commander)) == set(channel_bits())
    onboard = {column.replace(".", "_").upper() for row in TOPICS if row.onboard for column in row.columns}
    assert set(channel_bits()) == onboard


@settings(max_examples=30)
@given(mask=st.integers(1, ALL), every=st.integers(1, 30), begin=st.integers(0, 100))
def test_no_sample_is_lost_or_late(mask: int, every: int, begin: int) -> None:
    world = World(profile={})
    world.run(begin)
    assert subscribe(world, mask, 4000.0 * every) == MavResult.ACCEPTED
    world.sent.clear()
    seen: list[int] = []
    for _ in range(300):
        world.run()
        for one in world.taken("TWODOF_BATCH"):
            ticks, values = batch_rows(one)
            assert values.shape[1] == mask.bit_count()
            assert one.channels == mask
            # Not later than so many ticks, unless the samples themselves are further apart.
            assert world.controller.tick - 1 - ticks[0] <= max(LATEST_TICKS, every)
            seen += ticks.tolist()
    due = [tick for tick in range(begin, begin + 300) if tick % every == 0]
    # All but those that wait still.
    assert seen == due[: len(seen)]
    assert not due[len(seen) :] or begin + 300 - due[len(seen)] <= max(LATEST_TICKS, every)


def test_columns_are_the_steps_numbers() -> None:
    world = World(profile={})
    columns = ["imu.acc_x", "imu.gyro_y", "estimate.theta", "estimate.q", "setpoint.thrust", "command.M", "state.mode"]
    mask = channel_mask([*columns, "battery.voltage"])
    subscribe(world, mask)
    world.run(60, acc_x=1.5, gyro_y=2.5, theta=0.25, q=-0.5, T=0.5, M=0.125, mode=3, voltage=12.5)
    ticks, values = rows(world)
    bits = channel_bits()
    order = sorted([*columns, "battery.voltage"], key=lambda name: bits[name.replace(".", "_").upper()])
    expected = {"imu.acc_x": 1.5, "imu.gyro_y": 2.5, "estimate.theta": 0.25, "estimate.q": -0.5}
    expected |= {"setpoint.thrust": -0.5, "command.M": 0.125, "state.mode": 3.0, "battery.voltage": 12.5}
    assert len(ticks) >= 50
    assert (values == [expected[name] for name in order]).all()


def test_the_open_loop_is_the_commanders() -> None:
    world = World(profile={})
    loop = world.commander.openloop._replace(M=0.25, T=0.5, openloop=True, enableM=True)
    world.commander.openloop = loop
    names = ["openloop_M", "openloop_T", "openloop_openloop", "openloop_enableM", "openloop_enableT"]
    subscribe(world, channel_mask(names))
    world.run(30)
    assert (rows(world)[1] == [0.25, 0.5, 1.0, 1.0, 0.0]).all()


def test_where_a_sensor_gave_nothing_new_stands_nan() -> None:
    world = World(profile={})
    subscribe(world, channel_mask(["tof.distance", "imu.gyro_y"]))
    for tick in range(100):
        world.run(1, dist_new=tick % 13 == 0, imu_new=tick % 2 == 0, dist=0.5, gyro_y=1.0)
    ticks, values = rows(world)
    gyro, dist = values.T
    assert np.array_equal(np.isfinite(dist), ticks % 13 == 0)
    assert np.array_equal(np.isfinite(gyro), ticks % 2 == 0)


def test_position_and_velocity_are_new_where_the_estimator_has_published() -> None:
    # What is published in a step is read from the next one on (flightlog.steps).
    steps = is_published(np.arange(1000))
    assert [published(tick + 1) for tick in range(1000)] == steps.tolist()
    world = World(profile={})
    subscribe(world, channel_mask(["estimate.x", "estimate.v"]))
    world.run(250, x=0.1, v=0.2)
    assert np.isfinite(rows(world)[1][:, 0]).sum() == pytest.approx(100, abs=LATEST_TICKS)


def test_one_subscription_a_client() -> None:
    world = World(profile={})
    subscribe(world, channel_mask(["estimate.q"]), peer="one")
    subscribe(world, channel_mask(["estimate.theta"]), peer="other")
    subscribe(world, channel_mask(["command.M"]), peer="one")
    world.run(100)
    assert {one.channels for one in world.taken("TWODOF_BATCH", "one")} == {channel_mask(["command.M"])}
    assert {one.channels for one in world.taken("TWODOF_BATCH", "other")} == {channel_mask(["estimate.theta"])}


def test_what_waits_is_sent_at_the_end() -> None:
    world = World(profile={})
    subscribe(world, channel_mask(["estimate.q"]))
    world.run(7)
    assert world.taken("TWODOF_BATCH") == []
    assert subscribe(world, 0, -1.0) == MavResult.ACCEPTED
    assert rows(world)[0].tolist() == [*range(7)]
    world.run(100)
    assert world.taken("TWODOF_BATCH") == []


def test_time_that_begins_anew_does_not_mix_two_times() -> None:
    world = World(profile={})
    subscribe(world, channel_mask(["estimate.q"]))
    world.run(7)
    for service in world.services:
        service.restart()
    world.controller.tick = 0
    world.run(40)
    ticks = rows(world)[0].tolist()
    assert ticks[:8] == [0, 1, 2, 3, 4, 5, 6, 0]


def test_a_client_that_goes_gets_no_more() -> None:
    world = World(profile={})
    subscribe(world, channel_mask(["estimate.q"]))
    world.services[0].gone("client")
    world.run(100)
    assert world.taken("TWODOF_BATCH") == []


@pytest.mark.parametrize(
    "params",
    [
        (0.0, 0.0, 0.0),
        (0.0, 0.0, float(1 << 15)),  # the last bit, which no channel has
        (0.0, -1.0, 0.0),
        (0.0, 65536.0, 0.0),
        (0.0, math.nan, 0.0),
        (math.nan, 1.0, 0.0),
        (1e9, 1.0, 0.0),
    ],
)
def test_subscriptions_that_make_no_sense(params: tuple[float, ...]) -> None:
    assert World().command(511, BATCH, *params) == MavResult.DENIED
