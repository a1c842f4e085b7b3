"""Refusals of the commander: their words and codes, and the state that they leave unchanged."""

from collections.abc import Callable
from math import nan

import pytest

from tests.fcu.command.cockpit import LEVEL_FLIGHT, ME, OTHER, Cockpit, Rig, armed, offboard
from twodof.excitation import Impulse
from twodof.fcu.command.command_lease import CommandResult, rejected
from twodof.fcu.command.commander import Commander
from twodof.fcu.command.excitation_player import READY, REFUSED, written_out
from twodof.fcu.command.setpoints import HORIZON
from twodof.flight.failsafe.causes_and_actions import BIT
from twodof.link.mavlink import modes
from twodof.link.mavlink.dialect import MavResult
from twodof.link.mavlink.setpoints import SetPoint
from twodof.signals import POSITION

REJECTED = MavResult.TEMPORARILY_REJECTED
WHO = "system 250, component 190 holds"
NONE = "is missing, incomplete or already played"
LOCKED = "moves the cart, and the rings lock it"
FAR = "is past or more than a minute ahead, the next is 4"
PULSE = written_out(Impulse(0.1, 0.02, settle=0.4))
PITCHING = written_out(Impulse(0.1, 0.02, unit="rad"))
MOVING = written_out(Impulse(0.1, 0.02, unit="m"))


def started(
    cockpit: Cockpit, transfer: int = 7, loop: int = 0, thrust: float | None = 0.4, ahead: int = 0
) -> CommandResult:
    tick = cockpit.tick + ahead if ahead else 0
    return cockpit.commander.excitation.start(ME, transfer, loop, thrust, tick)


def playing() -> Cockpit:
    """One whose excitation 7 plays."""
    cockpit = armed()
    cockpit.commander.excitation.define(ME, 7, PULSE)
    assert started(cockpit).accepted
    cockpit.run(3)
    return cockpit


def ready(prepared: object = PULSE, **options: object) -> Cockpit:
    """One that has the excitation 7."""
    cockpit = armed(**options)
    cockpit.commander.excitation.define(ME, 7, prepared)
    return cockpit


def played() -> Cockpit:
    """One whose excitation 7 is over."""
    cockpit = ready(PITCHING)
    assert started(cockpit, loop=2).accepted
    cockpit.run(20)
    return cockpit


def on_the_ground(causes: int = 0) -> Cockpit:
    cockpit = Cockpit()
    cockpit.failsafe.causes = causes
    cockpit.run(2)
    return cockpit


def unready(what: str) -> Commander:
    """One on the ground that a controller in the making, the safety switch or the rings keep from arming."""
    cockpit = on_the_ground()
    cockpit.rig.safety_off = what != "switch"
    if what == "rings":
        cockpit.commander.set_mode(ME, modes.POSITION)
        cockpit.rig.rings = True
    if what == "unfit":
        cockpit.commander.unfit = lambda: "a controller is being built"
    return cockpit.commander


def killed() -> CommandResult:
    cockpit = offboard()
    cockpit.commander.arming.kill(OTHER)
    return cockpit.commander.arming.arm(ME)


def too_far() -> CommandResult:
    cockpit = offboard()
    return cockpit.commander.setpoint(ME, LEVEL_FLIGHT, cockpit.tick + HORIZON + 1)


def flown(rig: Rig | None = None) -> Commander:
    """The commander of one that is armed, and belongs to system 250."""
    return armed(rig).commander


def ground(causes: int = 0) -> Commander:
    return on_the_ground(causes).commander


SITUATIONS: dict[int, dict[str, Callable[[], CommandResult]]] = {
    REJECTED: {
        f"arming refused: {WHO} the lease": lambda: flown().arming.arm(OTHER),
        f"mode refused: {WHO} the lease": lambda: flown().set_mode(OTHER, modes.HOLD),
        f"set-point refused: {WHO} the lease": lambda: flown().setpoint(OTHER, LEVEL_FLIGHT),
        f"excitation refused: {WHO} the lease": lambda: playing().commander.excitation.define(OTHER, 8, PULSE),
        f"excitation refused: {WHO} the lease ": lambda: ready().commander.excitation.start(OTHER, 7, 0),
        f"excitation refused: {WHO} the lease  ": lambda: ready().commander.excitation.stop(OTHER),
        f"command refused: {WHO} the lease": lambda: flown().lease.take(OTHER),
        f"lease refused: {WHO} it": lambda: flown().lease.request(OTHER),
        f"lease not given up: {WHO} it": lambda: flown().lease.give_up(OTHER),
        "lease not given up: nobody holds it": lambda: ground().lease.give_up(ME),
        "not armed: tilted": lambda: ground(BIT["tilted"]).arming.arm(ME),
        "not armed: imu_lost, tilted": lambda: ground(BIT["tilted"] | BIT["imu_lost"]).arming.arm(ME),
        "not armed: no sensor has sent a sample yet": lambda: Cockpit().commander.arming.arm(ME),
        "not armed: rings_wrong": lambda: unready("rings").arming.arm(ME),
        "not armed: a controller is being built": lambda: unready("unfit").arming.arm(ME),
        "not armed: safety switch, press it": lambda: unready("switch").arming.arm(ME),
        "not armed: killed by system 245, component 190: release it first (twodof kill --release)": killed,
        "mode offboard needs set-points above 2 Hz first": lambda: flown().set_mode(ME, modes.OFFBOARD),
        "excitation refused: another one plays": lambda: started(playing(), transfer=8),
        "excitation refused: another one plays ": lambda: playing().commander.excitation.define(ME, 8, PULSE),
        f"excitation refused: definition 8 {NONE}": lambda: started(ready(), transfer=8),
        f"excitation refused: definition 7 {NONE}": lambda: started(played(), loop=2),
        "excitation refused: unknown loop 5": lambda: started(ready(), loop=5),
        "excitation refused: unknown loop -1": lambda: started(ready(), loop=-1),
        "excitation refused: it is in '-', the loop in 'rad/s'": lambda: started(ready(), loop=1),
        f"excitation refused: the loop {LOCKED}": lambda: started(ready(MOVING, rig=Rig(rings=True)), loop=4),
        "excitation refused: thrust is not within 0 to 1": lambda: started(ready(), thrust=1.01),
        "excitation refused: thrust is not within 0 to 1 ": lambda: started(ready(), thrust=-0.01),
        "excitation refused: a closed loop without thrust": lambda: started(ready(PITCHING), loop=2, thrust=0.0),
        f"excitation refused: tick 3 {FAR}": lambda: started(ready(), ahead=-1),
        f"excitation refused: tick {HORIZON + 5} {FAR}": lambda: started(ready(), ahead=HORIZON + 1),
    },
    MavResult.DENIED: {
        "command refused: the sender's MAVLink system is 0": lambda: ground().lease.take((0, 190)),
        "lease refused: the sender's MAVLink system is 0": lambda: ground().lease.request((0, 0)),
        f"mode position {LOCKED}": lambda: flown(Rig(rings=True)).set_mode(ME, modes.POSITION),
        "set-point refused: a number is not finite": lambda: flown().setpoint(ME, LEVEL_FLIGHT._replace(theta0=nan)),
        f"set-point refused: it {LOCKED}": lambda: flown(Rig(rings=True)).setpoint(ME, SetPoint(POSITION, x0=0.1)),
        "set-point refused: too many wait, or its time is more than a minute ahead": too_far,
        "set-point refused: a stick is beyond its end": lambda: flown().sticks(ME, 0.0, 1.01),
    },
    MavResult.UNSUPPORTED: {"unknown mode main 99, sub 0": lambda: flown().set_mode(ME, 99 << 16)},
}
"""By MAV_RESULT the words (spaces at the end tell equal ones apart), and what is done."""


@pytest.mark.parametrize(("result", "words"), [(r, words) for r, table in SITUATIONS.items() for words in table])
def test_it_is_refused_in_these_words(result: int, words: str) -> None:
    assert SITUATIONS[result][words]()[:2] == (result, words.rstrip())


# What is just still accepted.


def test_bounds_belong_to_what_is_accepted() -> None:
    cockpit = ready()
    assert started(cockpit, ahead=HORIZON).accepted
    assert cockpit.commander.excitation.start(ME, 7, 0, 1.0, cockpit.tick).accepted
    assert cockpit.run().M_open == PULSE.values[0]
    cockpit = ready()
    assert started(cockpit, thrust=0.0).accepted
    cockpit = offboard()
    assert cockpit.commander.setpoint(ME, LEVEL_FLIGHT, cockpit.tick + HORIZON).accepted
    assert cockpit.commander.sticks(ME, 1.0, 1.0).accepted
    assert cockpit.commander.sticks(ME, -1.0, 0.0).accepted


# What a refusal leaves as it was.


def test_a_start_that_is_refused_marks_the_excitation_that_it_names_and_no_other() -> None:
    cockpit = ready()
    revision = cockpit.commander.excitation.player.revision
    assert not started(cockpit, transfer=8).accepted
    assert (cockpit.commander.excitation.player.state, cockpit.commander.excitation.player.revision) == (
        READY,
        revision,
    )
    assert not started(cockpit, loop=9).accepted
    assert (cockpit.commander.excitation.player.state, cockpit.commander.excitation.player.reason) == (
        REFUSED,
        "unknown loop 9",
    )
    cockpit = played()
    revision = cockpit.commander.excitation.player.revision
    assert not started(cockpit, loop=2).accepted
    assert cockpit.commander.excitation.player.revision == revision


def test_a_stick_that_is_refused_keeps_nobody_from_arming() -> None:
    cockpit = on_the_ground()
    cockpit.commander.lease.request(ME)
    cockpit.commander.sticks(ME, 0.0, 0.0)
    assert not cockpit.commander.sticks(OTHER, 0.5, 0.5).accepted
    cockpit.commander.set_mode(ME, modes.ATTITUDE)
    assert cockpit.arm().accepted


def test_the_answer_to_an_arming_stays_until_the_next() -> None:
    cockpit = on_the_ground()
    assert cockpit.commander.arming.arm(ME).result == 5
    cockpit.failsafe.causes = BIT["tilted"] | BIT["imu_lost"]
    cockpit.run()
    refused = cockpit.commander.arming.answer
    assert refused == rejected("not armed: imu_lost, tilted")
    cockpit.run(60)
    assert cockpit.commander.arming.answer == refused
    cockpit.failsafe.causes = 0
    cockpit.run()
    assert cockpit.arm().accepted
    cockpit.commander.arming.disarm(ME)
    cockpit.run(60)
    assert cockpit.commander.arming.answer.accepted, "a disarming does not undo that it was armed"


def test_what_is_asked_before_the_first_tick_is_asked_at_once() -> None:
    for ask in (lambda one: one.setpoint(ME, LEVEL_FLIGHT), lambda one: one.open_loop(ME, 0.1, 0.4, True, True, True)):
        commander = Cockpit().commander
        assert ask(commander).accepted
        assert commander.set_mode(ME, modes.OFFBOARD).accepted, "it has been streamed"
