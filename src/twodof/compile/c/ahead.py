"""What the tick and the parameters alone decide, computed for several ticks at once: noise, test signals.

Such numbers do not wait for anything that a step computes. So `run` finds those of the next ticks in a loop of their
own, which a compiler turns into the processor's vectors, and the steps read them. The bits are the same: nothing is
computed in another order but the ticks.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from twodof.blocks.diagram import Rate
from twodof.blocks.expressions.expr import LOOPS, Expr
from twodof.blocks.expressions.graph import walk
from twodof.blocks.state_machine import StateMachine
from twodof.compile.c.branches import SLOW, decision
from twodof.compile.c.names import CNames
from twodof.compile.c.style import STRAIGHT
from twodof.compile.c.tick import Scope, describe
from twodof.compile.c.writer import CWriter
from twodof.compile.program.flat_program import Node

TICKS = 64  # that are looked ahead
SLOWEST = TICKS // 8  # divider of a rate of which enough ticks are due among them
WORTH = 60  # operations from which on it is worth it
MOST = 32  # numbers, which stand on the stack


@dataclass(frozen=True)
class Foreseen:
    """A number that is known ahead, and the member of the struct in which it stands."""

    node: Node
    value: Expr
    member: str

    @property
    def divider(self) -> int:
        """How many ticks lie between those at which it is read."""
        return self.node.rate.divider

    @property
    def text(self) -> str:
        """The C that reads it at the tick."""
        after = "s->tick - ahead->first"
        return f"ahead->{self.member}[{after if self.divider == 1 else f'({after}) / {self.divider}u'}]"


def foreseen(scope: Scope) -> list[Foreseen]:
    """What a program may compute ahead: what blocks that always act need in any case, and what costs enough."""
    if not scope.style.foresees:
        return []
    names, found = CNames({"first"}), list[Foreseen]()
    moved = {s.node for s in scope.program.moving}
    needy = {a.node for g in scope.program.tick if g.needs for a in g.actions}
    read = {s for g in scope.program.tick for a in g.actions for s in a.signals}
    for node in scope.program.nodes:
        if node.guard.enables or node.continuous or node in moved or node in needy or node in scope.layout.of:
            continue
        if node.rate.divider > SLOWEST or isinstance(node.block, StateMachine):
            continue
        outputs = [e for port, e in node.trace.outputs.items() if node.outputs.get(port) in read]
        for value in _values([*outputs, *node.trace.update.values()]):
            found.append(Foreseen(node, value, names.new(f"{node.path}_{len(found) + 1}")))
    return found[:MOST]


def _values(roots: Iterable[Expr]) -> list[Expr]:
    """The largest expressions below `roots`, read in any case, that are numbers of the tick and cost enough."""
    order = walk(roots := list(roots))
    timed: dict[int, bool | None] = {}  # whether it reads the tick; None where it reads what is not known ahead
    cost: dict[int, int] = {}
    for item in order:
        below = [timed[id(a)] for a in item.args]
        unknown = item.op in ("input", "state", "bound", *LOOPS) or (item.width is not None and item.op != "param")
        timed[id(item)] = None if unknown or None in below else item.op == "tick" or True in below
    found: dict[int, Expr] = {}
    seen: set[int] = set()
    stack = list(reversed(roots))
    while stack:
        item = stack.pop()
        if id(item) in seen:
            continue
        seen.add(id(item))
        if timed[id(item)]:
            cost[id(item)] = sum(SLOW.get(e.op, 1) for e in walk([item]))
            if cost[id(item)] >= WORTH:
                found[id(item)] = item
        elif decision(item, item.args) is not None:  # what it reads on one side only is perhaps not computed at all
            stack.append(item.args[0])
        else:
            stack.extend(reversed(item.outside))
    return list(found.values())


class AheadEmitter:
    """Writes the struct of what is known ahead, what fills it, and what runs steps with it."""

    def __init__(self, scope: Scope, found: Sequence[Foreseen], name: str) -> None:
        self.scope = scope
        self.found = found
        self.name = name

    @property
    def argument(self) -> str:
        """How a function is given it."""
        return f"const {self.name}_Ahead *restrict ahead"

    def struct(self) -> str:
        """The type."""
        most = f"{self.name}_AHEAD"
        sizes = {f: most if f.divider == 1 else f"{most} / {f.divider} + 1" for f in self.found}
        members = [f"    {self.scope.type(f.value.kind)} {f.member}[{size}];\n" for f, size in sizes.items()]
        return f"""/* Ticks of which is computed ahead what the tick and the parameters alone decide. */
#if __STDC_HOSTED__ && defined(__OPTIMIZE__)
#define {most} {TICKS}
#else
#define {most} 1
#endif
typedef struct {{
    uint32_t first;
{"".join(members)}}} {self.name}_Ahead;

"""

    def look(self, writer: CWriter) -> None:
        """The function that fills it for some ticks from `first` on."""
        p = self.name
        arguments = f"const {p}_P *restrict p, uint32_t first, uint32_t ticks, {p}_Ahead *restrict ahead"
        names = self.scope.names("p", "first", "ticks", "ahead")
        with writer.function(f"td_apart void {p}_look_ahead({arguments})"):
            writer.line("ahead->first = first;")
            for rate in dict.fromkeys(f.node.rate for f in self.found):
                self._rate(writer, names, rate)

    def _rate(self, writer: CWriter, names: CNames, rate: Rate) -> None:
        stem, divider = f"{rate.divider}_{rate.offset}", rate.divider
        count, at, tick = (names.new(f"{name}_{stem}") for name in ("count", "at", "tick"))
        start = "first"
        if divider > 1:
            skipped = names.new(f"skipped_{stem}")
            after = f"{divider + rate.offset}u - first % {divider}u"
            writer.line(f"const uint32_t {skipped} = ({after}) % {divider}u;")
            writer.line(f"const uint32_t {count} = (ticks + {divider - 1}u - {skipped}) / {divider}u;")
            start = f"first + {skipped}"
        else:
            writer.line(f"const uint32_t {count} = ticks;")
        with writer.block(f"for (uint32_t {at} = 0u; {at} < {count}; {at}++)"):
            writer.line(f"const uint32_t {tick} = {start} + {at}{'' if divider == 1 else f' * {divider}u'};")
            for node in dict.fromkeys(f.node for f in self.found if f.node.rate == rate):
                writer.line(describe(node))
                leaf = self.scope.leaf(node, _nothing, _nothing, tick)
                renderer = STRAIGHT.renderer(writer, names, self.scope.precision, leaf, node.path)
                own = [f for f in self.found if f.node is node]
                renderer.assign([(f"ahead->{f.member}[{at}]", f.value) for f in own])

    def step_and_run(self, one: str, strided: str) -> str:
        """What calls `advance`, which is one step."""
        p = self.name
        return f"""td_apart void {p}_ticks({strided}, {self.argument})
{{
    for (size_t k = 0; k < n; k++) {{
        {p}_advance(p, s, u + k * u_stride, y + k * y_stride, ahead);
    }}
}}

void {p}_run({strided})
{{
    {p}_Ahead ahead;
    size_t done = 0;
    while (done < n) {{
        size_t ticks = n - done < {p}_AHEAD ? n - done : {p}_AHEAD;
        if (ticks > UINT32_MAX - s->tick) {{
            ticks = 1; /* the tick begins again at 0 soon */
        }}
        {p}_look_ahead(p, s->tick, (uint32_t)ticks, &ahead);
        {p}_ticks(p, s, u + done * u_stride, u_stride, y + done * y_stride, y_stride, ticks, &ahead);
        done += ticks;
    }}
}}

void {p}_step({one})
{{
    {p}_run(p, s, u, 0, y, 0, 1);
}}

"""


def _nothing(name: Any) -> str:
    raise ValueError(f"{name} is not known ahead")
