"""A model structure: a diagram with parameters, and which of them an experiment is asked to tell."""

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Self

from twodof.blocks.block import Block
from twodof.blocks.declarations import Param
from twodof.blocks.diagram import Diagram
from twodof.errors import IdentificationError


def check_structure(one: object) -> None:
    """Raises IdentificationError for what is not a Structure."""
    if not isinstance(one, Structure):
        raise IdentificationError(
            f"a {type(one).__name__} is not a structure",
            f"{getattr(one, '__name__', one)!s:.80}",
            "give a twodof.models.Structure; the ready-made ones are functions, to be called: pitch_rate()",
        )


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
    `sums` names sums of unknowns, such as a total delay: an estimate gives value and standard deviation of them too.
    `at_rest` names speeds at the start that dry friction may hold at 0. A fit that cannot tell them holds them there.
    `delay` names the parameter [s] that delays all inputs alike, if there is one. Outputs that are stamped between two
    steps are then simulated exactly: an output that is seen earlier is one whose inputs are later. The state at the
    start is then that of the same fraction of a step before the record's start.
    `prior` gives (mean, standard deviation) of unknowns of which the machine itself tells something before a flight.
    `measured` names inputs that are measurements of the motion itself, as a pitch that pushes a cart is. A frequency
    response from them says nothing.
    Raises IdentificationError for a name that is not a parameter of the diagram.
    """

    diagram: Diagram
    estimate: tuple[str, ...]
    local: tuple[str, ...] = ()
    scale: Mapping[str, float] = field(default_factory=dict)
    substeps: int = 1
    sums: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    at_rest: tuple[str, ...] = ()
    delay: str = ""
    prior: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    measured: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in (
            *self.estimate,
            *self.local,
            *self.scale,
            *self.prior,
            *(part for parts in self.sums.values() for part in parts),
            *([self.delay] if self.delay else []),
        ):
            self._param(name)
        if not self.estimate:
            raise IdentificationError("there is nothing to estimate", f"structure '{self.name}'", "name an unknown")

    @classmethod
    def of_block(
        cls,
        block: Block,
        estimate: Sequence[str] = (),
        *,
        name: str = "model",
        local: Sequence[str] = (),
        scale: Mapping[str, float] | None = None,
        substeps: int = 1,
    ) -> Self:
        """The structure that is one block: its inputs, outputs and parameters are the structure's.

        By default all parameters are estimated, and those whose names end in "_0" are local. Raises
        IdentificationError for names that are not parameters of the block.
        """
        diagram = Diagram(name)
        for port in block.inputs:
            diagram.input(port.name, unit=port.unit)
        real = [param for param in block.params if param.kind == "real" and param.width is None]
        for param in real:
            value = float(param.value)
            diagram.param(param.name, value, unit=param.unit, low=param.low, high=param.high, text=param.text)
        diagram.add("model", block, params={param.name: param.name for param in real})
        for port in block.inputs:
            diagram.connect(port.name, f"model.{port.name}")
        for port in block.outputs:
            diagram.output(port.name, f"model.{port.name}")
        names = tuple(param.name for param in real)
        states = tuple(one for one in names if one.endswith("_0"))
        return cls(diagram, tuple(estimate) or names, tuple(local) or states, dict(scale or {}), substeps)

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
