"""NaN and infinity in every numeric field of every message, and in every parameter of every command.

From the pilot in flight: nothing raises, the flight code and the motors get finite numbers only, and the flight goes
on. On the ground: nothing arms, and no parameter changes.
"""

from collections.abc import Iterator
from math import inf, isfinite, nan
from typing import Any

import pytest

from tests.fcu.assembled import ARM, OFFBOARD, SET_MODE, TARGET, Assembled
from tests.link.mavlink.test_framing import NAMES
from twodof.flight.failsafe.state_machine import FLYING
from twodof.link.mavlink import dialect
from twodof.link.mavlink.messages import message

pytestmark = pytest.mark.slow

NO_NUMBERS = (nan, inf, -inf)
TERMINATE, DISARM = 185, (ARM, 0.0)
MOST_ELEMENTS = 4  # of an array: the others of its elements are read by the same loop
SOUND: dict[str, tuple[dict[str, Any], ...]] = {
    "SET_ATTITUDE_TARGET": (
        {"type_mask": 7, "q": [1.0, 0.0, 0.0, 0.0], "thrust": 0.4},
        {"type_mask": 128, "body_pitch_rate": 0.1, "thrust": 0.4},
        {"type_mask": 128 + 7, "thrust": 0.4},
        {"type_mask": 7 + 32, "q": [1.0, 0.0, 0.0, 0.0], "thrust_body": [0.0, 0.0, -0.4]},
    ),
    "SET_POSITION_TARGET_LOCAL_NED": ({"type_mask": 0, "coordinate_frame": 1}, {"type_mask": 7, "coordinate_frame": 8}),
    "TWODOF_OPENLOOP": tuple({"M": 0.0, "T": 0.4, "openloop": o, "enableM": 1, "enableT": 1} for o in (0, 1)),
    "TWODOF_EXCITE": tuple({"action": action, "transfer": 7, "loop": 2, "thrust": 0.4} for action in range(3)),
    "PARAM_SET": tuple({"param_id": name, "param_type": 9} for name in ("RATE_KP", "THRUST_BAR", "SAFE_SP_T")),
    "TWODOF_RIG_RESET": ({"seed": 1, "noise": 1.0, "rings": 1},),
}
"""Fields that make a message one that is acted on, so that what is no number in another field is looked at."""


def floats(name: str) -> Iterator[tuple[str, int]]:
    """The fields of a message that can hold NaN: name, and place in it if it is an array, else -1."""
    kind = dialect.load().mavlink_map[dialect.message_id(name)]
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    for field, type_name in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        if type_name in ("float", "double"):
            yield from (
                ((field, place) for place in range(min(lengths[field], MOST_ELEMENTS)))
                if lengths[field]
                else ((field, -1),)
            )


def spoilt(name: str) -> Iterator[Any]:
    """Yield messages of that name for us, with NaN or infinity in one field of each."""
    kind = dialect.load().mavlink_map[dialect.message_id(name)]
    ours = {field: value for field, value in TARGET.items() if field in kind.fieldnames}
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    for sound in SOUND.get(name, ({},)):
        for field, place in floats(name):
            for value in NO_NUMBERS:
                if place < 0:
                    yield message(name, **{**sound, **ours, field: value})
                else:
                    values = [*sound.get(field, [0.0] * lengths[field])]
                    values[place] = value
                    yield message(name, **{**sound, **ours, field: values})


def commands(drone: Assembled) -> Iterator[Any]:
    """Yield supported commands and an unsupported one, with NaN or infinity in one parameter, 0 or 1 in the others."""
    for number in (*drone.drone.assembly.px4.commands.supported, 31010):
        for others in (0.0, 1.0):
            for value in NO_NUMBERS:
                for place in range(1, 8):
                    given = {f"param{other}": others for other in range(1, 8)} | {f"param{place}": value}
                    yield message("COMMAND_LONG", command=number, **given, **TARGET)
                for place in (1, 2, 3, 4):
                    given = {f"param{other}": others for other in range(1, 5)} | {f"param{place}": value}
                    yield message("COMMAND_INT", command=number, **given, **TARGET)
                yield message("COMMAND_INT", command=number, z=value, **TARGET)


def every(drone: Assembled) -> list[Any]:
    """All of these messages."""
    return [*(one for name in NAMES for one in spoilt(name)), *commands(drone)]


def stops(sent: Any) -> bool:
    """Return whether a message stops motors."""
    if sent.get_type() not in ("COMMAND_LONG", "COMMAND_INT"):
        return False
    return (sent.command == TERMINATE and sent.param1 > 0.5) or (sent.command, sent.param1) == DISARM


def changes_mode(sent: Any) -> bool:
    """Return whether it may be a valid change of mode, in which the NaN or infinity is ignored."""
    return sent.get_type() in ("COMMAND_LONG", "COMMAND_INT") and sent.command in (SET_MODE, 262)


def test_most_messages_that_are_acted_on_are_among_those() -> None:
    assert {name for name in NAMES if any(floats(name))} >= {*SOUND, "COMMAND_LONG", "COMMAND_INT", "PARAM_SET"}
    assert len(NAMES) > 100


@pytest.mark.parametrize("lockstep", [False, True])
def test_in_flight_no_field_that_is_no_number_reaches_a_motor_or_disturbs_what_flies(lockstep: bool) -> None:
    drone = Assembled(lockstep=lockstep)
    drone.fly()
    asked, parameters = drone.steps[-1].asked, dict(drone.drone.assembly.store)
    before = asked.mode, asked.theta0, asked.thrust
    for sent in every(drone)[int(lockstep) :: 2]:  # half of them in lockstep, the others in real time
        if stops(sent) or changes_mode(sent):
            continue
        drone.say(sent)
        drone.stream()
        step = drone.run()
        sound = 0.0 <= step.fore <= 1.0 and 0.0 <= step.aft <= 1.0 and all(isfinite(value) for value in step.asked)
        assert sound, f"{sent}: {drone.texts()[-200:]}"
        now = step.armed, step.state, step.asked.mode, step.asked.theta0, step.asked.thrust
        assert now == (True, FLYING, *before), f"{sent}: {drone.texts()[-200:]}"
    assert dict(drone.drone.assembly.store) == parameters


def test_on_the_ground_none_arms_or_changes_a_parameter() -> None:
    drone = Assembled()
    drone.say(message("HEARTBEAT", type=6, autopilot=8))
    drone.run(60)
    parameters = dict(drone.drone.assembly.store)
    for sent in every(drone):
        sound_arming = sent.get_type().startswith("COMMAND") and sent.command == ARM and sent.param1 == 1.0
        if sound_arming:  # what is no number is a parameter that arming does not have
            continue
        drone.say(sent)
    drone.run(2)
    assert not any(step.armed or step.asked.arm for step in drone.steps)
    assert dict(drone.drone.assembly.store) == parameters
    drone.command(ARM, 0.0)  # a kill was among them
    drone.stream()
    drone.command(SET_MODE, *OFFBOARD)
    drone.command(ARM, 1.0)
    assert drone.run(3).armed, f"and it still serves: {drone.texts()[-200:]}"
