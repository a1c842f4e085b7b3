"""Rights on parameters: every client changes those for tuning, only the lease holder the others."""

from typing import Any
from unittest.mock import Mock

from tests.faults.virtual_time import on_virtual_time
from tests.fcu.command.cockpit import ME, OTHER, Cockpit
from twodof.fcu.server import Peer
from twodof.link.connection import Connection, Received
from twodof.link.mavlink.framing import Parser, decode, encode
from twodof.link.mavlink.messages import float_of_int, message
from twodof.parameters import FLIGHT_PARAMETERS
from twodof.sim.virtual_drone import VirtualDrone


def put(drone: VirtualDrone, system: int, **values: float) -> None:
    """A client sets them, each by a PARAM_SET."""
    for name, value in values.items():
        whole = drone.assembly.store.row(name).kind == "int32"
        number = float_of_int(int(value)) if whole else value
        sent = message("PARAM_SET", param_id=name, param_value=number, param_type=6 if whole else 9, **ITS)
        hear(drone, system, sent)


def hear(drone: VirtualDrone, system: int, sent: Any) -> None:
    (frame,) = Parser().feed(encode(sent, system, 190, 0))
    unheard: Any = Mock(spec=Connection)
    received = Received(decode(frame), frame, Peer(unheard, system))
    assert any(service.handle(received) for service in drone.assembly.px4.services)


ITS = {"target_system": 1, "target_component": 1}
SAFETY = {
    "M_MAX": 0.0,
    "THRUST_BAR": 1.0,
    "THRUST_ETA": 1.0,
    "SDLOG_DIRS_MAX": 1,
    "SDLOG_MODE": 1,
    "SAFE_BAT_CRIT": 0.0,
    "SAFE_WATCH_BITS": 0,
    "SAFE_RAIL_LIM": 0.4,
    "SAFE_PITCH_LIM": 0.87,
    "COM_ARM_WO_GPS": 0,
}


@on_virtual_time
async def test_only_who_commands_changes_what_is_not_for_tuning() -> None:
    async with VirtualDrone("paper", lockstep=True, controllers=["lqr-attitude"]) as drone:
        store, commander = drone.assembly.store, drone.commander
        assert commander.lease.request(ME).accepted
        before = dict(store)
        put(drone, OTHER[0], **SAFETY)
        assert dict(store) == before
        put(drone, OTHER[0], RATE_KP=0.0625, RATE_N=50.0, FC_PARAM_11=8.0, TLA_K_Q=0.25)
        assert [store[name] for name in ("RATE_KP", "RATE_N", "ATT_KP", "TLA_K_Q")] == [0.0625, 50.0, 8.0, 0.25]
        put(drone, ME[0], **SAFETY)
        assert {name: store[name] for name in SAFETY} == SAFETY


def test_the_gains_of_the_loops_are_what_is_for_tuning() -> None:
    tuned = {row.name for row in FLIGHT_PARAMETERS if row.tuning}
    assert tuned == {*("RATE_KP", "RATE_KI", "RATE_KD", "RATE_N", "ATT_KP", "VEL_KP", "VEL_KI", "POS_KP")}


def test_the_holder_is_told_who_has_tuned_what() -> None:
    commander = Cockpit().commander
    commander.lease.tuned(OTHER, "RATE_KP = 0.06")  # nobody holds it
    assert commander.lease.request(ME).accepted
    commander.lease.tuned(ME, "RATE_KP = 0.07")
    assert commander.remarks == []
    commander.lease.tuned(OTHER, "RATE_KP = 0.08")
    assert commander.remarks == [(6, "RATE_KP = 0.08, by system 245, component 190")]
