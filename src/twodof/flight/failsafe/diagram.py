"""The failsafe: thresholds, timers, state machine and the last gate to the motors, as one diagram at 250 Hz."""

from types import MappingProxyType

from twodof.blocks import Diagram
from twodof.blocks.library.functions import Trigonometry
from twodof.blocks.library.logic import Logic
from twodof.flight.declarations import (
    COMMANDS,
    ESTIMATED,
    FAILSAFE_INPUTS,
    IMU,
    OWN_INPUTS,
    RANGE,
    SET_POINTS,
    add_inputs,
    tunable,
)
from twodof.flight.failsafe.causes_and_actions import ACTIONS, CAUSES, RequestedActions
from twodof.flight.failsafe.consistency import ForceConsistency, RateConsistency
from twodof.flight.failsafe.flags import (
    BatteryFlags,
    OffDelay,
    PlaceFlags,
    SensorFlags,
    SetPointFlags,
    StuckCommands,
    WatchdogTimer,
)
from twodof.flight.failsafe.gate import OutputSelector, SafeSetPoints
from twodof.flight.failsafe.state_machine import STATES, FailsafeStateMachine, Reasons

__all__ = ["ACTIONS", "CAUSES", "OUTPUTS", "STATES", "TIMERS", "failsafe"]

OUTPUTS: tuple[tuple[str, str, str], ...] = (
    ("armed", "", "motors may turn"),
    ("action", "", "what the failsafe does: index into ACTIONS"),
    ("state", "", "its state: index into STATES"),
    ("reason", "", "why: mask of CAUSES, bit n for the nth"),
    ("causes", "", "all causes that hold in this tick, those that only speak against arming included: mask of CAUSES"),
)
"""Name, unit, meaning of what the flight code gives besides `core.OUTPUTS` when it has the failsafe."""

TIMERS = MappingProxyType(
    {
        "setpoint": "asked.fed",
        "link": "link_new",
        "imu": "sensors.imu_moves",
        "axis": "sensors.axes_move",
        "range": "sensors.range_good",
        "range_stuck": "sensors.range_moves",
        "brake": "at_large",
        "battery_low": "battery.full",
        "battery_critical": "battery.usable",
        "late": "in_time",
        "stuck": "commands.moves",
    }
)
"""What each timer waits for, by the timer's name; its parameter is `failsafe.NAME.timeout`."""

_SAME = MappingProxyType({name: name for name in SET_POINTS})


def failsafe() -> Diagram:
    """Return the failsafe, made for 250 Hz.

    Inputs: `FAILSAFE_INPUTS`; the measurements and estimates; `mode` and the set-points as given; the stock commands
    `fore`, `aft`, `M`, `T`; and the user's `own_fore`, ..., if `own_given` is true. Outputs: the mode and set-points
    for the controllers (`safe_mode`, `safe_x0`, ...) and `own`, which both depend on nothing behind the controllers;
    `range_taken`, whether the range may correct the estimates, and `range_age`, which depend on no estimate of this
    tick; `fore`, `aft`, `M`, `T` as they fly; and `OUTPUTS`.
    """
    d = Diagram("failsafe", "flags, timers, state machine, and the last gate to the motors")
    add_inputs(d, *(name for name, *_ in FAILSAFE_INPUTS), *IMU, *RANGE, *ESTIMATED, "mode", *SET_POINTS, "ax0")
    add_inputs(d, *COMMANDS, *(name for name, *_ in OWN_INPUTS))
    d.params["descent"] = tunable("failsafe.descent")
    _flags(d)
    _timers(d)
    _machine(d)
    _gate(d)
    return d


def _flags(d: Diagram) -> None:
    d.add(
        "sensors",
        SensorFlags(),
        inputs={name: name for name in (*IMU, *RANGE, "imu_new", "x", "v", "rings", "arm")},
    )
    d.add("place", PlaceFlags(), inputs={name: name for name in (*ESTIMATED, "rings")})
    for name, function in (("sine", "sin"), ("cosine", "cos")):
        d.add(name, Trigonometry(function, input_unit="rad"), u="theta")
    turned = {"sine": "sine", "cosine": "cosine"}
    d.add("force", ForceConsistency(), inputs=turned | {name: name for name in ("acc_x", "acc_z", "v", "rings")})
    d.add("rate", RateConsistency(), gyro_y="gyro_y", sine="sine")
    d.add("battery", BatteryFlags(), voltage="voltage")
    d.add("asked", SetPointFlags(), mode="mode", setpoint_new="setpoint_new", rings="rings", inputs=_SAME)
    d.add("in_time", Logic("not"), a="step_late")
    for name in ("range_taken", "range_age"):
        d.output(name, f"sensors.{name}")
    d.add("commands", StuckCommands(), mode="safe.mode", imu_moves="sensors.imu_moves", stopped="machine.stopped")


def _timers(d: Diagram) -> None:
    for name in TIMERS:
        d.add(name, WatchdogTimer(tunable(f"failsafe.{name}.timeout")))
    for name, source in TIMERS.items():
        d.connect(source, f"{name}.alive")


def _machine(d: Diagram) -> None:
    d.add("imu_lost", Logic("or"), a="imu", b="axis")
    d.add("rail_end", Logic("or"), a="place.rail_end", b="sensors.range_end")
    d.add("range_lost", Logic("or"), a="range", b="range_stuck")
    d.add(
        "classes",
        RequestedActions(),
        setpoint_lost="setpoint",
        setpoint_invalid="asked.invalid",
        pitch_near="place.pitch_near",
        rings_wrong="asked.rings_wrong",
        rail_near="place.rail_near",
        link_lost="link",
        battery_critical="battery_critical",
        range_lost="range_lost",
        imu_lost="imu_lost",
        estimate_lost="place.estimate_lost",
        pitch_stop="place.pitch_stop",
        rail_end="rail_end",
        brake_failed="brake",
        step_late="late",
        battery_low="battery_low",
        not_idle="asked.active",
        tilted="place.tilted",
        force_disagrees="force.disagrees",
        rate_disagrees="rate.disagrees",
    )
    for name in ("level", "brake"):
        d.add(f"{name}_lasts", OffDelay(tunable(f"failsafe.{name}_lasts.time")), flag=f"classes.{name}")
    d.add("at_large", Logic("not"), a="brake_lasts")
    d.add(
        "machine",
        FailsafeStateMachine(),
        params={"descent": "descent"},
        arm="arm",
        ready="classes.ready",
        off="classes.off",
        descend="classes.descend",
        brake="brake_lasts",
        level="level_lasts",
        stuck="stuck",
        own_given="own_given",
        own_lost="gate.own_lost",
        command_lost="gate.command_lost",
    )
    d.add(
        "reasons",
        Reasons(),
        state="machine.state",
        mask="classes.mask",
        failed="machine.failed",
        stuck_off="machine.stuck_off",
        own_lost="gate.own_lost",
        command_lost="gate.command_lost",
    )
    for name in ("armed", "action", "state"):
        d.output(name, f"machine.{name}")
    d.output("reason", "reasons")
    d.output("causes", "classes.mask")


def _gate(d: Diagram) -> None:
    d.add(
        "safe",
        SafeSetPoints(),
        params={"descent": "descent"},
        state="machine.state",
        timer="machine.timer",
        stopped="machine.stopped",
        mode="mode",
        ax0="ax0",
        x="x",
        v="v",
        T_flown="gate.T",
        inputs=_SAME,
    )
    for name in ("mode", *SET_POINTS, "ax0"):
        d.output(f"safe_{name}", f"safe.{name}")
    d.add("gate", OutputSelector(), stopped="machine.stopped", own="machine.own", own_late="own_late")
    d.output("own", "machine.own")
    for name in COMMANDS:
        d.connect(name, f"gate.{name}")
        d.connect(f"own_{name}", f"gate.own_{name}")
        d.output(name, f"gate.{name}")
    for name in ("fore", "aft"):
        d.connect(f"gate.{name}", *(f"{part}.{name}" for part in ("commands", "force", "rate")))
