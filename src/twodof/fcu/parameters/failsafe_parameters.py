"""The failsafe's parameters by the names that MAVLink carries: `place.pitch_limit` is SAFE_PITCH_LIM.

The rule: SAFE_ and the words of the path, without the sections that say nothing more (sensors, place, machine, safe),
abbreviated as in WORDS; a `timeout` is a T, as in PX4's names. Where it would give one name twice, or more than 16
characters, building the table fails.
"""

from functools import cache
from math import isfinite

from twodof.compile.program.lower import lower
from twodof.fcu.parameters.row import VehicleParameter
from twodof.flight.core import PERIOD
from twodof.flight.failsafe.diagram import failsafe

PREFIX = "flight.failsafe."
"""Of the parameters' paths in the closed loop; in the flight core alone it is `failsafe.`."""

SILENT = ("force", "rate", "sensors", "place", "machine", "safe")
WORDS = {
    "battery": "BAT",
    "critical": "CRIT",
    "error": "ERR",
    "limit": "LIM",
    "margin": "MARG",
    "setpoint": "SP",
    "stuck": "STK",
    "timeout": "T",
    "time": "",
}


def safe_name(path: str) -> str:
    """The name of the failsafe's parameter `path`, such as SAFE_SP_T for `setpoint.timeout`."""
    section, _, last = path.rpartition(".")
    words = [*(section.split("_") if section and section not in SILENT else ()), *last.split("_")]
    return "_".join(["SAFE", *(part for word in words if (part := WORDS.get(word, word.upper())))])


@cache
def failsafe_rows() -> tuple[VehicleParameter, ...]:
    """A row for each parameter of the failsafe; a flag is an int32 of 0 or 1."""
    rows = []
    for path, parameter in lower(failsafe(), PERIOD).parameters.items():
        declared = parameter.declared
        flag = declared.kind == "bool"
        low, high = (0.0, 1.0) if flag or not isfinite(declared.low) else (declared.low, declared.high)
        rows.append(
            VehicleParameter(
                safe_name(path),
                float(declared.value),
                low,
                high,
                declared.unit,
                declared.text,
                kind="int32" if flag else "float",
                group="Failsafe",
                disarmed=True,
                path=path,
            )
        )
    return tuple(rows)
