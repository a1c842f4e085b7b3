"""Declarations of a program's C for its callers: the structs P, S, U and Y, prototypes and tables."""

from collections.abc import Iterable, Mapping, Sequence

from twodof.compile.c.functions import Listing, Mark
from twodof.compile.c.operators import C_TYPES
from twodof.compile.c.statements import CNames
from twodof.compile.program.flat_program import FlatProgram
from twodof.compile.program.layout import Member, MemoryLayout

WIDEST = 120


class CInterface:
    """Declarations of one program's C.

    `types` are the C types by type of the language. With `tables` the tables of parameters and signals, the sizes and
    the function `run` are declared too.
    """

    def __init__(
        self, program: FlatProgram, layout: MemoryLayout, tables: bool, types: Mapping[str, str] = C_TYPES
    ) -> None:
        self.program = program
        self.layout = layout
        self.tables = tables
        self.types = types

    def text(self) -> str:
        """Return constants of enumerations, structs, prototypes, and the declarations of the tables."""
        listing = Listing()
        self.list(listing)
        return listing.text()

    def list(self, listing: Listing) -> None:
        """Add the text to a listing, in which each member of a struct belongs to its block."""
        layout, moving = self.layout, bool(self.program.integrated)
        listing.add(self._enumerations())
        self._struct(listing, "P", "parameters; `prepare` computes the derived ones", layout.p.members)
        if moving:
            self._struct(listing, "X", "continuous states", layout.x.members)
        self._struct(listing, "S", "discrete and continuous states, held signals", layout.s.members, moving)
        self._struct(listing, "U", "inputs", layout.u.members)
        self._struct(listing, "Y", "outputs and logged signals", layout.y.members)
        listing.add(self._prototypes())
        if self.tables:
            listing.add(self._tables())

    def _enumerations(self) -> str:
        """Return the members of enumerations as constants, for programs around this one."""
        names = CNames()
        lines = []
        for e in self.program.enumerations:
            # The least int32 has no literal of its own in C.
            values = {m: f"{v}" if v > -(2**31) else f"({v + 1} - 1)" for m, v in e.members.items()}
            prefix = f"{self.program.name}_{e.name}"
            members = ", ".join(f"{names.new(f'{prefix}_{m}')} = {v}" for m, v in values.items())
            lines.append(f"enum {{ {members} }};\n")
        return "".join([*lines, "\n"] if lines else [])

    def _struct(
        self, listing: Listing, name: str, remark: str, members: Sequence[Member], nested: bool = False
    ) -> None:
        declaration = Mark(name, "", "declaration")
        listing.add(f"typedef struct {{ /* {remark} */", declaration)
        for m in members:
            mark = Mark(name, m.block) if m.block else declaration
            listing.add(indented([m.declaration(self.types) + _remark(m)]), mark)
        more = [f"{self.program.name}_X x;"] if nested else []
        if not members and not more:
            more = ["unsigned char none;"]
        listing.add(f"{indented(more)}}} {self.program.name}_{name};\n\n", declaration)

    def _prototypes(self) -> str:
        p = self.program.name
        own = f"const {p}_P *p, {p}_S *s"
        rows = [
            ("Defaults of the given parameters.", "defaults", f"{p}_P *p"),
            (
                "Derived parameters from the given ones: after `defaults`, and after each change.",
                "prepare",
                f"{p}_P *p",
            ),
            ("Initial states of these parameters, and tick 0.", "init", own),
            (
                f"One step of {self.program.dt:.9g} s: reads u, writes y, moves s. The four must not overlap.",
                "step",
                f"{own}, const {p}_U *u, {p}_Y *y",
            ),
        ]
        if self.tables:
            remark = "n steps; a stride of 0 reads the same inputs, or writes the same outputs, at each."
            rows.append((remark, "run", f"{own}, const {p}_U *u, size_t u_stride, {p}_Y *y, size_t y_stride, size_t n"))
        lines = (f"/* {remark} */\n{_prototype(f'void {p}_{name}', taken)}" for remark, name, taken in rows)
        return "".join(lines) + "\n"

    def _tables(self) -> str:
        p = self.program.name
        return f"""/* For live tuning and logging: path, unit, struct (P, S, U, Y), type (r real, f float32, d float64,
   i int32, u uint32, c int8, C uint8, h int16, H uint16, b bool), number of elements, offset, bounds.
   The last entry has no path. */
typedef struct {{
    const char *path;
    const char *unit;
    char where;
    char type;
    uint32_t count;
    uint32_t offset;
    double low;
    double high;
}} {p}_Entry;

extern const {p}_Entry {p}_parameters[];
extern const {p}_Entry {p}_signals[];

/* Sizes of real, P, S, U, Y: whoever loads this must agree. */
extern const size_t {p}_sizes[5];

"""


def _remark(m: Member) -> str:
    words = [m.path] if m.path and m.path != m.name else []
    words += [f"[{m.unit}]"] if m.unit else []
    words += [m.remark] if m.remark else []
    return f" /* {comment(' '.join(words))} */" if words else ""


def _prototype(head: str, taken: str) -> str:
    line = f"{head}({taken});\n"
    if len(line) <= WIDEST:
        return line
    *before, last = (f"    {argument},\n" for argument in taken.split(", "))
    return f"{head}(\n{''.join(before)}{last[:-2]}\n);\n"


def indented(lines: Iterable[str]) -> str:
    """Return lines, indented by one level."""
    return "".join(f"    {line}\n" for line in lines)


def comment(text: str) -> str:
    """Return a user's text, made harmless within a C comment."""
    plain = " ".join("".join(c if " " <= c <= "~" else " " for c in text).split())
    return plain.replace("*/", "* /").replace("/*", "/ *").replace("??", "?")[:300]
