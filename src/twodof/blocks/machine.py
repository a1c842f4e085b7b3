"""Machine: one running program, with the rules and error texts that are the same on every target."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twodof.blocks.bus import fields_given
from twodof.blocks.declarations import (
    Param,
    Port,
    State,
    check_steps,
    check_value,
    numeric,
    rows_of,
    unknown_name,
    unknown_parameter,
)
from twodof.blocks.enumeration import plain_data
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.numbers import FLOATS, INTEGERS
from twodof.errors import DiagramError, ParameterError

_ACCEPTED = dict.fromkeys(FLOATS, "fiu") | dict.fromkeys(INTEGERS, "iu") | {"bool": "b"}


class Machine(ABC):
    """One running program: parameters, states and inputs of its own, by name or path.

    A value is a number, a list of `width` numbers for a vector, or a list of rows for a matrix. Of an enumeration it
    may be a name, and only members are taken. An input that is not given keeps its last value (0 at first).
    A parameter is refused outside its bounds or its type's range; inputs and states that are integers wrap around.
    Where the target can fault (docs/reference/compilation.md), a method that computes raises ControllerFault.
    A bus is given as a mapping from its fields, or field by field as "att.rates.p"; so are outputs and states named.
    One thread at a time may use a machine: queue the changes of others and apply them between two steps.
    """

    def __init__(
        self,
        name: str,
        precision: str,
        parameters: Mapping[str, Param],
        inputs: Iterable[Port],
        states: Mapping[str, State],
        outputs: Mapping[str, tuple[int, int] | None],
    ) -> None:
        self.name = name
        self.precision = precision
        self.parameters = parameters
        self.states = states
        self.inputs = {port.name: port for port in inputs}
        self._matrices = [(path, shape) for path, shape in outputs.items() if shape]

    @property
    @abstractmethod
    def tick(self) -> int:
        """Base ticks since the start, modulo 2^32."""

    @abstractmethod
    def reset(self) -> None:
        """To the initial states of the present parameters, tick 0, held outputs 0."""

    def set(self, path: str, value: Any) -> None:
        """Set one parameter; see `set_many`."""
        self.set_many({path: value})

    def set_many(self, values: Mapping[str, Any]) -> None:
        """Set several parameters before the next step, or, if one is refused with ParameterError, none."""
        self._store_parameters({path: self._checked(path, value) for path, value in values.items()})

    def get(self, path: str) -> Any:
        """Return a parameter's present value."""
        declared = self._declared(path)
        return as_rows(self._parameter(path), declared.shape)

    def state(self, path: str) -> Any:
        """Return a state's present value. Raises DiagramError for an unknown path."""
        declared = self._state_at(path)
        return as_rows(self._state(path, declared), declared.shape)

    def set_state(self, path: str, value: Any) -> None:
        """Overwrite a state. Raises DiagramError for an unknown path or a value of another type."""
        declared = self._state_at(path)
        self._store_state(path, declared, self._plain(value, declared, path))

    def step(self, inputs: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """One step. Returns values by signal name. Raises DiagramError for an input that does not fit."""
        for name, value in self._by_field(inputs or {}).items():
            self._write(name, value)
        return self._shaped(self._step())

    def run(self, steps: int, inputs: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Run `steps` steps; an input is one value, or an array of `steps` values. Returns arrays by signal name.

        Their first axis is the step; those of a vector or matrix follow. Raises DiagramError for an input that does not
        fit, and for more than MAX_STEPS steps.
        """
        steps = check_steps(steps, self.name)
        columns: dict[str, NDArray[Any]] = {}
        for name, value in self._by_field(inputs or {}).items():
            port = self._input(name)
            try:
                data = np.asarray(value)
            except ValueError as error:
                raise DiagramError("its rows differ in length", name, "give one value, or one a step") from error
            if data.shape in ((), axes(port)):
                self._write(name, data.tolist())
            else:
                columns[name] = self._column(port, data, steps)
        return self._shaped(self._run(steps, columns))

    def _by_field(self, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return `inputs` with the fields of buses that are given as mappings, or as lists of them."""
        if all(name in self.inputs for name in inputs):
            return inputs
        return fields_given(inputs, list(self.inputs), self.name)

    def _shaped(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return `values` with matrices as rows; targets keep them flat."""
        for path, shape in self._matrices:
            values[path] = as_rows(values[path], shape)
        return values

    @abstractmethod
    def _step(self) -> dict[str, Any]:
        """One step with the inputs as they were written."""

    @abstractmethod
    def _run(self, steps: int, columns: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
        """Run `steps` steps with a row of each column at each; the last row stays written."""

    @abstractmethod
    def _store_parameters(self, values: Mapping[str, Any]) -> None:
        """Take over checked values, all or, if an error is raised, none."""

    @abstractmethod
    def _parameter(self, path: str) -> Any: ...

    @abstractmethod
    def _state(self, path: str, declared: State) -> Any: ...

    @abstractmethod
    def _store_state(self, path: str, declared: State, value: Any) -> None: ...

    @abstractmethod
    def _store_input(self, port: Port, value: Any) -> None: ...

    def _declared(self, path: str) -> Param:
        if path not in self.parameters:
            raise unknown_parameter(path, self.parameters)
        return self.parameters[path]

    def _checked(self, path: str, value: Any) -> Any:
        """Return a parameter's new value as plain numbers, not yet rounded."""
        declared = self._declared(path)
        if not declared.tunable and self.tick > 0:
            raise ParameterError(
                "it is fixed while the diagram runs", path, "set it before the first step, or after reset()"
            )
        return check_value(declared, value, path)

    def _state_at(self, path: str) -> State:
        if path not in self.states:
            raise unknown_name("state", path, sorted(self.states), self.name)
        return self.states[path]

    def _input(self, name: str) -> Port:
        if name not in self.inputs:
            raise unknown_name("input", name, self.inputs, self.name)
        return self.inputs[name]

    def _write(self, name: str, value: Any) -> None:
        port = self._input(name)
        self._store_input(port, self._plain(value, port, name))

    def _plain(self, value: Any, declared: Port | State, where: str) -> Any:
        """`value` as plain numbers of the declared type, in this machine's precision."""
        plain = plain_data(value, where)
        if declared.enum is not None:
            plain = declared.enum.plain(plain, where)
        with numbers.precision(self.precision):
            return numbers.plain(numeric(plain, declared.kind, declared.width, where, declared.shape))

    def _column(self, port: Port, data: NDArray[Any], steps: int) -> NDArray[Any]:
        """Return an input's array, checked; integers wrap around."""
        if data.shape[:1] != (steps,):
            raise DiagramError(f"{len(data)} values for {steps} steps", port.name, "give one value, or one a step")
        if data.dtype.kind not in _ACCEPTED[port.kind] or data.shape != (steps, *axes(port)):
            size = f"shape {port.shape}" if port.shape else f"width {port.width or 1}"
            what = f"an array of {data.dtype} and shape {data.shape} is given for {port.kind} of {size}"
            raise DiagramError(what, port.name, "convert it")
        if port.enum is not None:
            strange = data[~np.isin(data, list(port.enum.members.values()))]
            if strange.size:
                port.enum.plain(strange[0].item(), port.name)
        if port.shape:  # its elements stand along the last axis, column after column
            data = data.swapaxes(-1, -2).reshape(steps, -1)
        return data.astype(port.kind) if port.kind in INTEGERS else data


def axes(declared: Port | State | Param) -> tuple[int, ...]:
    """Return the shape of a value outside the program: (), (width,) or (rows, columns)."""
    return declared.shape or (() if declared.width is None else (declared.width,))


def as_rows(value: Any, shape: tuple[int, int] | None) -> Any:
    """Return a matrix, kept column after column in a list or along an array's last axis, as rows."""
    if shape is None:
        return value
    if isinstance(value, np.ndarray):
        return np.ascontiguousarray(value.reshape(*value.shape[:-1], shape[1], shape[0]).swapaxes(-1, -2))
    return rows_of(value, shape)
