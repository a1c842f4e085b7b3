"""Routing: each frame to whom it concerns, to nobody else, as it is; what is not the sender's to say goes nowhere."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.companion.ends import SYSTEM, Ends, frame, names
from twodof.link.mavlink.dialect import COMPANION
from twodof.link.mavlink.framing import Parser, encode
from twodof.link.mavlink.messages import message

IDENTITIES = [(250, 190), (250, 191), (255, 190), (245, 190), (9, 1)]
SPEAKERS = st.lists(st.tuples(st.integers(0, 2), st.sampled_from(IDENTITIES)), max_size=12)


@settings(max_examples=40)
@given(SPEAKERS, st.sampled_from([*IDENTITIES, (250, 0), (9, 0), (77, 1)]))
def test_an_answer_reaches_exactly_those_it_is_addressed_to(
    spoken: list[tuple[int, tuple[int, int]]], to: tuple[int, int]
) -> None:
    ends = Ends("none", "none", "none")
    for place, (system, component) in spoken:
        ends.says(ends.clients[place], "HEARTBEAT", system, component)
    ends.settle()
    ends.vehicle("COMMAND_ACK", command=400, target_system=to[0], target_component=to[1])
    exact = {place for place, identity in spoken if identity == to}
    of_system = {place for place, (system, _) in spoken if system == to[0]}
    expected = exact or of_system  # MAVLink routes by system; where the very component is known, to it alone
    assert {place for place in range(3) if ends.heard(ends.clients[place])} == expected


@given(
    st.integers(0, 2), st.sampled_from(["SET_ATTITUDE_TARGET", "HEARTBEAT", "PARAM_SET", "TWODOF_GRANT", "TIMESYNC"])
)
def test_what_a_client_says_to_the_vehicle_reaches_it_unchanged_and_no_other_client(place: int, name: str) -> None:
    ends = Ends("onboard", "ground", "none")
    ends.settle()
    fields = {"target_system": SYSTEM, "target_component": 1} if name not in ("HEARTBEAT", "TIMESYNC") else {}
    sent = frame(name, 250, 190, 77, **fields)
    ends.router.from_client(ends.clients[place], sent)
    said = [raw for raw in ends.up.sent if raw[5] != SYSTEM]  # what the companion asks itself is not the client's
    assert said == [sent.raw]
    assert [ends.heard(client) for client in ends.clients] == [[], [], []]


def test_messages_that_the_dialect_has_not_and_signed_ones_pass_as_they_are() -> None:
    ends = Ends("onboard", "ground")
    ends.settle()
    raw = bytearray(encode(message("TUNNEL", target_system=0), SYSTEM, 1, 9))
    raw[7:10] = (60_000).to_bytes(3, "little")
    (unknown,) = Parser().feed(bytes(raw), whole=True)
    ends.router.from_vehicle(unknown)
    assert [ends.sinks[client].sent for client in ends.clients] == [[unknown.raw], [unknown.raw]]
    ends.router.from_client(ends.clients[0], Parser().feed(bytes(raw[:5]) + b"\xfa" + bytes(raw[6:]), whole=True)[0])
    assert len(ends.up.sent) == 1


@pytest.mark.parametrize("identity", [(SYSTEM, 1), (SYSTEM, COMPANION), (0, 1)])
def test_nobody_speaks_in_the_vehicles_name(identity: tuple[int, int]) -> None:
    ends = Ends("onboard", "onboard")
    ends.settle()
    ends.says(ends.clients[0], "HEARTBEAT", *identity)
    ends.says(ends.clients[0], "COMMAND_ACK", *identity, target_system=250, target_component=190)
    assert ends.up.sent == []
    assert ends.heard(ends.clients[1]) == []


def test_a_frame_that_echoes_back_does_not_go_round() -> None:
    ends = Ends("onboard", "onboard")
    ends.vehicle("HEARTBEAT", component=50)  # some component behind the line
    (heard,) = ends.heard(ends.clients[0])[-1:]
    ends.settle()
    ends.router.from_client(ends.clients[0], heard)
    assert ends.up.sent == []


def test_clients_speak_to_each_other_only_by_name() -> None:
    ends = Ends("none", "none", "none")
    for client, system in zip(ends.clients, (250, 255, 245), strict=True):
        ends.says(client, "HEARTBEAT", system)
    assert all(ends.heard(client) == [] for client in ends.clients)
    ends.settle()
    ends.says(ends.clients[0], "PING", 250, target_system=255, target_component=190)
    assert names(ends.heard(ends.clients[1])) == ["PING"]
    assert ends.heard(ends.clients[2]) == []
    assert ends.up.sent == []  # it was not for the vehicle


@pytest.mark.parametrize(("command", "first"), [(400, 0.0), (185, 1.0)])
def test_a_kill_overtakes_a_flood_of_its_own_sender(command: int, first: float) -> None:
    ends = Ends("none", line_rate=5760.0)
    for _ in range(100):
        ends.says(ends.clients[0], "MANUAL_CONTROL", 250, target=SYSTEM, x=1)
    ends.up.sent = []
    ends.says(ends.clients[0], "COMMAND_LONG", 250, command=command, param1=first, target_system=SYSTEM)
    for _ in range(50):
        ends.now += 0.01
        ends.line.pump(ends.now)
    assert names([one for one in ends.up.take() if one.system == 250])[:2] == ["COMMAND_LONG", "MANUAL_CONTROL"]


def test_a_kill_is_known_until_it_is_released() -> None:
    ends = Ends("onboard")
    assert not ends.router.killed
    for component, status, killed in ((1, 4, False), (1, 8, True), (191, 4, True), (2, 3, True), (1, 3, False)):
        ends.router.from_vehicle(frame("HEARTBEAT", 1, component, type=2, system_status=status))
        assert ends.router.killed is killed


@pytest.mark.parametrize("name", ["ATTITUDE", "STATUSTEXT", "HEARTBEAT"])
def test_what_is_not_on_board_says_nothing_as_the_drones_own_system(name: str) -> None:
    """Whatever its component: clients that go by the system would take it for the drone's."""
    ends = Ends("none", "none")
    ends.settle()
    for component in range(256):
        ends.says(ends.clients[0], name, SYSTEM, component)
    assert ends.heard(ends.clients[1]) == []
    assert ends.up.sent == []
    assert not ends.clients[0].identities


def test_a_program_on_board_speaks_to_everybody() -> None:
    ends = Ends("none", "none")
    ends.clients[0].on_board = True
    ends.settle()
    ends.says(ends.clients[0], "STATUSTEXT", SYSTEM, 195, text="landed")
    assert names(ends.heard(ends.clients[1])) == ["STATUSTEXT"]
    assert ends.heard(ends.clients[0]) == []
    assert len(ends.up.sent) == 1


@settings(max_examples=40)
@given(st.lists(st.sampled_from(["ATTITUDE", "STATUSTEXT", "lost", "LOCAL_POSITION_NED"]), max_size=60))
def test_what_was_thinned_out_does_not_count_as_lost_and_what_was_lost_does(events: list[str]) -> None:
    ends = Ends("ground")
    ends.settle()
    lost, time, last = 0, 0, None
    unseen = 0
    for event in events:
        time += 4
        if event == "lost":
            ends._sequence = (ends._sequence + 1) & 0xFF
            unseen += 1
            continue
        ends.vehicle(event, **({} if event == "STATUSTEXT" else {"time_boot_ms": time}))
        lost, unseen = lost + unseen, 0
        for got in ends.heard(ends.clients[0]):
            if last is not None:
                gap = (got.sequence - last[0] - 1) % 256
                assert gap == lost - last[1]
            last = got.sequence, lost


def test_a_client_that_left_gets_nothing_and_wants_nothing() -> None:
    ends = Ends("none", "none")
    first, second = ends.clients
    ends.says(first, "COMMAND_LONG", 250, command=511, target_system=1, target_component=1, param1=30, param2=4000)
    assert ends.answer() == [(30, 4000.0)]
    ends.settle()
    ends.router.remove(first)
    assert (30, -1.0) in ends.answer()
    ends.vehicle("COMMAND_ACK", command=400, target_system=250, target_component=190)
    assert ends.heard(first) == []
    assert ends.router.clients == [second]


def test_twodofs_own_messages_go_to_those_who_know_them() -> None:
    ends = Ends("onboard", "onboard", "onboard")
    stranger, asking, speaking = ends.clients
    own = ("TWODOF_RIG", "TWODOF_TOF", "TWODOF_OPENLOOP", "TWODOF_EXCITE_STATUS")
    ends.says(asking, "COMMAND_LONG", 250, command=512, param1=54206, target_system=SYSTEM, target_component=1)
    ends.says(speaking, "TWODOF_LEASE", 251, action=1, target_system=SYSTEM, target_component=1)
    assert (54204, 0.0) in ends.answer()  # now somebody wants the rangefinder's samples
    ends.settle()
    for name in own:
        ends.vehicle(name)
    assert [tuple(names(ends.heard(client))) for client in (stranger, asking, speaking)] == [(), own, own]
