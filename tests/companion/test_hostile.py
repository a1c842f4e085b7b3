"""Frames with anything in them, from both sides; commands that are signed and not, with a key here and without."""

import random

import pytest

from tests.companion.ends import SYSTEM, Ends
from tests.link.mavlink.test_framing import random_message
from twodof.companion.client import MOST_IDENTITIES, MOST_REQUESTS
from twodof.companion.component import CompanionComponent, ComputerStatus
from twodof.companion.router import MOST_BEHIND, Router
from twodof.link.mavlink import dialect
from twodof.link.mavlink.framing import Frame, Parser, decode, encode
from twodof.link.mavlink.messages import message
from twodof.link.signing import Key, Signing, Stamps


def hostile(chance: random.Random) -> Frame:
    """A sound frame with anything in it, often a command about streams or to the companion."""
    name = chance.choice(["COMMAND_LONG", "COMMAND_INT", "REQUEST_DATA_STREAM", *dialect.classes()])
    sent = random_message(name, chance, zeros=0.3)
    if chance.random() < 0.7 and hasattr(sent, "target_system"):
        sent.target_system, sent.target_component = chance.choice([0, 1, 1, 7]), chance.choice([0, 1, 191, 190])
    if name.startswith("COMMAND_") and name != "COMMAND_ACK":
        sent.command = chance.choice([400, 510, 511, 512, 185, sent.command])
        numbers = [chance.choice([0.0, 30.0, 54203.0, 70000.0, -1.0, 1e30, float("nan"), 4000.0]) for _ in range(4)]
        sent.param1, sent.param2, sent.param3, sent.param4 = numbers
    system, component = chance.choice([(1, 1), (1, 191), (250, 190), (chance.randrange(256), chance.randrange(256))])
    return Parser().feed(encode(sent, system, component, chance.randrange(256)))[0]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(1, 20))])
@pytest.mark.parametrize("keyed", [False, True], ids=["no key", "key"])
def test_no_frame_stops_the_router_or_makes_it_grow(seed: int, keyed: bool) -> None:
    chance = random.Random(seed)
    ends = Ends("onboard", "ground", "none")
    if keyed:
        clients = ends.clients
        ends.router = Router(SYSTEM, ends.line, lambda: ends.now, Signing(Key.fresh(), Stamps(None)))
        for client in clients:
            ends.router.add(client)
    CompanionComponent(ends.router, ComputerStatus())
    for number in range(2000):
        ends.now += chance.random() * 0.02
        if chance.random() < 0.5:
            ends.router.from_client(chance.choice(ends.clients), hostile(chance))
        else:
            ends.router.from_vehicle(hostile(chance))
        if number % 100 == 0:
            ends.up.sent.clear()
            for sink in ends.sinks.values():
                sink.sent.clear()
    for client in ends.clients:
        assert len(client.identities) <= MOST_IDENTITIES
        assert len(client.requests) <= MOST_REQUESTS
        assert len(client.due_once) <= len(dialect.classes())
    assert len(ends.router._behind) <= MOST_BEHIND


def signed(signing: Signing, sequence: int, **fields: float) -> Frame:
    """A command of a client that signs."""
    sent = message("COMMAND_LONG", command=511, target_system=SYSTEM, target_component=1, **fields)
    return Parser().feed(encode(sent, 250, 190, sequence, signing.outgoing()))[0]


def test_without_a_key_a_signed_command_reaches_the_vehicle_as_it_is_and_thins_nothing_out() -> None:
    ends = Ends("onboard")
    ends.settle()
    asked = signed(Signing(Key.fresh(), Stamps(None)), 0, param1=30, param2=4000)
    ends.router.from_client(ends.clients[0], asked)
    assert ends.up.sent == [asked.raw]
    assert ends.heard(ends.clients[0]) == []  # the vehicle answers, as nobody else could
    for tick in range(25):
        ends.vehicle("ATTITUDE", time_boot_ms=4 * tick)
    assert len(ends.heard(ends.clients[0])) == 25


def test_without_a_key_each_client_is_still_thinned_to_what_it_asked_for() -> None:
    ends, signing = Ends("none", "none"), Signing(Key.fresh(), Stamps(None))
    for client, interval in zip(ends.clients, (40_000, 4000), strict=True):
        ends.router.from_client(client, signed(signing, 0, param1=30, param2=interval))
    ends.settle()
    for tick in range(100):
        ends.vehicle("ATTITUDE", time_boot_ms=4 * tick)
    assert [len(ends.heard(client)) for client in ends.clients] == [10, 100]


def test_with_the_key_a_changed_command_is_signed_anew() -> None:
    key = Key.fresh()
    ends = Ends()
    ends.router = Router(SYSTEM, ends.line, lambda: ends.now, Signing(key, Stamps(None), link_id=191))
    fast, slow = ends.join("none"), ends.join("none")
    ends.settle()
    theirs, vehicle = Signing(key, Stamps(None), link_id=2), Signing(key, Stamps(None), link_id=3)
    for client, interval in ((fast, 4000), (slow, 40_000)):
        ends.router.from_client(client, signed(theirs, 0, param1=30, param2=interval))
    sent = ends.up.take()
    assert [decode(one).param2 for one in sent] == [4000.0, 4000.0]
    assert [(one.system, one.component) for one in sent] == [(250, 190)] * 2
    assert [vehicle.check(one).value for one in sent] == ["accepted"] * 2
