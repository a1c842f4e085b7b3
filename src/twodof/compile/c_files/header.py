"""The header of a program: what a caller in C or C++ includes, with an example of the loop."""

from collections.abc import Iterator, Sequence
from typing import Any

from twodof.blocks.declarations import Param
from twodof.compile.c.operators import C_TYPES
from twodof.compile.c_files.interface import CInterface, comment
from twodof.compile.program.flat_program import FlatProgram
from twodof.compile.program.layout import Member, MemoryLayout

SHOWN = 6  # inputs and outputs in the example


def header(program: FlatProgram, layout: MemoryLayout, precision: str, tables: bool) -> str:
    """The text of `program.name`.h: `layout`'s structs with units and paths, and the functions' prototypes.

    `real` is written as the C type of `precision`, so that programs of both can be included together. With `tables`
    it declares `run`, the tables of parameters and signals, and the sizes as well.
    """
    name, single = program.name, precision == "float32"
    interface = CInterface(
        program,
        layout,
        run=tables,
        tables=tables,
        types={**C_TYPES, "real": "float" if single else "double"},
        notes=dict(_notes(program, layout)),
    )
    return f"""/* {name}{f": {comment(program.text)}" if program.text else ""}

   One step is {program.dt:.9g} s; numbers are {precision}. twodof made this file and {name}.c of a diagram.
   Change the diagram and export again. The loop of a program that uses them:

{"".join(f"       {line}".rstrip() + chr(10) for line in _example(program, layout))}
   Each instance has structs of its own; nothing else changes. Compile {name}.c as C99 or later, with
   -ffp-contract=off -fno-math-errno and without -ffast-math, to have the bits of all other targets.
   Sizes [bytes]{_sizes(layout, precision)}. */
#ifndef {name}_INCLUDED
#define {name}_INCLUDED

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {{
#endif

{interface.text()}#ifdef __cplusplus
}}
#endif

#endif
"""


def _sizes(layout: MemoryLayout, precision: str) -> str:
    sizes = ", ".join(f"{name} {dtype.itemsize}" for name, dtype in layout.dtypes(precision).items())
    return f" where a double is aligned to 8: {sizes}" if precision == "float64" else f": {sizes}"


def _example(program: FlatProgram, layout: MemoryLayout) -> Iterator[str]:
    p = program.name
    for struct in "PSUY":
        yield f"static {p}_{struct} {struct.lower()};"
    yield ""
    for call in ("defaults(&p)", "prepare(&p)", "init(&p, &s)"):
        yield f"{p}_{call};"
    yield "for (;;) {"
    yield from _carried(layout.u.members, "u.{0} = read_{0}();", "read_{0}(u.{0});")
    yield f"    {p}_step(&p, &s, &u, &y);"
    yield from _carried(layout.y.members, "write_{0}(y.{0});", "write_{0}(y.{0});")
    yield "}"


def _carried(members: Sequence[Member], scalar: str, array: str) -> Iterator[str]:
    """Lines that give or take the values of a struct's members."""
    for member in members[:SHOWN]:
        yield "    " + (scalar if member.width is None else array).format(member.name)
    if len(members) > SHOWN:
        yield f"    ...  and {len(members) - SHOWN} more"


def _notes(program: FlatProgram, layout: MemoryLayout) -> Iterator[tuple[tuple[str, str], str]]:
    """What the comment of a member has to say beside its path, unit and text, by struct and name."""
    for parameter, member in layout.parameters.items():
        yield ("P", member.name), "; ".join(filter(None, (_bounds(parameter.declared), _order(parameter.declared))))
    for node in program.nodes:
        for port in node.block.derived:
            yield ("P", layout.derived[node, port.name].name), _order(port)
        for state in node.block.states:
            yield ("X" if state.continuous else "S", layout.states[node, state.name].name), _order(state)
    for signal, member in layout.inputs.items():
        yield ("U", member.name), _order(signal)
    for path, signal in program.outputs.items():
        yield ("Y", layout.outputs[path].name), _order(signal)


def _order(declared: Any) -> str:
    """How a matrix stands in its array."""
    if declared.shape is None:
        return ""
    rows, columns = declared.shape
    return f"{rows} x {columns}, column after column"


def _bounds(declared: Param) -> str:
    bounds = {"at least": declared.low, "at most": declared.high}
    words = [f"{word} {value:g}" for word, value in bounds.items() if abs(value) != float("inf")]
    value = declared.value if declared.width is None else None
    if isinstance(value, bool):
        words = [f"default {'true' if value else 'false'}"]
    elif value is not None:
        words = [f"default {float(value):g}", *words]
    return ", ".join(words)
