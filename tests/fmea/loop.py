"""One compiled closed loop for all rows of the hazard analysis: an instance flies a situation, a fault and a seed."""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from tests.fmea.faults import Fault, FlagFault, Mirrored, Noise
from twodof.blocks import Block, Diagram, Param, Port, State, int32, maximum, to_int32, where
from twodof.blocks.library.delays import ZeroOrderHold
from twodof.compile.builder import build
from twodof.compile.machine import CompiledProgram, Instances
from twodof.flight.cascade import cascade
from twodof.flight.core import PreviousPitch, core
from twodof.flight.failsafe.causes_and_actions import ACTIONS
from twodof.flight.mixer import Mixer
from twodof.rig.parameters import load_rig
from twodof.rig.rig import BASE_DT, SAMPLE, rig
from twodof.sim.closed_loop import loop_values

ARM, GO = 400, 600
"""When it arms and when it takes off [ms]."""

ONSET, END = 3000, 11_000
"""The fault comes at ONSET or up to .22 s later, by the seed; then the flight lasts 7.8 s at least [ms]."""

NUMBERS: Mapping[str, str] = {
    "acc_x": "acc_z",
    "acc_z": "acc_x",
    "gyro_y": "acc_x",
    "dist": "mirrored",
    "dist_age": "dist_age",
    "voltage": "dist",
    "x0": "v0",
    "v0": "x0",
    "theta0": "thrust",
    "thrust": "theta0",
    "q0": "theta0",
    "M_open": "thrust",
    "fore": "aft",
    "aft": "fore",
    "own_M": "own_M",
}
"""Where a fault in a number may be, and with which other number it is swapped."""

FLAGS = ("dist_new", "imu_new", "setpoint_new", "link_new", "step_late", "user_late", "step")
"""Where a fault in a flag may be; `step` is false where the flight code's step does not run."""


class Script(Block):
    """Set-points: armed at ARM, flown from GO in a mode with constant set-points or a square wave of them."""

    outputs = (
        Port("arm", "bool"),
        Port("mode", "int32"),
        Port("yes", "bool"),
        Port("no", "bool"),
        *(Port(name) for name in ("x0", "v0", "theta0", "q0", "thrust", "M_open", "nothing")),
        Port("rings", "bool"),
        Port("own", "bool"),
    )
    params = (
        Param("mode", 3, "int32"),
        Param("mode_after", -99, "int32", text="the mode that is asked for after the onset, if not -99"),
        *(Param(name, 0.0) for name in ("x0", "v0", "theta0", "q0", "thrust", "M_open")),
        Param("half", 2**28, "int32", text="half a period of the set-points [ms]"),
        Param("rings", True, "bool"),
        Param("own", False, "bool"),
        Param("onset", 2**30, "int32"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        now = to_int32(t.tick)
        flies = now >= int32(GO)
        back = (maximum(now - int32(GO), int32(0)) // p.half) & int32(1) == int32(1)
        mode = where((p.mode_after != int32(-99)) & (now >= p.onset), p.mode_after, p.mode)

        def wave(name: str) -> Any:
            return where(back, -p[name], p[name])

        return {
            "arm": now >= int32(ARM),
            "mode": where(flies, mode, int32(0)),
            "yes": True,
            "no": False,
            "nothing": 0.0,
            **{name: where(flies, wave(name), 0.0) for name in ("x0", "v0", "theta0", "q0")},
            "thrust": where(flies, p.thrust, 0.0),
            "M_open": where(flies, p.M_open, 0.0),
            "rings": p.rings,
            "own": p.own,
        }


class Witness(Block):
    """Results since the onset of the fault; times in ms, -1 for never.

    `level_at` is that of level or a stronger action, and so on; `at_stop` how long motors were on near a stop, within
    .02 rad or 5 mm, `on_after` how long after a stop was first met.
    """

    crossing = True
    inputs = (
        *(Port(name) for name in ("theta", "q", "x", "v", "fore", "aft")),
        Port("action", "int32"),
        Port("reason", "int32"),
    )
    outputs = (Port("seen", "bool"),)
    states = (
        State("early", False, "bool"),
        State("first_reason", 0, "int32"),
        State("strongest", 0, "int32"),
        *(State(f"{action}_at", -1, "int32") for action in ACTIONS[1:]),
        State("reason", 0, "int32"),
        State("theta"),
        State("x"),
        State("touched_at", -1, "int32"),
        State("impact_q"),
        State("impact_v"),
        State("at_stop", 0, "int32"),
        State("on_after", 0, "int32"),
    )
    params = (
        Param("onset", 2**30, "int32"),
        Param("pitch_stop", 0.87),
        Param("rail_stop", 0.40),
        Param("rings", True, "bool"),
    )

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.early

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        now = to_int32(t.tick)
        since = now - p.onset
        due = since >= int32(0)
        acts = u.action > int32(0)
        begins = due & acts & (x.strongest == int32(0))
        on = (u.fore > 0.0) | (u.aft > 0.0)
        # A stop is met within this tick, or the body rests on it or has just left it.
        pitch_hit = (abs(u.theta + u.q * BASE_DT) >= p.pitch_stop) & (u.theta * u.q > 0.0)
        rail_hit = (abs(u.x + u.v * BASE_DT) >= p.rail_stop) & (u.x * u.v > 0.0) & ~p.rings
        at_pitch = abs(u.theta) >= p.pitch_stop - 0.02
        at_rail = (abs(u.x) >= p.rail_stop - 0.005) & ~p.rings
        hit = due & (pitch_hit | rail_hit)
        touched = hit | (x.touched_at >= int32(0))
        return {
            "early": x.early | (acts & ~due & (now > int32(GO))),
            "first_reason": where(begins, u.reason, x.first_reason),
            "strongest": where(due & (u.action > x.strongest), u.action, x.strongest),
            **{
                f"{action}_at": where(
                    due & (u.action >= int32(n)) & (x[f"{action}_at"] < int32(0)), since, x[f"{action}_at"]
                )
                for n, action in enumerate(ACTIONS)
                if n
            },
            "reason": where(due, x.reason | u.reason, x.reason),
            "theta": where(due, maximum(abs(u.theta), x.theta), x.theta),
            "x": where(due & ~p.rings, maximum(abs(u.x), x.x), x.x),
            "touched_at": where(hit & (x.touched_at < int32(0)), since, x.touched_at),
            "impact_q": where(due & pitch_hit, maximum(abs(u.q), x.impact_q), x.impact_q),
            "impact_v": where(due & rail_hit, maximum(abs(u.v), x.impact_v), x.impact_v),
            "at_stop": x.at_stop + where(due & on & (at_pitch | at_rail), int32(1), int32(0)),
            "on_after": x.on_after + where(touched & on, int32(1), int32(0)),
        }


FILTER = "flight.estimator.filter"
SETTLING = 100_000
"""Ticks after which its covariances stand."""

MEASURED = tuple(state.name for state in Witness.states)


def faulty_loop() -> Diagram:
    """Script, rig, faults, flight code with the failsafe, a user's controller beside it, and the witness."""
    d = Diagram("fmea", "the closed loop with a fault anywhere")
    d.param("onset", 2**30, kind="int32")
    d.param("rings", True, kind="bool")
    d.param("seed", 1, kind="uint32")
    d.add("script", Script(), rate=SAMPLE, params={"onset": "onset", "rings": "rings"})
    d.add("rig", rig(), params={"seed": "seed", "rings": "rings"})
    d.add("noise", Noise(), rate=SAMPLE, params={"seed": "seed"})
    d.add("voltage_held", ZeroOrderHold(unit="V"), rate=SAMPLE, u="rig.voltage")
    sources = {name: f"rig.{name}" for name in ("acc_x", "acc_z", "gyro_y", "dist", "dist_age")}
    sources |= {name: f"script.{name}" for name in ("x0", "v0", "theta0", "q0", "thrust", "M_open")}
    sources |= {"voltage": "voltage_held", "fore": "flight.fore", "aft": "flight.aft", "own_M": "own.M"}
    d.add("mirrored", Mirrored(), rate=SAMPLE, dist="rig.dist")
    sources["mirrored"] = "mirrored"
    for name in NUMBERS:
        d.add(name, Fault(), rate=SAMPLE, params={"onset": "onset"}, n="noise")
    flags = dict.fromkeys(("imu_new", "setpoint_new", "link_new", "step"), "script.yes")
    flags |= {"dist_new": "rig.dist_new", "step_late": "script.no", "user_late": "script.no"}
    for name in FLAGS:
        d.add(name, FlagFault(), rate=SAMPLE, params={"onset": "onset"}, u=flags[name])
    d.add("flight", core(failsafe=True, outside=True), rate=SAMPLE, enable="step")
    for name in ("acc_x", "acc_z", "gyro_y", "dist", "dist_age", "voltage"):
        d.connect(name, f"flight.{name}")
    for name in ("x0", "v0", "theta0", "q0", "thrust", "M_open"):
        d.connect(name, f"flight.{name}")
    for name in ("imu_new", "setpoint_new", "link_new", "dist_new", "step_late", "user_late"):
        d.connect(name, f"flight.{name}")
    for name in ("arm", "mode", "rings"):
        d.connect(f"script.{name}", f"flight.{name}")
    d.connect("script.nothing", "flight.ax0")
    d.connect("script.no", "flight.in_reset", "flight.use_trim")
    # The user's controller: the stock cascade, with a fault in its moment.
    d.add("own", cascade(), rate=SAMPLE)
    d.add("own_pitch", PreviousPitch(), rate=SAMPLE, theta="flight.theta")
    d.connect("own_pitch", "own.theta")
    for name in ("q", "x", "v"):
        d.connect(f"flight.{name}", f"own.{name}")
    for name in ("x0", "v0", "theta0", "q0", "thrust", "M_open", "mode"):
        d.connect(f"script.{name}", f"own.{name}")
    d.connect("script.no", "own.in_reset")
    d.add("own_mixer", Mixer(), rate=SAMPLE, T="own.T", M="own_M")
    d.connect("script.own", "flight.user_given")
    for name, source in (("fore", "own_mixer.fore"), ("aft", "own_mixer.aft"), ("M", "own_M"), ("T", "own.T")):
        d.connect(source, f"flight.user_{name}")
    for name, partner in NUMBERS.items():
        d.connect(sources[name], f"{name}.u")
        d.connect(sources[partner], f"{name}.partner")
    for name in ("fore", "aft"):
        d.connect(name, f"rig.{name}")
    d.add("witness", Witness(), params={"onset": "onset", "rings": "rings"})
    for name in ("theta", "q", "x", "v"):
        d.connect(f"rig.{name}", f"witness.{name}")
    for name in ("fore", "aft"):
        d.connect(name, f"witness.{name}")
    for name in ("action", "reason"):
        d.connect(f"flight.{name}", f"witness.{name}")
    d.output("early", "witness.seen")
    for name in ("theta", "q", "x", "v"):
        d.output(f"true_{name}", f"rig.{name}")
    for name in ("theta", "x", "v", "action", "reason", "fore", "aft"):
        d.output(name, f"flight.{name}")
    return d


@functools.cache
def compiled() -> CompiledProgram:
    """Return the compiled loop."""
    program = build(faulty_loop(), BASE_DT, optimise="-O2")
    assert isinstance(program, CompiledProgram)
    return program


def settled() -> dict[str, Any]:
    """The estimator's states after a long rest: no flight starts with a doubtful pitch."""
    machine = Instances(compiled(), 1)
    machine.skip(SETTLING)
    paths = [path for path in machine.program.states if path.startswith(f"{FILTER}.P_")]
    return {path: float(machine.state(path)[0]) for path in paths} | {f"{FILTER}.started": True}


def fly(
    lanes: Sequence[Mapping[str, Any]], changes: Sequence[Mapping[str, Any]], start: Mapping[str, Any]
) -> dict[str, NDArray[Any]]:
    """Fly a set of parameters in each instance; `changes` come at ONSET, `start` are states.

    Returns what the witness saw, (instances,) each.
    """
    machine = Instances(compiled(), len(lanes))
    _set(machine, lanes)
    machine.reset()
    for path, value in start.items():
        machine.set_state(path, value)
    machine.skip(ONSET)
    _set(machine, changes)
    machine.skip(END - ONSET)
    return {name: machine.state(f"witness.{name}") for name in MEASURED}


def _set(machine: Instances, lanes: Sequence[Mapping[str, Any]]) -> None:
    """Sets the parameters that are given for any instance; in the others they stay."""
    values: dict[str, Any] = {}
    for path in sorted({path for lane in lanes for path in lane}):
        present = machine.get(path)[0].item()
        given = [lane.get(path, present) for lane in lanes]
        values[path] = given[0] if given.count(given[0]) == len(given) else given
    machine.set_many(values)


def rig_values(name: str) -> dict[str, float]:
    """A rig's parameters, as those of the loop."""
    return loop_values(load_rig(name))
