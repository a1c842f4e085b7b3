"""Scope of a program: data that its functions share, and the C of leaves, parameters, states and initial values."""

from collections.abc import Callable

from twodof.blocks.declarations import Param, Port, State, column_major
from twodof.blocks.expressions.expr import Expr
from twodof.compile.c.expressions import Leaves, Renderer, Used
from twodof.compile.c.graph import ProgramGraph
from twodof.compile.c.operators import ATOM, C_TYPES
from twodof.compile.c.statements import Assign, Call, CNames, Copy, LoopStatement, Statement, Text, constant, name_of
from twodof.compile.program.flat_program import FlatParameter, FlatProgram, FlatSignal, Node
from twodof.compile.program.layout import MemoryLayout

# Names that the file of a program defines behind its prefix.
OWN = ("P", "S", "U", "Y", "X", "advance", "step", "run")


class Scope:
    """The layout, precision and graph of one program."""

    def __init__(self, program: FlatProgram, layout: MemoryLayout, precision: str, lean: bool) -> None:
        self.program = program
        self.layout = layout
        self.precision = precision
        self.lean = lean
        self.graph = ProgramGraph(program)
        self.used = Used()

    def names(self, *arguments: str) -> CNames:
        """Return the namespace of a function, whose locals must not hide its `arguments` or the program's names."""
        return CNames({*arguments, *(f"{self.program.name}_{own}" for own in OWN)})

    def constant(self, value: object, kind: str) -> str:
        """Return the C literal of a value of the type `kind` in the program's precision."""
        return constant(value, kind, self.precision).text

    def renderer(self, names: CNames, leaves: Leaves) -> Renderer:
        """Return a renderer, which writes expressions into one function with the identifiers `names`."""
        return Renderer(names, self.precision, self.lean, self.used, leaves)

    def leaf(self, signal: Callable[[FlatSignal], str], state: Callable[[Node, str], str]) -> Callable[[Expr], Text]:
        """Return the function from a leaf to its C, given those from a signal and from a state to theirs.

        The text of a state counts its whole lvalue, not only the variable, among the names that it reads.
        """

        def text(item: Expr) -> Text:
            found = "s->tick"
            if item.op == "input":
                found = signal(item.data)
            elif item.op == "state":
                found = state(*item.data)
                return Text(found, ATOM, frozenset((name_of(found), found)))
            elif item.op == "param":
                found = self.parameter(item.data)
            return Text(found, ATOM, frozenset((name_of(found),)))

        return text

    def parameter(self, key: FlatParameter | tuple[Node, str]) -> str:
        """Return the C of a given parameter, or of a derived one, whose key is its node and name."""
        return f"p->{(self.layout.derived[key] if isinstance(key, tuple) else self.layout.parameters[key]).name}"

    def given(self, node: Node, name: str) -> str:
        """Return the C of a block's parameter, given or derived."""
        return self.parameter(node.parameters.get(name) or (node, name))

    def state(self, node: Node, name: str) -> str:
        """Return the lvalue of a state."""
        member = self.layout.states[node, name].name
        return f"s->x.{member}" if any(s.name == name for s in node.continuous) else f"s->{member}"

    def initial(self, node: Node, zeroed: bool = False) -> list[Statement]:
        """Return the statements that set a node's states to their initial values.

        With `zeroed` the memory is zero already, so zeros are not stored.
        """
        made: list[Statement] = []
        for state in node.block.states:
            target = self.state(node, state.name)
            if isinstance(state.initial, str):
                source, reads = self.given(node, state.initial), frozenset(("p",))
                if state.width is None:
                    made.append(Assign(target, source, owner=node, reads=reads))
                else:
                    made.append(Copy(target, source, state.width, C_TYPES[state.kind], owner=node, reads=reads))
            else:
                made += self.fill(target, state.initial, state, node, zeroed)
        return made

    def fill(
        self,
        target: str,
        value: object,
        declared: Port | State | Param,
        owner: Node | None,
        zeroed: bool = False,
        role: str = "",
    ) -> list[Statement]:
        """Return the statements that store the constant `value`, a number or an array, in `target`.

        There are none if the memory is zero already (`zeroed`) and the value is zero too.
        """
        kind, width = declared.kind, declared.width
        if width is None:
            text = self.constant(value, kind)
            return [] if zeroed and text in ZEROS else [Assign(target, text, owner=owner, role=role)]
        flat = column_major(value, declared.shape, declared.name) if declared.shape else value
        values = list(flat) if isinstance(flat, (list, tuple)) else [flat]
        texts = [self.constant(v, kind) for v in values]
        if len(set(texts)) == 1:
            if zeroed and texts[0] in ZEROS:
                return []
            body: list[Statement] = [Assign(f"{target}[i]", texts[0], owner=owner, role=role)]
            return [LoopStatement(f"for (int32_t i = 0; i < {width}; i++)", body, owner=owner, role=role)]
        table = f"static const {C_TYPES[kind]} initial[{width}] = {{{', '.join(texts)}}};"
        copy = f"(void)memcpy({target}, initial, sizeof initial);"
        return [
            LoopStatement(
                "", [Call(table, owner=owner, role=role), Call(copy, owner=owner, role=role)], owner=owner, role=role
            )
        ]


ZEROS = ("0.0", "0.0f", "0", "0u", "false")
