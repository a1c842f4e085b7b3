"""Running a structure on a record: compiled once for a step size, then a few microseconds for each set of values."""

import functools
import math
from collections.abc import Callable, Mapping
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.reference.interpreter import Reference
from twodof.compile import CompiledProgram, build
from twodof.errors import IdentificationError
from twodof.identify.record import Record
from twodof.models.structure import Structure

Array = NDArray[np.float64]


class RecordSimulator:
    """One structure on one record: `run(values)` gives each measured output at the times of its samples."""

    def __init__(self, structure: Structure, record: Record) -> None:
        missing = [name for name in structure.inputs if name not in record.inputs]
        if missing:
            raise IdentificationError(
                f"the structure's input '{missing[0]}' is not in the record",
                f"structure '{structure.name}', record '{record.name}'",
                f"the record's inputs are: {', '.join(record.inputs)}",
            )
        self.outputs = tuple(name for name in structure.outputs if name in record.outputs)
        if not self.outputs:
            raise IdentificationError(
                f"none of the structure's outputs ({', '.join(structure.outputs)}) was measured",
                f"structure '{structure.name}', record '{record.name}'",
                f"the record's outputs are: {', '.join(record.outputs)}",
            )
        self._machine = program_of(structure, record.dt).machine()
        self._values: dict[str, float] = {}
        self._substeps = structure.substeps
        self._steps = record.steps * structure.substeps
        self._inputs = {name: np.repeat(record.inputs[name], structure.substeps) for name in structure.inputs}
        self._at = {name: _sampler(record.outputs[name].position, record.steps) for name in self.outputs}

    def run(self, values: Mapping[str, float]) -> dict[str, Array]:
        """Outputs at their samples' times for the parameters `values`; those not named keep their last value."""
        # Most runs of a Jacobian change one value, and checking a value takes as long as simulating 50 steps.
        changed = {name: value for name, value in values.items() if self._values.get(name) != value}
        self._machine.set_many(changed)
        self._values |= changed
        self._machine.reset()
        simulated = self._machine.run(self._steps, self._inputs)
        return {name: self._at[name](simulated[name][:: self._substeps]) for name in self.outputs}


def _sampler(position: Array, steps: int) -> Callable[[Array], Array]:
    """Picks values of a simulated output at given positions, linearly between steps."""
    index = np.minimum(np.floor(position).astype(np.int64), max(steps - 2, 0))
    share = position - index
    first = int(index[0])
    if np.array_equal(position, np.arange(first, first + position.size)):
        return itemgetter(slice(first, first + position.size))

    def between(y: Array) -> Array:
        left = y[index]
        return np.asarray(left + share * (y[index + 1] - left))

    return between


def program_of(structure: Structure, dt: float) -> CompiledProgram | Reference:
    """The structure compiled for data with the step `dt` [s]; kept, so that a second fit does not compile again."""
    # Logs of one rig differ in the last digits of their step: a relative 1e-9 is no reason to compile again.
    digits = 9 - math.floor(math.log10(dt))
    return _program(structure, round(dt, digits))


@functools.lru_cache(maxsize=64)
def _program(structure: Structure, dt: float) -> CompiledProgram | Reference:
    return build(structure.diagram, dt=dt / structure.substeps, precision="float64")
