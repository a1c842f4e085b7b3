"""The module's C: the emitted program in float32, and a small interface that C++ can include, whatever it is named."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions import numbers
from twodof.compile.c.emitter import emit
from twodof.compile.program.flat_program import FlatProgram
from twodof.compile.program.layout import MemoryLayout
from twodof.compile.program.lower import lower
from twodof.compile.px4.message import MessageField, MessageFields
from twodof.compile.px4.names import ModuleNames, harmless
from twodof.compile.px4.parameters import LARGEST_FLOAT, LARGEST_INT, SMALLEST_INT, ExportedParameter
from twodof.errors import DiagramError

PERIOD_US = 4000
DT = PERIOD_US * 1e-6  # [s]
LARGEST_FRAME = 2000  # bytes of the 3150 of PX4's rate_ctrl queue, which also carries what publishes
_LOCAL_ARRAY = re.compile(r"^ +(?:const )?(?:real|int32_t|uint32_t|bool) \w+\[(\d+)\](?: =.*)?;", re.MULTILINE)


@dataclass(frozen=True)
class ControllerCode:
    """A diagram's program under the module's name, its C text and layout, and a bound of the step's stack [bytes]."""

    program: FlatProgram
    source: str
    layout: MemoryLayout
    stack: int


def controller(diagram: Diagram, names: ModuleNames, log: Sequence[str]) -> ControllerCode:
    """`diagram` lowered at 250 Hz with the signals at `log`, and emitted in float32.

    Raises DiagramError as `lower`, and for arrays that are too large for the stack of PX4's work queue.
    """
    with numbers.precision("float32"):
        program = replace(lower(diagram, DT, log), name=names.module)
        emitted = emit([program], "float32", lean=True)
    arrays = 4 * sum(int(width) for width in _LOCAL_ARRAY.findall(emitted.text))
    stack = -(-(arrays + 600) // 100) * 100  # 600: what steps of hundreds of blocks without arrays need on the M7
    if stack > LARGEST_FRAME:
        raise DiagramError(
            f"its local arrays need {arrays} bytes of stack; PX4's work queue has room for {LARGEST_FRAME - 600}",
            diagram.name,
            "make the arrays shorter, or states, which do not stand on the stack",
        )
    return ControllerCode(program, emitted.text, emitted.layouts[names.module], stack)


def header(names: ModuleNames, found: MessageFields, rows: Sequence[ExportedParameter], made: ControllerCode) -> str:
    """The interface between the work item and the step, for C and C++."""
    n = names.module
    sizes = {k: v.itemsize for k, v in made.layout.dtypes("float32").items()}
    words = -(-(2 * _padded(sizes["P"]) + sum(_padded(sizes[k]) for k in "SUY")) // 8)
    return f"""/* {n}: the controller, without PX4. To be included before PX4's headers and their macros. */
#ifndef {n.upper()}_H
#define {n.upper()}_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {{
#endif

typedef struct {{
{_members(found.inputs)}
}} {n}_Inputs;

/* What the diagram gives, and the signals that are logged. */
typedef struct {{
{_members(found.outputs)}
}} {n}_Outputs;

typedef union {{
    float real;
    int32_t integer;
}} {n}_Value;

/* A parameter in PX4: its name, its type (f float, i integer, b boolean), its bounds and its default. A fixed one is
   read when the module starts. */
typedef struct {{
    const char *name;
    char type;
    bool fixed;
    float low, high;
    int32_t least, most;
    {n}_Value standard;
}} {n}_Parameter;

enum {{
    {n}_PARAMETERS = {len(rows)},
{_own(names, rows)}    {n}_INPUT_WORDS = {sum(f.words for f in found.inputs)},
    {n}_OUTPUT_WORDS = {sum(f.words for f in found.outputs)}
}};

extern const {n}_Parameter {n}_parameters[{n}_PARAMETERS];

/* Parameters (those in use and those that are just being checked), states, inputs and outputs of one controller. */
typedef struct {{
    uint64_t words[{words}];
}} {n}_Controller;

/* Defaults and initial states. */
void {n}_begin({n}_Controller *c);

/* Initial states; the parameters stay. */
void {n}_reset({n}_Controller *c);

/* Whether a value is within the bounds of the parameter at `place`. A NaN is in no bounds. */
bool {n}_within(int32_t place, {n}_Value value);

/* Takes {n}_PARAMETERS values over, those of fixed parameters only when `starting`. Returns -1, or, if one is out of
   bounds, its place; then none is changed. */
int32_t {n}_change({n}_Controller *c, const {n}_Value *values, bool starting);

/* One step of {PERIOD_US} us. */
void {n}_tick({n}_Controller *c, const {n}_Inputs *in, {n}_Outputs *out);

/* Steps since the beginning or the last reset. */
uint32_t {n}_ticks(const {n}_Controller *c);

/* A row of a recorded sequence: 32 bits for each real, integer or bool (0 or 1), arrays element by element. */
void {n}_unpack(const uint32_t *words, {n}_Inputs *in);
void {n}_pack(const {n}_Outputs *out, uint32_t *words);

#ifdef __cplusplus
}}
#endif

#endif
"""


def _padded(size: int) -> int:
    return -(-size // 8) * 8


def _own(names: ModuleNames, rows: Sequence[ExportedParameter]) -> str:
    own = [(i, r) for i, r in enumerate(rows) if not r.path]
    suffix = len(names.prefix) + 1
    return "".join(f"    {names.module}_{r.name[suffix:]} = {i}, /* the place of {r.name} */\n" for i, r in own)


def _members(members: Sequence[MessageField]) -> str:
    lines = [f"    {f.c_declaration}{_remark(f)}" for f in members]
    return "\n".join(lines or ["    uint8_t none;"])


def _remark(field: MessageField) -> str:
    unit = f" [{field.unit}]" if field.unit else ""
    return f" /* {harmless(field.path + unit, 90)} */"


def source(names: ModuleNames, found: MessageFields, rows: Sequence[ExportedParameter], made: ControllerCode) -> str:
    """The C file: the emitted program, then the interface."""
    n = names.module
    return f"""/* Generated by twodof from the diagram beside README.md; change that and export again.
   PX4 builds with -freciprocal-math and -fno-signed-zeros; CMakeLists.txt takes them back for this file, since they
   change results. */
#include "{n}.h"

#if defined(__GNUC__) && !defined(__clang__)
/* These find a person's slips. A diagram may well ask the same thing twice, or what cannot be, and what the emitter
   names may turn out not to be needed. */
#pragma GCC diagnostic ignored "-Wlogical-op"
#pragma GCC diagnostic ignored "-Wtautological-compare"
#pragma GCC diagnostic ignored "-Wtype-limits"
#pragma GCC diagnostic ignored "-Wunused-but-set-variable"
#pragma GCC diagnostic ignored "-Wunused-variable"
#endif

{made.source}/* The interface of {n}.h. */
typedef struct {{
    {n}_P p, candidate;
    {n}_S s;
    {n}_U u;
    {n}_Y y;
}} {n}_Inside;

_Static_assert(sizeof({n}_Inside) <= sizeof({n}_Controller), "{n}_Controller is too small");
_Static_assert(sizeof(real) == 4, "the controller computes in float32");

{_table(names, rows)}
static {n}_Inside *inside({n}_Controller *c)
{{
    return (void *)c;
}}

void {n}_begin({n}_Controller *c)
{{
    memset(c, 0, sizeof *c);
    {n}_defaults(&inside(c)->p);
    {n}_prepare(&inside(c)->p);
    {n}_reset(c);
}}

void {n}_reset({n}_Controller *c)
{{
    {n}_init(&inside(c)->p, &inside(c)->s);
}}

bool {n}_within(int32_t place, {n}_Value value)
{{
    const {n}_Parameter *const row = &{n}_parameters[place];
    return row->type == 'f' ? value.real >= row->low && value.real <= row->high
                            : value.integer >= row->least && value.integer <= row->most;
}}

int32_t {n}_change({n}_Controller *c, const {n}_Value *values, bool starting)
{{
    for (int32_t i = 0; i < {n}_PARAMETERS; i++) {{
        const bool taken = starting || !{n}_parameters[i].fixed;
        if (taken && !{n}_within(i, values[i]))
            return i;
    }}
    {n}_Inside *const own = inside(c);
    own->candidate = own->p;
{_assignments(rows, made.layout)}    {n}_prepare(&own->candidate);
    own->p = own->candidate;
    return -1;
}}

void {n}_tick({n}_Controller *c, const {n}_Inputs *in, {n}_Outputs *out)
{{
    {n}_Inside *const own = inside(c);
{_inputs(found, made)}    {n}_step(&own->p, &own->s, &own->u, &own->y);
{_outputs(found, made)}}}

uint32_t {n}_ticks(const {n}_Controller *c)
{{
    return ((const {n}_Inside *)(const void *)c)->s.tick;
}}

void {n}_unpack(const uint32_t *words, {n}_Inputs *in)
{{
{_unpacked(found.inputs)}}}

void {n}_pack(const {n}_Outputs *out, uint32_t *words)
{{
{_packed(found.outputs)}}}
"""


def _table(names: ModuleNames, rows: Sequence[ExportedParameter]) -> str:
    lines = []
    for row in rows:
        fixed = "true" if row.fixed else "false"
        if row.kind == "real":
            bounds, standard = f"{_float(row.low)}, {_float(row.high)}, 0, 0", f".real = {_float(row.default)}"
        else:
            bounds = f"0.0f, 0.0f, {_integer(row.low)}, {_integer(row.high)}"
            standard = f".integer = {_integer(row.default)}"
        kind = {"real": "f", "bool": "b"}.get(row.kind, "i")
        lines.append(f"    {{\"{row.name}\", '{kind}', {fixed}, {bounds}, {{{standard}}}}},")
    n = names.module
    return "\n".join([f"const {n}_Parameter {n}_parameters[{n}_PARAMETERS] = {{", *lines, "};", ""])


def _float(value: float) -> str:
    if abs(value) >= LARGEST_FLOAT:
        return "-0x1.fffffep+127f" if value < 0 else "0x1.fffffep+127f"
    return f"{float(value).hex()}f"


def _integer(value: float) -> str:
    if value <= SMALLEST_INT:
        return "INT32_MIN"
    return "INT32_MAX" if value >= LARGEST_INT else str(int(value))


def _assignments(rows: Sequence[ExportedParameter], layout: MemoryLayout) -> str:
    members = {parameter.path: member.name for parameter, member in layout.parameters.items()}
    lines = {False: "", True: ""}
    for i, row in enumerate(rows):
        if not row.path:
            continue
        element = "" if row.index is None else f"[{row.index}]"
        value = {
            "real": f"values[{i}].real",
            "int32": f"values[{i}].integer",
            "uint32": f"(uint32_t)values[{i}].integer",
            "bool": f"values[{i}].integer != 0",
        }[row.kind]
        indent = "        " if row.fixed else "    "
        lines[row.fixed] += f"{indent}own->candidate.{members[row.path]}{element} = {value};\n"
    starting = f"    if (starting) {{\n{lines[True]}    }}\n" if lines[True] else ""
    return lines[False] + starting


def _inputs(found: MessageFields, made: ControllerCode) -> str:
    signals = list(made.program.inputs.values())
    text = "".join(
        _copied(f"own->u.{made.layout.inputs[s].name}", f"in->{f.name}", s.width)
        for s, f in zip(signals, found.inputs, strict=True)
    )
    return text or "    (void)in;\n"


def _outputs(found: MessageFields, made: ControllerCode) -> str:
    text = "".join(
        _copied(f"out->{f.name}", f"own->y.{made.layout.outputs[path].name}", f.width)
        for path, f in zip(made.program.outputs, found.outputs, strict=True)
    )
    return text or "    (void)out;\n"


def _copied(target: str, origin: str, width: int | None) -> str:
    if width is None:
        return f"    {target} = {origin};\n"
    return f"    memcpy({target}, {origin}, sizeof {target});\n"


def _unpacked(inputs: Sequence[MessageField]) -> str:
    lines, at = [], 0
    for f in inputs:
        if f.kind == "bool":
            lines += [f"    in->{f.name}{e} = words[{at + i}] != 0u;\n" for i, e in _elements(f)]
        else:
            lines.append(f"    memcpy(&in->{f.name}, words + {at}, sizeof in->{f.name});\n")
        at += f.words
    return "".join(lines) or "    (void)words;\n    (void)in;\n"


def _packed(outputs: Sequence[MessageField]) -> str:
    lines, at = [], 0
    for f in outputs:
        if f.kind == "bool":
            lines += [f"    words[{at + i}] = out->{f.name}{e} ? 1u : 0u;\n" for i, e in _elements(f)]
        else:
            lines.append(f"    memcpy(words + {at}, &out->{f.name}, sizeof out->{f.name});\n")
        at += f.words
    return "".join(lines) or "    (void)words;\n    (void)out;\n"


def _elements(field: MessageField) -> list[tuple[int, str]]:
    return [(0, "")] if field.width is None else [(i, f"[{i}]") for i in range(field.width)]
