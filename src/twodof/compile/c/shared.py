"""The C that copies of a block share: structs of one copy, and a function each for what all of them do."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from twodof.blocks.declarations import Param, Port, State, column_major
from twodof.blocks.expressions.expr import LEAVES, Expr
from twodof.blocks.expressions.graph import leaves, walk
from twodof.compile.c.expressions import Text, constant
from twodof.compile.c.names import CNames
from twodof.compile.c.operators import ATOM
from twodof.compile.c.states.next_states import commit, numbers_of
from twodof.compile.c.tick import Scope, TickEmitter, describe
from twodof.compile.c.writer import CWriter
from twodof.compile.program.flat_program import Action, FlatSignal, Node
from twodof.compile.program.layout import BlockKindLayout
from twodof.compile.program.lower import inputs_of

APART = """/* Not put in place, for it is there so that many share it, or so that a compiler sees less at once. */
#if defined(__GNUC__)
#define td_apart static __attribute__((noinline))
#else
#define td_apart static
#endif
/* Shared where size counts; but in place on a computer, where a call costs more than what it does. */
#if __STDC_HOSTED__ && defined(__GNUC__) && defined(__OPTIMIZE__) && !defined(__OPTIMIZE_SIZE__)
#define td_shared static inline __attribute__((always_inline))
#else
#define td_shared td_apart
#endif
"""
MOST_IN_PLACE = 2000  # nodes of expressions of all copies: what a compiler gets to see more of


class CopyScope(Scope):
    """The text of leaves within a function that copies share: `p` and `s` point to the structs of one copy.

    `inputs` and `outer` are the names of arguments: the inputs, and the parameters that other blocks read too.
    """

    def __init__(self, scope: Scope, kind: BlockKindLayout) -> None:
        super().__init__(scope.program, scope.layout, scope.precision, scope.style)
        self.defined = scope.defined
        self.kind = kind
        self.inputs: dict[str, str] = {}
        self.outer: dict[str, str] = {}

    def given(self, node: Node, name: str) -> str:
        return f"p->{self.kind.members[name].name}" if name in self.kind.members else self.outer[name]

    def state(self, node: Node, state: State) -> str:
        return f"s->{self.kind.members[state.name].name}"

    def inside(self, node: Node) -> Callable[[Expr], Text]:
        """The C text of `node`'s leaves."""
        states = {s.name: self.state(node, s) for s in node.block.states}
        other = self.leaf(node, lambda s: s.path, states.__getitem__, "tick")
        return lambda item: (self.inputs[item.data], ATOM) if item.op == "input" else other(item)


@dataclass(frozen=True)
class SharedFunction:
    """A function and its arguments: `p`, `s` and `tick` where they are read, inputs, outer parameters.

    A single scalar output is returned; for others pointers follow that say where they go.
    """

    name: str
    p: bool
    s: bool
    tick: bool
    inputs: tuple[str, ...]
    outer: tuple[str, ...]


class SharedFunctions:
    """The structs and functions of a program's kinds; a function is written when it is first called."""

    def __init__(self, scope: Scope, lean: bool, write: Callable[[Callable[[CWriter], None]], str]) -> None:
        self.scope = scope
        self.lean = lean
        self.texts: list[str] = []
        self._write = write
        self._made: dict[tuple[str, str, tuple[str, ...]], SharedFunction] = {}
        self._names = CNames()  # of functions
        ends = ("P", "S", "prepare", "init", "output", "update", "step")
        scope.defined |= {f"{k.prefix}_{end}" for k in scope.layout.block_kinds for end in ends}

    def defaults(self, writer: CWriter) -> None:
        """Lines that store the given parameters of all copies, and 0 in the derived ones."""
        for k in self.scope.layout.block_kinds:
            if not k.p.members:
                continue
            count, name = len(k.kind.nodes), k.name
            with writer.block(""):
                writer.line(_each(k))
                writer.line(f"static const {k.prefix}_P defaults[{count}] = {{")
                for node in k.kind.nodes:
                    given = [node.parameters[own].declared for own in k.kind.own]
                    values = [self._value(d, d.value) for d in given]
                    values += [self._value(o, None) for o in node.block.derived]
                    writer.line(f"    {{{', '.join(values)}}}, {describe(node)}")
                writer.line("};")
                writer.line(f"(void)memcpy(p->{name}, defaults, sizeof defaults);")

    def _value(self, declared: Param | Port, value: object) -> str:
        """A constant, or 0 for None."""
        kind, width = declared.kind, declared.width
        zero = constant(False if kind == "bool" else 0, kind, self.scope.precision)[0]
        if width is None:
            return zero if value is None else self.scope.constant(value, kind)
        if value is None:
            return f"{{{zero}}}"
        plain = value.tolist() if hasattr(value, "tolist") else value
        flat = column_major(plain, declared.shape, declared.name) if declared.shape else plain
        values = list(flat) if isinstance(flat, (list, tuple)) else [flat] * width
        return f"{{{', '.join(constant(v, kind, self.scope.precision)[0] for v in values)}}}"

    def prepare(self, writer: CWriter) -> None:
        """Lines that compute the derived parameters of all copies."""
        for k in self.scope.layout.block_kinds:
            if k.kind.first.block.derived:
                self._for_each(writer, k, "prepare")

    def init(self, writer: CWriter) -> None:
        """Lines that set the states of all copies."""
        for k in self.scope.layout.block_kinds:
            if k.kind.first.block.states:
                self._for_each(writer, k, "init")

    def start(self, node: Node) -> str:
        """The line that sets the states of one copy."""
        k, i = self.scope.layout.of[node]
        return f"{self._call(k, self.function(k, 'init'), node, str(i))};"

    def output(
        self,
        node: Node,
        ports: tuple[str, ...],
        update: bool,
        inputs: Callable[[FlatSignal], str],
        outputs: Iterable[str],
    ) -> str:
        """The call that gives the outputs `ports` of one copy (and, with `update`, its next states).

        `outputs` are the pointers to where they go; a single scalar is what the call returns.
        """
        k, i = self.scope.layout.of[node]
        function = self.function(k, "step" if update else "output", ports)
        return self._call(k, function, node, str(i), inputs, outputs)

    def update(self, node: Node, inputs: Callable[[FlatSignal], str]) -> str:
        """The call that gives the next states of one copy."""
        k, i = self.scope.layout.of[node]
        return self._call(k, self.function(k, "update"), node, str(i), inputs)

    def _for_each(self, writer: CWriter, k: BlockKindLayout, what: str) -> None:
        function, nodes = self.function(k, what), k.kind.nodes
        calls = [self._call(k, function, node, "i") for node in nodes]
        writer.line(_each(k))
        if len(set(calls)) == 1:
            with writer.block(f"for (int32_t i = 0; i < {len(nodes)}; i++)"):
                writer.line(f"{calls[0]};")
            return
        for i, node in enumerate(nodes):
            writer.line(f"{self._call(k, function, node, str(i))};")

    def _call(
        self,
        k: BlockKindLayout,
        function: SharedFunction,
        node: Node,
        copy: str,
        inputs: Callable[[FlatSignal], str] = lambda s: s.path,
        outputs: Iterable[str] = (),
    ) -> str:
        """A call for one copy, with the arguments that it reads."""
        texts = [f"&p->{k.name}[{copy}]"] if function.p else []
        texts += [f"&s->{k.name}[{copy}]"] if function.s else []
        texts += ["s->tick"] if function.tick else []
        texts += [inputs(node.drivers[name]) for name in function.inputs]
        texts += [self.scope.given(node, name) for name in function.outer]
        return f"{function.name}({', '.join([*texts, *outputs])})"

    def function(self, k: BlockKindLayout, what: str, ports: tuple[str, ...] = ()) -> SharedFunction:
        """The function that does `what` (prepare, init, output, update, or step: the last two) for a copy."""
        if (k.name, what, ports) not in self._made:
            self._made[k.name, what, ports] = self._written(k, what, ports)
        return self._made[k.name, what, ports]

    def _written(self, k: BlockKindLayout, what: str, ports: tuple[str, ...]) -> SharedFunction:
        node, scope, types = k.kind.first, CopyScope(self.scope, k), self.scope.style.types
        trace = node.trace
        roots = {port: trace.outputs[port] for port in ports}
        nexts = trace.update if what in ("update", "step") else {}
        whole = [*roots.values(), *nexts.values(), *(trace.prepare.values() if what == "prepare" else ())]
        params = leaves(whole, "param")
        if what == "init":
            params |= {s.initial for s in node.block.states if isinstance(s.initial, str)}
        outer = [d for d in node.block.params if d.name in params and d.name not in k.members]
        inputs = [d for d in node.block.inputs if d.name in leaves(whole, "input")]
        names = scope.names("p", "s", "tick")
        scope.inputs = {d.name: names.new(d.name) for d in inputs}
        scope.outer = {d.name: names.new(d.name) for d in outer}
        targets = {port: names.new(port) for port in ports}
        returned = len(ports) == 1 and roots[ports[0]].width is None
        writes_s = what in ("init", "update", "step")
        found = SharedFunction(
            name=self._names.new(f"{k.prefix}_{what}"),
            p=what == "prepare" or len(outer) < len(params),
            s=writes_s or bool(leaves(whole, "state")),
            tick=any(e.op == "tick" for e in walk(whole)),
            inputs=tuple(scope.inputs),
            outer=tuple(scope.outer),
        )
        arguments = [f"{'' if what == 'prepare' else 'const '}{k.prefix}_P *restrict p"] if found.p else []
        arguments += [f"{'' if writes_s else 'const '}{k.prefix}_S *restrict s"] if found.s else []
        arguments += ["uint32_t tick"] if found.tick else []
        read: list[Port | Param] = [*inputs, *outer]
        for d in read:
            name = {**scope.inputs, **scope.outer}[d.name]
            arguments.append(f"{types[d.kind]} {name}" if d.width is None else f"const {types[d.kind]} *{name}")
        if not returned:
            arguments += [f"{types[e.kind]} *restrict {targets[port]}" for port, e in roots.items()]
        result = types[roots[ports[0]].kind] if returned else "void"
        size = len(walk(whole)) * len(k.kind.nodes)
        often = what in ("output", "update", "step") and size <= MOST_IN_PLACE and not self.lean
        head = f"{'td_shared' if often else 'td_apart'} {result} {found.name}({', '.join(arguments) or 'void'})"

        def body(writer: CWriter) -> None:
            with writer.function(head):
                if what == "prepare":
                    scope.prepare(writer, names, node, k.name)
                elif what == "init":
                    for state in node.block.states:
                        scope.initial(writer, node, state, scope.state(node, state))
                else:
                    self._step(writer, scope, names, roots, targets, nexts)

        self.texts.append(self._write(body))
        return found

    def _step(
        self,
        writer: CWriter,
        scope: CopyScope,
        names: CNames,
        roots: Mapping[str, Expr],
        targets: Mapping[str, str],
        nexts: Mapping[str, Expr],
    ) -> None:
        """Lines that give outputs and the next states."""
        node = scope.kind.kind.first
        renderer = scope.renderer(writer, names, scope.inside(node), scope.kind.name)
        renderer.expect(nexts.values())
        renderer.prepare([*roots.values(), *numbers_of(nexts)])
        result = ""
        if [e.width for e in roots.values()] == [None]:
            ((port, root),) = roots.items()
            result = renderer.text(root)
            if nexts:
                writer.line(f"const {scope.type(root.kind)} {targets[port]} = {result};")
                result = targets[port]
                if root.op not in LEAVES:
                    renderer.learn({root: result})
        else:
            renderer.assign([(targets[p] if e.width else f"*{targets[p]}", e) for p, e in roots.items()])
        if nexts:
            commit(writer, renderer, names, node, nexts, {s.name: scope.state(node, s) for s in node.discrete})
        if result:
            writer.line(f"return {result};")


class SharingTick(TickEmitter):
    """The tick of a program with kinds: it calls their functions."""

    def __init__(self, scope: Scope, writer: CWriter, names: CNames, shared: SharedFunctions) -> None:
        super().__init__(scope, writer, names)
        self.shared = shared

    def _calls(self, node: Node) -> bool:
        return node in self.layout.of and self.layout.of[node][0].kind.called

    def _action(self, action: Action) -> None:
        node = action.node
        if action.start is not None and node in self.layout.of:
            self.writer.line(describe(node))
            with self.writer.choice("", [self.scope.style.disjunction([self.signal(r) for r in action.start.signals])]):
                self.writer.line(self.shared.start(node))
            self.computed.add(action.start)
        elif action.start is None and self._calls(node):
            self.writer.line(describe(node))
            for s in action.signals:
                if self._local(s):
                    self.texts[s] = self.names.new(s.path)
            for part in self._calls_of(action):
                self._outputs(
                    part,
                    declare=True,
                    update=part.signals[-1] is action.signals[-1] and self._may_update(node, part.signals),
                )
                self.computed.update(part.signals)
        else:
            super()._action(action)

    def _local(self, s: FlatSignal) -> bool:
        """Whether a signal stands in a variable that is declared where it is computed."""
        return s not in self.layout.stored and s not in self.layout.passing

    def _calls_of(self, action: Action) -> list[Action]:
        """An action as those in which no output reads another: what a call gives is not there before its end."""
        calls: list[list[FlatSignal]] = [[]]
        for s in action.signals:
            if inputs_of(action.node, [action.node.trace.outputs[s.port]]).intersection(calls[-1]):
                calls.append([])
            calls[-1].append(s)
        return [Action(action.node, tuple(signals)) for signals in calls]

    def _outputs(self, action: Action, declare: bool, update: bool = False) -> None:
        """The call that gives an action's outputs; those not in S stand in local variables."""
        node, write = action.node, self.writer
        ports = tuple(s.port for s in action.signals)
        single = len(ports) == 1 and action.signals[0].width is None
        pointers = []
        for s in action.signals:
            text, scalar = self.signal(s), s.width is None
            pointers.append(f"&{text}" if scalar else text)
            if declare and not single and self._local(s):
                write.elements += s.width or 0
                write.line(f"{self.scope.type(s.kind)} {text}{'' if scalar else f'[{s.width}]'};")
        call = self.shared.output(node, ports, update, self.signal, () if single else pointers)
        if update:
            self.updated.add(node)
        if single:
            (s,) = action.signals
            local = declare and self._local(s)
            call = f"{f'const {self.scope.type(s.kind)} ' if local else ''}{self.signal(s)} = {call}"
        write.line(f"{call};")

    def _assigned(self, action: Action) -> None:
        if self._calls(action.node):
            self._outputs(action, declare=False)
        else:
            super()._assigned(action)

    def _update(self, node: Node) -> None:
        if self._calls(node):
            self.writer.line(describe(node))
            self.writer.line(f"{self.shared.update(node, self.signal)};")
        else:
            super()._update(node)


def _each(k: BlockKindLayout) -> str:
    """The comment above what is done for each copy; `twodof.compile.c_files.source_map` reads it."""
    return f"/* each of {len(k.kind.nodes)}: {k.kind.name} */"
