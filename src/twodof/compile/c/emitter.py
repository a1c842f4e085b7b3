"""Readable C99 from a program: `prepare`, `init`, `step` and `run` on the structs P, S, U and Y.

No globals but constant tables, no malloc, no libm. `real` is double or float. What a step is stands in
docs/explanation/language.md.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from functools import cache

from twodof.blocks.declarations import Port
from twodof.blocks.elementary.functions import ARGUMENTS, DEFINITIONS
from twodof.blocks.expressions.expr import leaf, tracing
from twodof.blocks.expressions.graph import of_kinds
from twodof.blocks.expressions.kinds import BY_NAME, FLOATS, dtype_of
from twodof.compile.c.ahead import AheadEmitter, foreseen
from twodof.compile.c.helpers import HELPERS
from twodof.compile.c.names import STRAIGHT, CNames
from twodof.compile.c.operators import ATOM
from twodof.compile.c.shared import APART, SharedFunctions, SharingTick
from twodof.compile.c.states.integration import IntegrationEmitter
from twodof.compile.c.style import SCALAR, CStyle
from twodof.compile.c.text.pieces import in_pieces
from twodof.compile.c.text.unused import with_idle_parameters, without_unused
from twodof.compile.c.tick import INTEGRATION, NEXT_TICK, RETURNED, Scope, TickEmitter, describe
from twodof.compile.c.writer import CWriter
from twodof.compile.c_files.interface import CInterface, comment, indented
from twodof.compile.program.block_kinds import block_kinds
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
/* In place, so that the states of an integration stay in registers; but not where size counts. */
#if defined(__GNUC__) && defined(__OPTIMIZE__) && !defined(__OPTIMIZE_SIZE__)
#define td_inline static inline __attribute__((always_inline))
#else
#define td_inline static inline
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
    programs: Sequence[FlatProgram],
    precision: str = "float64",
    lean: bool = False,
    style: CStyle = SCALAR,
    header: str = "",
) -> list[EmittedProgram]:
    """`programs`, whose names must differ, each with the one C file that has the functions of all.

    `lean` is for a flight controller's firmware: without `run` and the tables, and without == on reals, of which its
    compiler warns (-Wfloat-equal). `style` says whether a value is one instance's or several lanes'. A `header` is the
    name of a file that has the `CInterface` of each program; by default the C file itself has it.
    """
    helpers: set[str] = set()
    functions: set[str] = set()
    layouts = [MemoryLayout(program, block_kinds(program) if style.shares else ()) for program in programs]
    bodies = []
    named = CNames({program.name for program in programs})
    for program, layout in zip(programs, layouts, strict=True):
        for k in layout.block_kinds:
            k.prefix = named.new(k.prefix)
        emitter = _Emitter(program, layout, precision, lean, style, not header)
        bodies.append(emitter.text())
        helpers |= emitter.helpers
        functions |= emitter.functions
    elementary, more = _elementary(functions, precision, lean, style)
    prelude, needs = style.prelude("".join([*elementary, *bodies]))
    helpers |= more | needs
    parts = [
        f'#include "{header}"\n\n' if header else "",
        "#include <stdbool.h>\n#include <stddef.h>\n#include <stdint.h>\n#include <string.h>\n\n",
        GUARDS,
        APART if any("td_apart" in body or "td_shared" in body for body in bodies) else "",
        f"\ntypedef {'float' if precision == 'float32' else 'double'} real;\n\n",
        *(f"{text}\n" for name, text in HELPERS[precision].items() if name in helpers),
        prelude,
        INSTRUCTIONS_THERE if any("td_instructions" in text for text in elementary) else "",
        *elementary,
        *bodies,
    ]
    text = "".join(parts)
    return [EmittedProgram(p, text, layout, precision) for p, layout in zip(programs, layouts, strict=True)]


def _elementary(names: Iterable[str], precision: str, lean: bool, style: CStyle) -> tuple[list[str], set[str]]:
    """The definitions of the elementary functions `names` and of those they call, callees first; and their helpers."""
    needed: dict[str, None] = {}
    stack = [(n, False) for n in sorted(names)]
    while stack:
        name, done = stack.pop()
        if done:
            needed[name] = None
        elif name not in needed:
            stack.append((name, True))
            stack += [(n, False) for n in sorted(_function(name, precision, lean, style)[1])]
    helpers = frozenset[str]().union(*(_function(n, precision, lean, style)[2] for n in needed))
    return [_function(n, precision, lean, style)[0] for n in needed], set(helpers)


@cache
def _function(name: str, precision: str, lean: bool, style: CStyle) -> tuple[str, frozenset[str], frozenset[str]]:
    """An elementary function in C, the functions it calls, and its helpers; "sin_float32" is the sine of that kind."""
    called, straight = name, name.startswith(STRAIGHT)
    name = name.removeprefix(STRAIGHT)
    own, _, last = name.rpartition("_")
    base, kind = (own, last) if last in FLOATS else (name, "real")
    precision = dtype_of(kind, precision).name
    arguments = ["x"] if ARGUMENTS[base] == 1 else ["y", "x"]
    with tracing(name):
        recorded = DEFINITIONS[base][precision](*(leaf("input", a, "real") for a in arguments))
        (result,) = of_kinds([recorded], {"real": kind})
    style = style.straight if straight else style.inner
    writer, real = style.writer(lean=lean), style.types[kind]
    renderer = style.renderer(writer, CNames({*arguments, "td"}), precision, lambda e: (e.data, ATOM), "td")
    writer.line(f"return {renderer.text(result)};")
    head = f"{style.function} {real} td_{called}({', '.join(f'{real} {a}' for a in arguments)})\n{{\n"
    body = "\n".join(writer.lines) + "\n"
    if base in INSTRUCTIONS and (style is SCALAR or straight) and not lean:
        builtin = f"__builtin_{base}{'f' if precision == 'float32' else ''}({', '.join(arguments)})"
        body = f"#if defined(td_instructions)\n    return {builtin};\n#else\n{body}#endif\n"
    text = f"{head}{body}}}\n\n"
    return text, frozenset(writer.functions), frozenset(writer.helpers)


class _Emitter:
    """One program's C."""

    def __init__(
        self, program: FlatProgram, layout: MemoryLayout, precision: str, lean: bool, style: CStyle, whole: bool
    ) -> None:
        self.program = program
        self.layout = layout
        self.precision = precision
        self.lean = lean
        self.prefix = program.name
        self.whole = whole
        self.scope = Scope(program, layout, precision, style)
        self.helpers: set[str] = set()
        self.functions: set[str] = set()
        self.shared = SharedFunctions(self.scope, lean, self._written)
        self.copied = {n.parameters[name] for k in layout.block_kinds for n in k.kind.nodes for name in k.kind.own}
        self.continuous = sum(m.width or 1 for m in layout.x.members)
        known = [] if lean else foreseen(self.scope)
        self.ahead = AheadEmitter(self.scope, known, program.name) if known else None

    def text(self) -> str:
        """Structs, functions and tables."""
        p = self.prefix
        stage = IntegrationEmitter(self.scope, p) if self.program.integrated else None
        functions = [self._written(write) for write in (self._defaults, self._prepare, self._init)]
        if stage:
            functions += [self._written(stage.derivative), self._written(stage.integrate)]
        if self.ahead:
            functions += [self.ahead.struct(), self._written(self.ahead.look)]
        functions.append(self._written(lambda writer: self._step(writer, stage)))
        if not self.lean:
            functions.append(self._step_and_run())
        remark = f" {comment(self.program.text)}" if self.program.text else ""
        parts = [f"/* {p}: one step is {self.program.dt:.9g} s.{remark} */\n"]
        if self.whole:
            parts.append(self._interface().text())
        if stage:
            parts.append(
                f"typedef struct {{ /* what does not change inside a step */\n"
                f"{indented(stage.declarations())}}} {p}_Held;\n\n"
            )
        return "".join(parts + self.shared.texts + functions) + ("" if self.lean else self._tables() + self._sizes())

    def _written(self, write: Callable[[CWriter], None]) -> str:
        writer = self.scope.style.writer(lean=self.lean)
        write(writer)
        text, gone = without_unused("\n".join(writer.lines) + "\n")
        handed = 0
        if not self.program.edged:  # whose times stand in variables of a kind that cannot be handed on
            text, handed = in_pieces(text)
        if (writer.elements + handed + 6 * self.continuous) * self.scope.style.copies > MOST_ON_STACK:
            raise DiagramError(
                f"its arrays have more than {MOST_ON_STACK} elements at once, too many for a stack",
                self.prefix,
                "make them shorter, or states, which do not stand on the stack",
            )
        self.helpers |= writer.helpers - gone
        self.functions |= {name for name in writer.functions if f"td_{name}" not in gone}
        return with_idle_parameters(text)

    def _interface(self) -> CInterface:
        style = self.scope.style
        return CInterface(self.program, self.layout, not self.lean, style.tables and not self.lean, style.types)

    def _defaults(self, writer: CWriter) -> None:
        with writer.function(f"void {self.prefix}_defaults({self.prefix}_P *p)"):
            for parameter, member in self.layout.parameters.items():
                if parameter not in self.copied:
                    d = parameter.declared
                    self.scope.fill(writer, f"p->{member.name}", _listed(d.value), d)
            self.shared.defaults(writer)

    def _prepare(self, writer: CWriter) -> None:
        names = self.scope.names("p")
        with writer.function(f"void {self.prefix}_prepare({self.prefix}_P *p)"):
            for node in self.program.nodes:
                if not node.block.derived or node in self.layout.of:
                    continue
                writer.line(describe(node))
                self.scope.prepare(writer, names, node)
            self.shared.prepare(writer)

    def _init(self, writer: CWriter) -> None:
        with writer.function(f"void {self.prefix}_init(const {self.prefix}_P *p, {self.prefix}_S *s)"):
            writer.line("(void)memset(s, 0, sizeof *s);")
            for node in self.program.nodes:
                if node in self.layout.of:
                    continue
                if node.block.states:
                    writer.line(describe(node))
                for state in node.block.states:
                    self.scope.initial(writer, node, state, self.scope.state(node, state))
            self.shared.init(writer)
            for signal, member in self.layout.stored.items():
                if signal.initial is not None:
                    writer.line(f"/* {signal.path} */")
                    declared = Port("held", signal.kind, signal.width)
                    self.scope.fill(writer, f"s->{member.name}", signal.initial, declared)

    def _step(self, writer: CWriter, stage: IntegrationEmitter | None) -> None:
        names = self.scope.names("p", "s", "u", "y", "ahead")
        copies = bool(self.layout.block_kinds)
        tick = SharingTick(self.scope, writer, names, self.shared) if copies else TickEmitter(self.scope, writer, names)
        head = f"void {self.prefix}_step" if self.lean else f"td_inline void {self.prefix}_advance"
        arguments = self._arguments()
        if self.ahead:
            arguments += f", {self.ahead.argument}"
            for f in self.ahead.found:
                tick.stored.setdefault(f.node, {})[f.value] = f.text
        with writer.function(f"{head}({arguments})"):
            tick.due()
            tick.outputs()
            if self.program.outputs:
                writer.line(RETURNED)
                tick.returned()
            if stage:
                writer.line(INTEGRATION)
                stage.within_step(tick)
            tick.updates()
            if stage:
                stage.commit(tick)
            else:
                writer.line(NEXT_TICK)
            writer.line("s->tick += 1u;")
            tick.write_due()

    def _arguments(self) -> str:
        p = self.prefix
        return f"const {p}_P *restrict p, {p}_S *restrict s, const {p}_U *restrict u, {p}_Y *restrict y"

    def _step_and_run(self) -> str:
        """What calls `advance`, which is one step. Its machine code stands in one of the two, in place."""
        p, one = self.prefix, self._arguments()
        strided = one.replace(" u,", " u, size_t u_stride,") + ", size_t y_stride, size_t n"
        if self.ahead:
            return self.ahead.step_and_run(one, strided)
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
        if not self.scope.style.tables:
            return ""
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

        states = [("S", m, m.name) for m in layout.members("S") if m.path and m.remark != "work"]
        states += [("S", m, f"x.{m.name}") for m in layout.x.members]
        signals = [("U", m, m.name) for m in layout.u.members] + [("Y", m, m.name) for m in layout.y.members] + states
        parameters = [("P", m, m.name) for m in layout.members("P")]
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
