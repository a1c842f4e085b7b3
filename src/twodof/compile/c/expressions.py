"""Expressions as C99: one `Renderer` for one block in one C scope."""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twodof.blocks.expressions.expr import LEAVES, LOOPS, Expr, node
from twodof.blocks.expressions.graph import ordered, unchanging, walk
from twodof.blocks.expressions.kinds import FLOATS, INTEGERS, dtype_of
from twodof.blocks.expressions.numbers import Integer
from twodof.compile.c.index_range import index_range
from twodof.compile.c.names import CNames
from twodof.compile.c.operators import ATOM, C_TYPES, COMPARISONS, LOOSE, OPERATORS, PLAIN, SIGNED, Operator, row
from twodof.compile.c.writer import CWriter

_CALL = re.compile(r"\w+\(.*\)")  # or what looks like it, which does no harm
WIDEST_LINE = 150  # an expression that would be longer becomes two
SMALL_ARRAY = 16  # up to here a copy is cheaper than a choice
MOST_CHOICES = 4  # stores in a row that are read by choices: more are copied, as each reader would choose among all

NOBODY = 0  # no node's identity

Text = tuple[str, int]


def constant(value: Any, kind: str, precision: str) -> Text:
    """A C literal of the final type, real numbers in hexadecimal with their decimal value beside."""
    value = value.value if isinstance(value, Integer) else value
    if kind == "bool":
        return ("true" if value else "false"), ATOM
    if kind == "int32":
        if value == -(2**31):
            return "INT32_MIN", ATOM
        return str(value), ATOM if value >= 0 else SIGNED
    if kind == "uint32":
        return f"{value}u", ATOM
    if kind in INTEGERS:
        return f"{value}", ATOM if value >= 0 else SIGNED
    precision = dtype_of(kind, precision).name
    with np.errstate(over="ignore"):
        rounded = float(np.float32(value)) if precision == "float32" else float(value)
    suffix = "f" if precision == "float32" else ""
    if math.isnan(rounded):
        return f'__builtin_nan{suffix}("")', ATOM
    sign, binding = ("-", SIGNED) if math.copysign(1.0, rounded) < 0 else ("", ATOM)
    if math.isinf(rounded):
        return f"{sign}__builtin_inf{suffix}()", binding
    digits, _, exponent = abs(rounded).hex().partition("p")
    mantissa = digits.rstrip("0").rstrip(".") if "." in digits else digits
    mantissa = "0x0" if mantissa == "0x" else mantissa
    return f"{sign}{mantissa}p{exponent}{suffix} /* {rounded:.9g} */", binding


def _paren(item: Text, loosest: int) -> str:
    return item[0] if item[1] <= loosest else f"({item[0]})"


def _loop_key(item: Expr) -> tuple[Any, ...]:
    """What the results of one fold have in common."""
    return (*map(id, item.args), *item.data[:2])


def _stores(array: Expr) -> int:
    """How many stores in a row made `array`, counted to one more than MOST_CHOICES."""
    found = 0
    while array.op == "store" and found <= MOST_CHOICES:
        array = array.args[0]
        found += 1
    return found


@dataclass
class Batch:
    """Expressions that are written together, with the `texts` that are known so far.

    `uses`: how often each node is read. `before`: what loops need before them. `always`: what is read later too.
    `whole`: the roots that stand by themselves in what asked for them. `given`: the variable that a branch within
    another one gives its value to.
    """

    uses: dict[int, int]
    before: set[int]
    always: list[Expr]
    whole: set[int] = field(default_factory=set)
    texts: dict[int, Text] = field(default_factory=dict)
    given: dict[int, str] = field(default_factory=dict)


class Renderer:
    """Writes the expressions of one block into a C scope.

    `leaf` gives the C text of an input, state, parameter, tick or dt; `known` that of whole expressions that
    are already at hand; `stem` names temporaries.
    """

    types: Mapping[str, str] = C_TYPES
    way = ""  # how the names of the elementary functions that it calls begin
    operators: Mapping[str, Operator] = OPERATORS
    kinds: Mapping[str, str] = {kind: kind for kind in C_TYPES}  # the kind whose functions and types each has

    def __init__(
        self,
        writer: CWriter,
        names: CNames,
        precision: str,
        leaf: Callable[[Expr], Text],
        stem: str,
        known: Mapping[Expr, str] | None = None,
    ) -> None:
        self.writer = writer
        self.names = names
        self.precision = precision
        self.leaf = leaf
        self.stem = stem
        self.named: dict[int, Text] = {}
        self._turning: dict[int, int] = {}  # of what is named in loops: those on which it depends, see Expr.loops
        self._undo: list[tuple[int, Text | None]] = []  # what the names were before the innermost loop
        self.bound: dict[tuple[int, int], Text] = {}
        self.limits: dict[tuple[int, int], int] = {}  # loop counters: one more than the largest value
        self.targets: dict[int, str] = {}
        self._kept: list[Expr] = []  # nodes made here, whose identities are used as keys
        self._resolved: dict[int, Expr] = {}
        self._before: dict[int, list[Expr]] = {}  # of each loop: what it does not change
        self._wanted: dict[tuple[Any, ...], set[int]] = {}  # of each fold, which of its results
        self.learn(known or {})
        self._later: dict[int, list[int]] = {}  # of expressions that are needed later, what there reads them

    def learn(self, known: Mapping[Expr, str]) -> None:
        """More expressions that are already at hand."""
        for e, text in known.items():
            self._name(e, self._local(text) if e.width is None else (text, ATOM))

    def _name(self, item: Expr, text: Text) -> Text:
        """Remember the name under which a node's value is at hand."""
        self._undo.append((id(item), self.named.get(id(item))))
        self.named[id(item)] = text
        if item.loops:
            self._turning[id(item)] = item.loops
        self._kept.append(item)
        return text

    def _local(self, name: str) -> Text:
        """The text of a number that stands in a variable or a struct's member."""
        return name, ATOM

    def _stored(self, text: str, kind: str) -> str:
        """A number's text as it is assigned."""
        return text

    def expect(self, roots: Iterable[Expr]) -> None:
        """Expressions that will be asked for later: what they share with others before them becomes a temporary."""
        for root in roots:
            self._later.setdefault(id(root), []).append(NOBODY)
        for item in walk(roots):
            self._kept.append(item)
            for a in item.outside:
                self._later.setdefault(id(a), []).append(id(item))

    def prepare(self, roots: Iterable[Expr]) -> None:
        """Write what several numbers that will be asked for one by one share, so that it is found once for all."""
        numbers = [self._resolve(r) for r in roots if r.width is None]
        if len(numbers) > 1:
            self._texts(numbers)

    def scalars(self, roots: Sequence[Expr]) -> list[Text]:
        """The C texts of `roots`, after the lines that they need. An array's text is a name."""
        resolved = [self._resolve(r) for r in roots]
        texts = zip(resolved, self._texts(resolved), strict=True)
        return [(self._stored(text, r.kind) if r.width is None else text, binding) for r, (text, binding) in texts]

    def text(self, root: Expr) -> str:
        """The C text of one expression."""
        return self.scalars([root])[0][0]

    def index(self, root: Expr, width: int) -> str:
        """The C text of an array index, clamped unless it cannot be outside."""
        resolved = self._resolve(root)
        return self._index(resolved, self._texts([resolved])[0], width)

    def assign(self, targets: Sequence[tuple[str, Expr]]) -> None:
        """Lines that store each expression in its lvalue, which no expression may read."""
        roots = [self._resolve(e) for _, e in targets]
        for (target, _), root in zip(targets, roots, strict=True):
            direct = root.op in ("vector", "build", "store") and not self.writer.masked
            if direct and id(root) not in self.named:
                self.targets.setdefault(id(root), target)
        texts = self._texts(roots)
        for (target, _), root, (text, _) in zip(targets, roots, texts, strict=True):
            if root.width is None:
                self.writer.assign(target, self._stored(text, root.kind), root.kind)
            elif text != target:
                self.writer.copy(target, text, root.width, root.kind)

    def _texts(self, roots: Sequence[Expr]) -> list[Text]:
        order = ordered(roots, self._args)
        uses: dict[int, int] = {}
        for item in order:
            for a in self._args(item):
                uses[id(a)] = uses.get(id(a), 0) + 1
        batch = Batch(uses, {id(e) for item in order if item.op in LOOPS for e in self._unchanging(item)}, list(roots))
        for r in roots:
            uses[id(r)] = uses.get(id(r), 0) + 1
        asked = {id(r) for r in roots}
        for item in order:
            more = [reader for reader in self._later.get(id(item), ()) if reader not in uses]
            later = sum(1 for reader in more if reader != NOBODY or id(item) not in asked)
            if later:
                uses[id(item)] += later
                batch.always.append(item)
        for item in order:
            if item.op == "fold":
                self._wanted.setdefault(_loop_key(item), set()).add(item.data[2])
        batch.whole.update(id(r) for r in roots if uses[id(r)] == 1)
        self._write(batch, order)
        return [batch.texts[id(r)] for r in roots]

    def _write(self, batch: Batch, order: Sequence[Expr]) -> None:
        """Find the texts of nodes, arguments before their users."""
        for item in order:
            self._step(batch, item)

    def _step(self, batch: Batch, item: Expr) -> None:
        """Find a node's text, after the lines that it needs."""
        if id(item) in self.named:
            batch.texts[id(item)] = self.named[id(item)]
            return
        args = [batch.texts[id(a)] for a in self._args(item)][: len(item.outside)]
        made = self._statement(item, args) if item.op in ("vector", "build", "store", "fold") else None
        if made is None:
            made = self._expression(item, args)
            trivial = item.op in LEAVES or (item.op == "select" and "(" not in made[0]) or self._counts(item)
            shared = batch.uses[id(item)] > 1 or id(item) in batch.before
            if not trivial and (shared or (len(made[0]) > WIDEST_LINE and id(item) not in batch.whole)):
                name = self.names.numbered(f"{self.stem}_t")
                self.writer.line(f"const {self.types[item.kind]} {name} = {self._stored(made[0], item.kind)};")
                made = self._name(item, self._local(name))
        else:
            self._name(item, made)
        batch.texts[id(item)] = made

    def _counts(self, item: Expr) -> bool:
        """Whether it is an index of loop counters: it stands where it is used, as by hand."""
        return item.op in PLAIN and item.kind == "int32" and index_range(item, self.limits) is not None

    def _args(self, item: Expr) -> tuple[Expr, ...]:
        if id(item) in self.named:
            return ()
        args = (*item.outside, *(self._unchanging(item) if item.op in LOOPS else ()))
        return tuple(self._resolve(a) for a in args)

    def _unchanging(self, loop: Expr) -> list[Expr]:
        """What is computed before a loop in this scope."""
        if id(loop) in self.named:
            return []
        if id(loop) not in self._before:
            self._before[id(loop)] = unchanging(loop, self._resolve, self._bodies)
            self._kept.append(loop)
        return self._before[id(loop)]

    def _bodies(self, loop: Expr) -> Sequence[Expr]:
        """What a loop must evaluate for the one result that its node stands for."""
        if loop.op == "build":
            return loop.bodies
        _, depth, which = loop.data
        return [loop.bodies[j] for j in self._carried(loop.bodies, depth, {which})]

    def _resolve(self, item: Expr) -> Expr:
        """`item`, or for an element of an array that is just being made, that element."""
        start = item
        found = self._resolved.get(id(start))
        if found is not None:
            return found
        while item.op == "select" and id(item) not in self.named:
            array, index = item.args
            if array.op == "vector" and index.op == "const":
                item = array.args[min(max(index.data, 0), len(array.args) - 1)]
            elif array.width is not None and array.width > SMALL_ARRAY and 0 < _stores(array) <= MOST_CHOICES:
                base, where, value = array.args
                same = self._keep("eq", "bool", (self._clamped(index, array.width), self._clamped(where, array.width)))
                other = self._keep("select", array.kind, (base, index))
                item = self._keep("where", array.kind, (same, value, other))
            else:
                break
        self._resolved[id(start)] = item
        self._kept.append(start)
        return item

    def _keep(self, op: str, kind: str, args: tuple[Expr, ...], data: Any = None) -> Expr:
        made = node(op, kind, args, data)
        self._kept.append(made)
        return made

    def _clamped(self, index: Expr, width: int) -> Expr:
        if index.op == "const":
            return self._keep("const", "int32", (), min(max(index.data, 0), width - 1))
        last, zero = self._keep("const", "int32", (), width - 1), self._keep("const", "int32", (), 0)
        upper = self._keep("where", "int32", (self._keep("lt", "bool", (index, last)), index, last))
        return self._keep("where", "int32", (self._keep("lt", "bool", (upper, zero)), zero, upper))

    def _use(self, helper: str) -> str:
        self.writer.helpers.add(helper)
        return helper

    def _index(self, index: Expr, text: Text, width: int) -> str:
        if index.op == "const":
            return str(min(max(index.data, 0), width - 1))
        span = index_range(index, self.limits)
        if span is not None and span[0] >= 0 and span[1] < width:
            return text[0]
        return f"{self._use('clamp_index')}({text[0]}, {width - 1})"

    def _expression(self, item: Expr, args: Sequence[Text]) -> Text:
        if item.op in LEAVES:
            return self._leaf(item)
        if item.op == "select":
            return self._element(item, args[0][0], args[1])
        if item.op == "call":
            kind = self.kinds[item.kind]
            name = f"{self.way}{item.data}{'' if kind == 'real' else f'_{kind}'}"
            self.writer.functions.add(name)
            return f"td_{name}({', '.join(a for a, _ in args)})", ATOM
        operand = self._resolve(item.args[0]).kind
        return self._special(item, args, operand) or self._operation(row(item, operand), args)

    def _leaf(self, item: Expr) -> Text:
        if item.op == "const":
            return constant(item.data, item.kind, self.precision)
        return self.bound[item.data] if item.op == "bound" else self.leaf(item)

    def _operation(self, name: str, args: Sequence[Text]) -> Text:
        """What the operator of a row says."""
        return self._applied(self.operators[name], args)

    def _applied(self, operator: Operator, args: Sequence[Text]) -> Text:
        if operator.helper:
            self._use(operator.helper)
        operands = [_paren(a, loosest) for a, loosest in zip(args, operator.operands, strict=False)]
        return operator.text.format(*operands, f="f" if self.precision == "float32" else ""), operator.binding

    def _element(self, item: Expr, name: str, index: Text) -> Text:
        """An array's element."""
        array = self._resolve(item.args[0])
        if array.width is None:
            raise ValueError("select on a scalar")
        return f"{name}[{self._index(self._resolve(item.args[1]), index, array.width)}]", ATOM

    def _special(self, item: Expr, args: Sequence[Text], operand: str) -> Text | None:
        """What is written in a simpler way than the operator's row, or in one without warnings."""
        op, lean = item.op, self.writer.lean
        if op in COMPARISONS:
            same = args[0][0] == args[1][0]  # one value, or one signal at two inputs
            if same and operand not in FLOATS:  # compilers warn about these; a float may be NaN
                return ("true" if op in ("le", "eq") else "false"), ATOM
            if lean and op in ("eq", "ne") and operand in FLOATS:
                equal = f"{self._use(f'{operand}_equal')}({args[0][0]}, {args[1][0]})"
                return (equal, ATOM) if op == "eq" else (f"!{equal}", SIGNED)
        elif op == "convert" and lean and operand not in FLOATS and _CALL.fullmatch(args[0][0]):
            return f"{self._use(f'{operand}_to_{item.kind}')}({args[0][0]})", ATOM
        elif op == "xor" and operand == "bool" and args[0][0] == args[1][0]:
            return "false", ATOM
        elif op in PLAIN and index_range(item, self.limits) is not None:
            return self._operation(PLAIN[op], args)
        elif item.kind == "uint32" and op == "abs":
            return args[0]
        elif item.kind == "uint32" and op in ("shl", "shr", "quot", "rem"):
            second = self._resolve(item.args[1])
            if second.op == "const" and op in ("shl", "shr"):
                return f"{_paren(args[0], ATOM)} {'<<' if op == 'shl' else '>>'} {second.data & 31}", LOOSE
            if second.op == "const" and second.data:
                return f"{_paren(args[0], ATOM)} {'/' if op == 'quot' else '%'} {args[1][0]}", LOOSE
        return None

    def _statement(self, item: Expr, args: Sequence[Text]) -> Text:
        """Write the lines that make an array or run a loop; the name of the result."""
        if item.op == "fold":
            return self._fold(item, args)
        target = self.targets.get(id(item))
        ctype, width = self.types[item.kind], item.width
        if width is None:
            raise ValueError("an array without a width")
        name = target or self.names.new(f"{self.stem}_array")
        self.writer.elements += 0 if target else width
        if item.op == "vector":
            elements = [self._stored(a, item.kind) for a, _ in args]
            if target is None:
                self.writer.line(f"const {ctype} {name}[{width}] = {{{', '.join(elements)}}};")
            else:
                for i, a in enumerate(elements):
                    self.writer.line(f"{name}[{i}] = {a};")
            return name, ATOM
        if target is None:
            self.writer.line(f"{ctype} {name}[{width}];")
        if item.op == "store":
            self.writer.copy(name, args[0][0], width, item.kind, target is None)
            at = self._index(self._resolve(item.args[1]), args[1], width)
            self.writer.put(name, at, self._stored(args[2][0], item.kind), item.kind, target is None)
            return name, ATOM
        length, depth = item.data
        with self._loop(length, depth) as counter:
            body = self._resolve(item.bodies[0])
            if body.width is not None:
                self._part(name, f"{counter} * {body.width}", body, target is None)
            else:
                ((text, _),) = self._texts([body])
                self.writer.line(f"{name}[{counter}] = {self._stored(text, item.kind)};")
        return name, ATOM

    def _part(self, name: str, start: str, body: Expr, own: bool) -> None:
        """Lines that store an array in the part of a longer one that begins at `start`."""
        part = self.names.new(f"{self.stem}_part")
        self.writer.line(f"{self.types[body.kind]} *const {part} = &{name}[{start}];")
        if body.op in ("vector", "build") and id(body) not in self.named:
            self.targets[id(body)] = part
        ((text, _),) = self._texts([body])
        if text != part:
            self.writer.copy(part, text, body.width or 1, body.kind, own)
        self.targets.pop(id(body), None)

    def _fold(self, item: Expr, args: Sequence[Text]) -> Text:
        length, depth, which = item.data
        bodies = item.bodies
        needed = self._carried(bodies, depth, {which} | self._wanted.get(_loop_key(item), set()))
        names = {j: self.names.new(f"{self.stem}_sum") for j in needed}
        for j, name in names.items():
            kind = bodies[j].kind
            self.writer.line(f"{self.types[kind]} {name} = {self._stored(args[j][0], kind)};")
        with self._loop(length, depth):
            for j, name in names.items():
                self.bound[depth, j + 1] = self._local(name)
            texts = self._texts([self._resolve(bodies[j]) for j in needed])
            if len(names) == 1:
                (j,) = needed
                self.writer.line(f"{names[j]} = {self._stored(texts[0][0], bodies[j].kind)};")
            else:
                nexts = [self.names.new(f"{names[j]}_next") for j in needed]
                for j, new, (text, _) in zip(needed, nexts, texts, strict=True):
                    kind = bodies[j].kind
                    self.writer.line(f"const {self.types[kind]} {new} = {self._stored(text, kind)};")
                for j, new in zip(needed, nexts, strict=True):
                    self.writer.line(f"{names[j]} = {new};")
        for j, name in names.items():  # the loop's other results
            twin = self._keep("fold", bodies[j].kind, item.args, (length, depth, j))
            self._name(twin, self._local(name))
        return self._local(names[which])

    def _carried(self, bodies: Sequence[Expr], depth: int, wanted: set[int]) -> list[int]:
        """The values that a fold must carry so that those `wanted` come out."""
        found: set[int] = set()
        seen: set[int] = set()
        stack = list(wanted)
        while stack:
            j = stack.pop()
            if j in found:
                continue
            found.add(j)
            below = [bodies[j]]
            while below:
                e = below.pop()
                if id(e) not in seen and e.loops >> depth & 1:
                    seen.add(id(e))
                    shadowed = e.op in LOOPS and e.data[1] == depth  # its bodies read its own variables
                    below += e.outside if shadowed else e.args
                    if e.op == "bound" and e.data[1]:
                        stack.append(e.data[1] - 1)
        return sorted(found)

    @contextmanager
    def _loop(self, length: int, depth: int) -> Iterator[str]:
        """A C loop; inside, only those names are known that do not depend on a loop of this depth."""
        counter = self.names.new("ijk"[depth] if depth < 3 else "i")
        outer = self.bound, self.limits, self._resolved, self._before
        self.bound = {**self.bound, (depth, 0): (counter, ATOM)}
        self.limits = {**self.limits, (depth, 0): length}
        self._resolved, self._before = {}, {}
        hidden = [key for key, loops in self._turning.items() if loops >> depth & 1]
        with self._within(hidden), self.writer.block(f"for (int32_t {counter} = 0; {counter} < {length}; {counter}++)"):
            yield counter
        self.names.taken.discard(counter)
        self.bound, self.limits, self._resolved, self._before = outer

    @contextmanager
    def _within(self, hidden: Sequence[int] = ()) -> Iterator[None]:
        """What is named inside is forgotten at the end, for it stands within brackets; the names `hidden` are not known
        inside.
        """
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
