"""Commands: each is acknowledged once to its sender, and a repeated one is not carried out twice."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fcu.mavlink.world import CLIENT, World
from twodof.fcu.command.command_lease import CommandResult, denied, rejected
from twodof.link.mavlink import modes
from twodof.link.mavlink.dialect import MavResult
from twodof.link.mavlink.messages import message

REFUSED = rejected("somebody else holds the lease")
US = {"target_system": 1, "target_component": 1}
NUMBERS = st.floats(width=32)


@settings(max_examples=40)
@given(number=st.integers(0, 65535), params=st.tuples(*[NUMBERS] * 7))
def test_every_command_is_acknowledged_once_to_who_sent_it(number: int, params: tuple[float, ...]) -> None:
    world = World()
    world.command(number, *params, peer="somebody", source=(77, 190))
    world.say(
        message("COMMAND_INT", command=number, **US, **{f"param{n}": params[n - 1] for n in (1, 2, 3, 4)}),
        "somebody",
        (78, 1),
    )
    # The first was taken by `command`.
    (ack,) = world.taken("COMMAND_ACK", "somebody")
    assert (ack.command, ack.target_system, ack.target_component) == (number, 78, 1)
    world.sent.clear()
    world.run(2)
    assert world.taken("COMMAND_ACK") == []


def test_commands_for_others_are_none_of_ours() -> None:
    world = World()
    for system, component in ((2, 1), (1, 2), (2, 0), (255, 190)):
        world.say(message("COMMAND_LONG", command=400, param1=1.0, target_system=system, target_component=component))
    assert world.taken("COMMAND_ACK") == []
    assert world.commander.asked == []


def test_of_commands_to_all_only_those_that_ask_or_stop_are_for_us() -> None:
    world = World()
    for number, value in ((512, 148.0), (519, 1.0), (400, 0.0), (185, 1.0)):
        world.say(message("COMMAND_LONG", command=number, param1=value))
        assert [ack.command for ack in world.taken("COMMAND_ACK")] == [number]
    assert [one[0] for one in world.commander.asked] == ["disarm", "kill"]
    world.commander.asked.clear()
    for number, value in ((400, 1.0), (400, math.nan), (176, 1.0), (246, 1.0), (511, 30.0), (262, 1.0)):
        world.say(message("COMMAND_LONG", command=number, param1=value, param2=6.0))
        world.say(message("COMMAND_INT", command=number, param1=value, param2=6.0))
    assert world.taken("COMMAND_ACK") == []
    assert world.commander.asked == []


def test_a_command_that_claims_to_be_from_us_is_ignored() -> None:
    world = World()
    world.say(message("COMMAND_LONG", command=400, param1=1.0, **US), source=(1, 1))
    assert world.taken("COMMAND_ACK") == []
    assert world.commander.asked == []


@pytest.mark.parametrize(("number", "first"), [(400, 0.0), (185, 1.0)])
def test_but_what_stops_motors_is_obeyed_under_whatever_number_it_comes(number: int, first: float) -> None:
    world = World()
    world.say(message("COMMAND_LONG", command=number, param1=first, **US), source=(1, 1))
    assert [one.result for one in world.taken("COMMAND_ACK")] == [MavResult.ACCEPTED]
    assert len(world.commander.asked) == 1


def test_checks_run_all_the_time() -> None:
    world = World()
    assert world.command(401) == MavResult.ACCEPTED
    world.commander.armed = True
    assert world.command(401) == MavResult.ACCEPTED  # as PX4: a client that comes in flight asks, too


@pytest.mark.parametrize(
    ("params", "asked"),
    [
        ((1.0,), ("arm", CLIENT)),
        ((1.0, 21196.0), ("arm", CLIENT)),
        ((0.0,), ("disarm", CLIENT)),
        ((0.0, 21196.0), ("kill", CLIENT)),
    ],
)
def test_arming_is_the_commanders(params: tuple[float, ...], asked: tuple[object, ...]) -> None:
    world = World()
    assert world.command(400, *params) == MavResult.ACCEPTED
    assert world.commander.asked == [asked]


@settings(max_examples=40)
@given(value=NUMBERS.filter(lambda value: value not in (0.0, 1.0)), force=NUMBERS)
def test_neither_arm_nor_disarm_is_denied(value: float, force: float) -> None:
    world = World()
    assert world.command(400, value, force) == MavResult.DENIED
    assert world.commander.asked == []


def test_a_refusal_says_why_to_who_asked() -> None:
    world = World()
    world.commander.verdict = REFUSED
    assert world.command(400, 1.0, peer="me") == MavResult.TEMPORARILY_REJECTED
    (said,) = world.taken("STATUSTEXT", "me")
    assert said.text == REFUSED.text
    long = "x" * 120
    world.commander.verdict = denied(long)
    world.command(400, 1.0)
    pieces = world.taken("STATUSTEXT")
    assert "".join(piece.text for piece in pieces) == long
    assert [piece.chunk_seq for piece in pieces] == [0, 1, 2]
    assert len({piece.id for piece in pieces}) == 1
    assert pieces[0].id > 0


def test_what_was_refused_in_the_end_is_not_accepted_when_it_is_repeated() -> None:
    world = World()
    world.commander.verdict = world.commander.answer = CommandResult(MavResult.IN_PROGRESS)
    world.command(400, 1.0)
    assert world.command(400, 1.0, confirmation=1) == -1  # the same is in progress still
    world.commander.answer = rejected("tilted")
    world.run()
    assert [ack.result for ack in world.taken("COMMAND_ACK")] == [MavResult.TEMPORARILY_REJECTED]
    world.commander.verdict = CommandResult(MavResult.DENIED)
    assert world.command(400, 1.0, confirmation=2) == MavResult.DENIED
    assert [one[0] for one in world.commander.asked] == ["arm", "arm"]


@pytest.mark.parametrize("lockstep", [False, True])
def test_disarming_does_not_wait_for_an_arming_in_progress(lockstep: bool) -> None:
    world = World(lockstep=lockstep)
    world.commander.verdict = world.commander.answer = CommandResult(MavResult.IN_PROGRESS)
    world.command(400, 1.0)
    world.commander.verdict = CommandResult(MavResult.ACCEPTED)
    assert world.command(400, 0.0) == MavResult.ACCEPTED
    assert [one[0] for one in world.commander.asked] == ["arm", "disarm"]


def test_a_repetition_is_acknowledged_and_not_carried_out_again() -> None:
    world = World()
    assert world.command(400, 1.0) == MavResult.ACCEPTED
    for confirmation in (1, 2, 3):
        assert world.command(400, 1.0, confirmation=confirmation) == MavResult.ACCEPTED
    assert len(world.commander.asked) == 1
    world.run(200)
    # Half a second later it is another one.
    assert world.command(400, 1.0, confirmation=4) == MavResult.ACCEPTED
    assert len(world.commander.asked) == 2


def test_a_frame_that_the_network_doubled_does_not_arm_again() -> None:
    world = World()
    arm = message("COMMAND_LONG", command=400, param1=1.0, **US)
    world.say(arm, sequence=7)
    world.command(400, 0.0)
    world.say(arm, sequence=7)
    assert [one[0] for one in world.commander.asked] == ["arm", "disarm"]
    world.say(arm, sequence=8)  # the client says it again
    world.say(arm, sequence=7, source=(251, 1))  # another client
    world.say(arm, "elsewhere", sequence=7)
    assert [one[0] for one in world.commander.asked] == ["arm", "disarm", "arm", "arm", "arm"]


@pytest.mark.parametrize(("number", "params"), [(400, (0.0,)), (400, (0.0, 21196.0)), (185, (1.0,))])
def test_what_stops_motors_is_carried_out_as_often_as_it_comes(number: int, params: tuple[float, ...]) -> None:
    """Another client may have armed between a kill and the same kill said again."""
    world = World()
    for confirmation in (0, 1, 2):
        assert world.command(number, *params, confirmation=confirmation) == MavResult.ACCEPTED
    assert len(world.commander.asked) == 3
    stop = message("COMMAND_LONG", command=number, **{f"param{n}": p for n, p in enumerate(params, 1)}, **US)
    world.say(stop, sequence=7)
    world.say(stop, sequence=7)
    assert len(world.commander.asked) == 5


def test_in_lockstep_where_time_stands_equal_frames_of_two_sessions_are_two_commands() -> None:
    world = World(lockstep=True)
    arm = message("COMMAND_LONG", command=400, param1=1.0, **US)
    world.say(arm, sequence=7)
    world.say(arm, sequence=7)
    assert len(world.commander.asked) == 2


def test_termination_is_a_kill_and_0_releases_it() -> None:
    world = World()
    for first, asked in ((1.0, "kill"), (0.51, "kill"), (math.inf, "kill"), (0.0, "release"), (-0.0, "release")):
        assert world.command(185, first) == MavResult.ACCEPTED
        world.run(200)
        assert world.commander.asked == [(asked, CLIENT)]
        world.commander.asked.clear()
    for first in (0.5, 0.49, -1.0, math.nan, -math.inf):
        assert world.command(185, first) == MavResult.DENIED
    assert world.commander.asked == []
    world.commander.verdict = REFUSED
    assert world.command(185, 0.0) == MavResult.TEMPORARILY_REJECTED


def test_a_release_is_for_one_drone_and_from_another() -> None:
    """Unlike a kill, which all obey, under any number."""
    world = World()
    world.say(message("COMMAND_LONG", command=185, param1=0.0, target_system=0, target_component=0))
    world.say(message("COMMAND_LONG", command=185, param1=0.0, **US), source=(1, 1))
    assert world.taken("COMMAND_ACK") == []
    assert world.commander.asked == []


def test_restart() -> None:
    world = World()
    assert world.command(246, 0.0) == MavResult.ACCEPTED
    for other in (2.0, 3.0, 4.0):  # shut down, stay in the boot loader, power on
        assert world.command(246, other) == MavResult.UNSUPPORTED
    assert world.command(246, 9.0) == MavResult.DENIED
    assert world.restarts == 0
    assert world.command(246, 1.0) == MavResult.ACCEPTED
    assert world.restarts == 1
    assert [one[0] for one in world.commander.asked] == ["take", "release"], "as after being switched on"
    world.commander.armed = True
    assert world.command(246, 1.0) == MavResult.TEMPORARILY_REJECTED
    world.commander.armed, world.commander.verdict = False, REFUSED
    assert world.command(246, 1.0) == MavResult.TEMPORARILY_REJECTED
    assert world.restarts == 1
    assert World(restart=None).command(246, 1.0) == MavResult.UNSUPPORTED


@pytest.mark.parametrize("mode", modes.MODES, ids=lambda mode: mode.name)
def test_a_mode_is_set_by_command_and_by_set_mode(mode: modes.FlightMode) -> None:
    world = World()
    assert world.command(176, 1.0, mode.main, mode.sub) == MavResult.ACCEPTED
    # With the bit for armed, as MAVSDK sends it.
    assert world.command(176, 129.0, mode.main, mode.sub) == MavResult.ACCEPTED
    world.say(message("SET_MODE", target_system=1, base_mode=1, custom_mode=mode.custom_mode))
    assert world.commander.asked == [("mode", CLIENT, mode.custom_mode)] * 3
    assert world.command(512, 436.0) == MavResult.ACCEPTED
    assert world.taken("CURRENT_MODE")[0].custom_mode == mode.custom_mode


def test_modes_that_are_none_of_px4s() -> None:
    world = World()
    for params in ((0.0, 6.0), (math.nan, 6.0), (1.0, math.nan), (1.0, 256.0), (1.0, -1.0), (1.0, 1e30)):
        assert world.command(176, *params) == MavResult.DENIED
    world.say(message("SET_MODE", target_system=1, base_mode=0, custom_mode=6 << 16))
    world.say(message("SET_MODE", target_system=2, base_mode=1, custom_mode=6 << 16))
    assert world.commander.asked == []


def test_set_mode_is_acknowledged_as_command_176() -> None:
    world = World()
    for verdict in (CommandResult(MavResult.ACCEPTED), REFUSED):
        world.commander.verdict = verdict
        world.say(message("SET_MODE", target_system=1, base_mode=1, custom_mode=6 << 16), "asks")
        assert [(ack.command, ack.result) for ack in world.taken("COMMAND_ACK", "asks")] == [(176, verdict.result)]
    assert world.texts() == REFUSED.text


def test_standard_modes() -> None:
    world = World()
    assert world.command(262, 1.0) == MavResult.ACCEPTED
    assert world.commander.asked == [("mode", CLIENT, modes.POSITION)]
    for standard in (0.0, 7.0, 99.0, math.nan):
        assert world.command(262, standard) == MavResult.UNSUPPORTED


def test_the_modes_there_are() -> None:
    world = World()
    assert world.command(512, 435.0, 0.0) == MavResult.ACCEPTED
    rows = world.taken("AVAILABLE_MODES")
    assert [row.custom_mode for row in rows] == [mode.custom_mode for mode in modes.MODES]
    assert [row.mode_index for row in rows] == [*range(1, len(rows) + 1)]
    assert {row.number_modes for row in rows} == {len(rows)}
    assert world.command(512, 435.0, 2.0) == MavResult.ACCEPTED
    assert [row.mode_name for row in world.taken("AVAILABLE_MODES")] == [modes.MODES[1].name]
    assert world.command(512, 435.0, 99.0) == MavResult.DENIED


def test_heartbeat_tells_a_new_mode_at_once_and_comes_once_a_second_to_everybody() -> None:
    world = World()
    world.run(10)
    world.sent.clear()
    world.command(176, 1.0, 6.0)
    (beat,) = [one for one, to in world.sent if one.get_type() == "HEARTBEAT" and to is None]
    assert (beat.custom_mode, beat.type, beat.autopilot, beat.mavlink_version) == (6 << 16, 2, 12, 3)
    world.sent.clear()
    world.run(2500)
    assert len(world.taken("HEARTBEAT", None)) == 10


def test_a_new_client_is_greeted_at_once() -> None:
    world = World()
    world.say(message("HEARTBEAT"), "new")
    world.say(message("HEARTBEAT"), "new")
    assert len(world.taken("HEARTBEAT", "new")) == 1


def test_remarks_go_to_everybody_in_words() -> None:
    world = World()
    world.commander.remarks.append((2, "the motors were stopped"))
    world.run()
    assert [(one.severity, one.text) for one in world.taken("STATUSTEXT", None)] == [(2, "the motors were stopped")]
    assert world.commander.remarks == []
