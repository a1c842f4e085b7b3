"""A block from a Python function."""

import inspect
from collections.abc import Callable, Sequence
from typing import Any

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import NAME, Param, Port
from twodof.blocks.enumeration import plain_data
from twodof.blocks.expressions.numbers import Integer, kind_of
from twodof.errors import DiagramError, shown

__all__ = ["FunctionBlock", "function_block"]


class FunctionBlock(Block):
    """A block without states whose outputs are what a function returns; made by `function_block`."""

    def __init__(
        self,
        function: Callable[..., Any],
        inputs: Sequence[Port],
        outputs: Sequence[Port],
        params: Sequence[Param],
    ) -> None:
        self.function = function
        self.inputs, self.outputs, self.params = list(inputs), list(outputs), list(params)

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        result = self.function(*(u[i.name] for i in self.inputs), **{q.name: p[q.name] for q in self.params})
        if isinstance(result, tuple) and len(self.outputs) > 1:
            if len(result) != len(self.outputs):
                raise DiagramError(
                    f"the function returns {len(result)} values for {len(self.outputs)} outputs",
                    type(self).__name__,
                    "return one value for each output",
                )
            return {port.name: value for port, value in zip(self.outputs, result, strict=True)}
        return result

    def written(self, method: str) -> Callable[..., Any]:
        return self.function if method == "output" else super().written(method)


def function_block(
    function: Callable[..., Any],
    outputs: Sequence[Port | str] = ("y",),
    inputs: Sequence[Port] = (),
    params: Sequence[Param] = (),
) -> FunctionBlock:
    """Return a block that computes `function`, written with the functions of twodof.blocks (`where`, `sin`, ...).

    Its positional arguments are the inputs: scalar reals, unless `inputs` declares a port of that name. Its
    keyword-only arguments are parameters with the given defaults (or as `params` declares them). It returns a bare
    value for one output, a tuple in the order of `outputs`, or a dict by name. In JSON its traced expressions travel.

    Raises DiagramError for a function with *args or **kwargs, a parameter without a default or an input with one. It
    also does so for a declared name that the function does not take.
    """
    if not callable(function):
        raise DiagramError(f"{shown(function)} is not a function", "function_block", "give a Python function")
    label = getattr(function, "__name__", "")
    label = label if NAME.fullmatch(label) else "Function"
    ports, tunables = {p.name: p for p in inputs}, {p.name: p for p in params}
    found_inputs: list[Port] = []
    found_params: list[Param] = []
    for argument in inspect.signature(function).parameters.values():
        name = argument.name
        if argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD):
            raise DiagramError(f"the function takes *{name}", label, "name each input and parameter")
        if argument.kind is argument.KEYWORD_ONLY:
            if name in tunables:
                found_params.append(tunables.pop(name))
            elif argument.default is argument.empty:
                raise DiagramError(f"parameter {name!r} has no default", label, f"write {name}=0.0")
            else:
                found_params.append(_param(name, argument.default))
        elif argument.default is not argument.empty:
            raise DiagramError(
                f"input {name!r} has a default", label, "parameters are keyword-only: put them after a *"
            )
        else:
            found_inputs.append(ports.pop(name, Port(name)))
    for name in [*ports, *tunables]:
        raise DiagramError(f"{name!r} is declared", label, "give the function an argument of this name")
    declared = [Port(port) if isinstance(port, str) else port for port in outputs]
    # The class is as much the user's as the function is.
    names = {"__doc__": function.__doc__, "__module__": getattr(function, "__module__", "__main__")}
    made: type[FunctionBlock] = type(label, (FunctionBlock,), names)
    return made(function, found_inputs, declared, found_params)


def _param(name: str, default: Any) -> Param:
    """Return a parameter of the type and width of its default; integers are given as int32(...) or uint32(...)."""
    default = plain_data(default, name)
    if isinstance(default, list) and default and isinstance(default[0], list) and default[0]:
        rows = [[_plain(v) for v in row] for row in default]
        return Param(name, rows, kind_of(default[0][0]), shape=(len(rows), len(rows[0])))
    many = isinstance(default, list)
    kind = kind_of(default[0] if many and default else default)
    plain = [_plain(v) for v in default] if many else _plain(default)
    return Param(name, plain, kind, len(default) if many else None)


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, Integer) else value
