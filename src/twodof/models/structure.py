"""A model structure: a diagram with parameters, and which of them an experiment is asked to tell."""

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Self

from twodof.blocks.declarations import Param
from twodof.blocks.diagram import Diagram
from twodof.errors import IdentificationError


@dataclass(frozen=True)
class UnknownParameter:
    """A parameter of a structure: its first guess `value`, bounds, unit, and the `scale` on which it matters.

    `local` unknowns (initial states, trim, bias) have one value for each record, the others one for all records.
    """

    name: str
    value: float
    lower: float
    upper: float
    unit: str
    scale: float
    local: bool
    text: str


@dataclass(frozen=True, eq=False)
class Structure:
    """Any diagram, linear or not, whose parameters are identified from data.

    The diagram's own parameters (`Diagram.param`) are the unknowns; its inputs and outputs are the columns a record
    must have. `estimate` names the unknowns that a fit finds unless told otherwise, the others keep their values;
    `local` those that each record has for itself; `scale` the size of a change that matters, for unknowns whose first
    guess is 0 (default: the guess, or 1). `substeps`: how many base ticks one step of the data is divided into.
    Raises IdentificationError for a name that is not a parameter of the diagram.
    """

    diagram: Diagram
    estimate: tuple[str, ...]
    local: tuple[str, ...] = ()
    scale: Mapping[str, float] = field(default_factory=dict)
    substeps: int = 1

    def __post_init__(self) -> None:
        for name in (*self.estimate, *self.local, *self.scale):
            self._param(name)
        if not self.estimate:
            raise IdentificationError("there is nothing to estimate", f"structure '{self.name}'", "name an unknown")

    @property
    def name(self) -> str:
        """The diagram's name."""
        return self.diagram.name

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(self.diagram.inputs)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(self.diagram.outputs)

    @property
    def unknowns(self) -> dict[str, UnknownParameter]:
        """Every scalar real parameter of the diagram by name."""
        return {
            name: self._unknown(param)
            for name, param in self.diagram.params.items()
            if param.kind == "real" and param.width is None
        }

    def with_guess(self, **values: float) -> Self:
        """The same structure with other first guesses. Raises IdentificationError for an unknown name."""
        diagram = copy(self.diagram)
        diagram.params = dict(self.diagram.params)
        for name, value in values.items():
            diagram.params[name] = replace(self._param(name), value=float(value))
        return replace(self, diagram=diagram)

    def _param(self, name: str) -> Param:
        if name not in self.diagram.params:
            raise IdentificationError(
                f"there is no parameter '{name}'",
                f"structure '{self.name}'",
                f"there are: {', '.join(self.diagram.params) or 'none'}",
            )
        return self.diagram.params[name]

    def _unknown(self, param: Param) -> UnknownParameter:
        value = float(param.value)
        scale = self.scale.get(param.name, abs(value) if value != 0.0 else 1.0)
        if not (math.isfinite(scale) and scale > 0.0):
            raise IdentificationError(f"scale {scale} of '{param.name}' is not positive", f"structure '{self.name}'")
        return UnknownParameter(
            param.name, value, param.low, param.high, param.unit, scale, param.name in self.local, param.text
        )
