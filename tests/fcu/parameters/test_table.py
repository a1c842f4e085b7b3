"""The table of a vehicle's parameters: names that fit the wire, all of the failsafe's, what PX4's clients ask for."""

import struct

from twodof.compile.program.lower import lower
from twodof.fcu.parameters.table import vehicle_rows, wire_rows
from twodof.flight.failsafe.diagram import failsafe
from twodof.parameters import NAME_LENGTH, PARAMETERS
from twodof.signals import PERIOD

INT32, FLOAT = "int32", "float"
# Facts about PX4's clients: QGroundControl shows errors where one of these is missing or of another type.
QGROUNDCONTROL = {
    **dict.fromkeys(("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR", "SENS_DPRES_OFF"), FLOAT),
    **dict.fromkeys((f"SENS_BOARD_{axis}_OFF" for axis in "XYZ"), FLOAT),
    **dict.fromkeys(("CAL_ACC0_ID", "CAL_GYRO0_ID", "SENS_BOARD_ROT", "TRIG_MODE", "UAVCAN_ENABLE"), INT32),
    **dict.fromkeys((f"CAL_MAG{n}_{what}" for n in range(4) for what in ("ID", "ROT")), INT32),
    **dict.fromkeys(("SYS_PARAM_VER", "SYS_AUTOSTART", "MAV_SYS_ID"), INT32),
}


def test_names_are_distinct_sorted_and_fit_param_id() -> None:
    names = [row.name for row in wire_rows(1)]
    assert names == sorted(set(names))
    assert all(1 <= len(name.encode()) <= NAME_LENGTH for name in names)


def test_what_qgroundcontrol_cannot_miss_is_there_with_px4s_type() -> None:
    rows = {row.name: row.kind for row in wire_rows(1)}
    assert {name: rows.get(name) for name in QGROUNDCONTROL} == QGROUNDCONTROL


def test_each_parameter_of_the_failsafe_is_on_the_wire_once_and_safe_from_changes_in_flight() -> None:
    rows = [row for row in vehicle_rows(1) if row.path.startswith("failsafe.")]
    declared = lower(failsafe(), PERIOD).parameters
    assert sorted(row.path for row in rows) == sorted(f"failsafe.{path}" for path in declared)
    assert all(row.disarmed for row in rows)


def test_the_drones_own_names_are_rows_of_their_own() -> None:
    rows = {row.name: row for row in wire_rows(1)}
    for row in PARAMETERS:
        if row.drone:
            assert (rows[row.drone].of, rows[row.drone].default) == (row.name, row.default)
            assert (rows[row.drone].low, rows[row.drone].high) == (row.low, row.high)


def test_bounds_of_int32_are_no_signalling_nan() -> None:
    """A signalling NaN does not survive a float32 on the way; whole numbers with such bits lie outside all bounds."""
    for row in wire_rows(1):
        if row.kind == "int32":
            for value in (row.low, row.default, row.high):
                bits = struct.unpack("<I", struct.pack("<i", int(value)))[0] & 0x7FFFFFFF
                assert not 0x7F800001 <= bits <= 0x7FBFFFFF, row.name
