"""What a page needs to fly the virtual rig in a browser: the closed loop as WebAssembly, and what to set in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from twodof.compile.builder import emit_program
from twodof.compile.wasm.module import compile_module
from twodof.flight.failsafe.causes_and_actions import ACTIONS, CAUSES
from twodof.flight.failsafe.state_machine import STATES
from twodof.parameters import TUNABLES
from twodof.rig.parameters import NAMES, TABLE, load_rig
from twodof.rig.rig import BASE_DT
from twodof.signals import MODES
from twodof.sim.closed_loop import FLIGHT, TICKS, ClosedLoop, closed_loop
from twodof.sim.initial_state import InitialState


@dataclass(frozen=True)
class PlayProgram:
    """`module` is the .wasm of the closed loop with its failsafe, in float64.

    `data` is JSON: `table` (`WasmModule.interface`), `ticks` of a control step, the names of `modes`, failsafe
    `states`, `actions` and `causes`; `rigs` (parameters by path), `starts` (`parameters` and `states` by path, for
    "rest" and "hover"), and `texts` (what parameters are, by path).
    """

    module: bytes
    data: dict[str, Any]


def play_program() -> PlayProgram:
    """The rig with the stock flight code and its failsafe, as `ClosedLoop(failsafe=True)` flies it.

    Raises CompileError where there is no compiler for WebAssembly.
    """
    emitted = emit_program(closed_loop(failsafe=True), BASE_DT)
    module = compile_module([emitted])
    loop = ClosedLoop(failsafe=True)
    starts = {}
    for name in ("rest", "hover"):
        at = InitialState(hover=name == "hover")
        parameters, states = loop.start_values(at)
        starts[name] = {"parameters": {f"rig.{path}": v for path, v in parameters.items()}, "states": states}
    texts = {f"{FLIGHT}{row.path}": row.text for row in TUNABLES.values()} | {
        f"rig.{row.name}": row.text for row in TABLE
    }
    rigs = {name: {f"rig.{path}": v for path, v in load_rig(name).snapshot().items()} for name in NAMES}
    data = {
        "table": module.interface(),
        "ticks": TICKS,
        "modes": list(MODES),
        "states": list(STATES),
        "actions": list(ACTIONS),
        "causes": [{"name": cause.name, "text": cause.text} for cause in CAUSES],
        "rigs": rigs,
        "starts": starts,
        "texts": texts,
    }
    return PlayProgram(module.data, data)
