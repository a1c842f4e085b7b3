"""Numbers of 32 bits that run over: stamps in milliseconds after 49 days, ticks after 198; in lockstep within hours.

A flight over such a moment is the same flight as one just after the start: what it asks, commands and sends.
"""

from pathlib import Path

import pytest

from tests.fcu.assembled import INTERVAL, TARGET, Assembled
from twodof.excitation import Impulse
from twodof.fcu.command.setpoints import FRESH
from twodof.fcu.mavlink.service import RUN_OVER, RUN_OVER_MS, acts_at, acts_at_ms, unwrap
from twodof.link.mavlink.dialect import message_id
from twodof.link.mavlink.messages import excite, message

pytestmark = pytest.mark.slow

MASK_32 = 2**32 - 1
BEFORE, AFTER = 170, 140  # ticks of the flight before and after the moment
EVERYTHING = ("ATTITUDE", "HIGHRES_IMU", "LOCAL_POSITION_NED", "SYSTEM_TIME", "SERVO_OUTPUT_RAW", "DISTANCE_SENSOR")
OWN = ("TWODOF_TOF", "TWODOF_TRUTH", "TWODOF_RIG", "TWODOF_SAFETY", "TWODOF_TIMING", "TWODOF_OPENLOOP", "TWODOF_LEASE")
STAMPS = {"time_boot_ms", "event_time_boot_ms", "time_usec", "time_unix_usec", "tick", "start_tick", "end_tick"} | {
    *("until", "step", "since", "start")
}
MOMENTS = {"int32 ms": 2**29, "uint32 ms, int32 ticks": 2**31, "uint32 ms and ticks": RUN_OVER}
PHASE = 3_000_000  # a multiple of the ticks between two messages of each stream, so that both flights send them alike


def flight(begin: int, state: Path | None) -> Assembled:
    """Fly a stream, an open loop sent ahead and a waiting excitation, each by its ticks."""
    drone = Assembled(begin, lockstep=True, state=state)

    def until(ticks: int) -> None:
        number = ticks & 0xFF
        drone.say(message("TWODOF_GRANT", until=begin + ticks & MASK_32, number=number, **TARGET))
        drone.run(drone.drone.controller.granted - drone.tick)
        assert drone.tick == begin + ticks, "granted"

    def ms(ticks: int) -> int:
        return (begin + ticks) * 4 & MASK_32

    drone.say(message("TWODOF_LEASE", action=1, duration_ms=20_000, **TARGET))
    drone.command(INTERVAL, message_id("ODOMETRY"), -1.0)  # 30 Hz is not a whole number of ticks: other ticks
    for name in (*EVERYTHING, *OWN):
        drone.command(INTERVAL, message_id(name), 4000.0)
    drone.command(INTERVAL, message_id("TWODOF_BATCH"), 4000.0, 0xFFF, 0)
    drone.command(512, message_id("COMPONENT_METADATA"))
    until(100)
    drone.fly()
    tick = drone.tick - begin
    for ahead in range(1, BEFORE + AFTER - tick - 40, 10):
        pitch = 0.002 * ahead
        fields = {"type_mask": 7, "q": [1.0, 0.0, pitch, 0.0], "thrust": 0.4, "time_boot_ms": ms(tick + ahead)}
        drone.say(message("SET_ATTITUDE_TARGET", **fields, **TARGET))
    until(BEFORE + 10)
    at = BEFORE + AFTER - 50
    for piece in excite(Impulse(0.05, 0.04, settle=0.02, unit="rad"), 2, 7, 1, 1):
        drone.say(piece)
    drone.say(message("TWODOF_EXCITE", action=1, transfer=7, loop=2, thrust=0.4, tick=begin + at & MASK_32, **TARGET))
    openloop = {"M": 0.02, "T": 0.4, "openloop": 1, "enableM": 1, "enableT": 1}
    drone.say(message("TWODOF_OPENLOOP", **openloop, tick=begin + at + 30 & MASK_32, **TARGET))
    until(BEFORE + AFTER)
    drone.command(400, 0.0)
    until(BEFORE + AFTER + 10)
    drone.drone.assembly.close()
    return drone


def told(drone: Assembled) -> list[list[str]]:
    """Names and fields of the messages that were sent, sorted, without their stamps."""
    fields = [sorted(f"{k} {v}" for k, v in one.to_dict().items() if k not in STAMPS) for one in drone.sent]
    return sorted([one.get_type(), *rest] for one, rest in zip(drone.sent, fields, strict=True))


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_flight_in_which_a_number_runs_over_is_the_same_flight(moment: str, tmp_path: Path) -> None:
    begin = MOMENTS[moment] - BEFORE
    early = begin % PHASE
    drone, judge = flight(begin, tmp_path / "late"), flight(early, tmp_path / "early")
    log = drone.drone.assembly.log
    assert log is not None
    assert (log.dropped, log.failure) == (0, None)
    assert [step.tick - begin for step in drone.steps] == [step.tick - early for step in judge.steps]
    assert [step.asked for step in drone.steps] == [step.asked for step in judge.steps]
    assert [(step.fore, step.aft) for step in drone.steps] == [(step.fore, step.aft) for step in judge.steps]
    assert told(drone) == told(judge)
    asked = [step.asked for step in judge.steps]
    assert {one.mode for one in asked} == {0, 1, 3}
    assert max(one.theta0 for one in asked) > 0.1
    assert sum(one.M_open > 0.0 for one in asked) > 10
    assert not judge.steps[-1].armed
    assert {one.get_type() for one in judge.sent} >= {*EVERYTHING, *OWN, "TWODOF_BATCH", "COMPONENT_METADATA"}


@pytest.mark.parametrize("run_over", [RUN_OVER, RUN_OVER_MS])
@pytest.mark.parametrize("now", [0, 1, 2**29, 2**30 - 1, 2**30, 2**31, 2**32 - 1, 2**32, 5 * 2**32 + 7])
@pytest.mark.parametrize("ahead", [-FRESH, -1, 0, 1, 15_000, 25_000])
def test_a_tick_on_the_wire_is_the_one_that_is_near(run_over: int, now: int, ahead: int) -> None:
    tick = now + ahead
    if tick >= 0:
        assert unwrap(tick % run_over, now, run_over) == tick
        assert acts_at(tick & MASK_32, now) == (tick if tick & MASK_32 else 0), "0 is at once"
        assert acts_at_ms(4 * tick & MASK_32, now) == (tick if 4 * tick & MASK_32 else 0)


def test_before_anything_has_run_over_a_field_is_its_own_tick() -> None:
    for now in (0, 1, 10**6):
        for value in (0, 1, 2**31 - 1, MASK_32):
            assert unwrap(value, now) == value
    assert acts_at_ms(MASK_32, 0) == RUN_OVER_MS
    assert acts_at_ms(5, 0) == 2, "the first tick that is not before it"
