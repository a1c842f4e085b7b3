"""From a Simulink model, or one of its subsystems, to a diagram of the block language.

`import_system(model, path, workspace)` first finds the type of each signal, from the sources on, then writes a diagram
for each system. What cannot be translated is refused with its path and parameter, all at once; nothing is guessed. A
report says for each block whether it was imported, approximated, dropped or refused.
"""

import re
from collections import deque
from collections.abc import Mapping, MutableMapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from twodof.blocks import Diagram
from twodof.blocks.bus import Bus, leaves_of
from twodof.blocks.diagram import BASE, Rate
from twodof.blocks.enumeration import Kind
from twodof.blocks.library import DataStore, StoreRead, StoreWrite
from twodof.errors import DiagramError
from twodof.slx.arithmetic import with_units
from twodof.slx.blocks import DROPPED, RULES, carried_out
from twodof.slx.bus_ports import with_bus_ports, with_each, with_inputs, with_iterated, with_ports, with_recorded
from twodof.slx.chart import declared_buses, function_rule
from twodof.slx.conditions import CONTROL_PORTS, ITERATED, conditions_of, without_events
from twodof.slx.connections import (
    CONTINUOUS,
    EVERY_SECOND,
    PASSING,
    STORES,
    Key,
    Output,
    ReportLine,
    active_choice,
    base_period,
    foreign,
    inherited,
    shared_memory,
    store_name,
)
from twodof.slx.data_types import SINGLE, in_single, kind_of, sized, value_of
from twodof.slx.dictionary import dictionary, enumerations
from twodof.slx.dynamic_blocks import STATEFUL
from twodof.slx.inspection import OWN_LIBRARIES, library_file, needed_files
from twodof.slx.matlab.function_block import last_index
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.script import run
from twodof.slx.matlab.values import NotComputed, Value, as_array, number
from twodof.slx.model import (
    CODED,
    COMPUTED,
    Model,
    Pin,
    SimulinkBlock,
    SimulinkChart,
    System,
    below,
    collapsed,
    escaped,
    one_spaced,
    read_model,
    source_file,
    split_path,
)
from twodof.slx.network import with_solved_loops
from twodof.slx.precision import ROUTES, precise
from twodof.slx.sheet import (
    BACKWARDS,
    KEEPS_TYPE,
    Sheet,
    argument,
    bus_wanted,
    ends,
    siblings,
    type_declared,
    type_text,
    width_wanted,
)
from twodof.slx.toolbox_blocks import TOOLBOXES
from twodof.slx.translation import TYPES, Asked, Made, NotTranslated, Rule, Signal
from twodof.slx.wiring import Wiring, safe

MOST_GUESSES = 12
"""How often the types of loops are guessed anew."""
_BUS_ENDS = {"BusAssignment", "BusCreator", "BusSelector", "Inport", "Outport"}
_SINGLE = "single: computed in the precision of the build"


@dataclass
class Imported:
    """Result of an import: the diagram (None if something was refused), its period [s] and the report."""

    diagram: Diagram | None
    dt: float
    report: list[ReportLine]
    notes: list[str] = field(default_factory=list)

    @property
    def refused(self) -> list[ReportLine]:
        """The lines of what cannot be translated."""
        return [line for line in self.report if line.status == "refused"]


def import_system(
    model: Model,
    path: str = "",
    workspace: Mapping[str, Value] | None = None,
    folders: Sequence[Path] = (),
    dt: float | None = None,
    otherwise: float | None = None,
) -> Imported:
    """Translate the system at `path` ("": the whole model). `workspace` has the names that the model takes.

    Libraries are looked for in `folders`. `dt` is the period [s]; None takes it from the blocks' sample times, or from
    the model's fixed step, and `otherwise` where they say none. Raises DiagramError for a path that does not exist, and
    where nothing says the period.
    """
    return _Import(model, path, dict(workspace or {}), folders, dt, otherwise).run()


class _Import(Wiring):
    def __init__(
        self,
        model: Model,
        path: str,
        workspace: dict[str, Value],
        folders: Sequence[Path],
        dt: float | None,
        otherwise: float | None,
    ) -> None:
        super().__init__(model, path)
        self.folders, self.given_dt, self.otherwise = folders, dt, otherwise
        self.libraries: dict[str, Model | None] = {one.name: one for one in needed_files(model, folders)}
        self.library_blocks: dict[str, dict[str, SimulinkBlock]] = {}
        texts = (text for one in self.libraries.values() if one is not None for text in one.texts())
        self.names = {**enumerations(texts, folders), **self._names_of(model), **workspace}
        self.names_of: dict[str, dict[str, Value]] = {}
        self.referenced: dict[str, dict[str, Value]] = {}
        self.times: dict[Key, tuple[float, float]] = {}
        self.taken: dict[Key, str] = {}
        """Data types that blocks take from behind, where a pass saw them too late."""
        self.code = {one.path: one for one in model.charts}

    def _names_of(self, model: Model) -> dict[str, Value]:
        """Return the names that a model's dictionary and callbacks give."""
        names: dict[str, Value] = {}
        try:
            names.update(dictionary(model.dictionary, self.folders))
        except DiagramError as reason:
            self.notes.append(str(reason))
        names.update(enumerations(model.texts(), self.folders))
        if {"single", "double"} <= {block.values.get("OutDataTypeStr") for _, block in model.blocks()}:
            names[SINGLE] = True  # they are mixed: each has its own precision
        for callback in ("PreLoadFcn", "PostLoadFcn", "InitFcn"):
            for skipped in run(model.callbacks.get(callback, ""), names, self.folders):
                self.notes.append(f"{model.name}, {callback}, line {skipped.line}: {skipped.why}")
        return names

    def run(self) -> Imported:
        system, names = with_ports(self.model.system(self.path), self.notes), self._names_at(self.path)
        self._collect(self.path, system, names, None)
        self.dt = self._period()
        for key, block in self.blocks.items():
            if block.type in ("Inport", "InportShadow") and key[0] == self.path:
                self._try(key, partial(self._inport, key, block))
        self._rates()
        self._infer()
        self.report += shared_memory({below(at, self.blocks[at, k]): one.item for (at, k), one in self.made.items()})
        if any(leaf.kind == "float64" for one in self.signals.values() for leaf in leaves_of(one.port("signal"))):
            self.notes.append("64-bit whole numbers are held as doubles: exact up to 2^53, without a wrap or a limit")
        imported = Imported(None, self.dt, self.report, self.notes)
        if not imported.refused:
            diagram = self._diagram(self.path)
            with suppress(DiagramError):  # what is wrong with it is said when it is compiled
                self.notes += with_solved_loops(diagram)
            imported.diagram = None if imported.refused else diagram  # some things only the connections show
        self.report.sort(key=lambda line: "refused, not reached, approximated, dropped, imported".index(line.status))
        return imported

    # --- what there is

    def _names_at(self, path: str) -> dict[str, Value]:
        """Return the names that a system's blocks may use: those of the masks around it win."""
        names, at = dict(self.names), ""
        for part in split_path(path) if path else []:
            block = next(b for b in self.model.system(at).blocks.values() if escaped(b.name) == part)
            names = self._inside(block, {}, names)
            at = f"{at}/{part}".lstrip("/")
        return names

    def _inside(self, block: SimulinkBlock, given: Mapping[str, str], names: dict[str, Value]) -> dict[str, Value]:
        """Return the names inside a masked block, which has values `given` by a link."""
        if block.mask is None:
            return names
        inner: MutableMapping[str, Value] = {}
        for name, (kind, text) in block.mask.parameters.items():
            said = given.get(name, text)
            try:
                inner[name] = evaluate(said, names, name) if kind in COMPUTED else said
            except DiagramError:  # who asks for it is refused
                if kind == "promote":  # of a choice
                    inner[name] = said
        run(block.mask.initialization, inner, self.folders)
        own = ", ".join(f"{name} = {text}" for name, text in block.mask.computed.items() if name not in given)
        if own and self.model.kind == "library":
            self.notes.append(f"{collapsed(block.name)}: has the values of its mask in the library: {own}")
        return {**names, **inner}

    def _collect(self, path: str, system: System, names: dict[str, Value], owner: Key | None, depth: int = 0) -> None:
        if depth > 40:
            raise DiagramError("libraries hold each other", f"{self.model.name}/{path}", "break the loop of links")
        recorded = list[SimulinkBlock]()
        system = with_recorded(system, recorded, path) if path != self.path else system
        system = with_bus_ports(with_units(without_events(system, self.notes, path)))
        if recorded:  # of a library, or of a referenced model
            top = self.sheets[self.path]
            self.sheets[self.path] = Sheet(with_inputs(top.system, recorded, self.notes), top.names, top.owner)
            added = self.sheets[self.path].system.blocks
            self.blocks |= {(self.path, sid): block for sid, block in added.items()}
        inside: list[tuple[str, str, System, SimulinkBlock]] = []
        for sid, block in system.blocks.items():
            at = below(path, block)
            try:
                linked = block if block.commented else self._linked(block, at)
                inner, masked = (None, block) if block.commented else self._body(linked, names, at, system)
            except (NotTranslated, DiagramError) as reason:
                why = reason.what if isinstance(reason, DiagramError) else str(reason)
                self.report.append(ReportLine(at, block.kind, "refused", why))
                linked, inner = block, None
            self.blocks[path, sid] = system.blocks[sid] = linked
            if inner is not None:
                inside.append((at, sid, inner, masked))
        self.sheets[path] = Sheet(system, names, owner)
        if path not in self.defaults and owner is not None:
            self.defaults[path] = self.defaults[owner[0]]
        try:
            self.conditions[path] = conditions_of(self.sheets[path].system)
        except NotTranslated as reason:
            self.report.append(ReportLine(path, "SubSystem", "refused", str(reason)))
        for at, sid, inner, masked in inside:
            block = system.blocks[sid]
            own = self._inside(masked, {**block.values, **block.instance}, self.referenced.get(at, names))
            self._collect(at, inner, own, (path, sid), depth + 1)

    def _linked(self, block: SimulinkBlock, at: str) -> SimulinkBlock:
        """Return the block of a library that a link stands for, with what the link gives it; else the block itself."""
        for _ in range(20):
            library, _, inside = one_spaced(block.values.get("SourceBlock", "")).partition("/")
            if block.type != "Reference" or (library in (*OWN_LIBRARIES, *TOOLBOXES) and block.kind in RULES):
                return block
            if library in OWN_LIBRARIES:
                raise NotTranslated(f"the library block {library}/{inside} is not translated")
            found = self._library(library).get(inside)
            if found is None:
                raise NotTranslated(f"the library {library} has no block {inside}")
            self._take_code(library, inside, at)
            instance = {**found.instance, **block.instance}
            if found.mask is not None:
                instance |= {name: block.values[name] for name in found.mask.parameters if name in block.values}
            place = {key: text for key, text in block.values.items() if key in ("Position", "Orientation")}
            block = replace(
                found,
                name=block.name,
                sid=block.sid,
                values={**found.values, **place},
                instance=instance,
                ports=block.ports or found.ports,
            )
        raise NotTranslated("libraries link to each other in a circle")

    def _body(
        self, block: SimulinkBlock, names: dict[str, Value], at: str, around: System
    ) -> tuple[System | None, SimulinkBlock]:
        """Return what is inside a block, and who has its mask: itself, or a variant's active choice."""
        if block.kind in CODED:
            return None, block
        if block.kind in ("State Transition Table", "Truth Table"):
            raise NotTranslated(f"a {block.kind} is not translated")
        if block.values.get("Variant", "off") == "on":
            choice = active_choice(block, names)
            inside = f"{below(at, choice)}/"  # its code stands in place of the variant's
            own = [path for path in self.code if path.startswith(inside)]
            self.code |= {f"{at}/{path.removeprefix(inside)}": self.code[path] for path in own}
            return self._body(self._linked(choice, at), names, at, around)
        if block.type == "SubSystem" and (file := block.values.get("ReferencedSubsystem", "")):
            self._take_code(file, "", at)
            return self._file(file).root, block
        if block.type == "ModelReference":
            return self._referenced(block, names, at), block
        system = block.system
        if system is not None and any(one.type == "ForEach" for one in system.blocks.values()):
            system, copies = with_each(system, names, around, block)
            self._copy_code(at, copies)
        elif system is not None and any(one.type in ITERATED for one in system.blocks.values()):
            system, self.iterated[f"{at}/turn"] = with_iterated(system, names)
            self._copy_code(at, ["turn"])
        return system, block

    def _copy_code(self, at: str, copies: Sequence[str]) -> None:
        """Let the MATLAB Functions and charts of a system be those of the subsystems that stand for it inside."""
        within = {path.removeprefix(at): one for path, one in self.code.items() if path.startswith(f"{at}/")}
        self.code |= {f"{at}/{copy}{path}": one for copy in copies for path, one in within.items()}

    def _referenced(self, block: SimulinkBlock, names: dict[str, Value], at: str) -> System:
        """Return the top of the model that a block refers to. It sees the workspace and its arguments, no masks."""
        file = source_file(block)
        model = self._file(file, "model")
        if model.kind != "model":
            raise NotTranslated(f"{file} is a {model.kind}, not a model")
        if file not in self.names_of:
            self.names_of[file] = self._names_of(model)
        own = {**self.names_of[file], **self.names}
        arguments = [block.values.get(f"ParameterArgument{end}", "") for end in ("Names", "Values")]
        for name, text in zip(*(re.findall(r"[^,]+", one) for one in arguments), strict=False):
            own[name.strip()] = evaluate(text, names, name)
        self._take_code(file, "", at)
        self.referenced[at], self.defaults[at] = own, model.defaults
        return model.root

    def _file(self, name: str, what: str = "library") -> Model:
        """Return the model of a library, of a subsystem that has a file of its own, or of a referenced model."""
        if name not in self.libraries:
            file = library_file(name, self.folders)
            self.libraries[name] = None if file is None else read_model(file)
        found = self.libraries[name]
        if found is None:
            raise NotTranslated(f"the {what} {name} is not found: name its folder with --path")
        return found

    def _library(self, name: str) -> dict[str, SimulinkBlock]:
        """Return the blocks of a library by path."""
        if name not in self.library_blocks:
            self.library_blocks[name] = dict(self._file(name).blocks())
        return self.library_blocks[name]

    def _take_code(self, library: str, inside: str, at: str) -> None:
        """Let the MATLAB Functions and charts of a library's block be those of the block at a path."""
        for one in self._file(library).charts:
            if f"{one.path}/".startswith(f"{inside}/".lstrip("/")):
                self.code[f"{at}/{one.path[len(inside) :].lstrip('/')}".strip("/")] = one

    def _period(self) -> float:
        """Return the base period [s], and note the blocks' own times. Raises DiagramError where there is none."""
        found: dict[float, str] = {}
        for key, block in self.blocks.items():
            values = self._values(key)
            wanted = {"RateTransition": "OutPortSampleTime", "Random Source": "SampTime"}.get(block.kind, "SampleTime")
            text = values.get(wanted, "1" if block.type in EVERY_SECOND else "-1")
            timed = block.type == "DiscretePulseGenerator" and values.get("PulseType", "Sample based") == "Time based"
            silent = timed or block.commented or block.type in (*DROPPED, *CONTROL_PORTS)
            if text in ("-1", "inf", "[-1, 0]", "") or silent:
                continue
            where = below(key[0], block)
            try:
                time = number(evaluate(text, self.sheets[key[0]].names, "SampleTime")).astype(float).flatten()
            except (DiagramError, AttributeError) as reason:
                why = reason.what if isinstance(reason, DiagramError) else "is not a number"
                self.report.append(ReportLine(where, block.kind, "refused", f"parameter SampleTime: {why}"))
                continue
            if time.size and 0 <= time[0] < float("inf"):
                self.times[key] = (float(time[0]), float(time[1]) if time.size > 1 else 0.0)
                found |= {one: where for one in self.times[key] if one > 0.0 and one not in found}
        if (start := self.model.solver.get("StartTime", "0.0")).strip("0."):
            self.notes.append(f"StartTime = {start} is not taken: time begins at 0")
        step = self.model.solver.get("FixedStep", "auto")
        if not found or any(block.type in CONTINUOUS for block in self.blocks.values()):
            try:
                found.setdefault(float(number(evaluate(step, self.names, "FixedStep")).flat[0]), "the fixed step")
            except (DiagramError, AttributeError):
                if not found and self.given_dt is None and self.otherwise is not None:
                    self.notes.append(f"the model says no period: {self.otherwise:g} s is taken")
                    return self.otherwise
                if not found and self.given_dt is None:
                    what = f"no block and no fixed step ({step}) says the period"
                    raise DiagramError(what, self.model.name, "give --dt SECONDS, or --workspace FILE") from None
        try:
            return base_period({time: where for time, where in found.items() if time > 0.0}, self.given_dt)
        except NotTranslated as reason:
            self.report.append(ReportLine("", "sample times", "refused", str(reason)))
            return min(found)

    def _rates(self) -> None:
        """Find the rate of each block: its own, or that of its inputs."""
        declared: dict[Key, Rate] = {}
        for key, (time, offset) in self.times.items():
            if self.blocks[key].type != "Constant":
                divider = max(round(time / self.dt), 1)
                declared[key] = Rate(divider, round(offset / self.dt) % divider)
        sources: dict[Key, set[Output]] = {}
        for key, block in self.blocks.items():
            if block.type in CONTINUOUS:
                declared[key] = BASE
            if block.type not in PASSING and not self._is_system(block) and not block.commented:
                with suppress(NotTranslated):  # refused with the types
                    self._await(key, sources)
        feeding = {key: {one[:2] for one in found} for key, found in sources.items()}
        for key, found in feeding.items():  # a Rate Transition without a time has that of what it feeds
            for one in found:
                if self.blocks[one].type == "RateTransition" and one not in self.times and key in declared:
                    declared[one] = min(declared[key], declared.get(one, declared[key]))
        for key, block in self.blocks.items():  # an input without a time has that of what it feeds, if it is one
            if block.type == "Inport" and key[0] == self.path and key not in declared:
                fed = {declared.get(one) for one, found in feeding.items() if key in found}
                declared[key] = next(iter(fed)) or BASE if len(fed) == 1 else BASE
        self.rates = inherited(declared, feeding)

    def _values(self, key: Key) -> dict[str, str]:
        """Return a block's values as text: those of its file's defaults, its own, and what a link gives."""
        block = self.blocks[key]
        values = {**self.defaults[key[0]].get(block.type, {}), **block.values, **block.instance}
        chart = self.code.get(below(key[0], block)) if block.kind == "Chart" else None
        if chart is not None and chart.form is not None and chart.form["values"].get("updateMethod") == "DISCRETE":
            values["SampleTime"] = chart.form["values"].get("sampleTime", "-1")
        return values

    # --- the types of the signals

    def _inport(self, key: Key, block: SimulinkBlock) -> None:
        names = self.sheets[key[0]].names
        said = collapsed(block.values.get("OutDataTypeStr", "Inherit: auto"))
        if said.startswith("Inherit") and (wanted := type_declared(self.sheets, *key, self.code)):
            self.approximated.setdefault(key, []).append(f"inherits its type: taken for {wanted}, declared behind it")
            said = wanted
        kind: Kind = "real" if said.startswith("Inherit") else kind_of(said, names)
        if said.startswith("Inherit") and (bus := bus_wanted(self.sheets, *key, self.code, self.folders)) is not None:
            self.approximated.setdefault(key, []).append("inherits its type: taken for a bus of what is selected of it")
            self.signals[*key, 1] = Signal(bus)
            return
        size = evaluate(block.values.get("PortDimensions", "-1"), names, "PortDimensions")
        elements = [int(n) for n in as_array(number(size)).flatten()]
        if block.values.get("OutputFunctionCall", "off") == "on":
            self.approximated.setdefault(key, []).append("a call is true for the step in which it is made")
            self.signals[*key, 1] = Signal("bool")
            return
        if said == "single" and SINGLE not in self.names:
            self.approximated.setdefault(key, []).append(_SINGLE)
        if elements == [-1]:
            elements = [1 if isinstance(kind, Bus) else width_wanted(self.sheets, *key, self.code, self.folders)]
            if elements != [1] or said.startswith("Inherit"):
                shape = f"a vector of {elements[0]} {kind}" if elements != [1] else f"a scalar {kind}"
                shape = shape.replace("real", "doubles" if elements != [1] else "double")
                self.approximated.setdefault(key, []).append(f"inherits its type: taken for {shape}")
        elif said.startswith("Inherit"):
            self.approximated.setdefault(key, []).append("inherits its type: taken for double")
        if len(elements) == 2 and elements[0] == 1 < elements[1]:
            self.approximated.setdefault(key, []).append("a row is taken for a vector, which is a column in a product")
        self.signals[*key, 1] = sized(kind, elements)

    def _infer(self) -> None:
        """Find the types of all signals. In a loop that of a state is guessed, and all found anew if that was wrong."""
        lines, signals, approximated = len(self.report), dict(self.signals), deepcopy(self.approximated)
        made, guessed = dict(self.made), dict[Key, Signal]()
        for _ in range(MOST_GUESSES):
            wrong = self._pass(guessed)
            if not wrong:
                return
            guessed |= wrong
            del self.report[lines:]
            self.signals, self.made, self.approximated = dict(signals), dict(made), deepcopy(approximated)
        self._pass(guessed)

    def _pass(self, guessed: Mapping[Key, Signal]) -> dict[Key, Signal]:
        """Translate each block when the types of its inputs are known, from the sources on.

        Return the types of the states in loops that turned out to be others than `guessed`.
        """
        waiting: dict[Key, set[Output]] = {}
        behind: dict[Output, list[Key]] = {}
        for key, block in self.blocks.items():
            if block.type not in PASSING and not self._is_system(block) and not block.commented:
                self._try(key, partial(self._await, key, waiting))
        for key, origins in waiting.items():
            for origin in origins:
                behind.setdefault(origin, []).append(key)
        outputs: dict[Key, list[Output]] = {}
        for origin in behind:
            outputs.setdefault(origin[:2], []).append(origin)
        reached = self.signals.keys() | {origin for origin in behind if origin[:2] in waiting}
        self._leave([origin for origin in behind if origin not in reached], waiting, behind, outputs)
        ready = deque(key for key, origins in waiting.items() if not origins - self.signals.keys())
        broken, wrong = dict[Key, Signal](), dict[Key, Signal]()
        assumed, early = False, list[Key]()

        def follow(key: Key, count: int) -> None:
            found = [(*key, k + 1) for k in range(count)]
            after = [one for output in found for one in behind.get(output, []) if one in waiting]
            ready.extend(one for one in after if not waiting[one] - self.signals.keys())

        while waiting:
            while ready:
                key = ready.popleft()
                if waiting.pop(key, None) is None:
                    continue
                self._translate(key)
                made = self.made[key].outputs
                left = [one for one in outputs.get(key, []) if one not in self.signals]
                if left and broken.keys() - guessed.keys():  # it may be refused for a wrong guess: go on to see that
                    self.signals |= self._assumed(key, left)
                    assumed, made = True, [Signal()] * len(left)
                self._leave([one for one in left if one not in self.signals], waiting, behind, outputs)
                if key in broken and self.made[key].outputs and not made[0].like(broken[key]):
                    wrong[key] = made[0]
                follow(key, len(made))
            # A loop is broken at the first block whose output may be known before its input.
            # What has no rule is refused there too, and without any such block the loop is an algebraic one.
            at = (key for key in waiting if self.blocks[key].type in STATEFUL and key not in broken)
            loop = next(at, None)
            if loop is None:
                # A block that takes its type from behind may wait for what itself drives.
                found = next((key for key in waiting if self._backwards(key) and self._known(key)), None)
                early += [found] if found is not None else []
                found = found or next((key for key in waiting if self.blocks[key].kind not in (*RULES, *CODED)), None)
                loop = self._in_circle(waiting, broken) if found is None else None  # also of a bus's elements
                if loop is None:
                    ready += [found] if found is not None else list(waiting)[:1]
                    continue
            broken[loop] = guessed.get(loop) or self._guess(loop, waiting, behind)
            self.signals[*loop, 1] = broken[loop]
            follow(loop, 1)
        if assumed and SINGLE in self.names:  # a double may be there for a block that was refused only
            wrong = {key: one for key, signal in wrong.items() if not (one := in_single(signal)).like(broken[key])}
        later = {key: said for key in early if (said := self._wanted(key)) and said != self.taken.get(key)}
        self.taken |= later
        return wrong or (broken if assumed else {}) or dict.fromkeys(later, Signal())

    def _assumed(self, key: Key, left: Sequence[Output]) -> dict[Output, Signal]:
        """Return the types of outputs that a refused block may have: the buses of its code, or that of an input."""
        block, code = self.blocks[key], self.code.get(below(key[0], self.blocks[key]))
        like = [] if block.type == "BusSelector" else self._inputs(key)  # not like its bus
        known = [one for pin in like if (one := self._type(key[0], pin)) is not None]
        buses = {} if code is None else declared_buses(code, self.sheets[key[0]].names)
        ports = block.system.ports("Outport") if block.system is not None else []
        declared = {(*key, k): Signal(buses[name]) for k, name in enumerate(ports, start=1) if name in buses}
        return {**dict.fromkeys(left, next(iter(known), Signal())), **declared}

    def _in_circle(self, waiting: Mapping[Key, set[Output]], broken: Mapping[Key, Signal]) -> Key | None:
        """Return a block with one output, not broken yet, of a circle of blocks that wait for each other."""
        at, seen = next(iter(waiting), None), list[Key]()
        while at is not None and at not in seen:
            seen.append(at)
            at = next((one[:2] for one in sorted(waiting[at] - self.signals.keys()) if one[:2] in waiting), None)
        circle = seen[seen.index(at) :] if at is not None else []
        return next((k for k in circle if k not in broken and (self.blocks[k].ports or (1, 1))[1] == 1), None)

    def _leave(
        self,
        left: list[Output],
        waiting: dict[Key, set[Output]],
        behind: Mapping[Output, list[Key]],
        outputs: Mapping[Key, list[Output]],
    ) -> None:
        """Leave out, as not reached, what hangs on outputs `left` without a type by a block that is refused."""
        while left:
            for key in behind.get(left.pop(), []):
                if waiting.pop(key, None) is not None:
                    self._line(*key, "not reached", "an input hangs on a block that is refused")
                    left += outputs.get(key, [])

    def _guess(self, key: Key, waiting: Mapping[Key, set[Output]], behind: Mapping[Output, list[Key]]) -> Signal:
        """Return the type that a state in a loop has by its initial value, or else by what it meets behind it."""
        ends_at = {block.type for _, _, block in ends(self.sheets, key[0], Pin(key[1], "out", 1))}
        bus = bus_wanted(self.sheets, *key, self.code, self.folders) if ends_at <= _BUS_ENDS else None
        real = "float32" if SINGLE in self.names else "real"  # where it is double, the next pass sees it
        if bus is not None:
            return in_single(Signal(bus)) if SINGLE in self.names else Signal(bus)
        values, said = self._values(key), ""
        if self.blocks[key].type == "DiscreteIntegrator":
            said = collapsed(values.get("OutDataTypeStr", "Inherit"))
        name = next((one for one in ("C", "InitialCondition", "X0") if one in values), "")
        size, shape = 1, None
        with suppress(DiagramError, NotComputed):
            found = as_array(number(evaluate(values.get(name, "0"), self.sheets[key[0]].names, name)))
            size = found.shape[0] if name == "C" else found.size
            shape = found.shape if name != "C" and 1 not in found.shape else None
        if size == 1 and name != "C":
            size = width_wanted(self.sheets, *key, self.code, self.folders, hops=0)  # a scalar may meet vectors there
        queue, seen = [key], {key}
        if said and not said.startswith("Inherit"):
            return Signal(kind_of(said, self.sheets[key[0]].names), size if size > 1 else None, shape)
        for at in queue:
            for one in behind.get((*at, 1), ()):
                if one in seen or one not in waiting or self.blocks[one].kind not in KEEPS_TYPE:
                    continue
                seen.add(one)
                queue.append(one)
                pins = [pin for pin in self._inputs(one) if self.blocks[one].type != "Switch" or pin.number != 2]
                sources = [source for pin in pins if (source := self._origin(one[0], pin)) in self.signals]
                met = [self.signals[source] for source in sources if source not in (None, (*at, 1))]
                if met:
                    return Signal(met[0].kind, size if size > 1 else None, shape)
        return Signal(real, size if size > 1 else None, shape)

    def _await(self, key: Key, waiting: dict[Key, set[Output]]) -> None:
        found = {self._origin(key[0], pin) for pin in self._inputs(key)}
        if self._backwards(key):
            beside = {self._origin(*one) for one in siblings(self.sheets, *key)}
            found |= {one for one in beside if one is not None and not self._backwards(one[:2])}
        waiting[key] = {one for one in found if one is not None and one[:2] != key}

    def _known(self, key: Key) -> bool:
        """Return True if the types of a block's inputs are known."""
        return all(self._type(key[0], pin) is not None for pin in self._inputs(key))

    def _backwards(self, key: Key) -> bool:
        """Return True for a block whose type is that of what is behind it."""
        block = self.blocks[key]
        default = BACKWARDS if block.type in ("DataTypeConversion", "Ground") else ""
        values = self._values(key)
        return values.get("OutDataTypeStr", default) == BACKWARDS and block.kind in RULES

    def _wanted(self, key: Key) -> str:
        """Return the data type of what is behind a block: declared, or that of what it meets there; "" without one."""
        declared = type_declared(self.sheets, *key, self.code, lambda at, pin: self._type(at, pin))
        if declared:
            return declared
        beside = (self._origin(*one) for one in siblings(self.sheets, *key))
        met = [one for one in beside if one is not None and one in self.signals]
        met.sort(key=lambda one: self._backwards(one[:2]))
        return type_text(self.signals[met[0]]) if met else ""

    def _translate(self, key: Key) -> None:
        """Translate a block; an input whose type is not known yet, in a loop, is taken for a scalar."""
        block, path = self.blocks[key], key[0]
        code = self.code.get(below(path, block))
        rule = function_rule(code) if block.kind in CODED else RULES.get(block.kind)
        rule = self._store(key) if block.type in STORES else rule

        def translate() -> None:
            if rule is None:
                raise NotTranslated(foreign(block, self.folders))
            pins = self._inputs(key)
            loose = [pin.number for pin in pins if self._origin(path, pin) is None]
            inputs = [
                self._undriven(code, block, pin) if pin.number in loose else self._type(path, pin) or Signal()
                for pin in pins
            ]
            values = self._values(key)
            labels = [self._label(path, pin) for pin in self._inputs(key)]
            if self._backwards(key) and (wanted := self._wanted(key) or self.taken.get(key)):
                values["OutDataTypeStr"] = wanted
            dt = self.dt * self.rates.get(key, BASE).divider
            real = [replace(one, kind="real") if one.kind == "float32" else one for one in inputs]
            taken = inputs if block.type in ROUTES else real
            names = self.sheets[path].names
            asked = Asked(block, path, values, names, [*taken], dt, labels, loose=loose, folders=self.folders)
            made = carried_out(asked, rule)
            made = precise(asked, made, inputs) if SINGLE in self.names else made
            if block.type == "RateTransition":
                made = self._transition(key, asked) or made
            self.made[key] = made
            self.signals.update({(*key, k + 1): signal for k, signal in enumerate(made.outputs)})
            single = asked.text("OutDataTypeStr") == "single" and SINGLE not in self.names
            notes = [*asked.notes, *([_SINGLE] * single)]
            notes += [f"nothing drives input {', '.join(map(str, loose))}: it is 0"] if loose and made.item else []
            self.approximated.setdefault(key, []).extend(notes)

        self._try(key, translate)

    def _undriven(self, code: SimulinkChart | None, block: SimulinkBlock, pin: Pin) -> Signal:
        """Return the type of an input that nothing drives: that of a chart's data, or as wide as its indices reach."""
        if code is None:
            return Signal()
        said = argument(code, block, pin.number).get("dataType", "Inherit")
        width = last_index(code.text, pin.number, self.folders) if code.function else 1
        return Signal(kind_of(said, self.names) if said in TYPES else "real", width if width > 1 else None)

    def _store(self, key: Key) -> Rule:
        """Return the rule of a block of a data store, whose memory stands on its sheet or on one around it."""
        block, memory = self.blocks[key], self._memory(key)
        name = store_name(block)

        def made(c: Asked) -> Made:
            if memory is None:
                raise NotTranslated(f"no Data Store Memory {name} is around it")
            values = {**self.defaults[memory[0]].get("DataStoreMemory", {}), **self.blocks[memory].values}
            said, names = values.get("OutDataTypeStr", "Inherit: auto"), self.sheets[memory[0]].names
            start = as_array(number(evaluate(values.get("InitialValue", "0"), names, "InitialValue")))
            kind = "real" if said.startswith("Inherit") else kind_of(said, names)
            said = values.get("Dimensions", "-1")
            size = as_array(number(evaluate(said, names, "Dimensions"))).astype(int).flatten().tolist()
            signal = sized(kind, list(start.shape) if size == [-1] else size)
            if signal.shape is not None or isinstance(kind, Bus) or c.text("DataStoreElements"):
                raise NotTranslated(f"a store of {signal}, or of elements of one, is not translated")
            if block.type == "DataStoreMemory":
                if (count := self._writers(key)) > 1:
                    raise NotTranslated(f"{count} blocks write it, and a store has one writer")
                return Made(DataStore(value_of(start, signal), kind, signal.width), [signal])
            c.notes.append("a store is read as it stood before the step")
            if block.type == "DataStoreRead":
                return Made(StoreRead(safe(f"store_{name}", set()), kind, signal.width), [signal])
            if not c.inputs[0].like(signal):
                raise NotTranslated(f"its input is {c.inputs[0]}, and the store {signal}")
            return Made(StoreWrite(safe(f"store_{name}", set()), kind, signal.width), [])

        return made
