"""Block kinds: blocks that exist many times and differ in the values of their parameters alone. They share their C."""

import re
from collections import Counter
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from twodof.blocks.declarations import Param, Port, State
from twodof.blocks.expressions.cost import CostMeter
from twodof.blocks.state_machine import StateMachine
from twodof.compile.program.flat_program import FlatParameter, FlatProgram, Node

FEWEST = 16  # copies: of fewer, each keeps its own lines, which are faster and read as the diagram does
WORTH = 8  # operations from which on a call is shorter than what it does


@dataclass(eq=False)
class BlockKind:
    """The blocks `nodes`, with the parameters `own` that no other block reads; `called`: they are worth a function."""

    name: str
    nodes: tuple[Node, ...]
    own: tuple[str, ...]
    called: bool

    @property
    def first(self) -> Node:
        """The one whose expressions stand for those of all."""
        return self.nodes[0]

    @property
    def outer(self) -> tuple[str, ...]:
        """The parameters that other blocks read too."""
        return tuple(d.name for d in self.first.block.params if d.name not in self.own)


def block_kinds(program: FlatProgram) -> list[BlockKind]:
    """The kinds of a program's blocks that are worth sharing, in the order of their first blocks."""
    if len(program.nodes) < FEWEST:
        return []
    readers = Counter(q for n in program.nodes for q in n.parameters.values())
    copies: dict[Hashable, list[Node]] = {}
    for n in program.nodes:
        if not (n.continuous or n.trace.edges):
            copies.setdefault(_structure(n, readers), []).append(n)
    found = []
    for nodes in copies.values():
        if len(nodes) < FEWEST:
            continue
        nodes = sorted(nodes, key=_counted)
        first = nodes[0]
        size = CostMeter(None).measure([*first.trace.outputs.values(), *first.trace.update.values()]).size
        # A state machine stays a switch that reads like its drawing.
        called = size >= WORTH and not isinstance(first.block, StateMachine)
        kind = BlockKind(_name(first), tuple(nodes), _own(first, readers), called)
        if kind.called or kind.own or first.block.derived or first.block.states:
            found.append(kind)
    return found


def _counted(node: Node) -> list[tuple[int, str]]:
    """Puts `pid10` behind `pid9`, so that the copies' numbers are those that people have given."""
    return [(int(word), "") if word.isdigit() else (-1, word) for word in re.split(r"([0-9]+)", node.path)]


def _structure(node: Node, readers: Counter[FlatParameter]) -> Hashable:
    """What the copies of a kind have in common. Expressions are the same node where they are equal."""
    block, trace = node.block, node.trace
    sections = (trace.outputs, trace.update, trace.prepare)
    declared: list[Port | Param] = [*block.inputs, *block.outputs, *block.params, *block.derived]
    return (
        _name(node),
        node.rate.divider,  # it is the value of dt
        _own(node, readers),
        tuple(map(len, (block.inputs, block.outputs, block.params))),
        tuple((d.name, d.kind, d.width, d.shape) for d in declared),
        tuple((s.name, s.kind, s.width, s.shape, _initial(s)) for s in block.states),
        tuple(tuple((name, id(e)) for name, e in section.items()) for section in sections),
    )


def _own(node: Node, readers: Counter[FlatParameter]) -> tuple[str, ...]:
    return tuple(d.name for d in node.block.params if readers[node.parameters[d.name]] == 1)


def _initial(state: State) -> Hashable:
    """A state's initial value: the name of a parameter, or a number's text, which tells -0 from 0."""
    return state.initial if isinstance(state.initial, str) else ("", repr(np.asarray(state.initial).tolist()))


def _name(node: Node) -> str:
    return node.block.type_name or type(node.block).__name__
