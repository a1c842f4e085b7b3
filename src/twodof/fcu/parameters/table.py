"""All parameters of a vehicle: the flight code's, and those of PX4 that its clients ask for."""

from dataclasses import replace
from functools import cache

from twodof.fcu.parameters.row import VehicleParameter
from twodof.fcu.px4_compat.parameters import px4_rows
from twodof.parameters import FLIGHT_PARAMETERS, PARAMETERS


@cache
def vehicle_rows(system: int) -> tuple[VehicleParameter, ...]:
    """Every parameter of the vehicle `system` once, by its main name."""
    flight = (*PARAMETERS, *(row for row in FLIGHT_PARAMETERS if row not in PARAMETERS))
    rows = (
        VehicleParameter(
            **vars(row),
            group="Flight" if row in PARAMETERS else "Failsafe",
            disarmed=row.path.startswith("failsafe."),
        )
        for row in flight
    )
    return (*rows, *px4_rows(system))


@cache
def wire_rows(system: int) -> tuple[VehicleParameter, ...]:
    """What PARAM_REQUEST_LIST shows, in the order of its indices, which is that of the names as in PX4.

    A parameter that the real drone has under a name of its own (FC_PARAM_4) shows under both: `of` says so.
    """
    rows = vehicle_rows(system)
    others = (
        replace(row, name=row.drone, drone="", of=row.name, text=f"{row.name}: {row.text}") for row in rows if row.drone
    )
    return tuple(sorted((*rows, *others), key=lambda row: row.name))
