"""The module's uORB message: what it read, what it commanded, the signals that are logged, and how it fares."""

from dataclasses import dataclass

from twodof.compile.program.flat_program import FlatProgram, FlatSignal
from twodof.compile.px4.names import ModuleNames, field_names, harmless
from twodof.errors import DiagramError

TYPES = {"real": "float32", "int32": "int32", "uint32": "uint32", "bool": "bool"}
_C_TYPES = {"real": "float", "int32": "int32_t", "uint32": "uint32_t", "bool": "bool"}
_SIZES = {"real": 4, "int32": 4, "uint32": 4, "bool": 1}
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
        """The member of a C struct."""
        return f"{_C_TYPES[self.kind]} {self.name}{'' if self.width is None else f'[{self.width}]'};"

    @property
    def described(self) -> str:
        """Its path and unit, for people."""
        return f"{self.path} [{self.unit}]" if self.unit else self.path

    @property
    def words(self) -> int:
        """32-bit words in a row of a recorded sequence."""
        return self.width or 1


@dataclass(frozen=True)
class MessageFields:
    """The inputs and the outputs (with the logged signals) of a module, in the program's order."""

    inputs: tuple[MessageField, ...]
    outputs: tuple[MessageField, ...]

    @property
    def description(self) -> int:
        """Characters of the message's description in a log, without its name."""
        rows = [f"{TYPES[f.kind]}_t[{f.words}] {f.name};" for f in (*self.inputs, *self.outputs)]
        rows += [f"{kind}_t {name};" for kind, name, _ in HEAD] + ["uint8_t[8] _padding0;"]
        return sum(map(len, rows))


def fields(program: FlatProgram, outputs: int) -> MessageFields:
    """Return the fields of a program whose first `outputs` outputs are the diagram's, the others logged signals.

    Raises DiagramError for more than a uORB message and a log's description of it can hold.
    """
    ins = _named("in", list(program.inputs.items()))
    rows = list(program.outputs.items())
    for path, signal in [*program.inputs.items(), *rows]:
        if signal.kind not in TYPES:
            remedy = f"convert it to one of {', '.join(TYPES)} for PX4"
            raise DiagramError(f"its signal {path!r} is {signal.kind}", program.name, remedy)
    found = MessageFields(ins, _named("out", rows[:outputs]) + _named("log", rows[outputs:]))
    every = [*found.inputs, *found.outputs]
    size = sum(_SIZES[f.kind] * f.words for f in every)
    text = found.description
    if text > LONGEST_FORMAT or size > LARGEST:
        raise DiagramError(
            f"its message would have {len(every)} signals ({size} bytes, {text} characters of description)",
            program.name,
            f"at most {LARGEST} bytes and {LONGEST_FORMAT} characters are logged: log fewer signals, or shorter names",
        )
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
