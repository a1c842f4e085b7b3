"""Flash a controller: check it, compile it, say what it costs and what changes, and let it fly from now on."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twodof.blocks import Diagram
from twodof.blocks.difference import Difference, difference
from twodof.compile import CompiledProgram, build
from twodof.compile.cortex_m7.report import measure
from twodof.compile.program.check import check as check_diagram
from twodof.compile.px4 import export
from twodof.compile.px4.checkout.check import ERROR
from twodof.compile.px4.checkout.check import check as check_module
from twodof.errors import CompileError
from twodof.fleet.flash_target import check_target, open_target
from twodof.flight.templates import check_template
from twodof.signals import PERIOD

_STEPS = 250  # run on the emulated processor to count instructions: a second of flight


@dataclass(frozen=True)
class ControllerCosts:
    """What a controller costs: bytes of its structs, alike on every target, and the Cortex-M7's figures or why none."""

    parameters: int
    states: int
    inputs: int
    outputs: int
    m7: dict[str, Any] | None
    m7_missing: str

    def to_json(self) -> dict[str, Any]:
        """The figures as a JSON object."""
        return {
            "parameter_bytes": self.parameters,
            "state_bytes": self.states,
            "input_bytes": self.inputs,
            "output_bytes": self.outputs,
            "cortex_m7": self.m7,
            "cortex_m7_missing": self.m7_missing or None,
        }


@dataclass(frozen=True)
class FlashReport:
    """What was flashed, or would be: `changes` against `origin`, what is odd about it, and the `place`, for people."""

    diagram: Diagram
    template: str
    costs: ControllerCosts
    origin: str
    changes: Difference
    remarks: tuple[str, ...]
    warnings: tuple[str, ...]
    place: str


def controller_costs(diagram: Diagram, precision: str = "float32") -> ControllerCosts:
    """What `diagram` costs at 250 Hz, compiled for this machine and for the Cortex-M7 where its tool chain is there.

    Raises DiagramError and CompileError as `build` does, CompileError also without a C compiler.
    """
    program = build(diagram, PERIOD, precision)
    if not isinstance(program, CompiledProgram):
        raise CompileError("there is no C compiler", diagram.name, "install gcc, or the wheel ziglang")
    p, s, u, y = (program.dtypes[struct].itemsize for struct in "PSUY")
    try:
        on_m7 = build(diagram, PERIOD, precision, target="cortex-m7")
    except CompileError as reason:
        return ControllerCosts(p, s, u, y, None, str(reason))
    # Only the native target falls back to the interpreter.
    m7 = measure(on_m7, _STEPS).to_json() if isinstance(on_m7, CompiledProgram) else None
    return ControllerCosts(p, s, u, y, m7, "")


def flash(
    diagram: Diagram,
    to: str,
    out: Path | None = None,
    px4: Path | None = None,
    precision: str = "float32",
    key: Path | None = None,
    dry_run: bool = False,
) -> FlashReport:
    """Lets `diagram` fly at `to`: "sim", "px4-dir" (a module in the folder `out`), "fcu" or a drone's URL.

    A drone must be disarmed; it builds the controller itself, for its sandbox, and keeps it over restarts. The module
    is first compared with the PX4 in the folder `px4`, if one is given. `dry_run`: everything but the last step.

    Raises LinkError for another `to`, DiagramError for a diagram that fits no template, CompileError, and what
    `open_target` and the drone raise.
    """
    check_target(to)
    kind = check_template(diagram).name
    costs = controller_costs(diagram, precision)
    remarks = tuple(f"{r.where}: {r.what} ({r.remedy})" for r in check_diagram(diagram, PERIOD).remarks)
    warnings = () if px4 is None else _checked(diagram, px4)
    with open_target(to, kind, out, key) as there:
        if not dry_run:
            there.put(diagram)
    changes = difference(there.before, diagram)
    return FlashReport(diagram, kind, costs, there.origin, changes, remarks, warnings, there.place)


def _checked(diagram: Diagram, px4: Path) -> tuple[str, ...]:
    """What `twodof px4 check` warns of, of a module that nobody keeps. Raises CompileError where it does not fit."""
    with tempfile.TemporaryDirectory(prefix="twodof-") as name:
        folder = Path(name) / "module"
        export(diagram, folder)
        found = check_module(px4, folder)
    if not found.fits:
        errors = "; ".join(f"{row.where}: {row.what} ({row.remedy})" for row in found.rows if row.level == ERROR)
        raise CompileError(f"{found.module} does not fit it: {errors}", str(px4), "nothing was written")
    return tuple(f"{row.where}: {row.what} ({row.remedy})" for row in found.rows)
