"""A MATLAB Function as a block: its statements are carried out on recorded signals, and what they compute is the block.

It takes functions without branches and loops: assignments of scalars and small matrices. The block travels in JSON as
its recorded expressions, as any block of a user's own does.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from twodof.blocks.block import Block, Clock
from twodof.blocks.declarations import Port
from twodof.blocks.expressions.arrays import vector
from twodof.errors import DiagramError
from twodof.slx.matlab import run
from twodof.slx.matlab_values import Array, Value, as_array, number

_HEAD = re.compile(
    r"^\s*function\s+(?:(?P<outputs>\[[^\]]*\]|\w+)\s*=\s*)?(?P<name>\w+)\s*(?:\((?P<inputs>[^)]*)\))?[ \t]*[;,]?",
    re.MULTILINE,
)
_COMMENT = re.compile(r"%[^\n]*|\.\.\.[^\n]*\n")


class MatlabFunction(Block):
    """The function `code` of signals with these widths (None: a scalar); `names` are values of the workspace.

    Raises DiagramError with the line of a statement that is not translated.
    """

    def __init__(self, code: str, widths: Sequence[int | None], names: Mapping[str, Value] | None = None) -> None:
        heads = list(_HEAD.finditer(code))
        if len(heads) != 1:
            raise DiagramError(f"{len(heads)} functions in it", "MATLAB Function", "one is translated")
        (head,) = heads
        self.arguments = _list(head["inputs"])
        self.results = _list((head["outputs"] or "").strip("[]"))
        # Lines keep their numbers.
        self.body = "\n" * code[: head.end()].count("\n") + re.sub(r"\bend\s*;?\s*$", "", code[head.end() :])
        self.names = dict(names or {})
        given = self.arguments[: len(widths)]
        self.names = {name: value for name, value in self.names.items() if name in self.arguments[len(widths) :]}
        if len(given) + len(self.names) < len(self.arguments):
            raise DiagramError("an argument has neither a signal nor a value", "MATLAB Function", "give --workspace")
        if not self.results:
            raise DiagramError("it has no output", "MATLAB Function", "leave it out")
        # The sizes do not hang on the numbers: some stand for the signals.
        trial = {
            name: np.full((width or 1, 1), 0.5 + 0.1 * k)
            for k, (name, width) in enumerate(zip(given, widths, strict=True))
        }
        shapes = {name: value.shape for name, value in self._computed(trial).items()}
        if bad := [name for name, shape in shapes.items() if 1 not in shape]:
            raise DiagramError(f"the output {bad[0]} is a matrix", "MATLAB Function", "give a vector")
        self.inputs = [Port(_port(name), width=width) for name, width in zip(given, widths, strict=True)]
        sizes = {name: shape[0] * shape[1] for name, shape in shapes.items()}
        self.outputs = [Port(_port(name), width=None if sizes[name] == 1 else sizes[name]) for name in self.results]

    def _computed(self, given: Mapping[str, Array]) -> dict[str, Array]:
        names: dict[str, Value] = {**self.names, **given}
        for skipped in run(self.body, names):
            raise DiagramError(
                f"line {skipped.line}: {skipped.why}", "MATLAB Function", "only assignments are translated"
            )
        if missing := [name for name in self.results if name not in names]:
            raise DiagramError(f"the output {missing[0]} gets no value", "MATLAB Function", "assign it")
        return {name: as_array(number(names[name])) for name in self.results}

    def output(self, u: Any, x: Any, p: Any, t: Clock) -> Any:
        """Carry out the statements on the inputs."""
        given = {}
        for name, port in zip(self.arguments, self.inputs, strict=False):
            value = np.empty((port.width or 1, 1), dtype=object)
            for k in range(port.width or 1):
                value[k, 0] = u[port.name] if port.width is None else u[port.name][k]
            given[name] = value
        found = self._computed(given)
        answers = {}
        for name, port in zip(self.results, self.outputs, strict=True):
            elements = list(found[name].flatten(order="F"))
            plain = [float(one) if isinstance(one, int | float | np.generic) else one for one in elements]
            answers[port.name] = plain[0] if port.width is None else vector(plain)
        return answers


def last_index(code: str, argument: int) -> int:
    """Return the largest constant index that code has for its argument of this number, from 1; 1 without any."""
    head = _HEAD.search(code)
    names = _list(head["inputs"]) if head is not None else []
    if argument > len(names):
        return 1
    return max((int(one) for one in re.findall(rf"\b{names[argument - 1]}\s*\(\s*(\d{{1,4}})\s*\)", code)), default=1)


def _list(text: str | None) -> list[str]:
    return [one for one in re.split(r"[\s,]+", _COMMENT.sub("", text or "")) if one]


def _port(name: str) -> str:
    """Return a legal name of a port: MATLAB's may end with an underscore, and Python's words are taken."""
    return (
        f"{name}_" if name in ("if", "in", "is", "as", "or", "and", "not", "from", "lambda", "def", "class") else name
    )
