"""A module's controller: its C in float32 behind a small interface, and the uORB message of each of its steps."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.numbers import STORED
from twodof.compile.c.emitter import emit
from twodof.compile.c.operators import C_TYPES
from twodof.compile.program.flat_program import FlatProgram, FlatSignal
from twodof.compile.program.layout import MemoryLayout
from twodof.compile.program.lower import lower
from twodof.compile.px4.names import ModuleNames, field_names, fill, harmless
from twodof.compile.px4.parameters import LARGEST_FLOAT, LARGEST_INT, SMALLEST_INT, ExportedParameter
from twodof.errors import DiagramError

TYPES = {"real": "float32", "int32": "int32", "uint32": "uint32", "bool": "bool"}
_C_TYPES = {"real": "float", "int32": "int32_t", "uint32": "uint32_t", "bool": "bool"}
QUEUE = 16
LONGEST_FORMAT = 1450  # the logger of v1.14 has 1500 characters for it, a name included
LARGEST = 1000  # bytes; the topic's queue holds 16 of them

# bit, name, meaning
FAULTS = (
    (1, "STALE", "a measurement is missing, invalid or too old: the controller waits, the commands are 0"),
    (2, "NOT_FINITE", "the controller gave a command that is not finite: it starts again, the commands are 0"),
    (4, "REFUSED", "a parameter was out of bounds and was put back, or it is missing in PX4"),
    (8, "NO_SETPOINT", "a set-point is missing, not finite or old: a neutral one stands in for it"),
    (16, "SHARED", "another module publishes a topic of the commands too, or has ended its publication"),
)

HEAD = (
    ("uint64", "timestamp", "time since system start [us]"),
    ("uint64", "timestamp_sample", "time of the gyro sample of this step [us]"),
    ("uint32", "tick", "steps of the controller before this one since it started or was reset"),
    ("uint32", "missed", "periods without a step since the module started"),
    ("uint32", "overruns", "steps that took longer than a period"),
    ("uint32", "step_time", "duration of this step [us]"),
    ("uint32", "parameter_revision", "how often parameters have been taken over"),
    ("int32", "refused_parameter", "place in module.yaml of the parameter that was put back last, or -1"),
    ("uint8", "faults", "a sum of FAULT_"),
    ("bool", "active", "the commands are in use: armed, in a mode that wants this controller, and without a fault"),
)


@dataclass(frozen=True)
class MessageField:
    """A signal in the message and in the C interface."""

    name: str
    path: str
    kind: str
    width: int | None
    unit: str

    @property
    def c_declaration(self) -> str:
        """Declaration as a member of a C struct."""
        return f"{_C_TYPES[self.kind]} {self.name}{'' if self.width is None else f'[{self.width}]'};"

    @property
    def described(self) -> str:
        """Text with path and unit."""
        return f"{self.path} [{self.unit}]" if self.unit else self.path

    @property
    def words(self) -> int:
        """Number of 32-bit words in a row of a recorded sequence."""
        return self.width or 1


@dataclass(frozen=True)
class MessageFields:
    """Inputs and outputs (with the logged signals) of a module, in the program's order."""

    inputs: tuple[MessageField, ...]
    outputs: tuple[MessageField, ...]

    @property
    def description(self) -> int:
        """Number of characters of the message's description in a log, without its name."""
        rows = [f"{TYPES[f.kind]}_t[{f.words}] {f.name};" for f in (*self.inputs, *self.outputs)]
        rows += [f"{kind}_t {name};" for kind, name, _ in HEAD] + ["uint8_t[8] _padding0;"]
        return sum(map(len, rows))


def fields(program: FlatProgram, outputs: int) -> MessageFields:
    """Return the fields of a program whose first `outputs` outputs are the diagram's, the others logged signals.

    Raises DiagramError if there are more than a uORB message or its description in a log can hold.
    """
    ins = _named("in", list(program.inputs.items()))
    rows = list(program.outputs.items())
    for path, signal in [*program.inputs.items(), *rows]:
        if signal.kind not in TYPES:
            remedy = f"convert it to one of {', '.join(TYPES)} for PX4"
            raise DiagramError(f"its signal {path!r} is {signal.kind}", program.name, remedy)
    found = MessageFields(ins, _named("out", rows[:outputs]) + _named("log", rows[outputs:]))
    every = [*found.inputs, *found.outputs]
    size = sum((1 if f.kind == "bool" else 4) * f.words for f in every)
    text = found.description
    if text > LONGEST_FORMAT or size > LARGEST:
        what = f"its message would have {len(every)} signals ({size} bytes, {text} characters of description)"
        most = f"at most {LARGEST} bytes and {LONGEST_FORMAT} characters are logged"
        raise DiagramError(what, program.name, f"{most}: log fewer signals, or shorter names")
    return found


def _named(prefix: str, signals: list[tuple[str, FlatSignal]]) -> tuple[MessageField, ...]:
    names = field_names(prefix, [path for path, _ in signals])
    return tuple(MessageField(n, p, s.kind, s.width, s.unit) for n, (p, s) in zip(names, signals, strict=True))


def message(names: ModuleNames, found: MessageFields) -> str:
    """Return the text of the .msg file."""
    lines = [f"# What the module {names.module} reads, computes and commands at each step.", ""]
    lines += [_line(kind, name, text) for kind, name, text in HEAD]
    lines += ["", _line("uint8", f"ORB_QUEUE_LENGTH = {QUEUE}", "so that a logger that is late misses none")]
    lines += [_line("uint8", f"FAULT_{name} = {bit}", text) for bit, name, text in FAULTS]
    for title, members in (("read", found.inputs), ("computed", found.outputs)):
        lines += ["", f"# {title}"]
        for f in members:
            array = "" if f.width is None else f"[{f.width}]"
            lines.append(_line(TYPES[f.kind] + array, f.name, f.described))
    return "\n".join(lines) + "\n"


def _line(kind: str, name: str, text: str) -> str:
    return f"{kind} {name}".ljust(40) + f" # {harmless(text, 110)}"


PERIOD_US = 4000
DT = PERIOD_US * 1e-6  # [s]
LARGEST_FRAME = 2000  # bytes of the 3150 of PX4's rate_ctrl queue, which also carries what publishes
_LOCAL_ARRAY = re.compile(r"^ +(?:const )?(?:real|int32_t|uint32_t|bool) \w+\[(\d+)\](?: =.*)?;", re.MULTILINE)

# The language's rules: no contraction, no reassociation, IEEE division, signed zeros. PX4's flags come before, and
# CMake drops one that PX4 has given already: -fno-fast-math, say, would switch errno on, and nothing switch it off.
EXACT = (
    "-ffp-contract=off",
    "-fno-associative-math",
    "-fno-reciprocal-math",
    "-fno-finite-math-only",
    "-fsigned-zeros",
)


@dataclass(frozen=True)
class ControllerCode:
    """A diagram's program under the module's name, its C text and layout, and a bound of the step's stack [bytes]."""

    program: FlatProgram
    source: str
    layout: MemoryLayout
    stack: int


def controller(diagram: Diagram, names: ModuleNames, log: Sequence[str]) -> ControllerCode:
    """Lower `diagram` at 250 Hz with the signals at `log`, and emit it in float32.

    Raises DiagramError as `lower`, and for arrays that are too large for the stack of PX4's work queue.
    """
    with numbers.precision("float32"):
        program = replace(lower(diagram, DT, log), name=names.module)
        (emitted,) = emit([program], "float32", lean=True)
    arrays = 4 * sum(int(width) for width in _LOCAL_ARRAY.findall(emitted.source))
    stack = -(-(arrays + 600) // 100) * 100  # 600: what steps of hundreds of blocks without arrays need on the M7
    if stack > LARGEST_FRAME:
        what = f"its local arrays need {arrays} bytes of stack; PX4's work queue has room for {LARGEST_FRAME - 600}"
        remedy = "make the arrays shorter, or keep them in states, which are not on the stack"
        raise DiagramError(what, diagram.name, remedy)
    return ControllerCode(program, emitted.source, emitted.layout, stack)


def header(names: ModuleNames, found: MessageFields, rows: Sequence[ExportedParameter], made: ControllerCode) -> str:
    """Return the interface between the work item and the step, for C and C++."""
    sizes = {k: v.itemsize for k, v in made.layout.dtypes("float32").items()}
    return fill(
        "controller.h",
        names,
        inputs=_members(found.inputs),
        outputs=_members(found.outputs),
        parameters=len(rows),
        own=_own(names, rows),
        input_words=sum(f.words for f in found.inputs),
        output_words=sum(f.words for f in found.outputs),
        words=-(-(2 * _padded(sizes["P"]) + sum(_padded(sizes[k]) for k in "SUY")) // 8),
        period=PERIOD_US,
    )


def _padded(size: int) -> int:
    return -(-size // 8) * 8


def _own(names: ModuleNames, rows: Sequence[ExportedParameter]) -> str:
    own = [(i, r) for i, r in enumerate(rows) if not r.path]
    suffix = len(names.prefix) + 1
    return "".join(f"    {names.module}_{r.name[suffix:]} = {i}, /* the place of {r.name} */\n" for i, r in own)


def _members(members: Sequence[MessageField]) -> str:
    lines = [f"    {f.c_declaration} /* {harmless(f.described, 90)} */" for f in members]
    return "\n".join(lines or ["    uint8_t none;"])


def source(names: ModuleNames, found: MessageFields, rows: Sequence[ExportedParameter], made: ControllerCode) -> str:
    """Return the C file: the emitted program, then the interface."""
    layout = made.layout
    return fill(
        "controller.c",
        names,
        program=made.source,
        table=_table(names, rows),
        assignments=_assignments(rows, layout),
        inputs=_copies(
            [
                (f"own->u.{layout.inputs[signal].name}", f"in->{f.name}", f.width)
                for signal, f in zip(made.program.inputs.values(), found.inputs, strict=True)
            ],
            "in",
        ),
        outputs=_copies(
            [(f"out->{f.name}", f"own->y.{layout.outputs[f.path].name}", f.width) for f in found.outputs], "out"
        ),
        unpacked=_words(
            found.inputs, "in->{name} = {word} != 0u;", "memcpy(&in->{name}, {place}, sizeof in->{name});", "in"
        ),
        packed=_words(
            found.outputs,
            "{word} = out->{name} ? 1u : 0u;",
            "memcpy({place}, &out->{name}, sizeof out->{name});",
            "out",
        ),
    )


def _table(names: ModuleNames, rows: Sequence[ExportedParameter]) -> str:
    lines = []
    for row in rows:
        fixed = "true" if row.fixed else "false"
        low, high, default = (_number(value, row.kind) for value in (row.low, row.high, row.default))
        real = row.kind == "real"
        bounds = f"{low}, {high}, 0, 0" if real else f"0.0f, 0.0f, {low}, {high}"
        standard = f".{'real' if real else 'integer'} = {default}"
        kind = {"real": "f", "bool": "b"}.get(row.kind, "i")
        lines.append(f"    {{\"{row.name}\", '{kind}', {fixed}, {bounds}, {{{standard}}}}},")
    n = names.module
    return "\n".join([f"const {n}_Parameter {n}_parameters[{n}_PARAMETERS] = {{", *lines, "};", ""])


def _number(value: float, kind: str) -> str:
    """Return a bound or default in C, the largest ones by name."""
    if kind == "real":
        largest = f"{'-' if value < 0 else ''}0x1.fffffep+127f"
        return largest if abs(value) >= LARGEST_FLOAT else f"{float(value).hex()}f"
    return {SMALLEST_INT: "INT32_MIN", LARGEST_INT: "INT32_MAX"}.get(int(value), str(int(value)))


def _assignments(rows: Sequence[ExportedParameter], layout: MemoryLayout) -> str:
    members = {parameter.path: member for parameter, member in layout.parameters.items()}
    lines = {False: "", True: ""}
    values = {"real": "real", "bool": "integer != 0"}
    for i, row in enumerate(rows):
        if not row.path:
            continue
        element = "" if row.index is None else f"[{row.index}]"
        member = members[row.path]
        stored = member.kind in STORED or row.kind == "uint32"
        cast = f"({C_TYPES[member.kind if member.kind in STORED else row.kind]})" if stored else ""
        value = f"{cast}values[{i}].{values.get(row.kind, 'integer')}"
        indent = "        " if row.fixed else "    "
        lines[row.fixed] += f"{indent}own->candidate.{member.name}{element} = {value};\n"
    starting = f"    if (starting) {{\n{lines[True]}    }}\n" if lines[True] else ""
    return lines[False] + starting


def _copies(pairs: Sequence[tuple[str, str, int | None]], unused: str) -> str:
    """Return lines that copy origins to targets: scalars, or arrays of the given width."""
    lines = [
        f"    {to} = {origin};\n" if width is None else f"    memcpy({to}, {origin}, sizeof {to});\n"
        for to, origin, width in pairs
    ]
    return "".join(lines) or f"    (void){unused};\n"


def _words(members: Sequence[MessageField], flag: str, whole: str, unused: str) -> str:
    """Return lines that copy `members` from or to words of 32 bits: `flag` for a bool, `whole` for other kinds."""
    lines, at = [], 0
    for f in members:
        names = [f.name] if f.width is None else [f"{f.name}[{i}]" for i in range(f.width)]
        for i, name in enumerate(names if f.kind == "bool" else [f.name]):
            line = flag if f.kind == "bool" else whole
            lines.append(f"    {line.format(name=name, word=f'words[{at + i}]', place=f'words + {at}')}\n")
        at += f.words
    return "".join(lines) or f"    (void)words;\n    (void){unused};\n"
