"""Model structure: a diagram with parameters, and those to estimate from data."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import Param, Port
from twodof.blocks.diagram import Diagram
from twodof.errors import IdentificationError, is_number, shown
from twodof.models.around_plant import Offset
from twodof.models.zero_order_hold import Matrix, ZohPlant

Array = NDArray[np.float64]


def check_structure(one: object) -> None:
    """Raise IdentificationError unless `one` is a Structure."""
    if not isinstance(one, Structure):
        what = f"a {type(one).__name__} is not a structure"
        remedy = "give a twodof.models.Structure; the ready-made ones are functions, to be called: pitch_rate()"
        raise IdentificationError(what, f"{getattr(one, '__name__', one)!s:.80}", remedy)


@dataclass(frozen=True)
class UnknownParameter:
    """A parameter of a structure: first guess `value`, bounds, unit, and `scale`, the size of a change that matters.

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
    must have. `estimate` names the unknowns that a fit finds by default; the others keep their values. `local` names
    those with a value of its own for each record. `scale` is the size of a change that matters, for unknowns whose
    first guess is 0 (default: the guess, or 1). `substeps` is the number of base ticks per step of the data.
    `sums` names sums of unknowns, such as a total delay: an estimate gives value and standard deviation of them too.
    `at_rest` names initial speeds that dry friction may hold at 0. A fit that cannot determine them holds them there.
    `delay` names the parameter [s] that delays all inputs alike, if there is one. Outputs that are stamped between two
    steps are then simulated exactly, by a longer delay: reading an output earlier is the same as delaying its inputs.
    The initial state is then that of the same fraction of a step before the record's start.
    `prior` gives (mean, standard deviation) of unknowns that are roughly known before a flight.
    `measured` names inputs that are measurements of the motion itself, such as a pitch that pushes a cart. A frequency
    response from them has no meaning.
    `predictor` is the model in innovation form, if it has one: its inputs are also the measured outputs, as
    "<output>_measured", and its last unknowns the gains "K_i_j" with which they correct the states.
    `pushed` names initial states that random pushes move during the whole flight, with what is known of the density of
    the pushes [the state's unit/sqrt(s)]: the likeliest one, and the factor of a standard deviation.
    `begin` gives the structure with first guesses for an input (steps,), an output (steps,) and the step [s].
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
    predictor: "Structure | None" = None
    pushed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    begin: "Callable[[Array, Array, float], Structure] | None" = None

    def __post_init__(self) -> None:
        parts = [part for sum_of in self.sums.values() for part in sum_of]
        known = (*self.local, *self.scale, *self.prior, *self.pushed)
        for name in (*self.estimate, *known, *parts, *filter(None, [self.delay])):
            self._param(name)
        if not self.estimate:
            raise self.error("there is nothing to estimate", "name a parameter of the diagram in `estimate`")

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
        """Make the structure of one block, with its inputs, outputs and parameters.

        By default all parameters are estimated, and those whose names end in "_0" are local. Raises
        IdentificationError for names that are not parameters of the block.
        """
        diagram = Diagram(name)
        for port in block.inputs:
            diagram.input(port.name, unit=port.unit)
        for param in _reals(block.params):
            value = float(param.value)
            diagram.param(param.name, value, unit=param.unit, low=param.low, high=param.high, text=param.text)
        names = tuple(diagram.params)
        diagram.add("model", block, params={name: name for name in names})
        for port in block.inputs:
            diagram.connect(port.name, f"model.{port.name}")
        for port in block.outputs:
            diagram.output(port.name, f"model.{port.name}")
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
        return {param.name: self._unknown(param) for param in _reals(self.diagram.params.values())}

    def error(self, what: str, remedy: str = "") -> IdentificationError:
        """Return an IdentificationError that names this structure as its place."""
        return IdentificationError(what, f"structure '{self.name}'", remedy)

    def check_names(self, names: Iterable[str]) -> None:
        """Raise IdentificationError if one of `names` is not an unknown of this structure."""
        known = self.unknowns
        for name in names:
            if name not in known:
                raise self.error(f"no unknown is called '{name}'", f"there are: {', '.join(known)}")

    def with_guess(self, **values: float) -> Self:
        """Return a copy with other first guesses. Raises IdentificationError for a name that is not a parameter."""
        diagram = copy(self.diagram)
        diagram.params = dict(self.diagram.params)
        for name, value in values.items():
            diagram.params[name] = replace(self._param(name), value=float(value))
        return replace(self, diagram=diagram)

    def _param(self, name: str) -> Param:
        if name not in self.diagram.params:
            raise self.error(f"no parameter named '{name}'", f"there are: {', '.join(self.diagram.params) or 'none'}")
        return self.diagram.params[name]

    def _unknown(self, param: Param) -> UnknownParameter:
        value = float(param.value)
        scale = self.scale.get(param.name, abs(value) if value != 0.0 else 1.0)
        if not (math.isfinite(scale) and scale > 0.0):
            raise self.error(f"scale {scale} of '{param.name}' is not positive")
        return UnknownParameter(
            param.name, value, param.low, param.high, param.unit, scale, param.name in self.local, param.text
        )


def _reals(params: Iterable[Param]) -> list[Param]:
    """Return the scalar real ones: those that a fit can find."""
    return [param for param in params if param.kind == "real" and param.width is None]


Entry = float | str
Rows = Sequence[Sequence[Entry]]

MAX_STATES = 20


def linear_model(
    a: Rows,
    b: Rows,
    c: Rows,
    d: Rows | None = None,
    *,
    inputs: Sequence[str],
    outputs: Sequence[str],
    guess: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    discrete: bool = False,
    delays: Mapping[str, Entry] | None = None,
    ring: int = 64,
    name: str = "linear_model",
) -> Structure:
    """Make the structure x' = A x + B u, y = C x + D u (`discrete`: x[k+1] = A x[k] + B u[k]).

    `inputs` and `outputs` are the names of u and y.

    An element of a matrix is a number, or the name of an unknown, which a leading "-" negates:
    `a=[[0, 1], ["-k", "-d"]]`. One name may stand in several places. `guess` has the first guess of each, `bounds`
    its (lower, upper). In continuous time the response to an input that is held over a tick is exact. The response to
    an input that changes within a tick (see `Record.hold`) is exact too if the model is slow compared with a tick. D is
    0 by default: give numbers or names for a feed-through. `delays` has the dead time of inputs [s], a number or the
    name of an unknown: `delays={"u": "dead_time"}`; the response is exact for any dead time up to `ring` - 2 ticks. In
    discrete time dead times are states of A.

    Further unknowns have a value for each record: the initial states x1_0, x2_0, ... (estimated by default); of each
    input a constant part without effect, "<input>_trim"; of each output a "<output>_bias". Trims and biases are 0 by
    default.
    Raises IdentificationError for shapes that do not fit and for names without a guess.
    """
    where = f"structure '{name}'"
    for key, names in (("inputs", inputs), ("outputs", outputs)):
        if isinstance(names, str) or not all(isinstance(one, str) for one in names):
            raise IdentificationError(f"`{key}` is {shown(names)}", where, "give a list of names")
    zero = [[0.0] * len(inputs) for _ in outputs]
    a, b, c, feed = (getattr(one, "tolist", lambda one=one: one)() for one in (a, b, c, zero if d is None else d))
    n, m, p = _length(a), len(inputs), len(outputs)
    if not (1 <= n <= MAX_STATES and m and p):
        what = f"the model has {n} states, {m} inputs, {p} outputs"
        raise IdentificationError(what, where, f"give 1 to {MAX_STATES} states, an input and an output")
    for key, matrix, rows, columns in (("a", a, n, n), ("b", b, n, m), ("c", c, p, n), ("d", feed, p, m)):
        if _length(matrix) != rows or any(_length(row) != columns for row in matrix):
            raise IdentificationError(f"`{key}` is not {rows} rows of {columns}", where, "check the matrices")
        for entry in (entry for row in matrix for entry in row):
            named = isinstance(entry, str) and entry.removeprefix("-").isidentifier()
            if not named and not is_number(entry):
                raise IdentificationError(
                    f"`{key}` holds {entry!r:.40}", where, "use finite numbers and names, as 'k' and '-k'"
                )
    late = dict(delays or {})
    for one, entry in late.items():
        named = isinstance(entry, str) and entry.isidentifier()
        if one not in inputs or discrete or not (named or is_number(entry, 0.0)):
            raise IdentificationError(
                f"the dead time {shown(entry)} of '{one}'", where, "give a name or seconds by input, in continuous time"
            )
    entries = [*(entry for matrix in (a, b, c, feed) for row in matrix for entry in row), *late.values()]
    unknowns = tuple(dict.fromkeys(entry.removeprefix("-") for entry in entries if isinstance(entry, str)))
    states = tuple(f"x{i + 1}_0" for i in range(n))
    local = (*states, *(f"{one}_trim" for one in inputs), *(f"{one}_bias" for one in outputs))
    if twice := [one for one in unknowns if one in local]:
        raise IdentificationError(f"'{twice[0]}' names two unknowns", where, "give the one in a matrix another name")
    for one in dict.fromkeys([*unknowns, *guess, *(bounds or {})]):
        if one not in unknowns or not is_number(guess.get(one)):
            what = f"'{one}' has no first guess" if one in unknowns else f"no element of a matrix is called '{one}'"
            raise IdentificationError(what, where, f"give `guess` finite numbers for: {', '.join(unknowns) or 'none'}")
    limits = {one: (0.0 if one in late.values() else -math.inf, math.inf) for one in unknowns} | dict(bounds or {})
    params = [
        Param(one, float(guess[one]), unit="s" if one in late.values() else "", low=low, high=high)
        for one, (low, high) in ((one, limits[one]) for one in unknowns)
    ]
    plain, corrected = (
        _LinearModel((a, b, c, feed), inputs, outputs, params, discrete, gains, late, ring) for gains in (False, True)
    )
    gains = tuple(gain for row in corrected.gains for gain in row)
    common = set(late.values()) if len(late) == m else set()
    delay = str(next(iter(common))) if len(common) == 1 and common <= set(unknowns) else ""
    predictor = Structure(_around(corrected, name), (*unknowns, *states, *gains), local)
    return Structure(_around(plain, name), (*unknowns, *states), local, predictor=predictor, delay=delay)


def _around(block: "_LinearModel", name: str) -> Diagram:
    """Return the diagram of a linear model between trims and biases."""
    diagram = Diagram(name)
    for param in block.params:
        diagram.param(param.name, float(param.value), unit=param.unit, low=param.low, high=param.high)
    diagram.add("model", block, params={param.name: param.name for param in block.params})
    for one in block.driven:
        diagram.input(one)
        diagram.param(f"{one}_trim", 0.0, text=f"constant part of {one} that moves nothing")
        diagram.add(f"trim_{one}", Offset("", -1.0), params={"offset": f"{one}_trim"}, u=one)
        diagram.connect(f"trim_{one}", f"model.{one}")
    for port in block.outputs:
        one = port.name
        diagram.param(f"{one}_bias", 0.0, text=f"bias of the measured {one}")
        diagram.add(f"bias_{one}", Offset(""), params={"offset": f"{one}_bias"}, u=f"model.{one}")
        diagram.output(one, f"bias_{one}")
    for port in block.inputs[len(block.driven) :]:
        bias = port.name.removesuffix("_measured") + "_bias"
        diagram.input(port.name)
        diagram.add(f"unbiased_{port.name}", Offset("", -1.0), params={"offset": bias}, u=port.name)
        diagram.connect(f"unbiased_{port.name}", f"model.{port.name}")
    return diagram


def _length(rows: Any) -> int:
    """Return the number of rows of a matrix, or of entries of a row; 0 for anything but a list."""
    return len(rows) if isinstance(rows, Sequence) and not isinstance(rows, str) else 0


class _LinearModel(ZohPlant):
    """Block of a linear model; the unknowns in its matrices are its parameters.

    With `gains` the measured outputs are inputs too, and K (y - C x - D u) is added to the states (innovation form).
    """

    def __init__(
        self,
        matrices: tuple[Rows, Rows, Rows, Rows],
        inputs: Sequence[str],
        outputs: Sequence[str],
        params: Sequence[Param],
        discrete: bool,
        gains: bool,
        delays: Mapping[str, Entry],
        ring: int,
    ) -> None:
        self.a, self.b, self.c, self.d = matrices
        self.discrete, self.plant_delays, self.plant_params = discrete, delays, params
        self.plant_states = [(f"x{i + 1}", "") for i in range(len(self.a))]
        self.plant_inputs, self.plant_outputs = [Port(name) for name in inputs], [(name, "") for name in outputs]
        super().__init__(ring)
        measured = [f"{name}_measured" for name in outputs] if gains else []
        self.gains = [[f"K_{i + 1}_{j + 1}" for j in range(len(measured))] for i in range(len(self.a))]
        self.inputs = (*self.inputs, *(Port(name) for name in measured))
        self.params = (*self.params, *(Param(gain) for row in self.gains for gain in row))

    def matrices(self, p: Any) -> tuple[Matrix, Matrix]:
        return _numbers(self.a, p), _numbers(self.b, p)

    def readout(self, p: Any) -> tuple[Matrix, Matrix]:
        return _numbers(self.c, p), _numbers(self.d, p)

    def sampled(self, a: Matrix, b: Matrix, t: Clock) -> tuple[list[Any], list[Any]]:
        """Return Phi and Gamma: in discrete time A and B themselves."""
        if not self.discrete:
            return super().sampled(a, b, t)
        return [v for row in a for v in row], [v for row in b for v in row]

    def update(self, u: Any, x: Any, p: Any, t: Clock) -> dict[str, Any]:
        """Return Phi x + Gamma u, and K times the innovation."""
        states = super().update(u, x, p, t)
        if self.gains[0]:
            innovation = [u[f"{name}_measured"] - one for name, one in self.output(u, x, p, t).items()]
            for name, row in zip(self.names, self.gains, strict=True):
                for gain, error in zip(row, innovation, strict=True):
                    states[name] = states[name] + p[gain] * error
        return states


def _numbers(rows: Rows, p: Any) -> list[list[Any]]:
    """Return a matrix's elements as numbers and parameters."""

    def one(entry: Entry) -> Any:
        if not isinstance(entry, str):
            return float(entry)
        return -p[entry[1:]] if entry.startswith("-") else p[entry]

    return [[one(entry) for entry in row] for row in rows]
