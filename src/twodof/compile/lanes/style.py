"""The emitter's style for lanes: several instances in the vectors of one struct; see `helpers.py` for the C below.

What is the same in all lanes (rates that are due, loops with their counters) stays ordinary C. A condition of a lane's
own becomes a mask: both sides are computed, and only stores are chosen.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import reduce
from typing import ClassVar

from twodof.blocks.expressions.expr import Expr
from twodof.compile.c.expressions import Renderer, Text, constant
from twodof.compile.c.index_range import index_range
from twodof.compile.c.names import CNames
from twodof.compile.c.operators import ATOM, PLAIN, called
from twodof.compile.c.operators import OPERATORS as SCALAR
from twodof.compile.c.style import CStyle
from twodof.compile.c.writer import CWriter
from twodof.compile.lanes.helpers import SCALARS, TYPES, VECTORS, more, prelude
from twodof.compile.lanes.other_kinds import lane_kinds, lane_operators
from twodof.compile.program.layout import LaneShape, Member

MASKS = 1000  # names kept for masks
DEEPEST_INDEX = 20  # operations in an index that is the same in all lanes


@dataclass
class LaneWriter(CWriter):
    """Lines of C whose stores a mask may choose: they store where it allows it."""

    kinds: ClassVar[Mapping[str, str]]
    mask: str = ""
    masks: int = 0
    shared: set[str] = field(default_factory=set)  # indices that are the same in all lanes

    @contextmanager
    def choice(self, due: str, tests: Sequence[str] = ()) -> Iterator[None]:
        """An `if` on `due`, and within it a mask of `tests`."""
        with self.block(f"if ({due})" if due else "") if due or tests else nullcontext():
            outer = self.mask, self.masked
            if tests:
                self.masks += 1
                on = f"on_{self.masks}"
                whole = conjunction([*filter(None, (self.mask,)), *tests])
                self.line(f"const lanes_bool {on} = {whole};")
                self.mask, self.masked = on, True
            yield
            self.mask, self.masked = outer

    def assign(self, target: str, text: str, kind: str) -> None:
        pick = f"lanes_pick_{self.kinds[kind]}"
        self.line(f"{target} = {pick}({self.mask}, {text}, {target});" if self.mask else f"{target} = {text};")

    def copy(self, target: str, source: str, width: int, kind: str, own: bool = False) -> None:
        if own or not self.mask:
            self.line(f"memcpy({target}, {source}, sizeof {source}[0] * {width});")
            return
        with self.block(f"for (int32_t i = 0; i < {width}; i++)"):
            self.assign(f"{target}[i]", f"{source}[i]", kind)

    def duplicate(self, target: str, source: str, width: int, kind: str) -> None:
        self.copy(target, source, width, kind)

    def table(self, target: str, table: str, width: int, kind: str) -> None:
        with self.block(f"for (int32_t i = 0; i < {width}; i++)"):
            self.assign(f"{target}[i]", f"lanes_{self.kinds[kind]}_all({table}[i])", kind)

    def put(self, target: str, index: str, text: str, kind: str, own: bool = False) -> None:
        """A line that stores an element of an array; its index may be each lane's own."""
        mask = "" if own else self.mask
        if index not in self.shared:
            self.line(f"lanes_put_{self.kinds[kind]}({target}, {index}, {text}, {mask or 'lanes_bool_all(true)'});")
        elif mask:
            self.assign(f"{target}[{index}]", text, kind)
        else:
            self.line(f"{target}[{index}] = {text};")

    def index(self, name: str, text: str) -> None:
        if text in self.shared:
            self.shared.add(name)
        self.line(f"const {'int32_t' if text in self.shared else 'lanes_int32'} {name} = {text};")


def conjunction(texts: Sequence[str]) -> str:
    """Whether all hold, as C."""
    return reduce("lanes_and_bool({}, {})".format, texts)


_VARIABLE = re.compile(r"[A-Za-z_][\w.\[\]]*(->[\w.\[\]]+)?\.v@")


_LESS = {name: called(f"lanes_v_{name}", 2) for name in ("min_real", "max_real")}
OPERATORS = {precision: lane_operators(precision) | _LESS for precision in ("float32", "float64")}
"""The rows of C's operators as functions of vectors, by precision; what a row does is said in `helpers`."""


class LaneRenderer(Renderer):
    """Writes the expressions of one block, each value in all lanes: `@` stands for the number of a vector."""

    vectors: int
    writer: LaneWriter

    def _local(self, name: str) -> Text:
        return f"{name}.v@", ATOM

    def _stored(self, text: str, kind: str) -> str:
        """All vectors of a value: an expression is written once for each, all of one before the next.

        So it needs the registers of one, and the processor still finds both to work on.
        """
        if _VARIABLE.fullmatch(text):
            return text[:-3]
        return f"({self.types[kind]}){{{', '.join(text.replace('@', str(k)) for k in range(self.vectors))}}}"

    def _args(self, item: Expr) -> tuple[Expr, ...]:
        args = list(super()._args(item))
        if args and item.op in ("select", "store") and self._counted(args[1]) is not None:
            args[1] = args[0]  # an index that all lanes share is no value
        return tuple(args)

    def _counted(self, index: Expr, depth: int = 0) -> Text | None:
        """The C of an index that is made of constants and loop counters alone."""
        if index.op == "const":
            return constant(index.data, "int32", self.precision)
        if index.op == "bound" and index.data[1] == 0:
            return self.bound[index.data]
        if index.op in PLAIN and index.kind == "int32" and depth < DEEPEST_INDEX:
            a, b = (self._counted(self._resolve(x), depth + 1) for x in index.args)
            if a is not None and b is not None:
                plain = index_range(index, self.limits) is not None
                return self._applied(SCALAR[PLAIN[index.op] if plain else f"{index.op}_int32"], (a, b))
        return None

    def _index(self, index: Expr, text: Text, width: int) -> str:
        counted = self._counted(index)
        if counted is not None:
            at = super()._index(index, counted, width)
            self.writer.shared.add(at)
            return at
        if index.op == "and" and any(a.op == "const" and 0 <= a.data < width for a in map(self._resolve, index.args)):
            return self._stored(text[0], "int32")
        return self._stored(f"lanes_within({text[0]}, {width - 1})", "int32")

    def _leaf(self, item: Expr) -> Text:
        text = super()._leaf(item)
        if item.op == "const" or (item.op == "bound" and item.data[1] == 0):  # a constant, or a loop's counter
            return f"lanes_v_{self.kinds[item.kind]}_all({text[0]})", ATOM
        return text if item.op == "bound" or item.width is not None else self._local(text[0])

    def _special(self, item: Expr, args: Sequence[Text], operand: str) -> Text | None:
        """The smaller or the larger of two."""
        if item.op != "where" or self.kinds[item.kind] != "real":
            return None
        test = self._resolve(item.args[0])
        if test.op != "lt":
            return None
        compared, chosen = ([id(self._resolve(a)) for a in some] for some in (test.args, item.args[1:]))
        which = "min_real" if compared == chosen else "max_real" if compared == chosen[::-1] else ""
        return self._operation(which, args[1:]) if which else None

    def _element(self, item: Expr, name: str, index: Text) -> Text:
        """An array's element; one at each lane's own index is fetched into a variable."""
        array = self._resolve(item.args[0])
        if array.width is None:
            raise ValueError("select on a scalar")
        at = self._index(self._resolve(item.args[1]), index, array.width)
        if at in self.writer.shared:
            return self._local(f"{name}[{at}]")
        fetched = self.names.numbered(f"{self.stem}_t")
        self.writer.line(f"const {self.types[item.kind]} {fetched} = lanes_get_{self.kinds[item.kind]}({name}, {at});")
        return self._name(item, self._local(fetched))


class VectorRenderer(LaneRenderer):
    """Writes an elementary function of a single vector."""

    def _local(self, name: str) -> Text:
        return name, ATOM

    def _stored(self, text: str, kind: str) -> str:
        return text


_WEIGHTED = (
    "lanes_v_add_real(x->{m}.v@, lanes_v_mul_real(sixth.v@, lanes_v_add_real(lanes_v_add_real(lanes_v_add_real("
    "k1.{m}.v@, lanes_v_mul_real({two}.v@, k2.{m}.v@)), lanes_v_mul_real({two}.v@, k3.{m}.v@)), k4.{m}.v@)))"
)


class LaneStyle(CStyle):
    """C for as many instances as a `LaneShape` says; a condition says where it holds."""

    function = "td_inline"
    tables = False
    branches = False
    shares = False
    foresees = False
    gathers = False

    def __init__(self, shape: LaneShape) -> None:
        self.shape = shape
        self.vectors = shape.vectors
        along = self._whole("lanes_v_add_real({0}.v@, lanes_v_mul_real(h.v@, {1}.v@))")
        self.along = along.replace("{{", "{{{{").replace("}}", "}}}}")  # it is formatted twice
        self.weighted = self._whole(_WEIGHTED)
        self._inner = VECTOR[shape.precision]
        kinds = lane_kinds(shape.precision)
        self.kinds = kinds
        self.types = {kind: TYPES[lane] for kind, lane in kinds.items()}
        own = {"kinds": kinds, "types": self.types, "operators": OPERATORS[shape.precision]}
        self.renderer = type("Renderer", (LaneRenderer,), {**own, "vectors": shape.vectors})
        self.writer = type("Writer", (LaneWriter,), {"kinds": kinds})
        self.copies = shape.lanes
        self._always, self._more = prelude(shape), more(shape)
        every = "".join([self._always, *(m.text for m in self._more)])
        self.reserved = frozenset(re.findall(r"\blanes_\w+", every)) | {f"on_{i}" for i in range(MASKS)}

    def _whole(self, text: str) -> str:
        """A real whose vectors `text` gives, `@` being the number of each; braces doubled, for it will be formatted."""
        vectors = ", ".join(text.replace("@", str(k)) for k in range(self.vectors))
        return f"(lanes_real){{{{{vectors}}}}}"

    @property
    def inner(self) -> CStyle:
        """The style of the elementary functions: of single vectors."""
        return self._inner

    def prelude(self, programs: str) -> tuple[str, frozenset[str]]:
        used = [m for m in self._more if m.mark in programs]
        return "".join([self._always, *(m.text for m in used)]), SCALARS.union(*(m.helpers for m in used))

    def same(self, text: str, kind: str) -> str:
        return f"lanes_{self.kinds[kind]}_all({text})"

    def literal(self, text: str, binding: int, kind: str) -> Text:
        return self.same(text, kind), ATOM

    def conjunction(self, texts: Sequence[str]) -> str:
        return conjunction(texts)

    def disjunction(self, texts: Sequence[str]) -> str:
        return reduce("lanes_or_bool({}, {})".format, texts)

    def negation(self, text: str) -> str:
        return f"lanes_not_bool({text})"

    def truth(self, due: str, tests: Sequence[str]) -> str:
        return conjunction([*([f"lanes_bool_all({due})"] if due else []), *tests])

    def product(self, a: str, b: str) -> str:
        return f"lanes_mul_real({a}, {b})"

    def compared(self, sign: str, a: str, b: str, kind: str = "real") -> str:
        name = {"!=": "ne", ">": "gt", "<": "lt", ">=": "ge"}[sign]
        return f"lanes_{name}_{self.kinds[kind]}({a}, {b})"

    def chosen(self, test: str, a: str, b: str, kind: str) -> str:
        return f"lanes_pick_{self.kinds[kind]}({test}, {a}, {b})"

    def anywhere(self, test: str) -> str:
        return f"lanes_any({test})"

    def piece(self, start: str, end: str, dt: str) -> str:
        return f"lanes_mul_real(lanes_sub_real({end}, {start}), {dt})"

    @contextmanager
    def moving(
        self, writer: CWriter, names: CNames, prefix: str, members: Sequence[Member], start: str, x: str
    ) -> Iterator[str]:
        """A copy of the states; those of lanes whose step is not over yet are taken from it."""
        moved = names.new("moved")
        writer.line(f"{prefix}_X {moved} = {x};")
        yield moved
        with writer.choice("", [self.compared("<", start, self.same("1", "real"))]):
            for m in members:
                if m.width is None:
                    writer.assign(f"{x}.{m.name}", f"{moved}.{m.name}", m.kind)
                else:
                    writer.copy(f"{x}.{m.name}", f"{moved}.{m.name}", m.width, m.kind)


class VectorStyle(CStyle):
    """C of single vectors, for the elementary functions."""

    function = "td_inline"

    def __init__(self, precision: str) -> None:
        kinds = lane_kinds(precision)
        self.types = {kind: VECTORS[lane] for kind, lane in kinds.items()}
        own = {"kinds": kinds, "types": self.types, "operators": OPERATORS[precision]}
        self.renderer = type("Renderer", (VectorRenderer,), own)
        self.writer = type("Writer", (LaneWriter,), {"kinds": kinds})


VECTOR = {precision: VectorStyle(precision) for precision in OPERATORS}
