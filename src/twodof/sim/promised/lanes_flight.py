"""One step of a set-point flown on many rigs: instances of one compiled closed loop."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks import Diagram
from twodof.compile.builder import build
from twodof.compile.instances import Instances
from twodof.compile.machine import CompiledProgram
from twodof.errors import CompileError, ParameterError
from twodof.flight.gains import DEFAULT, Gains
from twodof.rig.rig import BASE_DT
from twodof.signals import HOVER, MODES, PERIOD
from twodof.sim.closed_loop import ARMING, SETPOINTS, TICKS, closed_loop

Array = NDArray[np.float64]

HOLD = 8.0
"""From the start of the motors to the step [s], as the experiments have it."""

BEFORE = 125
"""Samples before the step that are kept: .5 s."""

_CHUNK = 250  # steps between two calls of `said`


@dataclass(frozen=True, eq=False)
class LanesFlight:
    """`time` (steps,) [s] from the step on, `BEFORE` samples of it before; `channels` are (steps, rigs) each."""

    time: Array
    channels: Mapping[str, Array]


def fly_lanes(
    rigs: Sequence[Mapping[str, float]],
    setpoint: str,
    goal: float,
    duration: float,
    *,
    gains: Gains = DEFAULT,
    tuned: Mapping[str, Sequence[Any]] = MappingProxyType({}),
    controllers: Iterable[Diagram] = (),
    read: Sequence[str] = ("theta", "q", "M"),
    seed: int = 1,
    said: Callable[[float], None] = lambda share: None,
) -> LanesFlight:
    """Hold `setpoint` ("theta0", "v0" or "x0") at 0, then step it to `goal`, for `duration` [s].

    Each of `rigs` is a rig's parameters by name; the k-th has the noise of `seed` + k. `read` are outputs of the closed
    loop. `gains` are those of the stock loops, and `controllers` fly in place of some. `tuned` are parameters of the
    closed loop by path, a value for each rig. `said` is called with the share done; an exception that it raises ends
    the flights. Raises ParameterError for another set-point, and as `closed_loop` and `build`.
    """
    modes = {"theta0": "attitude", "v0": "velocity", "x0": "position"}
    if setpoint not in modes:
        raise ParameterError(f"a set-point {setpoint!r:.40}", "fly_lanes", f"give one of {', '.join(modes)}")
    program = build(closed_loop(gains, controllers=controllers), BASE_DT)
    if not isinstance(program, CompiledProgram):
        raise CompileError("flights of many rigs need a C compiler", "fly_lanes", "install gcc, or the wheel ziglang")
    machine = Instances(program, len(rigs))
    values = {f"rig.{name}": [rig[name] for rig in rigs] for name in rigs[0]}
    # As the experiments have it, rings lock the cart while the pitch is stepped.
    values["rig.rings"] = [setpoint == "theta0"] * len(rigs)
    values |= {"rig.noise": [rig.get("noise", 1.0) for rig in rigs], "rig.seed": [seed + k for k in range(len(rigs))]}
    machine.set_many(values | dict(tuned))
    machine.reset()
    still = ARMING + 100
    begin = still + round(HOLD / PERIOD)
    steps = begin + round(duration / PERIOD) + 1
    kept: dict[str, list[Array]] = {name: [] for name in read}
    for first in range(0, steps, _CHUNK):
        said(first / steps)
        k = np.arange(first, min(first + _CHUNK, steps))
        given = {name: np.zeros(len(k)) for name in SETPOINTS}
        given |= {name: np.zeros(len(k), dtype=bool) for name in ("in_reset", "use_trim")}
        given["mode"] = np.where(k < still, 0, MODES.index(modes[setpoint])).astype(np.int32)
        given["thrust"] = np.where(k < still, 0.0, HOVER)
        given[setpoint] = np.where(k < begin, 0.0, goal)
        out = machine.run(len(k) * TICKS, {name: np.repeat(column, TICKS) for name, column in given.items()})
        for name in read:
            kept[name].append(np.asarray(out[name][::TICKS], dtype=float)[k >= begin - BEFORE])
    time = np.asarray((np.arange(begin - BEFORE, steps) - begin) * PERIOD, dtype=np.float64)
    return LanesFlight(time, {name: np.concatenate(parts) for name, parts in kept.items()})
