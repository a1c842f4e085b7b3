"""Contents of a Simulink model: release, solver, sample times, blocks, libraries, code, and the names that it needs.

`inspect(model, folders)` reads the libraries too, as far as they are there.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from twodof.errors import DiagramError
from twodof.slx.dictionary import dictionary, enumerations
from twodof.slx.matlab.evaluation import assigned_names, names_in
from twodof.slx.matlab.values import FUNCTIONS
from twodof.slx.model import Mask, Model, SimulinkBlock, System, below, collapsed, port_number, read_model

OWN_LIBRARIES = ("simulink", "slpidlib", "simulink_need_slupdate", "simulink_extras", "hdlsllib")
"""Libraries that are Simulink's own: their blocks stand for code and are in no file of the user's."""
SUFFIXES = (".slx", ".mdl")

_Names = dict[str, list[str]]
# What MATLAB has beside the functions that are computed here: none of it is a variable of the user's.
_MORE = """break case class else elseif end eval for function get_param gcb gcbh gcs global if interp1 isnan otherwise
persistent poly polyfit rand randn return set_param sort squeeze std switch trapz var while Simulink fixdt i j"""
_MATLAB = frozenset([*FUNCTIONS, *_MORE.split()])

# The parameters that hold a value to be computed; all others are choices, texts or looks.
VALUES: dict[str, tuple[str, ...]] = {
    "Backlash": ("BacklashWidth", "InitialOutput"),
    "Bias": ("Bias",),
    "Constant": ("Value",),
    "DataStoreMemory": ("InitialValue",),
    "DeadZone": ("LowerValue", "UpperValue"),
    "Delay": ("DelayLength", "InitialCondition"),
    "DiscreteFilter": ("Numerator", "Denominator", "InitialStates"),
    "DiscreteFir": ("Coefficients", "InitialStates"),
    "DiscreteIntegrator": ("gainval", "InitialCondition", "UpperSaturationLimit", "LowerSaturationLimit"),
    "DiscretePulseGenerator": ("Amplitude", "Period", "PulseWidth", "PhaseDelay"),
    "DiscreteStateSpace": ("A", "B", "C", "D", "InitialCondition"),
    "DiscreteTransferFcn": ("Numerator", "Denominator", "InitialStates"),
    "DiscreteZeroPole": ("Zeros", "Poles", "Gain"),
    "Gain": ("Gain",),
    "Integrator": ("InitialCondition", "UpperSaturationLimit", "LowerSaturationLimit"),
    "Lookup": ("InputValues", "Table"),
    "Lookup_n-D": ("Table", *(f"BreakpointsForDimension{n}" for n in range(1, 5))),
    "PID Controller": (
        *"PIDNbc",
        *("Kb", "Kt", "InitialConditionForIntegrator", "InitialConditionForFilter"),
        *("UpperSaturationLimit", "LowerSaturationLimit"),
    ),
    "Quantizer": ("QuantizationInterval",),
    "RandomNumber": ("Mean", "Variance", "Seed"),
    "RateLimiter": ("RisingSlewLimit", "FallingSlewLimit", "InitialCondition"),
    "Relay": ("OnSwitchValue", "OffSwitchValue", "OnOutputValue", "OffOutputValue"),
    "Saturate": ("UpperLimit", "LowerLimit"),
    "Sin": ("Amplitude", "Bias", "Frequency", "Phase"),
    "StateSpace": ("A", "B", "C", "D", "X0", "InitialCondition"),
    "Step": ("Time", "Before", "After"),
    "Switch": ("Threshold",),
    "TransferFcn": ("Numerator", "Denominator"),
    "TransportDelay": ("DelayTime", "InitialOutput"),
    "UniformRandomNumber": ("Minimum", "Maximum", "Seed"),
    "UnitDelay": ("InitialCondition", "X0"),
    "ZeroPole": ("Zeros", "Poles", "Gain"),
}


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
    named = Counter(
        collapsed(one.values.get("SourceBlock", "")).partition("/")[0] for _, one in blocks if one.type == "Reference"
    )
    named.update(name for _, one in blocks if (name := one.values.get("ReferencedSubsystem", "")))
    libraries = tuple(_library(name, count, folders) for name, count in named.most_common())
    lines = [line for _, system in systems for line in system.lines]
    outside = set(
        enumerations((text for _, one in blocks for text in (*one.values.values(), *one.instance.values())), folders)
    )
    with suppress(DiagramError):  # a dictionary that is not found: its names have no value
        outside |= set(dictionary(model.dictionary, folders))
    return Inspection(
        model,
        dict(Counter(one.kind for _, one in blocks).most_common()),
        len(systems) - 1,
        max((path.replace("//", "").count("/") + 1 for path, _ in systems if path), default=0),
        dict(times.most_common()),
        tuple(ports(model.root, "Inport")),
        tuple(ports(model.root, "Outport")),
        libraries,
        tuple(sorted(one.path for one in model.charts if one.function)),
        tuple(sorted(one.path for one in model.charts if not one.function)),
        unresolved(model, [read_model(one.file) for one in libraries if one.file is not None], outside),
        sum(one.commented for _, one in blocks),
        sum(line.source is None or next(line.wire.sinks(), None) is None for line in lines),
    )


def ports(system: System, kind: str) -> list[str]:
    """Return the names of the Inports or Outports of a system by their number."""
    found = [one for one in system.blocks.values() if one.type == kind]
    return [collapsed(one.name) for one in sorted(found, key=port_number)]


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


def unresolved(
    model: Model, libraries: Iterable[Model] = (), outside: Iterable[str] = ()
) -> dict[str, tuple[str, ...]]:
    """Return the names that values of blocks take from a workspace, each with the paths of up to three blocks.

    Names `outside` have a value in a data dictionary or an enumeration's class.

    What a link gives to a block of a library is read if the library is among `libraries`: only its mask tells a name
    from a choice.
    """
    masks = {f"{one.name}/{path}": block.mask for one in libraries for path, block in one.blocks() if block.mask}
    found: dict[str, list[str]] = {}
    known = {name for code in model.callbacks.values() for name in assigned_names(code)} | set(outside)
    _unresolved(model.root, "", known, masks, found)
    for one in libraries:
        if one.kind == "subsystem":  # a subsystem with a file of its own has the names of its model's workspace
            _unresolved(one.root, one.name, known, masks, found)
    return {name: tuple(paths[:3]) for name, paths in sorted(found.items())}


def _unresolved(system: System, path: str, known: set[str], masks: Mapping[str, Mask], found: _Names) -> None:
    for block in system.blocks.values():
        if block.commented:
            continue
        at = below(path, block)
        mask = masks.get(collapsed(block.values.get("SourceBlock", ""))) if block.type == "Reference" else block.mask
        given = {**block.values, **block.instance}  # a link's values stand beside its own in older files
        values = [given.get(key, "") for key in (*VALUES.get(block.kind, ()), "SampleTime")]
        if mask is not None:
            values += [given.get(key, text) for key, text in mask.computed.items()]
        for name in {name for value in values for name in names_in(value)} - known - _MATLAB:
            found.setdefault(name, []).append(at)
        if block.system is not None:
            inner = known if mask is None else known | set(mask.parameters) | assigned_names(mask.initialization)
            _unresolved(block.system, at, inner, masks, found)
