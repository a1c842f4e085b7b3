"""Sensors, battery, controllers and set-points that fail in flight, seen on the assembled thing, companion included."""

import math
import time
from collections.abc import Callable
from typing import Any

import pytest

from tests.faults.virtual_time import on_virtual_time
from tests.faults.whole import BRAKE, DESCEND, LEVEL, NONE, OFF, Whole, acts, silent, stands, tell
from tests.fcu.flights import exhausting, failing
from twodof.fcu.control.hardware import SensorSample
from twodof.flight.failsafe.causes_and_actions import BIT

pytestmark = pytest.mark.slow

LEVEL_RAD = 0.06  # as in tests/sim/test_failsafe_flights.py: the wake alone moves the pitch by .03
FAILS_AT = 700
PITCH_STOP, RAIL_STOP = 0.87, 0.40  # the lab rig's
SAG_V = 2.5  # 12.3 V less this is below the critical 10.5
RING = {"rings": True, "seed": 3}
FREE = {"rings": False, "seed": 3}


def frozen_imu(whole: Whole) -> Callable[[SensorSample], SensorSample]:
    last = whole.steps[-1].step.sample
    return lambda sample: sample._replace(acc_x=last.acc_x, acc_z=last.acc_z, gyro_y=last.gyro_y)


def silent_range(whole: Whole) -> Callable[[SensorSample], SensorSample]:
    return lambda sample: sample._replace(dist_new=False)


def sagging_battery(whole: Whole) -> Callable[[SensorSample], SensorSample]:
    return lambda sample: sample._replace(voltage=sample.voltage - SAG_V)


def busy_processor(whole: Whole) -> Callable[[SensorSample], SensorSample]:
    until = whole.tick + 5

    def toil(sample: SensorSample) -> SensorSample:
        end = time.thread_time_ns() + 4_500_000
        while whole.tick < until and time.thread_time_ns() < end:
            pass
        return sample

    return toil


@pytest.mark.parametrize(
    ("fault", "conditions", "action", "within_ms", "off_ms", "cause"),
    [
        (frozen_imu, RING, OFF, 20, 20, "imu_lost"),
        (silent_range, FREE, DESCEND, 240, 1300, "range_lost"),
        (sagging_battery, RING, DESCEND, 500, 1500, "battery_critical"),
        (busy_processor, RING, OFF, 8, 8, "step_late"),
    ],
)
@on_virtual_time
async def test_what_fails_on_board_ends_in_its_action(
    fault: Any, conditions: dict[str, Any], action: int, within_ms: int, off_ms: int, cause: str
) -> None:
    async with Whole(conditions=conditions) as whole:
        drone = await whole.airborne(0.1 if conditions["rings"] else None)
        assert drone.state.safety.action == "none"
        first = whole.tick
        whole.drone.rig.distort = fault(whole)
        if fault is busy_processor:
            first += 1  # a step has overrun when its 4 ms are over
        await whole.passes(off_ms / 1000 + 0.1)
        tell(fault.__name__, "action", whole.ms(first, acts(action)), within_ms)
        tell(fault.__name__, "motors off", whole.ms(first, stands), off_ms)
        assert whole.steps[-1].step.reason & BIT[cause]
        await whole.passes(0.6)
        assert all(stands(seen) for seen in whole.steps[-100:])
        assert (drone.state.safety.action, drone.state.safety.reason) == ("off", cause)
        await drone.disarm()
        await drone.close()


@on_virtual_time
async def test_a_last_resort_that_gives_no_number_stops_the_motors_at_once() -> None:
    async with Whole() as whole:
        drone = await whole.airborne()
        first = whole.tick
        whole.drone.controller.code.machine.set_state("cascade.rate.sum", math.nan)
        await whole.passes(0.5)
        tell("NaN of the stock controller", "motors off", whole.ms(first, stands), 8)
        assert whole.steps[-1].step.reason & BIT["command_lost"]
        assert (drone.state.safety.action, drone.state.safety.reason) == ("off", "command_lost")
        await drone.close()


@pytest.mark.long
@pytest.mark.parametrize(
    ("trusted", "wrong"),
    [
        pytest.param(True, 1.0, id="native, infinity"),
        pytest.param(False, 0.0, id="sandbox, NaN"),
        pytest.param(True, 0.0, id="native, NaN", marks=pytest.mark.soak),
        pytest.param(False, 1.0, id="sandbox, infinity", marks=pytest.mark.soak),
    ],
)
@on_virtual_time
async def test_a_controller_of_ones_own_that_gives_no_number_never_reaches_a_motor(trusted: bool, wrong: float) -> None:
    """From its step FAILS_AT on, two seconds into the flight."""
    async with Whole(controllers=[failing(FAILS_AT, wrong)], trusted=trusted) as whole:
        drone = await whole.airborne()
        await whole.passes(2.0)
        assert all(math.isfinite(seen.step.fore) and math.isfinite(seen.step.aft) for seen in whole.steps)
        tell("NaN of one's own", "level", whole.ms(FAILS_AT, acts(LEVEL)), 8)
        assert not stands(whole.steps[-1])  # the stock controller flies
        assert abs(whole.steps[-1].theta) < LEVEL_RAD
        assert (drone.state.safety.action, drone.state.safety.reason) == ("level", "user_failed")
        await drone.close()


@pytest.mark.long
@on_virtual_time
async def test_a_controller_in_its_sandbox_that_overruns_is_replaced_in_its_tick() -> None:
    async with Whole(controllers=[exhausting(FAILS_AT)], fuel=15_000) as whole:
        drone = await whole.airborne()
        await whole.passes(2.0)
        tell("overrun of one's own", "level", whole.ms(FAILS_AT, acts(LEVEL)), 8)
        assert silent(whole.since(FAILS_AT - 10)[:10])
        assert not stands(whole.steps[-1])
        assert abs(whole.steps[-1].theta) < LEVEL_RAD
        assert drone.state.safety.reason == "user_failed"
        assert any("fuel" in text.text for text in drone.messages)
        await drone.close()


@pytest.mark.long
@pytest.mark.parametrize("conditions", [RING, FREE], ids=["rings", "free"])
@on_virtual_time
async def test_set_points_at_both_limits_in_turn_meet_no_stop(conditions: dict[str, Any]) -> None:
    """Beyond them, pitch with full thrust or position with acceleration, from one end to the other each .3 s."""
    async with Whole(conditions=conditions) as whole:
        drone = await whole.airborne(0.0 if conditions["rings"] else None)
        first = whole.tick
        for turn in range(10):
            sign = 1.0 if turn % 2 else -1.0
            if conditions["rings"]:
                await drone.set_pitch(sign * 1.5, thrust=1.0)
            else:
                await drone.set_position(sign * 1.0, acceleration=sign * 50.0)
            await drone.run(0.3)
        flown = [seen for seen in whole.steps if seen.step.tick >= first]
        assert {round(seen.step.theta0, 2) for seen in flown} >= {-0.6, 0.6} or not conditions["rings"]
        assert max(abs(seen.theta) for seen in flown) < PITCH_STOP
        assert all(0.0 <= value <= 1.0 for seen in flown for value in (seen.step.fore, seen.step.aft))
        assert all(seen.step.action in (NONE, LEVEL, BRAKE) for seen in flown)
        assert max(abs(seen.x) for seen in flown) < RAIL_STOP
        drone.stop_setpoints()
        last = whole.tick
        await whole.passes(2.0)
        tell("set-points at the limits, then none", "level", whole.ms(last, acts(LEVEL)), 1000)
        assert abs(whole.steps[-1].theta) < LEVEL_RAD or not conditions["rings"]
        await drone.close()
