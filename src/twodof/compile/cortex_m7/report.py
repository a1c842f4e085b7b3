"""Report: what a program costs on the Cortex-M7, measured and bounded."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from twodof.compile.cortex_m7.processor import Processor
from twodof.compile.cortex_m7.target import CortexM7Backend, CortexM7Instance
from twodof.compile.cortex_m7.usage import SectionSizes, Usage, image_sizes
from twodof.compile.machine import CompiledProgram
from twodof.errors import CompileError

STEPS = 1000
FUNCTIONS = ("defaults", "prepare", "init", "step")


@dataclass(frozen=True)
class CortexM7Report:
    """A program's bytes, stack and instructions.

    `code` is what its four functions (defaults, prepare, init, step) need, with all they call. `step` is what the step
    alone needs, `image` the whole image with start-up and server. `structs` has the bytes of P, S, U and Y. `stack` is
    the bound of a step by the call graph (None: unknown) and `stack_seen` what steps that were run used, both without
    interrupts. `instructions` are those of each step that was run, (steps,), call and return left out.
    """

    name: str
    precision: str
    compiler: str
    optimise: str
    code: SectionSizes
    step: SectionSizes
    image: SectionSizes
    structs: Mapping[str, int]
    stack: int | None
    stack_seen: int
    instructions: NDArray[np.int64]

    @property
    def flash(self) -> int:
        """Bytes of flash of the program's own code and constants."""
        return self.code.flash

    @property
    def ram(self) -> int:
        """Bytes of RAM of one instance: its structs and the code's variables; the stack comes on top."""
        return sum(self.structs.values()) + self.code.ram

    def to_json(self) -> dict[str, Any]:
        """Return the figures as a JSON object."""
        return {
            "name": self.name,
            "precision": self.precision,
            "compiler": self.compiler,
            "optimise": self.optimise,
            "flash_bytes": self.flash,
            "flash_bytes_step": self.step.flash,
            "flash_bytes_image": self.image.flash,
            "ram_bytes": self.ram,
            "struct_bytes": dict(self.structs),
            "stack_bytes_bound": self.stack,
            "stack_bytes_seen": self.stack_seen,
            "instructions_mean": float(self.instructions.mean()),
            "instructions_max": int(self.instructions.max()),
            "steps": len(self.instructions),
        }


def measure(
    program: CompiledProgram,
    steps: int = STEPS,
    inputs: Mapping[str, Any] | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> CortexM7Report:
    """Measure the cost of `program`, built for the Cortex-M7.

    Its steps are run with these inputs (as `Machine.run` takes them) and parameters, which decide the instructions
    that are reached.

    Raises CompileError if it was built for another target or no step is asked for, ParameterError for the parameters,
    DiagramError for the inputs, ControllerFault if a step faults.
    """
    backend = program.backend
    if not isinstance(backend, CortexM7Backend):
        raise CompileError("it is built for another target", program.flat.name, 'build it with target="cortex-m7"')
    if steps < 1:
        raise CompileError(f"{steps} steps to measure", program.flat.name, "ask for at least one")
    image = backend.processor.image
    with Processor(image, counting=True) as processor:
        counting = CompiledProgram(program.emitted, CortexM7Backend(program.emitted, processor, backend.index))
        machine = counting.machine()
        machine.set_many(parameters or {})
        machine.reset()
        machine.run(steps, inputs)
    instance = cast(CortexM7Instance, machine.instance)
    usage = Usage(image)
    prefix = program.flat.name
    return CortexM7Report(
        name=prefix,
        precision=program.precision,
        compiler=image.compiler,
        optimise=image.optimise,
        code=usage.sizes([f"{prefix}_{f}" for f in FUNCTIONS]),
        step=usage.sizes([f"{prefix}_step"]),
        image=image_sizes(image),
        structs={k: program.dtypes[k].itemsize for k in "PSUY"},
        stack=usage.stack(f"{prefix}_step"),
        stack_seen=instance.stack,
        instructions=instance.instructions,
    )
