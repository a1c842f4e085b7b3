"""All parameters of a vehicle: the flight code's, those of users' controllers, and those of PX4 that clients expect.

QGroundControl needs some of PX4's; MAVSDK, MAVProxy and course scripts read or set others. A few have an effect here.
Some are fixed, because they describe this vehicle. The rest are stored for the client that sets them and have no
effect, as their text says. Source of names, types, bounds: PX4 v1.16, parameter reference.

A parameter of a user's controller has the same name as in the diagram's PX4 module (docs/explanation/targets.md), so
that a ground station's file fits both. A value at its default flies with all bits of the diagram's number, although the
wire carries float32.
"""

import hashlib
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Literal

import numpy as np

from twodof.blocks import Diagram, Param
from twodof.blocks.declarations import rows_of
from twodof.blocks.expressions.numbers import FLOATS
from twodof.blocks.schema.json_form import to_json
from twodof.compile.program.lower import lower
from twodof.compile.px4.names import harmless, module_names
from twodof.compile.px4.parameters import LARGEST_FLOAT, LARGEST_INT, SMALLEST_INT, ExportedParameter, diagram_rows
from twodof.errors import listed
from twodof.flight.templates import by_kind
from twodof.parameters import FLIGHT_PARAMETERS, PARAMETERS, Parameter, float32_decimal
from twodof.signals import PERIOD


@dataclass(frozen=True)
class VehicleParameter(Parameter):
    """A parameter as a vehicle describes it.

    `group` is the heading under which a ground station shows it. `disarmed`: it changes only while disarmed; `reboot`:
    a change takes effect after the next start. `acts` is False if clients of PX4 expect it and nothing on board reads
    it. `of` is the main name of a parameter of which this is another name. `user_path` is its path in a user's diagram,
    such as `attitude_control.k_q`, with an index for an array's element. `bounded` is False if the diagram gives it no
    bounds.
    """

    group: str = "Flight"
    disarmed: bool = False
    reboot: bool = False
    acts: bool = True
    of: str = ""
    user_path: str = ""
    bounded: bool = True

    def bits(self, value: float) -> bytes:
        """Return the four bytes of a value, as PARAM_VALUE carries them."""
        return struct.pack("<i", int(value)) if self.kind == "int32" else struct.pack("<f", value)

    @property
    def fixed(self) -> bool:
        """Return whether the parameter has one possible value, which describes the vehicle."""
        return self.low == self.high


Kind = Literal["float", "int32"]

LOG_ALWAYS, LOG_BOOT, LOG_ARMED, LOG_NEVER = 2, 1, 0, -1
"""Values of SDLOG_MODE: from the start on, from the start to the first disarming, while armed, only on request."""
SIMULATED_IMU, SIMULATED_MAG = 1310988, 197388
"""Sensor ids of PX4 in simulation; an id of 0 is a sensor that was never calibrated."""
_LOGGED = "on-board log: 0 while armed, 1 from the start to disarming, 2 from the start on, -1 on request"
_UNUSED = "; kept, acts on nothing here"


def _fixed(
    name: str, value: float, text: str, kind: Kind = "int32", unit: str = "", group: str = "System"
) -> VehicleParameter:
    return VehicleParameter(name, value, value, value, unit, text, kind=kind, group=group)


def _kept(
    name: str, default: float, low: float, high: float, unit: str, text: str, kind: Kind = "int32", group: str = "PX4"
) -> VehicleParameter:
    return VehicleParameter(name, default, low, high, unit, text + _UNUSED, kind=kind, group=group, acts=False)


def _logging(name: str, default: float, low: float, high: float, text: str) -> VehicleParameter:
    return VehicleParameter(name, default, low, high, "", text, kind="int32", group="Log", disarmed=True)


def px4_rows(system: int) -> tuple[VehicleParameter, ...]:
    """Return PX4's parameters for a vehicle with this MAVLink system id."""
    return (
        _fixed("MAV_SYS_ID", system, "MAVLink system id, set where the flight controller is started"),
        _fixed("MAV_COMP_ID", 1, "MAVLink component id: autopilot"),
        _fixed("MAV_TYPE", 2, "MAVLink type: quadrotor"),
        _fixed("MAV_PROTO_VER", 2, "MAVLink version that is sent"),
        _fixed("SYS_PARAM_VER", 1, "version of the set of parameters"),
        _fixed("SYS_AUTOSTART", 4001, "airframe: quadrotor"),
        _fixed("SYS_AUTOCONFIG", 0, "parameters are not set again from the airframe"),
        _fixed("SYS_HAS_GPS", 0, "there is no GPS receiver"),
        _fixed("SYS_HAS_MAG", 0, "there is no magnetometer"),
        _fixed("SYS_HAS_BARO", 0, "there is no barometer"),
        _fixed("IMU_GYRO_RATEMAX", 250, "rate of the inner loop", unit="Hz"),
        _fixed("CAL_ACC0_ID", SIMULATED_IMU, "the accelerometer is there and calibrated", group="Sensors"),
        _fixed("CAL_GYRO0_ID", SIMULATED_IMU, "the gyro is there and calibrated", group="Sensors"),
        _fixed("CAL_MAG0_ID", SIMULATED_MAG, "as in simulation: no ground station asks for a compass", group="Sensors"),
        *(_fixed(f"CAL_MAG{n}_ID", 0, "there is no such magnetometer", group="Sensors") for n in (1, 2, 3)),
        *(_fixed(f"CAL_MAG{n}_ROT", -1, "there is no such magnetometer", group="Sensors") for n in (0, 1, 2, 3)),
        _fixed("SENS_BOARD_ROT", 0, "the board's axes are the body's", group="Sensors"),
        *(
            _fixed(f"SENS_BOARD_{axis}_OFF", 0, "the board's axes are the body's", "float", "deg", "Sensors")
            for axis in "XYZ"
        ),
        _fixed("SENS_DPRES_OFF", 0, "there is no airspeed sensor", "float", "Pa", "Sensors"),
        _fixed("TRIG_MODE", 0, "there is no camera"),
        _fixed("UAVCAN_ENABLE", 0, "there is no CAN bus"),
        _logging("SDLOG_MODE", LOG_ARMED, LOG_NEVER, LOG_ALWAYS, _LOGGED),
        _logging("SDLOG_DIRS_MAX", 100, 1, 1000, "most logs that are kept on board; the oldest go first"),
        _kept("BAT_LOW_THR", 0.15, 0.05, 0.5, "norm", "low charge; see SAFE_BAT_LOW", "float", "Battery"),
        _kept("BAT_CRIT_THR", 0.07, 0.03, 0.5, "norm", "critical charge; see SAFE_BAT_CRIT", "float", "Battery"),
        _kept("BAT_EMERGEN_THR", 0.05, 0.02, 0.5, "norm", "charge of emergency; see SAFE_BAT_CRIT", "float", "Battery"),
        _fixed("BAT1_N_CELLS", 3, "cells in series", group="Battery"),
        _kept("BAT1_V_EMPTY", 3.6, 2.0, 5.0, "V", "an empty cell's voltage", "float", "Battery"),
        _kept("BAT1_V_CHARGED", 4.2, 2.0, 5.0, "V", "a full cell's voltage", "float", "Battery"),
        _kept("COM_RC_IN_MODE", 1, 0, 5, "", "source of manual control"),
        _kept("COM_OBL_RC_ACT", 7, -1, 8, "", "after the loss of offboard set-points; see docs/explanation/safety.md"),
        _kept("COM_OF_LOSS_T", 1.0, 0.0, 60.0, "s", "silence of offboard set-points; see SAFE_SP_T", "float"),
        _kept("COM_DL_LOSS_T", 10, 5, 300, "s", "silence of the ground; see SAFE_LINK_T"),
        _kept("COM_LOW_BAT_ACT", 0, 0, 3, "", "what a low battery does; see docs/explanation/safety.md"),
        _kept("COM_DISARM_LAND", -1.0, -1.0, 120.0, "s", "disarming after landing", "float"),
        _kept("COM_DISARM_PRFLT", -1.0, -1.0, 120.0, "s", "disarming when nothing takes off", "float"),
        _kept("COM_ARM_WO_GPS", 1, 0, 2, "", "arming without GPS"),
        *(_kept(f"COM_FLTMODE{n}", -1, -1, 16, "", "mode of a switch") for n in range(1, 7)),
        _kept("NAV_RCL_ACT", 0, 0, 6, "", "loss of manual control"),
        _kept("NAV_DLL_ACT", 0, 0, 6, "", "loss of the ground station; see docs/explanation/safety.md"),
        _kept("GF_ACTION", 0, 0, 5, "", "geofence"),
        _kept("CBRK_SUPPLY_CHK", 894281, 0, 894281, "", "circuit breaker of the supply check"),
        _kept("CBRK_USB_CHK", 197848, 0, 197848, "", "circuit breaker of the USB check"),
        _kept("CBRK_IO_SAFETY", 22027, 0, 22027, "", "circuit breaker of the safety switch"),
        *(_kept(f"RC_MAP_{name}", 0, 0, 18, "", "radio channel") for name in ("ROLL", "PITCH", "YAW", "THROTTLE")),
    )


@cache
def vehicle_rows(system: int, defaults: tuple[tuple[str, float], ...] = ()) -> tuple[VehicleParameter, ...]:
    """Return every parameter of the vehicle with the id `system` once, under its main name.

    `defaults` are this vehicle's own, by path.
    """
    own = dict(defaults)
    flight = (*PARAMETERS, *(row for row in FLIGHT_PARAMETERS if row not in PARAMETERS))
    rows = (
        VehicleParameter(
            **(vars(row) | {"default": own.get(row.path, row.default)}),
            group="Flight" if row in PARAMETERS else "Failsafe",
            disarmed=row.path.startswith("failsafe."),
        )
        for row in flight
    )
    return (*rows, *px4_rows(system))


@cache
def wire_rows(system: int, defaults: tuple[tuple[str, float], ...] = ()) -> tuple[VehicleParameter, ...]:
    """Return the rows of PARAM_REQUEST_LIST in the order of their indices, by name as in PX4.

    A parameter that has a name of its own on the real drone (FC_PARAM_4) is listed under both names (see `of`).
    """
    rows = vehicle_rows(system, defaults)
    others = (
        replace(row, name=row.drone, drone="", of=row.name, text=f"{row.name}: {row.text}") for row in rows if row.drone
    )
    return tuple(sorted((*rows, *others), key=lambda row: row.name))


LONGEST_TEXT, LONGEST_UNIT = 160, 20
"""Longest text and unit that are taken from an unchecked diagram."""


@dataclass(frozen=True)
class UserParameters:
    """Tunable parameters of the controller `name` of the template `kind`; `identity` is the SHA-256 of its JSON `text`.

    `rows` are the parameters in the vehicle's list; `remark` says which ones of the diagram are not, "" if all are.
    """

    kind: str
    name: str
    identity: str
    rows: tuple[VehicleParameter, ...]
    remark: str = ""
    text: str = field(default="", repr=False)
    _elements: Mapping[str, tuple[Param, tuple[VehicleParameter, ...]]] = field(default_factory=dict, repr=False)

    def flying(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Return the values to fly by path (`attitude_control.k_q`), lists for arrays; `values` are by name."""
        flying: dict[str, Any] = {}
        for path, (declared, rows) in self._elements.items():
            defaults = np.ravel(np.asarray(declared.value), order="F").tolist()
            numbers = [
                _exact(declared, row, values[row.name], defaults[place if len(defaults) > 1 else 0])
                for place, row in enumerate(rows)
            ]
            flying[path] = numbers[0] if declared.width is None else rows_of(numbers, declared.shape)
        return flying


def user_parameters(controllers: Iterable[Diagram]) -> tuple[UserParameters, ...]:
    """Return the tunable parameters of `controllers`, in the order of templates: names of later ones may be shortened.

    Raises DiagramError for two parameters with the same name.
    """
    taken = {row.name for row in wire_rows(1)}
    found = []
    for kind, diagram in sorted(by_kind(controllers).items()):
        user = _of(kind, diagram, taken)
        taken |= {row.name for row in user.rows}
        found.append(user)
    return tuple(found)


def _of(kind: str, diagram: Diagram, taken: Iterable[str]) -> UserParameters:
    program = lower(diagram, PERIOD)
    shown, kept = diagram_rows(program, module_names(diagram.name).prefix, taken, kind)
    starts = {f"{n.path}.{p.name}" for n in program.nodes for p in n.block.params if p.is_initial}
    rows: list[VehicleParameter] = []
    elements: dict[str, tuple[Param, tuple[VehicleParameter, ...]]] = {}
    for one in shown:
        if one.fixed:
            continue
        row = _row(kind, diagram.name, one, one.path not in starts)
        rows.append(row)
        path = f"{kind}.{one.path}"
        _, before = elements.get(path, (None, ()))
        elements[path] = program.parameters[one.path].declared, (*before, row)
    left = [one.path for one in kept]
    remark = f"{kind}: {len(left)} parameters are not shown: {listed(left, 3)}"[:200] if left else ""
    text = to_json(diagram)
    identity = hashlib.sha256(text.encode()).hexdigest()
    return UserParameters(kind, diagram.name, identity, tuple(rows), remark, text, elements)


def _row(kind: str, diagram: str, one: ExportedParameter, tuning: bool) -> VehicleParameter:
    path = f"{kind}.{one.place}"
    text = ": ".join(filter(None, (path, one.text)))
    default, low, high = one.default, one.low, one.high
    if one.kind == "real":
        default, low, high = float32_decimal(default), float32_decimal(low), float32_decimal(high)
    return VehicleParameter(
        one.name,
        default,
        low,
        high,
        harmless(one.unit, LONGEST_UNIT),
        harmless(text, LONGEST_TEXT),
        kind="float" if one.kind == "real" else "int32",
        tuning=tuning,  # an initial value is no gain: the page lists it only where all parameters are wanted
        group=f"Controller {diagram}",
        user_path=path,
        bounded=one.low not in (-LARGEST_FLOAT, SMALLEST_INT) or one.high not in (LARGEST_FLOAT, LARGEST_INT),
    )


def _exact(declared: Param, row: VehicleParameter, value: float, default: Any) -> Any:
    """Return the number that flies for a row's value."""
    if declared.kind == "bool":
        return bool(value)
    if declared.kind not in FLOATS:
        return int(value)
    # A bound, too, may lie between two numbers of float32.
    return float(default) if value == row.default else min(max(float(value), declared.low), declared.high)
