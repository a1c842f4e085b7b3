"""Readable C99 from a program: `prepare`, `init`, `step` and `run` on the structs P, S, U and Y.

No globals but constant tables, no malloc, no libm. `real` is double or float. docs/explanation/language.md defines a
step.
"""

import math
from collections.abc import Iterable, Sequence
from functools import cache
from typing import NamedTuple

from twodof.blocks.declarations import Port
from twodof.blocks.elementary.functions import ARGUMENTS, DEFINITIONS
from twodof.blocks.expressions.expr import leaf, tracing
from twodof.blocks.expressions.graph import of_kinds
from twodof.blocks.expressions.numbers import BY_NAME, FLOATS, dtype_of
from twodof.compile.c.expressions import Renderer, Used
from twodof.compile.c.functions import Function, Listing, Mark
from twodof.compile.c.graph import ProgramGraph, in_doubles
from twodof.compile.c.integration import Integration
from twodof.compile.c.operators import C_TYPES, HELPERS
from twodof.compile.c.scope import Scope
from twodof.compile.c.statements import Assign, Call, CNames, Statement, Text, every
from twodof.compile.c.step import StepEmitter
from twodof.compile.c_files.interface import CInterface, comment, indented
from twodof.compile.program.flat_program import FlatProgram
from twodof.compile.program.layout import Member, MemoryLayout
from twodof.compile.target import EmittedProgram
from twodof.errors import DiagramError

GUARDS = """#if defined(__FAST_MATH__)
#error "compile without -ffast-math: it changes results"
#endif
#if defined(__FLT_EVAL_METHOD__) && __FLT_EVAL_METHOD__ != 0
#error "this compiler rounds to another precision than the type's (x87?)"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off", "no-tree-pre") /* no-tree-pre: fewer registers spilled */
#endif
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wfloat-equal" /* == is meant: it asks for the same number */
#endif
/* In place, and stage by stage, so that states stay in registers; but not where size counts. */
#if defined(__GNUC__) && defined(__OPTIMIZE__) && !defined(__OPTIMIZE_SIZE__)
#define td_inline static inline __attribute__((always_inline))
#define td_unrolled _Pragma("GCC unroll 4")
#else
#define td_inline static inline
#define td_unrolled
#endif
"""
INSTRUCTIONS = ("floor",)
"""Elementary functions that some processors have as one instruction, which gives the same bits."""
INSTRUCTIONS_THERE = """#if defined(__OPTIMIZE__) && (defined(__SSE4_1__) || defined(__aarch64__))
#define td_instructions
#endif
"""


UNBOUNDED = (-math.inf, math.inf)
MOST_ON_STACK = 40_000  # elements: 320 kB of the 512 kB that the smallest usual thread has


def emit(
    programs: Sequence[FlatProgram], precision: str = "float64", lean: bool = False, header: str = ""
) -> list[EmittedProgram]:
    """Return each of `programs`, whose names must differ, with its C; all functions are in one C file that they share.

    `lean` is for a flight controller's firmware: it leaves out `run` and the tables. `header` is the name of a file
    with the `CInterface` of each program; by default the C file itself contains it.
    """
    emitters = [_Emitter(p, MemoryLayout(p), precision, lean, not header) for p in programs]
    elementary = _elementary(set[str]().union(*(e.scope.used.functions for e in emitters)), precision)
    helpers = set[str]().union(*(e.scope.used.helpers for e in emitters), *(f.helpers for f in elementary))
    listing = Listing()
    parts = [
        f'#include "{header}"\n\n' if header else "",
        "#include <stdbool.h>\n#include <stddef.h>\n#include <stdint.h>\n#include <string.h>\n\n",
        GUARDS,
        f"\ntypedef {'float' if precision == 'float32' else 'double'} real;\n\n",
        *(f"{text}\n" for name, text in HELPERS[precision].items() if name in helpers),
        INSTRUCTIONS_THERE if any("td_instructions" in f.text for f in elementary) else "",
        *(f.text for f in elementary),
    ]
    listing.add("".join(parts))
    for emitter in emitters:
        listing.lines += emitter.listing.lines
        listing.marks += emitter.listing.marks
        listing.cost += emitter.listing.cost
    text = listing.text()
    return [EmittedProgram(e.program, text, e.layout, precision, listing.marks, listing.cost) for e in emitters]


class ElementaryFunction(NamedTuple):
    """C of an elementary function, and the names of the elementary functions and of the helpers that it calls."""

    text: str
    functions: frozenset[str]
    helpers: frozenset[str]


def _elementary(names: Iterable[str], precision: str) -> list[ElementaryFunction]:
    """Return the elementary functions `names` and those that they call, callees first."""
    found: dict[str, ElementaryFunction] = {}

    def add(name: str) -> None:
        if name not in found:
            made = _function(name, precision)
            for called in sorted(made.functions):
                add(called)
            found[name] = made

    for name in sorted(names):
        add(name)
    return list(found.values())


@cache
def _function(name: str, precision: str) -> ElementaryFunction:
    """Return an elementary function; "sin_float32" is the sine of that kind."""
    own, _, last = name.rpartition("_")
    base, kind = (own, last) if last in FLOATS else (name, "real")
    precision = dtype_of(kind, precision).name
    arguments = ["x"] if ARGUMENTS[base] == 1 else ["y", "x"]
    with tracing(name):
        recorded = DEFINITIONS[base][precision](*(leaf("input", a, "real") for a in arguments))
        (result,) = of_kinds([recorded], {"real": kind})
    used, real = Used(), C_TYPES[kind]
    renderer = Renderer(CNames({*arguments, "td"}), precision, used, lambda e: Text.of(e.data))
    value = renderer.text(result)
    body = [*renderer.out, Call(f"return {value.text};", reads=value.reads)]
    if base in INSTRUCTIONS:
        builtin = f"__builtin_{base}{'f' if precision == 'float32' else ''}({', '.join(arguments)})"
        there = [Call(line) for line in ("#if defined(td_instructions)", f"return {builtin};", "#else")]
        body = [*there, *body, Call("#endif")]
    listing = Listing()
    listing.function(Function(f"static {real}", f"td_{name}", tuple(f"{real} {a}" for a in arguments), body, ""))
    return ElementaryFunction(listing.text(), frozenset(used.functions), frozenset(used.helpers))


class _Emitter:
    """One program's C."""

    def __init__(self, program: FlatProgram, layout: MemoryLayout, precision: str, lean: bool, whole: bool) -> None:
        self.program = program
        self.layout = layout
        self.precision = precision
        self.lean = lean
        self.prefix = p = program.name
        self.scope = Scope(program, layout, precision)
        self.listing = Listing()
        remark = f" {comment(program.text)}" if program.text else ""
        self.listing.add(f"/* {p}: one step is {program.dt:.9g} s.{remark} */")
        if whole:
            CInterface(program, layout, not lean).list(self.listing)
        self._list(self._defaults(), "default parameters")
        self._list(self._prepare(), "derived parameters")
        self._list(self._init(), "initial states")
        self._list(self._step(), "one step")
        if not lean:
            self.listing.add(self._step_and_run(), Mark("run", "", "many steps"))
            self.listing.add(self._tables() + self._sizes())

    def _list(self, function: Function, role: str) -> None:
        elements = sum(s.size or 0 for s in every(function.body) if isinstance(s, Assign))
        elements += 4 * sum(m.width or 1 for m in self.layout.x.members)  # x, at, sum and slope of the integration
        if elements > MOST_ON_STACK:
            what = f"its arrays have more than {MOST_ON_STACK} elements at once, too many for a stack"
            remedy = "make them shorter, or keep them in states, which are not on the stack"
            raise DiagramError(what, self.prefix, remedy)
        self.listing.function(function, role)

    def _defaults(self) -> Function:
        body: list[Statement] = []
        owners = {q: n for n in self.program.nodes for q in n.parameters.values() if q.path.startswith(f"{n.path}.")}
        for parameter, member in self.layout.parameters.items():
            d = parameter.declared
            body += self.scope.fill(f"p->{member.name}", _listed(d.value), d, owners.get(parameter))
        return Function("void", f"{self.prefix}_defaults", (f"{self.prefix}_P *p",), body, "defaults")

    def _prepare(self) -> Function:
        names = self.scope.names("p")
        graph = ProgramGraph(self.program)
        renderer = self.scope.renderer(names, self.scope.leaf(self.scope.state), graph.owner)
        for node in self.program.nodes:
            exprs = in_doubles(node.trace.prepare) if self.precision == "float32" else node.trace.prepare
            renderer.owner = node
            renderer.assign([(self.scope.given(node, n), graph.of(node, e)) for n, e in exprs.items()])
        return Function("void", f"{self.prefix}_prepare", (f"{self.prefix}_P *p",), renderer.out, "prepare")

    def _init(self) -> Function:
        body: list[Statement] = [Call("(void)memset(s, 0, sizeof *s);", reads=frozenset("s"))]
        for node in self.program.nodes:
            body += self.scope.initial(node, zeroed=True)
        for signal, member in self.layout.stored.items():
            if signal.initial is not None:
                declared = Port("held", signal.kind, signal.width)
                body += self.scope.fill(f"s->{member.name}", signal.initial, declared, signal.node, zeroed=True)
        p = self.prefix
        return Function("void", f"{p}_init", (f"const {p}_P *p", f"{p}_S *s"), body, "init")

    def _step(self) -> Function:
        step = StepEmitter(self.scope, self.scope.names("p", "s", "u", "y"))
        integration = Integration(step) if self.program.integrated else None
        step.outputs()
        step.returned()
        if integration:
            integration.write()
        step.updates()
        if integration:
            integration.commit()
        out = step.renderer.out
        out.append(Call("s->tick += 1u;", role="next tick", reads=frozenset("s")))
        name = f"{self.prefix}_step" if self.lean else f"{self.prefix}_advance"
        result = "void" if self.lean else "td_inline void"
        return Function(result, name, self._parameters(), [*step.due(), *out], "step")

    def _parameters(self) -> tuple[str, ...]:
        p = self.prefix
        return f"const {p}_P *restrict p", f"{p}_S *restrict s", f"const {p}_U *restrict u", f"{p}_Y *restrict y"

    def _step_and_run(self) -> str:
        """Return what calls `advance`, which is one step. Its machine code stands in one of the two, in place."""
        p, one = self.prefix, ", ".join(self._parameters())
        strided = one.replace(" u,", " u, size_t u_stride,") + ", size_t y_stride, size_t n"
        run = f"""void {p}_run({strided})
{{
    for (size_t k = 0; k < n; k++) {{
        {p}_advance(p, s, u + k * u_stride, y + k * y_stride);
    }}
}}
"""
        return f"""#if __STDC_HOSTED__ && defined(__OPTIMIZE__)
/* A computer runs many steps at a time: what parameters alone decide is computed once, before the loop. */
{run}
void {p}_step({one})
{{
    {p}_run(p, s, u, 0, y, 0, 1);
}}
#else
void {p}_step({one})
{{
    {p}_advance(p, s, u, y);
}}

{run.replace("_advance(", "_step(")}#endif

"""

    def _tables(self) -> str:
        p, layout = self.prefix, self.layout
        bounds = {m.name: (q.declared.low, q.declared.high) for q, m in layout.parameters.items()}

        def bound(value: float) -> str:
            return float(value).hex() if math.isfinite(value) else f"{'-' if value < 0 else ''}__builtin_inf()"

        def entry(struct: str, m: Member, place: str) -> str:
            low, high = bounds.get(m.name, UNBOUNDED) if struct == "P" else UNBOUNDED
            return (
                f"{{\"{m.path}\", \"{_quoted(m.unit)}\", '{struct}', '{BY_NAME[m.kind].letter}', {m.width or 1}u, "
                f"(uint32_t)offsetof({p}_{struct}, {place}), {bound(low)}, {bound(high)}}},"
            )

        states = [("S", m, m.name) for m in layout.s.members if m.path and m.remark != "work"]
        states += [("S", m, f"x.{m.name}") for m in layout.x.members]
        signals = [("U", m, m.name) for m in layout.u.members] + [("Y", m, m.name) for m in layout.y.members] + states
        parameters = [("P", m, m.name) for m in layout.p.members]
        none = "{0, 0, 0, 0, 0u, 0u, 0.0, 0.0},"
        text = ""
        for name, rows in (("parameters", parameters), ("signals", signals)):
            lines = [entry(*row) for row in rows]
            text += f"const {p}_Entry {p}_{name}[] = {{\n{indented([*lines, none])}}};\n\n"
        return text

    def _sizes(self) -> str:
        p = self.prefix
        sizes = f"sizeof(real), sizeof({p}_P), sizeof({p}_S), sizeof({p}_U), sizeof({p}_Y)"
        return f"const size_t {p}_sizes[5] = {{{sizes}}};\n\n"


def _listed(value: object) -> object:
    return value.tolist() if hasattr(value, "tolist") else value


_HARMLESS = {c: c for c in map(chr, range(32, 127)) if c not in '"\\?'}


def _quoted(text: str) -> str:
    """User's text made harmless within a C string."""
    return "".join(_HARMLESS.get(c) or "".join(f"\\{b:03o}" for b in c.encode("utf-8", "replace")) for c in text)
