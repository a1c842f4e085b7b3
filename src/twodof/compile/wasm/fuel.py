"""How much a step of a program may cost in the sandbox, known from the program and not from a measurement."""

from __future__ import annotations

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
    declared: list[Port | State | Param] = [*block.states, *block.outputs, *block.inputs, *block.params]
    return sum(4 * (d.width or 1) for d in declared) + 8
