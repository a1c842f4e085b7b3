"""Renderer: expressions as statements of one C function."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from twodof.blocks.expressions.expr import LEAVES, LOOPS, Expr, node
from twodof.blocks.expressions.graph import ordered, unchanging
from twodof.blocks.expressions.numbers import FLOATS
from twodof.compile.c.branches import Branch, Plan, Step
from twodof.compile.c.graph import index_range
from twodof.compile.c.operators import ATOM, C_TYPES, COMPARISONS, LOOSE, OPERATORS, PLAIN, row
from twodof.compile.c.statements import (
    EMPTY,
    NOTHING,
    Assign,
    CNames,
    IfStatement,
    LoopStatement,
    Names,
    Statement,
    Text,
    constant,
    name_of,
    stored,
)
from twodof.compile.program.flat_program import Node

WIDEST_LINE = 150  # an expression that would be longer becomes two


def _bracketed(item: Text, loosest: int) -> str:
    return item.text if item.binding <= loosest else f"({item.text})"


@dataclass
class Batch:
    """Expressions that are written together, with the `texts` (C) of the nodes that are known so far, by id.

    `uses` is the number of readers of each node. `before` are nodes that a loop needs before it. `whole` are the roots
    that are read once only, by the statement for which they are written.
    """

    uses: dict[int, int]
    before: set[int]
    whole: set[int] = field(default_factory=set)
    texts: dict[int, Text] = field(default_factory=dict)


@dataclass
class Used:
    """Names of the helpers and elementary functions that a program's C calls."""

    helpers: set[str] = field(default_factory=set)
    functions: set[str] = field(default_factory=set)


class Renderer:
    """Writes expressions as statements into the list `out`; `leaf` gives the C of a leaf, `block` a node's block."""

    def __init__(
        self,
        names: CNames,
        precision: str,
        used: Used,
        leaf: Callable[[Expr], Text],
        block: Callable[[Expr], Node | None] = lambda item: None,
    ) -> None:
        self.names = names
        self.precision = precision
        self.used = used
        self.leaf = leaf
        self.block = block
        self.out: list[Statement] = []
        self.owner: Node | None = None  # of statements that belong to no expression
        self.named: dict[int, Text] = {}
        self._turning: dict[int, int] = {}  # of names in loops: the loops on which they depend, see Expr.loops
        self._undo: list[tuple[int, Text | None]] = []  # what the names were before the innermost block
        self.bound: dict[tuple[int, int], Text] = {}
        self.limits: dict[tuple[int, int], int] = {}  # loop counters: one more than the largest value
        self.targets: dict[int, str] = {}  # lvalues in which arrays are made
        self.placed: dict[int, str] = {}  # lvalues of signals that are not variables
        self._hints: dict[int, Expr] = {}  # signals, by the expressions that give them
        self._shown: set[int] = set()  # signals whose expressions have been named after them
        self._pointers: set[str] = set()
        self._kept: list[Expr] = []  # nodes made here, whose identities are used as keys
        self._resolved: dict[int, Expr] = {}
        self._before: dict[int, list[Expr]] = {}  # of each loop: nodes that it does not change

    def know(self, item: Expr, text: Text) -> Text:
        """Use `text` as the C of the node `item` from here on, and return it."""
        self._undo.append((id(item), self.named.get(id(item))))
        self.named[id(item)] = text
        if item.loops:
            self._turning[id(item)] = item.loops
        self._kept.append(item)
        return text

    @contextmanager
    def within(self) -> Iterator[list[Statement]]:
        """Collect statements in a list of their own; names that are declared inside are forgotten at the end."""
        with self._scope(), self.collecting() as body:
            yield body

    @contextmanager
    def collecting(self) -> Iterator[list[Statement]]:
        """Collect statements in a list of their own."""
        outer, self.out = self.out, []
        yield self.out
        self.out = outer

    def texts(self, roots: Iterable[Expr]) -> list[Text]:
        """Return the C texts of `roots`, after the statements that they need. An array's text is a name."""
        self._resolved, self._before = {}, {}  # what was being made may be at hand now
        return self._texts([self._resolve(r) for r in roots])

    def text(self, root: Expr) -> Text:
        """Return the C text of one expression."""
        return self.texts([root])[0]

    def index(self, text: Text, root: Expr, width: int) -> Text:
        """Return the C of the index `root` into an array, clamped to `width` unless its range shows that it fits."""
        return Text(self._index(self._resolve(root), text, width), ATOM, text.reads)

    def put(self, target: str, value: Text, kind: str = "", width: int | None = None, more: Names = NOTHING) -> None:
        """Add a statement that stores a number, or an array of `width`, in an lvalue, which reads the names `more`."""
        base = name_of(target)
        reads = value.reads | more | ({base} if base in self._pointers else NOTHING)
        self.out.append(stored(target, value.text, kind, width, self.owner, reads))

    def declare(self, name: str, kind: str, value: Text = EMPTY, fixed: bool = False, width: int | None = None) -> None:
        """Add the declaration of a variable, which does not change if it is `fixed`."""
        declared = f"{'const ' if fixed else ''}{C_TYPES[kind]}"
        self.out.append(Assign(name, value.text, declared, width, owner=self.owner, reads=value.reads))

    def assign(self, targets: Sequence[tuple[str, Expr]]) -> None:
        """Add statements that store each expression in its lvalue, which none of the expressions may read."""
        self._resolved, self._before = {}, {}
        roots = [self._resolve(e) for _, e in targets]
        for (target, _), root in zip(targets, roots, strict=True):
            if root.op in ("vector", "build", "store") and id(root) not in self.named:
                self.targets.setdefault(id(root), target)
        texts = self._texts(roots)
        for (target, _), root, text in zip(targets, roots, texts, strict=True):
            if text.text != target:
                self.put(target, text, root.kind, root.width)

    def _texts(self, roots: Sequence[Expr]) -> list[Text]:
        order = ordered(roots, self._args)
        uses: dict[int, int] = {}
        for item in order:
            for a in self._args(item):
                uses[id(a)] = uses.get(id(a), 0) + 1
        for r in roots:
            uses[id(r)] = uses.get(id(r), 0) + 1
        before = {id(e) for item in order if item.op in LOOPS for e in self._unchanging(item)}
        batch = Batch(uses, before, {id(r) for r in roots if uses[id(r)] == 1})
        hand, optional = set(), set()
        for item in order:
            if item.op in LEAVES or id(item) in self.named:
                hand.add(id(item))
            elif item.op == "signal":
                self._hints.setdefault(id(self._resolve(item.args[0])), item)
                if item.width is None and id(item) not in self.placed:
                    optional.add(id(item))
        plan = Plan(order, self._args, roots, hand, optional)
        for key, more in plan.uses.items():
            uses[key] += more
        self._steps(batch, plan.steps)
        return [batch.texts[id(r)] for r in roots]

    def _steps(self, batch: Batch, found: Iterable[Step]) -> None:
        for step in found:
            if isinstance(step, Branch):
                self._branch(batch, step)
            else:
                self._step(batch, step)

    def _step(self, batch: Batch, item: Expr) -> None:
        """Find a node's text, after the statements that it needs."""
        if id(item) in self.named:
            batch.texts[id(item)] = self.named[id(item)]
            return
        outer = self.owner
        self.owner = self.block(item) or outer
        batch.texts[id(item)] = self._found(batch, item)
        self.owner = outer

    def _found(self, batch: Batch, item: Expr) -> Text:
        args = [batch.texts[id(a)] for a in self._args(item)][: len(item.outside)]
        if item.op == "signal":
            return self._signal(item, args[0])
        if item.op in ("vector", "build", "store", "fold"):
            return self.know(item, self._statement(item, args))
        made = self._expression(item, args)
        shared = batch.uses[id(item)] > 1 or id(item) in batch.before
        trivial = item.op in LEAVES or (item.op == "select" and "(" not in made.text) or self._counts(item)
        if trivial or not (shared or (len(made.text) > WIDEST_LINE and id(item) not in batch.whole)):
            return made
        return self._variable(item, made)

    def _variable(self, item: Expr, value: Text) -> Text:
        """Keep a number in a variable."""
        name = self._new_name(item)
        self.declare(name, item.kind, value, fixed=True)
        return self.know(item, Text.of(name))

    def _new_name(self, item: Expr) -> str:
        """Return the name of a new variable for a node: that of the signal with its value, or with a number."""
        signal = item if item.op == "signal" else self._hints.pop(id(item), None)
        if signal is not None:
            self._shown.add(id(signal))
            return self.names.new(signal.data.path)
        if item.width is not None:
            return self.names.new(f"{self._stem()}array")
        return self.names.numbered(f"{self._stem()}t")

    def _stem(self) -> str:
        return f"{self.owner.path}_" if self.owner is not None else ""

    def _signal(self, item: Expr, text: Text) -> Text:
        """Store a signal's value where it stands, or in a variable; a variable points to an array that stays."""
        root = self._resolve(item.args[0])
        place = self.placed.get(id(item))
        if place is not None:
            if text.text != place:
                self.put(place, text, item.kind, item.width)
            if root.op not in LEAVES and root.width is None:
                self.know(root, Text.of(place))
            return self.know(item, Text.of(place))
        if id(root) in self.named and id(item) in self._shown:
            return self.know(item, text)
        if item.width is None:
            new = id(root) not in self.named and root.op not in (*LEAVES, "signal")
            return self.know(item, self._variable(root if new else item, text))
        name = self.names.new(item.data.path)
        if root.op == "state":
            self.declare(name, item.kind, width=item.width)
            self.put(name, text, item.kind, item.width)
        else:
            declared = f"const {C_TYPES[item.kind]} *const"
            self.out.append(Assign(name, text.text, declared, owner=self.owner, reads=text.reads))
        return self.know(item, Text.of(name))

    def _branch(self, batch: Batch, branch: Branch) -> None:
        """Add an `if` that gives variables their values."""
        outer = self.owner
        (first, choice), *_ = branch.choices
        self.owner = self.block(first) or outer
        names = [self._new_name(item) for item, _ in branch.choices]
        for name, (item, _) in zip(names, branch.choices, strict=True):
            self.declare(name, item.kind)
        sides = []
        for steps, holds in ((branch.then, True), (branch.otherwise, False)):
            with self.within() as body:
                self._steps(batch, steps)
                for name, (_, each) in zip(names, branch.choices, strict=True):
                    side = each.then if holds else each.otherwise
                    known = batch.texts.get(id(side))
                    self.put(name, known or constant(side.data, side.kind, self.precision))
            sides.append(body)
        test = batch.texts[id(choice.condition)]
        self.out.append(IfStatement(test.text, *sides, owner=self.owner, reads=test.reads))
        self.owner = outer
        for name, (item, _) in zip(names, branch.choices, strict=True):
            batch.texts[id(item)] = self.know(item, Text.of(name))

    def _counts(self, item: Expr) -> bool:
        """Return True if a node is an index made of loop counters: it is written where it is used."""
        return item.op in PLAIN and item.kind == "int32" and index_range(item, self.limits) is not None

    def _args(self, item: Expr) -> tuple[Expr, ...]:
        if id(item) in self.named:
            return ()
        args = (*item.outside, *(self._unchanging(item) if item.op in LOOPS else ()))
        return tuple(self._resolve(a) for a in args)

    def _unchanging(self, loop: Expr) -> list[Expr]:
        """Return what is computed before a loop: arrays, loops and calls that it does not change, and signals."""
        if id(loop) in self.named:
            return []
        if id(loop) not in self._before:
            self._before[id(loop)] = unchanging(loop, self._resolve, lambda item: item.op == "signal")
            self._kept.append(loop)
        return self._before[id(loop)]

    def _resolve(self, item: Expr) -> Expr:
        """Return `item`, or for an element of an array that is just being made, that element."""
        start = item
        if id(start) in self._resolved:
            return self._resolved[id(start)]
        while item.op == "select" and id(item) not in self.named and item.args[1].op == "const":
            array, index = item.args
            while array.op == "signal" and id(array) not in self.named:
                array = array.args[0]
            if array.op != "vector":
                break
            item = array.args[min(max(index.data, 0), len(array.args) - 1)]
        self._resolved[id(start)] = item
        self._kept.append(start)
        return item

    def _index(self, index: Expr, text: Text, width: int) -> str:
        if index.op == "const":
            return str(min(max(index.data, 0), width - 1))
        span = index_range(index, self.limits)
        if span is not None and span[0] >= 0 and span[1] < width:
            return text.text
        return f"{self._use('clamp_index')}({text.text}, {width - 1})"

    def _use(self, helper: str) -> str:
        self.used.helpers.add(helper)
        return helper

    def _expression(self, item: Expr, args: Sequence[Text]) -> Text:
        if item.op == "const":
            return constant(item.data, item.kind, self.precision)
        if item.op == "bound":
            return self.bound[item.data]
        if item.op in LEAVES:
            return self.leaf(item)
        reads = NOTHING.union(*(a.reads for a in args))
        if item.op == "select":
            return Text(self._element(item, args[0].text, args[1]), ATOM, reads)
        if item.op == "call":
            name = f"{item.data}{'' if item.kind == 'real' else f'_{item.kind}'}"
            self.used.functions.add(name)
            return Text(f"td_{name}({', '.join(a.text for a in args)})", ATOM, reads)
        operand = self._resolve(item.args[0]).kind
        text, binding = self._special(item, args, operand) or self._operation(row(item, operand), args)
        return Text(text, binding, NOTHING if text in ("true", "false") else reads)

    def _operation(self, name: str, args: Sequence[Text]) -> tuple[str, int]:
        """Return what an operator's row says."""
        operator = OPERATORS[name]
        if operator.helper:
            self._use(operator.helper)
        operands = [_bracketed(a, loosest) for a, loosest in zip(args, operator.operands, strict=False)]
        return operator.text.format(*operands, f="f" if self.precision == "float32" else ""), operator.binding

    def _element(self, item: Expr, name: str, index: Text) -> str:
        """Return an array's element."""
        array = item.args[0]
        if array.width is None:
            raise ValueError("select on a scalar")
        return f"{name}[{self._index(self._resolve(item.args[1]), index, array.width)}]"

    def _special(self, item: Expr, args: Sequence[Text], operand: str) -> tuple[str, int] | None:
        """Return what is simpler than the operator's row, or free of a compiler's warnings."""
        op, kind = item.op, item.kind
        same = len(args) > 1 and args[0].text == args[1].text  # one value, or one signal at two inputs
        if op in COMPARISONS:
            if same and operand not in FLOATS:  # compilers warn about these; a float may be NaN
                return ("true" if op in ("le", "eq") else "false"), ATOM
        elif op == "xor" and operand == "bool" and same:
            return "false", ATOM
        elif op in PLAIN and index_range(item, self.limits) is not None:
            return self._operation(PLAIN[op], args)
        elif kind == "uint32" and op == "abs":
            return args[0].text, args[0].binding
        elif kind == "uint32" and op in ("shl", "shr", "quot", "rem"):
            second = self._resolve(item.args[1])
            if second.op == "const" and op in ("shl", "shr"):
                return f"{_bracketed(args[0], ATOM)} {'<<' if op == 'shl' else '>>'} {second.data & 31}", LOOSE
            if second.op == "const" and second.data:
                return f"{_bracketed(args[0], ATOM)} {'/' if op == 'quot' else '%'} {args[1].text}", LOOSE
        return None

    def _statement(self, item: Expr, args: Sequence[Text]) -> Text:
        """Add the statements that make an array or run a loop; return the name of the result."""
        if item.op == "fold":
            return self._fold(item, args)
        target, width = self.targets.get(id(item)), item.width
        if width is None:
            raise ValueError("an array without a width")
        name = target or self._new_name(item)
        found = Text.of(name)
        if item.op == "vector":
            if target is None:
                reads = NOTHING.union(*(a.reads for a in args))
                self.declare(name, item.kind, Text(f"{{{', '.join(a.text for a in args)}}}", ATOM, reads), True, width)
                return found
            for i, a in enumerate(args):
                self.put(f"{name}[{i}]", a)
            return found
        if target is None:
            self.declare(name, item.kind, width=width)
        if item.op == "store":
            self.put(name, args[0], item.kind, width)
            at = self._index(self._resolve(item.args[1]), args[1], width)
            self.put(f"{name}[{at}]", args[2], more=args[1].reads)
            return found
        length, depth = item.data
        with self._loop(length, depth) as counter:
            body = self._resolve(item.bodies[0])
            if body.width is not None:
                self._part(name, f"{counter} * {body.width}", body)
            else:
                (text,) = self._texts([body])
                self.put(f"{name}[{counter}]", text)
        return found

    def _part(self, name: str, start: str, body: Expr) -> None:
        """Store an array in the part of a longer one that begins at `start`."""
        part = self.names.new(f"{name}_part" if name.isidentifier() else "part")
        self._pointers.add(part)
        reads = frozenset((name_of(name),))
        declared = f"{C_TYPES[body.kind]} *const"
        self.out.append(Assign(part, f"&{name}[{start}]", declared, owner=self.owner, reads=reads))
        if body.op in ("vector", "build") and id(body) not in self.named:
            self.targets[id(body)] = part
        (text,) = self._texts([body])
        if text.text != part:
            self.put(part, text, body.kind, body.width)
        self.targets.pop(id(body), None)

    def _fold(self, item: Expr, args: Sequence[Text]) -> Text:
        length, depth = item.data[:2]
        which: int = item.data[2]
        values = [Text.of(self.names.new(f"{self._stem()}sum")) for _ in args]
        for value, body, start in zip(values, item.bodies, args, strict=True):
            self.declare(value.text, body.kind, start)
        with self._loop(length, depth):
            self.bound |= {(depth, j): value for j, value in enumerate(values, 1)}
            nexts = self._texts([self._resolve(body) for body in item.bodies])
            if len(values) > 1:  # each reads the old ones
                new = [Text.of(self.names.new(f"{value.text}_next")) for value in values]
                for name, body, text in zip(new, item.bodies, nexts, strict=True):
                    self.declare(name.text, body.kind, text, fixed=True)
                nexts = new
            for value, text in zip(values, nexts, strict=True):
                self.put(value.text, text)
        for j, (value, body) in enumerate(zip(values, item.bodies, strict=True)):  # the loop's other results
            self.know(node("fold", body.kind, item.args, (length, depth, j)), value)
        return values[which]

    @contextmanager
    def _loop(self, length: int, depth: int) -> Iterator[str]:
        """Add a loop; inside, only those names are known that do not depend on a loop of this depth."""
        counter = self.names.new("ijk"[depth] if depth < 3 else "i")
        outer = self.bound, self.limits, self._resolved, self._before
        self.bound = {**self.bound, (depth, 0): Text(counter)}
        self.limits = {**self.limits, (depth, 0): length}
        self._resolved, self._before = {}, {}
        hidden = [key for key, loops in self._turning.items() if loops >> depth & 1]
        with self._scope(hidden), self.collecting() as body:
            yield counter
        self.out.append(
            LoopStatement(f"for (int32_t {counter} = 0; {counter} < {length}; {counter}++)", body, owner=self.owner)
        )
        self.names.taken.discard(counter)
        self.bound, self.limits, self._resolved, self._before = outer

    @contextmanager
    def _scope(self, hidden: Sequence[int] = ()) -> Iterator[None]:
        """Open a scope of C: names made inside are forgotten at its end, and the names `hidden` are unknown inside."""
        outer = self._undo
        self._undo = [(key, self.named.pop(key)) for key in hidden if key in self.named]
        yield
        for key, text in reversed(self._undo):
            if text is None:
                del self.named[key]
                self._turning.pop(key, None)
            else:
                self.named[key] = text
        self._undo = outer
