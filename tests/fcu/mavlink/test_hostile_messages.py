"""Messages of every kind with any content: nothing raises, nobody is armed, no parameter changes by chance."""

import random
from itertools import count

import pytest

from tests.fcu.mavlink.world import World
from tests.link.mavlink.test_framing import NAMES, random_message
from twodof.link.mavlink.messages import message

EACH, EACH_IN_THE_SOAK = 5, 40


def aimed(name: str, chance: random.Random) -> object:
    """A random message; every other one for us."""
    sent = random_message(name, chance)
    if chance.random() < 0.5:
        for field, value in (("target_system", 1), ("target_component", 1)):
            if hasattr(sent, field):
                setattr(sent, field, value)
    if hasattr(sent, "command") and chance.random() < 0.8:
        sent.command = chance.choice([176, 185, 246, 262, 300, 400, 410, 510, 511, 512, 519, 520])
    return sent


LENGTHS = [pytest.param(EACH), pytest.param(EACH_IN_THE_SOAK, marks=pytest.mark.soak)]


@pytest.mark.parametrize("each", LENGTHS)
def test_nothing_raises_and_every_client_is_still_served(each: int) -> None:
    world = World(truth=lambda: (0.0, 0.0, 0.0, 0.0))
    chance, tick = random.Random(1), count()
    for name in NAMES:
        for _ in range(each):
            source = (chance.randrange(256), chance.randrange(256))
            world.say(aimed(name, chance), f"peer {chance.randrange(200)}", source)
            if next(tick) % 5 == 0:
                world.run()
        world.sent.clear()
    world.say(message("HEARTBEAT"), "honest")
    world.run(250)
    assert len(world.taken("ATTITUDE", "honest")) == 100


@pytest.mark.parametrize("each", LENGTHS)
def test_random_messages_change_no_parameter(each: int) -> None:
    world = World(profile={})
    before, chance = dict(world.store), random.Random(2)
    for name in NAMES:
        for _ in range(each):
            world.say(random_message(name, chance))
    assert dict(world.store) == before
