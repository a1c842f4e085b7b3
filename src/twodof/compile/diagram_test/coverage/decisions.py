"""The decisions of a diagram: what can go one way or another, and where it stands.

A *condition* is a bool that chooses. It is the first argument of a `where` (a minimum, a limit and a switch are made
of it), or an operand of a bool `&` or `|`. It has two sides. One that stands in several places of a block is one
decision, and `~c` is decided as c is. The conditions of a sub-diagram (enable, reset, trigger) are decisions as well.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from twodof.blocks.block import Block
from twodof.blocks.expressions.expr import Expr, noting_lines
from twodof.blocks.expressions.graph import walk
from twodof.blocks.state_machine import StateMachine
from twodof.blocks.trace import by_method, trace_of
from twodof.compile.diagram_test.coverage.expression_text import limit_of, machine_text, text_of


@dataclass(frozen=True)
class Decision:
    """One decision of the block or sub-diagram at `path`.

    `kind` is "condition", "enable", "reset" or "trigger", or of a state machine "mode" or "transition", with the one
    side that it is entered, or taken, at all. `place` is the user's line, or the method and name that it is first used
    for; `sides` are what its ways are called; `number` tells decisions of one path apart.
    """

    kind: str
    path: str
    place: str
    text: str
    sides: tuple[str, ...] = ("true", "false")
    number: int = 0


def conditions(block: Block, path: str) -> dict[int, Decision]:
    """The decisions of a block, by the id of the condition's node; `bare` leads there from a node below a `not`.

    A state machine has none of these: its modes and transitions are its decisions.
    """
    if isinstance(block, StateMachine):
        return {}
    first: dict[int, tuple[Expr, str]] = {}  # by id: the condition, and where it is first used
    users: dict[int, list[Expr]] = {}  # what asks it
    for method, exprs in by_method(block.trace).items():
        for name, roots in exprs.items():
            for item in walk(roots):
                for condition in _chooses(item):
                    first.setdefault(id(condition), (condition, f"{method} {name}"))
                    users.setdefault(id(condition), []).append(item)
    lines = _lines(block) if first else {}
    found = {}
    for number, (condition, used) in enumerate(first.values()):
        asking = users[id(condition)]
        text, sides = _described(condition, asking)
        place = next((lines[id(e)] for e in (condition, *asking) if id(e) in lines), used)
        found[id(condition)] = Decision("condition", path, place, text, sides, number)
    return found


def machine_decisions(machine: StateMachine, path: str) -> tuple[list[Decision], list[Decision]]:
    """The modes of a state machine, by number, and its transitions, by number."""
    chart = machine.chart
    modes = [Decision("mode", path, "", leaf.mode.name, ("entered",), leaf.number) for leaf in chart.leaves]
    ways = []
    for number, (t, guard) in enumerate(zip(chart.transitions, machine.graph.guards, strict=True)):
        text = t.text if guard.op == "const" else f"{t.text}: {machine_text(guard)}"
        place = Path(chart.guards[number].line.removeprefix(", ")).name
        ways.append(Decision("transition", path, place, text, ("taken",), number))
    return modes, ways


def bare(condition: Expr) -> Expr:
    """A condition without its `not`s."""
    while condition.op == "not":
        condition = condition.args[0]
    return condition


def _chooses(item: Expr) -> Iterator[Expr]:
    if item.op == "where":
        given = item.args[:1]
    elif item.op in ("and", "or") and item.kind == "bool":
        given = item.args
    else:
        return
    for condition in given:
        plain = bare(condition)
        if plain.op != "const":
            yield plain


def _described(condition: Expr, users: list[Expr]) -> tuple[str, tuple[str, str]]:
    """What a decision is, and what its two ways are called."""
    for item in users:
        limit = limit_of(item)
        if limit is not None:
            word, a, b = limit
            left, right = text_of(a), text_of(b)
            # a < b chooses a of a minimum; of a maximum(a, b), which asks b < a, it is a as well.
            return f"{word}({left}, {right})", (left, right)
    return text_of(condition), ("true", "false")


def _lines(block: Block) -> Mapping[int, str]:
    """The user's file and line of each node that a block's methods record, by the node's id; none of the library's."""
    if type(block).__module__.startswith("twodof.blocks."):
        return {}
    lines: dict[int, str] = {}
    with noting_lines(lines):
        trace_of(block)  # the nodes of the first trace live, and so are met again
    return {
        node: f"{Path(file).name}:{line}" for node, place in lines.items() for file, _, line in [place.rpartition(":")]
    }
