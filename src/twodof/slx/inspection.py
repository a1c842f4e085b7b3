"""Contents of a Simulink model: release, solver, sample times, blocks, libraries, code, and the names that it needs.

`inspect(model, folders)` reads the libraries too, as far as they are there.
"""

import re
from collections import Counter
from collections.abc import Iterable, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from twodof.errors import DiagramError
from twodof.slx.dictionary import dictionary, enumerations
from twodof.slx.matlab.library import LIBRARY
from twodof.slx.matlab.parser import assigned_names, names_in
from twodof.slx.matlab.signals import SIGNAL_FUNCTIONS
from twodof.slx.matlab.values import FUNCTIONS
from twodof.slx.model import (
    Model,
    SimulinkBlock,
    SimulinkChart,
    System,
    below,
    collapsed,
    one_spaced,
    read_model,
    source_file,
)

OWN_LIBRARIES = ("simulink", "slpidlib", "pid_lib", "simulink_need_slupdate", "simulink_extras", "hdlsllib")
"""Libraries that are Simulink's own: their blocks stand for code and are in no file of the user's."""
SUFFIXES = (".slx", ".mdl")

DEEPEST = 40
_ARGUMENTS = re.compile(r"^\s*function\b[^(\n]*\(([^)]*)\)", re.MULTILINE)
# What MATLAB has beside the functions that are computed here: none of it is a variable of the user's.
_MORE = """and break case class else elseif end eval for function get_param gcb gcbh gcs global if mtimes or otherwise
persistent power return set_param squeeze std switch times trapz polyfit rand randn var while Simulink fixdt i j"""
_MATLAB = frozenset([*FUNCTIONS, *SIGNAL_FUNCTIONS, *LIBRARY, *_MORE.split()])

# The parameters that hold a value to be computed; all others are choices, texts or looks.
_VALUES = """
Backlash: BacklashWidth InitialOutput; Bias: Bias; Constant: Value; DataStoreMemory: InitialValue;
DeadZone: LowerValue UpperValue; Delay: DelayLength InitialCondition;
DiscreteFilter: Numerator Denominator InitialStates; DiscreteFir: Coefficients InitialStates;
DiscreteIntegrator: gainval InitialCondition UpperSaturationLimit LowerSaturationLimit;
DiscretePulseGenerator: Amplitude Period PulseWidth PhaseDelay; DiscreteStateSpace: A B C D InitialCondition;
DiscreteTransferFcn: Numerator Denominator InitialStates; DiscreteZeroPole: Zeros Poles Gain; Gain: Gain;
Integrator: InitialCondition UpperSaturationLimit LowerSaturationLimit; Lookup: InputValues Table;
Lookup_n-D: Table BreakpointsForDimension1 BreakpointsForDimension2 BreakpointsForDimension3 BreakpointsForDimension4;
PID Controller: P I D N b c Kb Kt InitialConditionForIntegrator InitialConditionForFilter UpperSaturationLimit
LowerSaturationLimit;
Quantizer: QuantizationInterval; RandomNumber: Mean Variance Seed;
RateLimiter: RisingSlewLimit FallingSlewLimit InitialCondition;
Relay: OnSwitchValue OffSwitchValue OnOutputValue OffOutputValue; Saturate: UpperLimit LowerLimit;
Sin: Amplitude Bias Frequency Phase; StateSpace: A B C D X0 InitialCondition; Step: Time Before After;
Switch: Threshold; TransferFcn: Numerator Denominator; TransportDelay: DelayTime InitialOutput;
UniformRandomNumber: Minimum Maximum Seed; UnitDelay: InitialCondition X0; ZeroPole: Zeros Poles Gain
"""
VALUES = {kind.strip(): tuple(names.split()) for kind, names in re.findall(r"([^:;]+):([^;]+)", _VALUES)}


@dataclass(frozen=True)
class Library:
    """A library that blocks of the model come from: its name, how many, and its file; None where it is not found."""

    name: str
    blocks: int
    file: Path | None
    own: bool
    """Whether it is Simulink's own."""


@dataclass(frozen=True)
class Inspection:
    """Result of `inspect`. `names` are those that the model's values take from a workspace, with who asks for them."""

    model: Model
    blocks: dict[str, int]
    systems: int
    depth: int
    sample_times: dict[str, int]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    libraries: tuple[Library, ...]
    functions: tuple[str, ...]
    charts: tuple[str, ...]
    names: dict[str, tuple[str, ...]]
    commented: int
    loose: int
    """Lines without a beginning or an end."""


def inspect(model: Model, folders: Sequence[Path] = ()) -> Inspection:
    """Return what a model holds. Libraries are looked for in `folders`, not below them."""
    systems = list(model.root.walk())
    blocks = list(model.blocks())
    times = Counter(found for _, one in blocks if (found := sample_time(one)))
    named = Counter(source_file(one) for _, one in blocks if one.type == "Reference" or source_file(one))
    libraries = tuple(_library(name, count, folders) for name, count in named.most_common())
    lines = [line for _, system in systems for line in system.lines]
    files = needed_files(model, folders)
    outside = set(enumerations((text for one in (model, *files) for text in one.texts()), folders))
    with suppress(DiagramError):  # a dictionary that is not found: its names have no value
        outside |= set(dictionary(model.dictionary, folders))
    return Inspection(
        model,
        dict(Counter(one.kind for _, one in blocks).most_common()),
        len(systems) - 1,
        max((path.replace("//", "").count("/") + 1 for path, _ in systems if path), default=0),
        dict(times.most_common()),
        tuple(model.root.ports("Inport")),
        tuple(model.root.ports("Outport")),
        libraries,
        tuple(sorted(one.path for one in model.charts if one.function)),
        tuple(sorted(one.path for one in model.charts if not one.function)),
        unresolved(model, files, outside),
        sum(one.commented for _, one in blocks),
        sum(line.source is None or next(line.wire.sinks(), None) is None for line in lines),
    )


def sample_time(block: SimulinkBlock) -> str:
    """Return the sample time that a block has of its own, as text; "" where it takes that of its inputs."""
    values = {**block.values, **block.instance}
    said = collapsed(values.get("SampleTime", values.get("SystemSampleTime", "")))
    if block.type == "RateTransition":
        said = collapsed(values.get("OutPortSampleTime", ""))
    return "" if said in ("-1", "inf", "[-1, 0]", "") else said


def _library(name: str, count: int, folders: Iterable[Path]) -> Library:
    own = name in OWN_LIBRARIES
    return Library(name or "(none)", count, None if own else library_file(name, folders), own)


def library_file(name: str, folders: Iterable[Path]) -> Path | None:
    """Return the file of a user's library in these folders; None where it is not there."""
    candidates = folders if re.fullmatch(r"[A-Za-z]\w*", name) else ()
    return next((at for one in candidates for end in SUFFIXES if (at := one / f"{name}{end}").is_file()), None)


def needed_files(model: Model, folders: Sequence[Path]) -> list[Model]:
    """Return the libraries, subsystems and models in the folders that a model needs, and those that they need."""
    found: dict[str, Model] = {}
    waiting = [model]
    while waiting:
        for name in {source_file(one) for _, one in waiting.pop().blocks() if not one.commented} - found.keys():
            if name not in OWN_LIBRARIES and (file := library_file(name, folders)) is not None:
                with suppress(DiagramError):  # one that cannot be read is refused where it is asked for
                    found[name] = read_model(file)
                    waiting.append(found[name])
    return list(found.values())


def unresolved(model: Model, files: Sequence[Model] = (), outside: Iterable[str] = ()) -> dict[str, tuple[str, ...]]:
    """Return the names that a model takes from a workspace, each with the paths of up to three blocks.

    Names `outside` have a value in a data dictionary or an enumeration's class. Blocks of `files` count where the model
    has them: what a link gives to a block of a library is a name or a choice, as its mask says.
    """
    return {
        name: tuple(dict.fromkeys(paths))[:3] for name, paths in sorted(_Names(model, files, outside).found.items())
    }


class _Names:
    def __init__(self, model: Model, files: Sequence[Model], outside: Iterable[str]) -> None:
        self.found: dict[str, list[str]] = {}
        self.files = {one.name: one for one in files}
        self.library_blocks = {f"{one.name}/{path}": block for one in files for path, block in one.blocks()}
        self.arguments = {(one.name, chart.path): _arguments(chart) for one in (model, *files)
                          for chart in one.charts}  # fmt: skip
        self._walk(model.root, "", (model.name, ""), _assigned(model) | {*outside} | _MATLAB, 0)

    def _walk(self, system: System, path: str, place: tuple[str, str], known: Set[str], depth: int) -> None:
        """Look into a system, whose `place` is its file and the path there."""
        for block in system.blocks.values() if depth < DEEPEST else ():
            if block.commented:
                continue
            at, own = below(path, block), (place[0], below(place[1], block))
            inner, mask, seen = block.system, block.mask, known
            file, link = self.files.get(source_file(block)), one_spaced(block.values.get("SourceBlock", ""))
            if file is not None and block.type == "Reference":
                inside = self.library_blocks.get(link)
                inner, mask = (None, None) if inside is None else (inside.system, inside.mask)
                own = (file.name, link.partition("/")[2])
            elif file is not None:
                inner, own = file.root, (file.name, "")
                seen = known | _assigned(file) | {*names_in(block.values.get("ParameterArgumentNames", ""))}
            given = {**block.values, **block.instance}  # a link's values stand beside its own in older files
            values = [given.get(key, "") for key in (*VALUES.get(block.kind, ()), "SampleTime")]
            values.append(given.get("OutDataTypeStr", "").partition("Bus:")[2])
            if inner is not None and given.get("Variant", "off") == "on" and not given.get("LabelModeActiveChoice"):
                conditions = (one.values.get("VariantControl", "") for one in inner.blocks.values())
                values += [text for text in conditions if text != "(default)"]
            if mask is not None:
                values += [given.get(key, text) for key, text in mask.computed.items()]
            taken = {name for value in values for name in names_in(value)} - known
            if mask is not None:
                seen = seen | set(mask.parameters) | assigned_names(mask.initialization)
            ports = {collapsed(one.name) for one in inner.blocks.values()} if inner is not None else set()
            for name in taken | (self.arguments.get(own, set()) - ports - seen):
                self.found.setdefault(name, []).append(at)
            if inner is not None:
                self._walk(inner, at, own, seen, depth + 1)


def _assigned(model: Model) -> set[str]:
    return {name for code in model.callbacks.values() for name in assigned_names(code)}


def _arguments(chart: SimulinkChart) -> set[str]:
    """Return the names that a MATLAB Function takes as arguments, or a chart as parameters."""
    if not chart.function:
        data = [one for one in (chart.form or {}).get("inside", ()) if one["tag"] == "data"]
        return {one["name"] for one in data if one["values"].get("scope") == "PARAMETER_DATA"}
    head = _ARGUMENTS.search(chart.text)
    return set() if head is None else set(names_in(head[1]))
