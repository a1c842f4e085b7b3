"""Diagram of the failsafe at 250 Hz: thresholds, timers, state machine, and the gate to the motors."""

from types import MappingProxyType
from typing import Any

from twodof.blocks import Block, Diagram, Port, State, int32, maximum, minimum, to_real, where
from twodof.blocks.library.functions import Trigonometry
from twodof.blocks.library.logic import Logic
from twodof.flight.declarations import (
    COMMANDS,
    ESTIMATED,
    FAILSAFE_INPUTS,
    IMU,
    RANGE,
    SET_POINTS,
    USER_INPUTS,
    add_inputs,
    finite,
    ports,
    tunable,
    tunables,
)
from twodof.flight.failsafe.causes_and_actions import ACTIONS, CAUSES, RequestedActions
from twodof.flight.failsafe.flags import (
    BatteryFlags,
    EstimateFlags,
    ForceConsistency,
    OffDelay,
    RangeConsistency,
    RateConsistency,
    SensorFlags,
    SetPointFlags,
    StuckCommands,
    WatchdogTimer,
    ticks,
)
from twodof.flight.failsafe.state_machine import BRAKE, DESCEND, FLYING, LEVEL, STATES, FailsafeStateMachine, Reasons
from twodof.signals import ATTITUDE, OFF, POSITION


class SafeSetPoints(Block):
    """Mode and set-points for the controllers.

    Flying: the inputs, each limited (one within its limit keeps its bits), 0 for one that is NaN or infinite. Level:
    attitude mode, theta0 = 0, the last thrust flown. Brake: the same with the pitch that stops the cart and brings it
    back, theta0 = brake_x (x - place) + brake_v v within +-`brake_tilt`; `place` is x limited to +-`rail_hold`. The
    position loop is not used for it: the faster the cart is, the further that tilts, up to the pitch stop. Descend: as
    level, and the thrust fades to 0 within `descent` s. If the thrust was 0 when the failsafe began to act, and
    whenever the motors are stopped, the mode is off, so that no action starts motors at rest.
    """

    inputs = (*ports("state", "timer", "stopped", "mode", *SET_POINTS, "ax0", "x", "v"), Port("T_flown"))
    outputs = ports("mode", *SET_POINTS, "ax0")
    states = (State("thrust"),)
    derived = (Port("per_tick"),)
    params = (tunable("failsafe.descent"), *tunables("failsafe.safe"))

    def prepare(self, p: Any, t: Any) -> Any:
        return 1.0 / to_real(ticks(p.descent, t.dt))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        def within(name: str, low: Any, high: Any) -> Any:
            return where(finite(u[name]), maximum(low, minimum(high, u[name])), 0.0)

        given = {
            "thrust": within("thrust", 0.0, 1.0),
            "M_open": within("M_open", -1.0, 1.0),
            "ax0": where(finite(u.ax0), u.ax0, 0.0),
        }
        for name in ("x0", "v0", "theta0", "q0"):
            given[name] = within(name, -p[f"{name}_limit"], p[f"{name}_limit"])
        flying = u.state == int32(FLYING)
        braking = u.state == int32(BRAKE)
        acting = (u.state >= int32(LEVEL)) & (u.state <= int32(DESCEND))
        standing = u.stopped | (acting & ~(x.thrust > 0.0))
        asked = where(u.mode > int32(POSITION), int32(OFF), u.mode)
        mode = where(flying, asked, int32(ATTITUDE))
        fade = where(u.state == int32(DESCEND), maximum(0.0, 1.0 - to_real(u.timer) * p.per_tick), 1.0)
        place = maximum(-p.rail_hold, minimum(p.rail_hold, u.x))
        back = p.brake_x * (u.x - place) + p.brake_v * u.v
        tilt = maximum(-p.brake_tilt, minimum(p.brake_tilt, back))
        held = {"thrust": x.thrust * fade, "theta0": where(braking & finite(tilt), tilt, 0.0)}
        return {"mode": where(standing, int32(OFF), mode)} | {
            name: where(flying, value, held.get(name, 0.0)) for name, value in given.items()
        }

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        held = maximum(0.0, minimum(p.thrust_held, u.T_flown))
        return where((u.state == int32(FLYING)) & finite(u.T_flown), held, where(u.stopped, 0.0, x.thrust))


class OutputSelector(Block):
    """Gate to the motors: passes the commands of the user's controller or of the stock one, or stops the motors.

    `user_fore`, ... are the user's commands. They pass while `user_flies`, if they are finite and the controller was in
    time (not `user_late`). Otherwise the stock commands pass in the same tick. If those are not finite either, or the
    motors are `stopped`, both pairs get 0. `fore` and `aft` are limited to [0, 1].
    """

    inputs = ports("stopped", "user_flies", "user_late", *COMMANDS, *(f"user_{name}" for name in COMMANDS))
    outputs = ports(*COMMANDS, "user_lost", "command_lost")

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        def numbers(prefix: str) -> Any:
            fore, aft, moment, thrust = (finite(u[f"{prefix}{name}"]) for name in COMMANDS)
            return fore & aft & moment & thrust

        healthy = numbers("user_") & ~u.user_late
        use_user = u.user_flies & healthy
        sound = use_user | numbers("")
        fly = ~u.stopped & sound

        def passed(name: str) -> Any:
            return where(fly, where(use_user, u[f"user_{name}"], u[name]), 0.0)

        return {
            "fore": maximum(0.0, minimum(1.0, passed("fore"))),
            "aft": maximum(0.0, minimum(1.0, passed("aft"))),
            "M": passed("M"),
            "T": passed("T"),
            "user_lost": u.user_flies & ~healthy,
            "command_lost": ~u.stopped & ~sound,
        }


class StandbyReset(Block):
    """Resets of the integrals of the controllers that do not fly. `user_given` is the constant `given`."""

    inputs = ports("in_reset", "user_flies")
    outputs = (Port("user_in_reset", "bool"), Port("stock_in_reset", "bool"), *ports("user_given"))

    def __init__(self, given: bool) -> None:
        self.given = given

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {
            "user_in_reset": u.in_reset | ~u.user_flies,
            "stock_in_reset": u.in_reset | u.user_flies,
            "user_given": self.given,
        }


__all__ = ["ACTIONS", "CAUSES", "OUTPUTS", "STATES", "TIMERS", "failsafe"]

OUTPUTS: tuple[tuple[str, str, str], ...] = (
    ("armed", "", "motors may turn"),
    ("action", "", "what the failsafe does: index into ACTIONS"),
    ("state", "", "its state: index into STATES"),
    ("reason", "", "why: mask of CAUSES, bit n for the nth"),
    ("causes", "", "all causes that hold in this tick, also those that only prevent arming: mask of CAUSES"),
)
"""Name, unit and meaning of each output that a flight core with the failsafe has besides `core.OUTPUTS`."""

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
"""The flag that restarts each timer, by the timer's name; its time is the parameter `failsafe.NAME.timeout`."""

_SAME = MappingProxyType({name: name for name in SET_POINTS})


def failsafe() -> Diagram:
    """Return the diagram of the failsafe, made for 250 Hz.

    Inputs: `FAILSAFE_INPUTS`; the measurements and estimates; `mode` and the set-points from outside; the stock
    commands `fore`, `aft`, `M`, `T`; and the user's `user_fore`, ..., used if `user_given` is true.

    Outputs: mode and set-points for the controllers (`safe_mode`, `safe_x0`, ...) and `user_flies`, which do not depend
    on the controllers' outputs of this tick; `range_taken`, true if the range sample may correct the estimates, and
    `range_age`, which do not depend on the estimates of this tick; the commands `fore`, `aft`, `M`, `T` for the motors;
    and `OUTPUTS`.
    """
    d = Diagram("failsafe", "flags, timers, state machine, and the last gate to the motors")
    add_inputs(d, *(name for name, *_ in FAILSAFE_INPUTS), *IMU, *RANGE, *ESTIMATED, "mode", *SET_POINTS, "ax0")
    add_inputs(d, *COMMANDS, *(name for name, *_ in USER_INPUTS))
    d.params["descent"] = tunable("failsafe.descent")
    _flags(d)
    _timers(d)
    _machine(d)
    _gate(d)
    return d


def _flags(d: Diagram) -> None:
    d.add("sensors", SensorFlags(), inputs={name: name for name in (*IMU, *RANGE, "imu_new", "x", "v", "rings", "arm")})
    d.add("place", EstimateFlags(), inputs={name: name for name in (*ESTIMATED, "rings")})
    for name, function in (("sine", "sin"), ("cosine", "cos")):
        d.add(name, Trigonometry(function, input_unit="rad"), u="theta")
    turned = {"sine": "sine", "cosine": "cosine"}
    d.add("rate", RateConsistency(), gyro_y="gyro_y", sine="sine")
    turned |= {"turning": "rate.turning"}
    d.add("force", ForceConsistency(), inputs=turned | {name: name for name in (*IMU, "v", "rings")})
    d.add(
        "motion",
        RangeConsistency(),
        speed="force.speed",
        range_taken="sensors.range_taken",
        inputs={name: name for name in ("dist", "arm", "rings")},
    )
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
    d.add("range_silent", Logic("or"), a="range", b="range_stuck")
    d.add("range_lost", Logic("or"), a="range_silent", b="motion.disagrees")
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
        user_given="user_given",
        user_lost="gate.user_lost",
        command_lost="gate.command_lost",
    )
    d.add(
        "reasons",
        Reasons(),
        state="machine.state",
        mask="classes.mask",
        failed="machine.failed",
        stuck_off="machine.stuck_off",
        user_lost="gate.user_lost",
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
    d.add("gate", OutputSelector(), stopped="machine.stopped", user_flies="machine.user_flies", user_late="user_late")
    d.output("user_flies", "machine.user_flies")
    for name in COMMANDS:
        d.connect(name, f"gate.{name}")
        d.connect(f"user_{name}", f"gate.user_{name}")
        d.output(name, f"gate.{name}")
    for name in ("fore", "aft"):
        d.connect(f"gate.{name}", *(f"{part}.{name}" for part in ("commands", "force", "rate")))
