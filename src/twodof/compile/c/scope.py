"""Scope of a program: data that its functions share, and the C of leaves, parameters, states and initial values."""

from collections.abc import Callable

from twodof.blocks.declarations import Param, Port, State, column_major
from twodof.blocks.expressions.expr import Expr
from twodof.compile.c.expressions import Renderer, Used
from twodof.compile.c.operators import ATOM, C_TYPES
from twodof.compile.c.statements import (
    Assign,
    Call,
    CNames,
    LoopStatement,
    Statement,
    Text,
    constant,
    every,
    name_of,
    stored,
)
from twodof.compile.program.flat_program import FlatParameter, FlatProgram, Node
from twodof.compile.program.layout import MemoryLayout

# Names that the file of a program defines behind its prefix.
OWN = ("P", "S", "U", "Y", "X", "advance", "step", "run")


class Scope:
    """The layout, precision and graph of one program."""

    def __init__(self, program: FlatProgram, layout: MemoryLayout, precision: str) -> None:
        self.program = program
        self.layout = layout
        self.precision = precision
        self.used = Used()

    def names(self, *arguments: str) -> CNames:
        """Return the namespace of a function, whose locals must not hide its `arguments` or the program's names."""
        return CNames({*arguments, *(f"{self.program.name}_{own}" for own in OWN)})

    def constant(self, value: object, kind: str) -> str:
        """Return the C literal of a value of the type `kind` in the program's precision."""
        return constant(value, kind, self.precision).text

    def renderer(self, names: CNames, leaf: Callable[[Expr], Text], block: Callable[[Expr], Node | None]) -> Renderer:
        """Return a renderer, which writes expressions into one function with the identifiers `names`."""
        return Renderer(names, self.precision, self.used, leaf, block)

    def leaf(self, state: Callable[[Node, str], str]) -> Callable[[Expr], Text]:
        """Return the function from a leaf to its C, given that from a state to its lvalue.

        The text of a state counts its whole lvalue, not only the variable, among the names that it reads.
        """

        def text(item: Expr) -> Text:
            if item.op == "state":
                found = state(*item.data)
                return Text(found, ATOM, frozenset((name_of(found), found)))
            if item.op == "param":
                return Text.of(self.parameter(item.data))
            return Text.of("s->tick" if item.op == "tick" else f"u->{self.layout.inputs[item.data].name}")

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
                source, reads = self.given(node, state.initial), frozenset("p")
                made.append(stored(target, source, state.kind, state.width, node, reads))
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
        flat = column_major(value, declared.shape, declared.name) if declared.shape else value
        values = list(flat) if isinstance(flat, (list, tuple)) else [flat]
        texts = [self.constant(v, kind) for v in values]
        made: list[Statement]
        if zeroed and set(texts) <= ZEROS and len(set(texts)) == 1:
            return []
        if width is None:
            made = [Assign(target, texts[0])]
        elif len(set(texts)) == 1:
            made = [LoopStatement(f"for (int32_t i = 0; i < {width}; i++)", [Assign(f"{target}[i]", texts[0])])]
        else:
            table = f"static const {C_TYPES[kind]} initial[{width}] = {{{', '.join(texts)}}};"
            made = [LoopStatement("", [Call(table), Call(f"(void)memcpy({target}, initial, sizeof initial);")])]
        for statement in every(made):
            statement.owner, statement.role = owner, role
        return made


ZEROS = {"0.0", "0.0f", "0", "0u", "false"}
