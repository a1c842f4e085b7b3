"""The closed loop as a WebAssembly module for another host, such as a browser, with the start of a flight."""

import base64
import functools
from collections.abc import Iterator
from typing import Any

from twodof.blocks import Diagram
from twodof.compile.builder import emit_program
from twodof.compile.program.flat_program import FlatProgram
from twodof.compile.program.flatten import FlatDiagram
from twodof.compile.program.lower import lower
from twodof.compile.wasm.module import compile_module
from twodof.flight.failsafe.causes_and_actions import ACTIONS, CAUSES
from twodof.flight.failsafe.state_machine import STATES
from twodof.flight.gains import DEFAULT
from twodof.flight.templates import MOTOR, check_template
from twodof.parameters import TUNABLES
from twodof.rig.parameters import NAMES, TABLE, load_rig
from twodof.rig.rig import BASE_DT
from twodof.signals import MODES, PERIOD
from twodof.sim.closed_loop import CASCADE, FLIGHT, SETPOINTS, TICKS, ClosedLoop, InitialState, closed_loop, loop_values

MOST_LOGGED = 600
"""Most numbers inside the diagram that the module returns at each tick; outer signals are chosen first."""


def portable_loop(controller: Diagram, rig: str = "lab") -> dict[str, Any]:
    """Compile `controller` of one of the templates in the closed loop with `rig` ("lab", "paper"), as WebAssembly.

    Returns plain data for a host, which must set `parameters`, call `init`, and set `states`; the flight then starts in
    hover. `module` is in base 64. `prefix` begins the paths of the controller's parameters and signals, such as
    "flight.cascade.attitude_control.". `signals` are the paths, inside the controller, of the signals that the module
    returns; `given` are the paths of the signals that the controller's inputs read, by name.

    The diagram, which may be untrusted, is compiled here and not run. The module has the bits of `ClosedLoop` with
    `start(InitialState(hover=True))`. Raises DiagramError for a diagram that fits no template, ParameterError for
    another rig, CompileError without a compiler for WebAssembly.
    """
    template = check_template(controller).name
    prefix = f"{FLIGHT if template == MOTOR.name else CASCADE}{template}."
    signals = list(_chosen(lower(controller, PERIOD)))
    loop = closed_loop(controllers=[controller])
    given = _given(loop, prefix.removesuffix("."))
    emitted = emit_program(
        loop, BASE_DT, log=[*(f"{prefix}{path}" for path in signals), *dict.fromkeys(given.values())]
    )
    module = compile_module([emitted], optimise="-O1")
    wanted, states = _start(rig)
    known = emitted.flat.parameters
    return {
        "module": base64.b64encode(module.data).decode("ascii"),
        "interface": module.interface(),
        "template": template,
        "prefix": prefix,
        "parameters": {path: value for path, value in wanted.items() if path in known},
        "states": dict(states),
        "signals": signals,
        "given": given,
        "setpoints": list(SETPOINTS),
        "ticks": TICKS,
    }


@functools.lru_cache(8)
def _start(rig: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return parameters and states of a start in hover of the stock loop; its estimator settles alike in all loops."""
    stock = ClosedLoop(rig=load_rig(rig))
    started, states = stock.start_values(InitialState(hover=True))
    wanted = {f"rig.{name}": value for name, value in (stock.rig | started).items()}
    return wanted | {f"{CASCADE}{path}": value for path, value in DEFAULT.parameters().items()}, states


def _chosen(program: FlatProgram) -> Iterator[str]:
    """Paths of outputs of blocks, the outermost first, until there are enough."""
    left = MOST_LOGGED
    for path in sorted(program.signals, key=lambda one: one.count(".")):
        signal = program.signals[path]
        if signal.node is not None:
            left -= signal.width or 1
            if left >= 0:
                yield path


def _given(loop: Diagram, place: str) -> dict[str, str]:
    """Of the sub-diagram at `place` the signals that its inputs read; not those that are the loop's own inputs."""
    flat = FlatDiagram(loop)
    level = next(one for one in flat.levels if one.path == place)
    found: dict[str, str] = {}
    for name in level.diagram.inputs:
        source = None if level.parent is None else level.parent.diagram.feed(level.name, name)
        if source is not None and level.parent is not None:
            signal = level.parent.resolve(source)
            if signal.node is not None:
                found[name] = signal.path
    return found


def play_program() -> tuple[bytes, dict[str, Any]]:
    """Return the closed loop with stock flight code and failsafe as a .wasm in float64, and plain data beside it.

    The data: `table` (`WasmModule.interface`), `ticks` of a control step, the names of `modes`, failsafe `states`,
    `actions` and `causes`; `rigs` (parameters by path), `starts` (`parameters` and `states` by path, for "rest" and
    "hover"), and `texts` (meanings of the parameters, by path). Raises CompileError without a compiler for WebAssembly.
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
    rigs = {name: loop_values(load_rig(name)) for name in NAMES}
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
    return module.data, data
