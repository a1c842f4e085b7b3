"""The sheets, blocks and signals of a model, the output that drives an input wherever that stands, and the rates.

A block without a sample time of its own takes the fastest one of its inputs, as Simulink does.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from math import gcd, lcm
from pathlib import Path

import numpy as np

from twodof.blocks.diagram import BASE, Rate
from twodof.errors import DiagramError
from twodof.slx.blocks import INPUTS, RULES
from twodof.slx.conditions import CONTROL_PORTS, ITERATED, Activation
from twodof.slx.matlab.function_block import MatlabFunction
from twodof.slx.matlab.program import IN_BASE, evaluate
from twodof.slx.matlab.values import NotComputed, Value, number
from twodof.slx.model import CODED, Model, Pin, SimulinkBlock, below, collapsed, port_number
from twodof.slx.network import Iteration
from twodof.slx.sheet import Sheet
from twodof.slx.translation import Made, NotTranslated, Signal

Output = tuple[str, str, int]
"""An output of a block: path of its system, identifier and number."""
ROUTED: Mapping[str, Callable[[Mapping[str, str]], int]] = {
    "FunctionCallSplit": lambda values: 1,
    "ManualSwitch": lambda values: 1 if values.get("sw", values.get("CurrentSetting", "1")) == "1" else 2,
}
"""Types whose output is one of their inputs, with its number."""
PASSING = ("Inport", "Outport", "InportShadow", "Goto", "From", "GotoTagVisibility", *CONTROL_PORTS, *ITERATED, *ROUTED)
"""Types that only pass signals on, or say when a system acts."""
_TRANSLATED = {*RULES, *CODED}
STORES = ("DataStoreMemory", "DataStoreRead", "DataStoreWrite")


def store_name(block: SimulinkBlock) -> str:
    """Return the name of the data store that a block is, reads or writes."""
    return block.values.get("DataStoreName", "A")


Key = tuple[str, str]
"""A block: path of its system and identifier."""
CONTINUOUS = ("Integrator", "SecondOrderIntegrator", "TransferFcn", "StateSpace", "ZeroPole", "Derivative",
              "TransportDelay")  # fmt: skip
"""Types whose step is the solver's."""

EVERY_SECOND = ("DigitalClock", "DiscreteIntegrator", "DiscretePulseGenerator", "DiscreteStateSpace", "UnitDelay",
                "ZeroOrderHold")  # fmt: skip
"""Types with a sample time of 1 s where the file does not say it."""


def base_period(times: Mapping[float, str], given: float | None = None) -> float:
    """Return the longest period [s] of which all `times` are multiples, or the `given` one; each has a place's name.

    Raises NotTranslated where there is none, or a time is no multiple of the given one.
    """
    if given is not None:
        for time, where in times.items():
            if abs(time / given - round(time / given)) > 1e-6:
                raise NotTranslated(f"{time:g} s ({where}) is no multiple of {given:g} s (--dt)")
        return given
    parts = [Fraction(time).limit_denominator(10**7) for time in times]
    below = lcm(*(part.denominator for part in parts))
    common = Fraction(reduce(gcd, (int(part * below) for part in parts)), below)
    nearest = min(times)
    if common == Fraction(nearest).limit_denominator(10**7):
        return nearest  # its own bits
    if common * 10**5 < max(parts):
        several = ", ".join(f"{time:g} s ({where})" for time, where in sorted(times.items()))
        raise NotTranslated(f"these periods have no common one: {several}")
    return float(common)


def inherited(declared: Mapping[Key, Rate], sources: Mapping[Key, Set[Key]]) -> dict[Key, Rate]:
    """Return the rates of all blocks that have one, `declared` or from the blocks in `sources` that feed them."""
    rates = dict(declared)
    followers: dict[Key, list[Key]] = {}
    for key, feeding in sources.items():
        for one in feeding:
            followers.setdefault(one, []).append(key)
    waiting = deque(declared)
    while waiting:
        for key in followers.get(waiting.popleft(), ()):
            found = [rates[one] for one in sources[key] if one in rates]
            fastest = min(found)
            if any(one.divider % fastest.divider or (one.offset - fastest.offset) % fastest.divider for one in found):
                fastest = BASE
            if key not in declared and (faster := min(fastest, rates.get(key, fastest))) != rates.get(key):
                rates[key] = faster
                waiting.append(key)
    return rates


@dataclass(frozen=True)
class ReportLine:
    """A line of the report: block path, its kind, what became of it, and why."""

    path: str
    kind: str
    status: str
    """`imported`, `approximated`, `dropped`, `refused`, or `not reached`: it hangs on what is refused."""
    why: str = ""


class Connections:
    """The sheets of a model by path, their blocks by path and identifier, and what was found of them so far."""

    def __init__(self, model: Model, path: str) -> None:
        self.model, self.path = model, model.place(path)
        self.notes = list[str]()
        self.iterated = dict[str, Iteration]()
        """How systems at these paths are iterated."""
        self.report: list[ReportLine] = []
        self.defaults = {self.path: model.defaults}
        self.sheets: dict[str, Sheet] = {}
        self.conditions: dict[str, list[Activation]] = {}
        self.beyond: dict[tuple[str, str], Output] = {}
        """Outputs that lead into a sheet from another one, by its path and the name of the input made for them."""
        self.acting: dict[tuple[str, str], tuple[int, tuple[str, ...]]] = {}
        """Inputs made for a sheet that say whether what drives another of its inputs acts: its number, the element."""
        self.rates: dict[tuple[str, str], Rate] = {}
        self.held: dict[tuple[str, str], Rate] = {}
        """Rates of Rate Transitions whose input is slower."""
        self.blocks: dict[tuple[str, str], SimulinkBlock] = {}
        self.made: dict[tuple[str, str], Made] = {}
        self.signals: dict[Output, Signal] = {}
        self.approximated: dict[tuple[str, str], list[str]] = {}

    def _try(self, key: tuple[str, str], step: Callable[[], None]) -> None:
        """Take a step of the translation of a block; refuse the block where that fails."""
        try:
            step()
        except (NotTranslated, NotComputed, DiagramError) as reason:
            self._refuse(key, reason.what if isinstance(reason, DiagramError) else str(reason))

    def _source(self, path: str, pin: Pin) -> Output | None:
        """Return the output that drives an input on its sheet, through Goto and From; None where nothing does."""
        sheet = self.sheets[path]
        for _ in range(200):
            source = sheet.sources.get(pin)
            if source is None or source.kind != "out" or source.sid not in sheet.system.blocks:
                return None
            block = sheet.system.blocks[source.sid]
            if block.commented:
                if block.values["Commented"] != "through":
                    return None
                pin = Pin(source.sid, "in", source.number)
            elif block.type in ROUTED:
                pin = Pin(source.sid, "in", ROUTED[block.type]({**block.values, **block.instance}))
            elif block.type == "From":
                path, goto = self._goto(path, block.values.get("GotoTag", "A"))
                sheet, pin = self.sheets[path], Pin(goto, "in", 1)
            else:
                return path, source.sid, source.number
        raise NotTranslated("From and Goto blocks lead in a circle")

    def _goto(self, path: str, tag: str) -> tuple[str, str]:
        """Return the Goto of a tag: that of the sheet, else one that is seen from it, scoped or global."""
        gotos = [(path, sid) for sid in self.sheets[path].tagged.get(("Goto", tag), [])]
        if not gotos:
            scopes = [at for at in self.sheets if self.sheets[at].tagged.get(("GotoTagVisibility", tag))]
            scopes = [at for at in scopes if f"{path}/".startswith(f"{at}/".lstrip("/"))]
            for at, sheet in self.sheets.items():
                for sid in sheet.tagged.get(("Goto", tag), []):
                    seen = sheet.system.blocks[sid].values.get("TagVisibility", "local")
                    scoped = scopes and f"{at}/".startswith(f"{max(scopes, key=len)}/".lstrip("/"))
                    gotos += [(at, sid)] if seen == "global" or (seen == "scoped" and scoped) else []
        if len(gotos) != 1:
            raise NotTranslated(f"{len(gotos)} Goto blocks with the tag {tag} are seen from this system")
        return gotos[0]

    def _label(self, path: str, pin: Pin) -> str:
        """Return the name of the signal at an input: of its line, or of the element that a BusSelector takes out.

        Where a line has none, that of the line into an Outport of the subsystem that it leaves counts, or of the line
        to the subsystem that it comes into. An output of a chart or a MATLAB Function names its line.
        """
        for _ in range(1000):
            sheet = self.sheets[path]
            source = sheet.sources.get(pin)
            block = None if source is None else sheet.system.blocks.get(source.sid)
            label = "" if source is None else sheet.labels.get(source, "").strip("<>")
            if label or source is None or block is None:
                return label
            if block.kind in CODED and block.system is not None:
                outputs = (one for one in block.system.blocks.values() if one.type == "Outport")
                return next((collapsed(one.name) for one in outputs if port_number(one) == source.number), "")
            inner = below(path, block)
            if inner in self.sheets and self._is_system(block):
                path, sid = inner, self.sheets[inner].ports.get(("Outport", source.number))
                pin = Pin(sid or "", "in", 1)
            elif block.type == "Inport" and sheet.owner is not None:
                path, pin = sheet.owner[0], Pin(sheet.owner[1], "in", port_number(block))
            else:
                return ""
        return ""

    def _origin(self, path: str, pin: Pin) -> Output | None:
        """Return the output of a block that drives an input, out of and into subsystems; None where nothing does."""
        return self._resolved(self._source(path, pin))

    def _resolved(self, source: Output | None) -> Output | None:
        """Return the output of a block that is behind that of a subsystem or an Inport; None where nothing is."""
        for _ in range(1000):
            if source is None:
                return None
            path, sid, output = source
            sheet = self.sheets[path]
            block = sheet.system.blocks[sid]
            inner = below(path, block)
            if inner in self.sheets and self._is_system(block):
                port = self.sheets[inner].ports.get(("Outport", output))
                source = None if port is None else self._source(inner, Pin(port, "in", 1))
            elif block.type in ("Inport", "InportShadow") and sheet.owner is not None:
                source = self._source(sheet.owner[0], Pin(sheet.owner[1], "in", port_number(block)))
            elif block.type == "EnablePort" and sheet.owner is not None:  # it shows what enables its subsystem
                source = self._source(sheet.owner[0], Pin(sheet.owner[1], "enable", 1))
            else:
                return source
        raise NotTranslated("subsystems lead in a circle")

    def _type(self, path: str, pin: Pin) -> Signal | None:
        """Return the type of what drives an input: of nothing a scalar 0; None where it is not known yet."""
        origin = self._origin(path, pin)
        return Signal() if origin is None else self.signals.get(origin)

    @staticmethod
    def _is_system(block: SimulinkBlock) -> bool:
        return block.type in ("SubSystem", "Reference", "ModelReference") and block.kind not in _TRANSLATED

    def _inputs(self, key: tuple[str, str]) -> list[Pin]:
        block = self.blocks[key]
        least = max(self.sheets[key[0]].inputs.get(key[1], 0), INPUTS.get(block.type, 1))
        count = least if block.ports is None else block.ports[0]
        return [Pin(key[1], "in", k + 1) for k in range(count)]

    def _memory(self, key: tuple[str, str]) -> tuple[str, str] | None:
        """Return the Data Store Memory that a block reads or writes: the nearest one of its name."""
        path: str | None = key[0]
        while path is not None:
            sheet = self.sheets[path]
            for sid, block in sheet.system.blocks.items():
                if block.type == "DataStoreMemory" and store_name(block) == store_name(self.blocks[key]):
                    return path, sid
            path = None if sheet.owner is None else sheet.owner[0]
        return None

    def _writers(self, memory: tuple[str, str]) -> int:
        """Return how many blocks write a Data Store Memory."""
        writing = (one for one, b in self.blocks.items() if b.type == "DataStoreWrite" and not b.commented)
        return sum(self._memory(one) == memory for one in writing)

    def _rate(self, key: tuple[str, str]) -> Rate | None:
        """Return the rate at which a block's output changes; None of a constant."""
        block = self.blocks[key]
        if block.type in ("Inport", "InportShadow"):
            return BASE
        return None if block.type in ("Constant", "Ground") else self.held.get(key) or self.rates.get(key, BASE)

    def _refuse(self, key: tuple[str, str], why: str) -> None:
        self._line(*key, "refused", why)
        self.made[key] = Made(None, [])

    def _line(self, path: str, sid: str, status: str, why: str) -> None:
        block = self.blocks[path, sid]
        self.report.append(ReportLine(below(path, block), block.kind, status, why))


def active_choice(block: SimulinkBlock, names: dict[str, Value]) -> SimulinkBlock:
    """Return the active choice of a variant: by its label, or the one whose condition is true."""
    inside = block.system.blocks.values() if block.system is not None else ()
    choices = [one for one in inside if one.type not in ("Inport", "Outport") and not one.commented]
    label = block.values.get("LabelModeActiveChoice", block.values.get("LabelModeActivechoice", ""))
    active = []
    for one in choices:
        condition = one.values.get("VariantControl", "")
        if label:
            held = condition == label
        elif condition in ("(default)", ""):
            continue
        else:
            try:
                held = bool(np.all(number(evaluate(condition, names))))
            except DiagramError as reason:
                raise NotTranslated(f"condition of the choice {collapsed(one.name)}: {reason.what}") from None
        active += [one] * held
    active = active or [one for one in choices if one.values.get("VariantControl") == "(default)"]
    if len(active) != 1 or active[0].type not in ("SubSystem", "Reference", "ModelReference"):
        raise NotTranslated(
            f"{len(active)} choices of the variant are active: give their conditions' names by --workspace"
        )
    return active[0]


def shared_memory(blocks: Mapping[str, object]) -> Iterator[ReportLine]:
    """Refuse the functions, by path, that assign a name of the base workspace which another one uses."""
    found = {path: one for path, one in blocks.items() if isinstance(one, MatlabFunction) and one.code.touched}
    for path, one in found.items():
        others = set[str]().union(*(other.code.touched for at, other in found.items() if at != path))
        if shared := sorted(others & {name.removeprefix(IN_BASE) for name in one.kept if name.startswith(IN_BASE)}):
            why = f"{shared[0]} of the base workspace is used by another block, too"
            yield ReportLine(path, "MATLABFcn", "refused", why)


def foreign(block: SimulinkBlock, folders: Sequence[Path]) -> str:
    """Return why a block has no rule: of a function in another language with the file that has its code."""
    name = collapsed(block.values.get("FunctionName", block.values.get("System", "")))
    if block.type not in ("S-Function", "M-S-Function", "MATLABSystem"):
        return f"the block type {block.kind} is not translated"
    if not any((one / f"{name}.{end}").is_file() for one in folders for end in ("m", "c", "cpp")):
        return f"the code of the {block.type} {name} is not found: a compiled or protected one is not read"
    return f"the {block.type} {name} is code of its own: draw it as blocks, or as a MATLAB Function"
