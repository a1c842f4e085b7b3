"""Work item in flight while other modules publish, a command stops it, or the gyro falls silent."""

from collections.abc import Callable

import numpy as np
import pytest

from tests.compile.px4.build import Bench, Events
from tests.compile.px4.flown import NO_SETPOINT, NOT_FINITE, PERIOD, SHARED, STALE, fly, mode

pytestmark = pytest.mark.slow

DISARM, FORCED = 400, 21196
COMMANDS = ("vehicle_thrust_setpoint", "vehicle_torque_setpoint")


def silence(bench: Bench, seconds: float, armed: bool = True) -> None:
    """Time without a sample of the gyro, in which all else goes on."""
    for _ in range(round(seconds / 0.02)):
        bench.at(bench.now + 5 * PERIOD)
        mode(bench, armed)


def asked(events: Events) -> list[float]:
    """When [s] PX4 was asked to disarm, in flight too; the test fails if it was asked anything else."""
    rows = events.topic("vehicle_command")
    assert {(int(r["command"]), float(r["param1"]), float(r["param2"])) for r in rows} <= {(DISARM, 0.0, FORCED)}
    return [float(row["timestamp"]) * 1e-6 for row in rows]


@pytest.mark.long
@pytest.mark.parametrize("topic", ["rate_ctrl_status", "vehicle_torque_setpoint", "vehicle_thrust_setpoint"])
def test_it_does_not_start_beside_another_that_commands(built: Bench, topic: str) -> None:
    built.fresh()
    built.advertise(topic)
    built.command("start")
    built.end(topic)  # as mc_rate_control does when it stops
    built.command("start")
    events = built.run()
    assert events.returned() == [-1, 0]
    assert topic in " ".join(events.said())


@pytest.mark.long
def test_it_does_not_start_while_armed_and_leaves_the_flight_to_who_commands(built: Bench) -> None:
    built.fresh()
    built.advertise("rate_ctrl_status")
    mode(built)
    built.command("disarmed")
    built.command("start")
    mode(built, armed=False)
    built.end("rate_ctrl_status")
    built.command("disarmed")
    built.command("start")
    events = built.run()
    assert events.returned() == [-1, -1, 0, 0]
    assert set(events.told()) == {"twodof_pitch: not started while armed"}
    assert asked(events) == []


@pytest.mark.long
@pytest.mark.parametrize("rates", [True, False], ids=["that it would control", "that is another's"])
def test_a_start_in_a_flight_that_nobody_controls_disarms(built: Bench, rates: bool) -> None:
    built.fresh()
    mode(built, rates=rates)
    built.command("start")
    events = built.run()
    assert events.returned() == [-1]
    assert len(asked(events)) == rates


@pytest.mark.parametrize("topic", COMMANDS)
def test_another_that_ends_takes_no_command_away(bench: Bench, topic: str) -> None:
    fly(bench, 10)
    bench.end(topic)
    fly(bench, 10)
    events = bench.run()
    assert events.lost() == []
    assert len(events.topic(topic)) == 20
    rows = events.topic("twodof_pitch")
    assert list(rows["faults"]) == [0] * 10 + [SHARED] + [0] * 9
    assert rows["active"].all()
    assert len([text for text in events.told() if topic in text]) == 1


def test_another_that_commands_too_is_told_once_and_seen_all_the_time(bench: Bench) -> None:
    fly(bench, 5)
    for _ in range(50):
        bench.publish("vehicle_torque_setpoint", xyz=[0.0, 0.3, 0.0])
        fly(bench, 1)
    fly(bench, 5)
    events = bench.run()
    assert list(events.topic("twodof_pitch")["faults"]) == [0] * 5 + [SHARED] * 50 + [0] * 5
    assert len([text for text in events.told() if "vehicle_torque_setpoint" in text]) == 1


def test_it_does_not_stop_in_flight(bench: Bench) -> None:
    fly(bench, 5)
    bench.command("stop")
    fly(bench, 5)
    events = bench.run()
    assert events.returned() == [0, -1]
    assert events.topic("vehicle_torque_setpoint")["xyz"][:, 1].all()
    assert events.topic("twodof_pitch")["active"].all()
    assert "not stopped while armed: disarm first, or `twodof_pitch stop -f`" in " ".join(events.said())


@pytest.mark.parametrize("queued", [False, True], ids=["alone", "with a run asked for before"])
def test_a_forced_stop_in_flight_disarms_and_leaves_no_command_behind(started: Bench, queued: bool) -> None:
    started.publish("vehicle_status", system_id=7, component_id=1)
    mode(started)
    fly(started, 5)
    started.obey()
    if queued:
        started.publish("vehicle_angular_velocity", at_once=False)
    started.command("stop", "-f")
    fly(started, 5)
    events = started.run()
    assert events.returned() == [0, 0]
    assert len(asked(events)) == 1
    command = events.topic("vehicle_command")[0]
    for part, number in (("system", 7), ("component", 1)):  # else mavlink would send it to other vehicles
        assert command[f"target_{part}"] == command[f"source_{part}"] == number
    assert any("stopped while armed" in text for text in events.told())
    torque, thrust = (events.topic(f"vehicle_{what}_setpoint")["xyz"] for what in ("torque", "thrust"))
    assert len(torque) == len(thrust) == 6
    assert torque[4].any()
    assert thrust[4].any()
    assert not torque[5].any()
    assert not thrust[5].any()
    # PX4's allocator runs after the module on the same queue, and reads nothing of a topic without a publication.
    for topic in COMMANDS:
        assert events.withdrawn()[topic] >= events.topic(topic)["timestamp"][5] + 5 * PERIOD


def test_a_forced_stop_commands_nothing_to_move_until_px4_has_disarmed(bench: Bench) -> None:
    fly(bench, 5)
    begin = bench.now
    bench.command("stop", "-f")
    events = bench.run()
    end = events.withdrawn()["vehicle_torque_setpoint"]
    assert 1_000_000 <= end - begin <= 1_100_000
    rows = events.topic("vehicle_torque_setpoint")[5:]
    assert not rows["xyz"].any()
    assert np.diff(rows["timestamp"].astype(np.int64)).max() <= 6 * PERIOD
    assert any("PX4 is armed and nobody commands" in text for text in events.told())


def test_disarmed_it_stops_at_once_and_without_a_word(started: Bench) -> None:
    mode(started, armed=False)
    fly(started, 5)
    started.command("stop")
    events = started.run()
    assert events.returned() == [0, 0]
    assert events.told() == []
    assert len(events.topic("vehicle_command")) == 0
    assert len(events.topic("vehicle_torque_setpoint")) == 6


def test_a_gyro_that_falls_silent_in_flight_is_told_and_px4_is_asked_to_disarm(bench: Bench) -> None:
    fly(bench, 50)
    begin = bench.now
    silence(bench, 1.2)
    events = bench.run()
    assert [text for text in events.told() if "motors off" in text] == ["twodof_pitch: motors off: gyro silent"]
    first, second = (round(t - begin * 1e-6, 3) for t in asked(events))
    assert 0.5 <= first <= 0.56
    assert 0.5 <= second - first <= 0.52
    assert not events.topic("vehicle_torque_setpoint")["xyz"][50:].any()
    silent = events.topic("twodof_pitch")[50:]  # one each 20 ms, the first of them 20 ms after the last sample
    # After 1 s the thrust set-point is too old as well.
    assert list(silent["faults"]) == [STALE] * 49 + [STALE | NO_SETPOINT] * 11
    assert not silent["active"].any()


def test_once_px4_has_disarmed_it_is_not_asked_again(bench: Bench) -> None:
    fly(bench, 5)
    silence(bench, 0.6)
    silence(bench, 2.0, armed=False)
    assert len(asked(bench.run())) == 1


def test_a_short_silence_is_told_and_flown_through(bench: Bench) -> None:
    fly(bench, 50)
    silence(bench, 0.3)
    fly(bench, 50)
    events = bench.run()
    assert asked(events) == []
    assert len(events.told()) == 1
    rows = events.topic("twodof_pitch")
    assert rows["active"][-50:].all()


def test_a_gyro_that_is_silent_while_disarmed_is_nobodys_business(started: Bench) -> None:
    mode(started, armed=False)
    fly(started, 50)
    silence(started, 2.0, armed=False)
    events = started.run()
    assert events.told() == []
    assert asked(events) == []


def test_an_attitude_that_stays_away_is_told_and_px4_is_asked_to_disarm(bench: Bench) -> None:
    fly(bench, 10)
    for _ in range(200):
        bench.at(bench.now + PERIOD)
        bench.publish("vehicle_angular_velocity")
    events = bench.run()
    assert [text for text in events.told() if "motors off" in text] == [
        "twodof_pitch: motors off: no sound measurement"
    ]
    assert len(asked(events)) == 1
    assert set(events.topic("twodof_pitch")["faults"][-100:]) == {STALE}


@pytest.mark.long
def test_single_commands_that_are_not_finite_are_told_once_and_do_not_disarm(benches: Callable[[str], Bench]) -> None:
    bench = benches("overflow")
    bench.command("start")
    mode(bench)
    fly(bench, 400)
    events = bench.run()
    assert ((events.topic("twodof_overflow")["faults"] & NOT_FINITE) != 0).sum() == 100
    assert [t for t in events.told() if "off" in t] == ["twodof_overflow: motors off: command not finite"]
    assert asked(events) == []


@pytest.mark.long
def test_a_position_module_leaves_the_attitude_set_point_to_the_others_when_it_ends(
    benches: Callable[[str], Bench],
) -> None:
    bench = benches("rail")
    bench.publish("vehicle_attitude_setpoint")  # mavlink does in Offboard, and goes on
    bench.command("start")
    bench.command("stop")
    bench.script.append("flag vehicle_attitude_setpoint")
    bench.advertise("takeoff_status")
    bench.command("start")
    events = bench.run()
    assert events.returned() == [0, 0, -1]
    assert [rest for what, rest in events.rows if what == "flag"] == ["1"]
    assert "mc_pos_control" in " ".join(events.said())
