"""What a program costs, known before it is compiled: fuel for a step in the sandbox, time for an optimiser."""

import re
from collections.abc import Iterable

from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.cost import CostMeter
from twodof.blocks.expressions.expr import Expr
from twodof.compile.program.flat_program import FlatProgram, Node
from twodof.compile.target import EmittedProgram

PER_OPERATION = 100
PER_BYTE = 8
AT_LEAST = 10_000


def step_fuel(program: EmittedProgram) -> int:
    """The fuel [instructions of WebAssembly, about] that one call of a function but `run` may use.

    An upper bound with a wide margin: PER_OPERATION for each operation of the language that any path computes, PER_BYTE
    for what is filled and copied, and AT_LEAST. A program that needs more has a fault, or its compiler.
    """
    return PER_OPERATION * operations(program.flat) + PER_BYTE * sum(program.sizes[1:]) + AT_LEAST


def operations(program: FlatProgram) -> int:
    """At most this many operations of the language (elements of arrays included) are computed in a step."""
    stages = (4 if program.integrator == "rk4" else 1) * (len(program.edged) + 1)
    continuous = bool(program.integrated)
    total = 0
    for node in program.nodes:
        trace = node.trace
        edges = [e for pair in trace.edges.values() for e in pair]
        outputs = list(trace.outputs.values())
        once = _cost([*outputs, *edges, *trace.update.values(), *trace.project.values(), *trace.prepare.values()])
        again = _cost([*outputs, *trace.derivative.values()]) if continuous else 0
        total += once + stages * again + _moved(node)
    return total


def _cost(expressions: Iterable[Expr]) -> int:
    return CostMeter(None).measure(expressions).operations


def _moved(node: Node) -> int:
    """Values that are held, reset, zeroed or committed: a few operations for each element."""
    block = node.block
    started = len(node.starts) * sum(s.width or 1 for s in block.states)
    declared: list[Port | State | Param] = [*block.states, *block.outputs, *block.inputs, *block.params]
    return sum(4 * (d.width or 1) for d in declared) + started + 8


_WORD = re.compile(r"[A-Za-z_]\w*")
_LOCAL = re.compile(r" +(?:const )?(?:real|int32_t|uint32_t|bool) (\w+) = ")
OPTIMISATION_BUDGET = 100_000_000
"""From here on code is not optimised: zig's -O3 needs about 4 s of processor time for as much; cubic in the values."""


def optimisation_cost(source: str) -> int:
    """The sum over the lines of C of the square of the number of local values that a later line still reads.

    `source` is as the emitter writes it: a local value a line, a function's end at the line's beginning.
    """
    total = 0
    body: list[str] = []
    for line in source.splitlines():
        if line.startswith("}"):
            total += _function_cost(body)
            body = []
        else:
            body.append(line)
    return total


def _function_cost(lines: list[str]) -> int:
    last: dict[str, int] = {}
    for number, line in enumerate(lines):
        if match := _LOCAL.match(line):
            last[match[1]] = number
        for word in _WORD.findall(line):
            if word in last:
                last[word] = number
    alive = total = 0
    ends = [0] * (len(lines) + 1)
    for number, line in enumerate(lines):
        if match := _LOCAL.match(line):
            alive += 1
            ends[last[match[1]]] += 1
        total += alive * alive
        alive -= ends[number]
    return total
