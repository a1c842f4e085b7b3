"""A Stateflow chart as a MATLAB Function: `chart_code` writes the function that does what the chart does in a tick.

The chart's data are persistent variables, and so are the number of the active state in each state and the ticks since
a state was entered. In the first call the chart takes its default transitions only. In each other one, from the outside
in: the outer transitions of an active state in their order; if none leads to a state, its `during` action, its inner
transitions, and what is inside it. A transition's condition action acts as soon as its condition holds, also where the
way does not reach a state. Exit actions go from the inside out, entry actions from the outside in.

Graphical functions, and functions in MATLAB's language, see and change the chart's data.

Actions in C are read as MATLAB's where both mean the same. An event is a call of a subsystem, or a local one that is
sent to a parallel state, which acts at once, before the sender goes on; anything else is refused.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twodof.blocks.bus import Bus, grouped
from twodof.blocks.declarations import Port
from twodof.blocks.enumeration import Kind
from twodof.blocks.expressions.numbers import INTEGER_TYPES
from twodof.errors import DiagramError
from twodof.slx.data_types import kind_of
from twodof.slx.matlab.chart_text import AFTER, COMMENT, SEND, actions_of, label_of, matlab_of, without_strings
from twodof.slx.matlab.function_block import MatlabFunction, typed, zero_of
from twodof.slx.matlab.parser import names_in
from twodof.slx.matlab.program import IN_C, evaluate
from twodof.slx.matlab.values import Members, Value, as_array, number
from twodof.slx.model import SimulinkChart, System, collapsed
from twodof.slx.reader import parts_inside
from twodof.slx.translation import Asked, Made, NotTranslated, Rule, Signal

MOST_LINES = 4000
DEEPEST, MOST_JUNCTIONS = 12, 20
_CHANGED = re.compile(r"\bhasChanged(|From|To)\s*\(\s*(\w+)\s*(?:,([^(),]+))?\)")
_SECONDS = {"sec": 1.0, "msec": 1e-3, "usec": 1e-6}
_SENT = {"FUNCTION_CALL_EVENT": "{} = true", "EITHER_EDGE_EVENT": "due_{0} = due_{0} + 1"}
_SETTINGS = {
    "updateMethod": ({"INHERITED", "DISCRETE"}, "it is updated continuously"),
    "stateMachineType": ({"CLASSIC"}, "it is a Moore or Mealy machine"),
}
Form = Mapping[str, Any]
"""A part of a chart as the reader gives it: tag, id, name, values and the parts inside."""


@dataclass
class _Way:
    """A transition, or a part of one between junctions."""

    source: str
    target: str
    parent: "_State"
    order: int
    condition: str = ""
    action: str = ""
    at_end: str = ""
    events: frozenset[str] = frozenset()
    """The local events of which it waits for one."""


@dataclass(eq=False)
class _State:
    """A state, or the chart itself; `ways` are the transitions drawn in it."""

    id: str
    name: str
    parent: "_State | None"
    parallel: bool
    number: int = 0
    actions: dict[str, str] = field(default_factory=dict)
    children: list["_State"] = field(default_factory=list)
    ways: list[_Way] = field(default_factory=list)
    data: list["Form"] = field(default_factory=list)
    """Of a function: its arguments and results."""

    @property
    def active(self) -> str:
        return f"active_in_{self.id}"

    @property
    def since(self) -> str:
        return f"ticks_in_{self.id}"

    def chain(self) -> list["_State"]:
        """Return the states from the outermost to this one, without the chart."""
        return [] if self.parent is None else [*self.parent.chain(), self]


@dataclass
class ChartCode:
    """A chart as a MATLAB Function: its text, the names that it takes, and the kinds of its data.

    A function's own data are `function.name` there. `owners` say for each line of the text whose it is.
    """

    text: str
    known: dict[str, Value]
    declared: dict[str, Kind]
    owners: list[str]
    notes: list[str]


def chart_code(
    form: Form, inputs: Sequence[str], outputs: Sequence[str], names: Mapping[str, Value], dt: float, exact: bool
) -> ChartCode:
    """Translate a chart with these ports, in their order, for a period [s]. Raises NotTranslated, naming the part.

    `exact` says that all its inputs are doubles or logical: then arithmetic in C is that of MATLAB.
    """
    return _Chart(form, names, dt, exact).code(inputs, outputs)


class _Chart:
    def __init__(self, form: Form, names: Mapping[str, Value], dt: float, exact: bool) -> None:
        for setting, (known, why) in _SETTINGS.items():
            if form["values"].get(setting, next(iter(known))) not in known:
                raise NotTranslated(why)
        self.in_c = form["values"].get("actionLanguage", "") != "2"
        self.bits = form["values"].get("actionLanguage", "") == "1"
        self.wraps = form["values"].get("saturateOnIntegerOverflow", "0") == "0"
        self.afresh = form["values"].get("initializeOutput", "0") == "1"
        self.names, self.dt = names, dt
        typed = re.compile(r"Inherit|double|boolean")
        kinds = [one["values"].get("dataType", "double") for one in parts_inside(form) if one["tag"] == "data"]
        self.exact = exact and all(map(typed.match, kinds))
        self.at_start = form["values"].get("executeAtInitialization", "0") == "1"
        self.states: dict[str, _State] = {}
        self.junctions: set[str] = set()
        self.scripts: list[str] = []
        self.functions: list[_State] = []
        self.data: list[Form] = []
        self.calls: dict[str, str] = {}
        """The events that are outputs, with what sends them: true in the tick of a call, or one of the edges due."""
        self.events: list[str] = []
        """Its local events."""
        self.event = ""
        """The local event that the code written now processes."""
        self.busy: list[_State] = []
        """The states from which this event came."""
        self.asleep: set[_State] = set()
        """The parallel states that are not active, where those beside them are."""
        self.notes: list[str] = []
        self.root = _State("chart", "the chart", None, form["values"].get("decomposition") == "SET_CHART")
        self._read(form, self.root, 0)
        if self.calls:
            self._with_calls()
        self.data, written = without_strings(self.data)
        self._rewrite(written)
        self.scripts = [written(text, "a function in it") for text in self.scripts]
        for way in self._ways() if self.in_c else ():
            if re.search(r"(?<![=!<>~])=(?!=)", way.condition):
                raise NotTranslated(f"{_shown(way)}: an assignment in a condition")
        if self.in_c:
            self._from_c()
        called = [one["name"] for one in self.data] + [one.name for one in self.functions]
        if len(set(called)) < len(called):
            twice = next(one for one in called if called.count(one) > 1)
            raise NotTranslated(f"the name {twice} stands for two things in it")
        for way in self._ways():
            if unknown := sorted(way.events.difference(self.events)):
                raise NotTranslated(f"{_shown(way)}: the event {unknown[0]} is not translated")
            if way.target not in self.states and way.target not in self.junctions:
                raise NotTranslated(f"{_shown(way)}: it leads to no state")
            alike = [one for one in self._from(way.source) if way.source and one.order == way.order]
            if len({id(one.parent) if one.source in self.states else 0 for one in alike}) < len(alike):
                raise NotTranslated(f"{_shown(way)}: the order of the transitions is not in the file")
        onward = {one: {way.target for way in self._from(one)} & self.junctions for one in self.junctions}
        for _ in range(len(onward).bit_length()):
            onward = {one: found.union(*(onward[k] for k in found)) for one, found in onward.items()}
        self.circles = {one for one, found in onward.items() if one in found}
        """The junctions from which ways lead back to them."""
        sent = [one for one in self.calls.values() if one.endswith("true")]
        for way in self._ways():
            if way.target in self.circles and any(one in way.action for one in sent):
                raise NotTranslated(f"{_shown(way)}: a circle of junctions calls a subsystem")
        self.lines, self.owners = list[str](), list[str]()
        self.clocks: dict[str, _State] = {}
        self.watched: list[str] = []
        """The names of which a chart asks whether they have changed."""
        self.flags = 0

    # --- what is there

    def _read(self, form: Form, parent: _State, depth: int) -> None:
        if depth > DEEPEST:
            raise NotTranslated(f"{parent.name}: states lie more than {DEEPEST} deep")
        for part in form["inside"]:
            values = part["values"]
            if part["tag"] == "state" and values.get("isNoteBox", "0") != "1":
                self._read_state(part, parent, depth)
            elif part["tag"] == "transition":
                source, target = (values.get(f"{end}/SSID", values.get(f"{end}/id", "")) for end in ("src", "dst"))
                way = _Way(source, target, parent, int(values.get("executionOrder", "1")))
                way.condition, way.action, way.at_end, way.events = label_of(values.get("labelString", ""))
                parent.ways.append(way)
            elif part["tag"] == "junction":
                if values.get("type") == "HISTORY_JUNCTION":
                    raise NotTranslated(f"{parent.name}: a history junction is not translated")
                self.junctions.add(part["id"])
            elif part["tag"] == "event":
                name, scope = values.get("name", part["name"]), values.get("scope")
                if scope == "LOCAL_EVENT":
                    self.events.append(name)
                elif scope != "OUTPUT_EVENT" or values.get("trigger") not in _SENT:
                    raise NotTranslated(f"the event {name} is not translated")
                else:
                    self.calls[name] = _SENT[values["trigger"]].format(name)
            elif part["tag"] == "data" and values.get("scope") == "CONSTANT_DATA":
                alike = [one for one in self.data if one["name"] == part["name"] and one["values"] == values]
                self.data += [] if alike else [part]  # states may hold the same constant
            elif part["tag"] == "data":
                (parent.data if parent in self.functions else self.data).append(part)
        order = [one.number for one in parent.children]
        parent.children.sort(key=lambda one: one.number)
        if parent.parallel and len(set(order)) < len(order):
            raise NotTranslated(f"{parent.name}: the order of its parallel states is not in the file")
        for number_, child in enumerate(parent.children, start=1):
            child.number = number_
        parent.ways.sort(key=lambda way: way.order)

    def _read_state(self, part: Form, parent: _State, depth: int) -> None:
        values, label = part["values"], part["values"].get("labelString", "")
        kind = values.get("type", "OR_STATE")
        if kind == "FUNC_STATE" and "simulink/isSimulinkFcn" not in values:
            called = re.match(r"(?:[^=]*=)?\s*([A-Za-z]\w*)", label)
            made = _State(part["id"], called[1] if called else "?", None, False, actions={"head": collapsed(label)})
            self.functions.append(made)
            self._read(part, made, depth + 1)
            if "eml/script" in values:
                self.scripts.append(values["eml/script"])
                made.actions.clear()
            return
        name = re.match(r"\s*([A-Za-z]\w*)", label)
        if kind not in ("OR_STATE", "AND_STATE") or name is None:
            what = {"FUNC_STATE": "Simulink function", "GROUP_STATE": "box"}.get(kind, "state of another kind")
            raise NotTranslated(f"the {what} {label.strip()[:40]} is not translated")
        if not {"simulink/isActionSubsystem", "simulink/isComponent"}.isdisjoint(values):
            raise NotTranslated(f"the state {name[1]} is a Simulink subsystem or an atomic subchart: not translated")
        made = _State(part["id"], name[1], parent, values.get("decomposition") == "SET_STATE")
        made.number = int(values.get("executionOrder", len(parent.children) + 1 if kind == "OR_STATE" else 0))
        made.actions = actions_of(label[name.end() :], name[1])
        parent.children.append(made)
        self.states[made.id] = made
        self._read(part, made, depth + 1)

    def _with_calls(self) -> None:
        """Write a call of a subsystem, or an edge of an output, as an assignment."""
        if called := [name for name, sent in self.calls.items() if sent.endswith("true")]:
            self.notes.append(f"{', '.join(called)}: what is called acts once in a tick, after the chart")
        names = "|".join(self.calls)
        call = re.compile(rf"\bsend\s*\(\s*({names})\s*\)|(?<![\w.])({names})(?:\s*\(\s*\))?(?=\s*(?:[;,\n]|$))")
        self._rewrite(lambda text, _: call.sub(lambda found: self.calls[found[1] or found[2]], text))

    def _from_c(self) -> None:
        """Write conditions and actions in C as in MATLAB's language."""
        functions = {one.name for one in self.functions}
        functions |= {name for name, value in self.names.items() if isinstance(value, Members)}
        self._rewrite(lambda text, owner: matlab_of(text, functions, self.exact, self.bits, owner))

    def _rewrite(self, written: Callable[[str, str], str]) -> None:
        """Write all conditions and actions anew; each is given with its owner."""
        for way in self._ways():
            texts = (way.condition, way.action, way.at_end)
            way.condition, way.action, way.at_end = (written(text, _shown(way)) for text in texts)
        for state in self.states.values():
            state.actions = {name: written(text, f"{name} of {state.name}") for name, text in state.actions.items()}

    def _ways(self) -> Iterator[_Way]:
        for state in (self.root, *self.states.values(), *self.functions):
            yield from state.ways

    def _from(self, source: str) -> list[_Way]:
        return sorted((way for way in self._ways() if way.source == source), key=lambda way: way.order)

    # --- the text

    def code(self, inputs: Sequence[str], outputs: Sequence[str]) -> ChartCode:
        """Return the chart as a function of these inputs and outputs."""
        actions = {"chart", *(one.name for one in self.functions if one.actions)}
        known: dict[str, Value] = {IN_C: (actions, self.wraps)} if self.in_c else {}
        declared: dict[str, Kind] = {}
        kept, parameters, afresh = list[str](), list[str](), list[str]()
        for part in self.data:
            name, scope = part["name"], part["values"].get("scope", "LOCAL_DATA")
            if scope in ("OUTPUT_DATA", "LOCAL_DATA"):
                kept.append(name)
                declared[name] = self._kind(part)
                known[f"initial_{name}"] = self._initial(part, declared[name])
                afresh += [name] * (self.afresh and scope == "OUTPUT_DATA")
            elif scope == "CONSTANT_DATA":
                known[name] = self._initial(part, self._kind(part))
            elif scope == "PARAMETER_DATA":
                parameters.append(name)
                known[name] = self.names.get(name)
                if known[name] is None:
                    raise NotTranslated(f"the parameter {name} has no value: give it by --workspace")
                known[name] = number(known[name])
            elif scope != "INPUT_DATA":
                raise NotTranslated(f"the data {name} with {scope} is not translated")
        edges = [name for name, sent in self.calls.items() if not sent.endswith("true")]
        afresh += self.calls.keys() - edges
        for name in self.calls:
            kept.append(name)
            declared[name], known[f"initial_{name}"] = "bool", np.zeros((1, 1), bool)
        if missing := [name for name in outputs if name not in kept]:
            raise NotTranslated(f"the output {missing[0]} is not in the chart's data")
        step = self._block(lambda: self._children_act(self.root))
        first = self._block(lambda: self._begin(self.root))
        functions = list[tuple[str, str]]()
        for one in self.functions:
            functions += self._block(lambda one=one: self._function(one, known, declared))  # type: ignore[misc]
        containers = [one for one in (self.root, *self.states.values()) if one.children and not one.parallel]
        memory = [*(one.active for one in containers), *self.clocks, *(f"due_{name}" for name in edges)]
        head = [f"function [{', '.join(outputs)}] = chart({', '.join(inputs)})"]
        values = [f"{at}_{name}" for name in self.watched for at in ("before", "start")]
        head += [f"persistent {' '.join([*kept, *memory, *values, 'was_entered'])}", "if isempty(was_entered)"]
        head += [f"{name} = initial_{name};" for name in kept] + [f"{name} = 0;" for name in memory]
        head += [f"{at} = {at.partition('_')[2]};" for at in values]
        head += ["was_entered = true;"]
        again = [(f"{name} = initial_{name};", "") for name in afresh]
        clocks = [f"{name} = {name} + 1;" for name in self.clocks]
        clocks += [
            line for name in self.watched for line in (f"before_{name} = start_{name};", f"start_{name} = {name};")
        ]
        middle = [("else", ""), *again, *((line, "") for line in clocks), *step]
        if self.at_start:  # the chart is entered before the first tick, which acts as any other
            used = {name for line, _ in first for name in names_in(line)}
            if self.clocks or self.watched or used & set(inputs):
                raise NotTranslated("it executes at initialization, with after() or with inputs in its entry")
            middle = [("end", ""), ("if true", ""), *again, *step]
        unread = {f"{one.since} = 0;" for one in self.states.values()} - {f"{name} = 0;" for name in self.clocks}
        turned = (f"if due_{name} > 0, {name} = ~{name}; due_{name} = due_{name} - 1; end" for name in edges)
        text = [*((line, "") for line in head), *first, *middle, *((line, "") for line in ("end", *turned, "end"))]
        text = [one for one in text if one[0] not in unread]
        text += functions
        text += [(line, "a function in it") for script in self.scripts for line in [*script.splitlines()]]
        if len(text) > MOST_LINES:
            raise NotTranslated(f"it takes more than {MOST_LINES} lines")
        return ChartCode("\n".join(line for line, _ in text), known, declared, [owner for _, owner in text], self.notes)

    def _function(self, function: _State, known: dict[str, Value], declared: dict[str, Kind]) -> None:
        """Write a graphical function: its result is 0 where no way gives one. The data of a script have kinds only."""
        for part in function.data:
            scope, said = part["values"].get("scope", "LOCAL_DATA"), part["values"].get("dataType", "double")
            if not scope.startswith("FUNCTION_") and function.actions:
                raise NotTranslated(f"the data {part['name']} of {function.name} with {scope} is not translated")
            if not said.startswith("Inherit") and not said.startswith("Bus"):
                declared[f"{function.name}.{part['name']}"] = self._kind(part)
        if not function.actions:
            return
        self._say(f"function {function.actions['head']}", f"the function {function.name}")
        for part in function.data:
            if part["values"].get("scope") == "FUNCTION_OUTPUT_DATA":
                self._say(f"{part['name']} = initial_{function.name}_{part['name']};")
                known[f"initial_{function.name}_{part['name']}"] = self._initial(part, self._kind(part))
        self._flow([way for way in function.ways if not way.source], self._flag(), None, function)
        self._say("end")

    def _kind(self, part: Form) -> Kind:
        said = part["values"].get("dataType", "double")
        kind = "real" if said.startswith("Inherit") else kind_of(said, self.names)
        if kind == "float32":
            self.notes.append(f"{part['name']}: single is computed in the precision of the build")
            return "real"
        leaves = [one.kind for one in kind.leaves] if isinstance(kind, Bus) else [kind]
        if not {"float32", "float64"}.isdisjoint(leaves) or not all(isinstance(one, str) for one in leaves):
            raise NotTranslated(f"the data {part['name']} of type {said} is not translated")
        return kind

    def _begins_with_0(self, said: str) -> None:
        """Raise NotTranslated for a type with an enumeration whose default, the first member, is not 0."""
        name = said.rpartition(":")[2].strip()
        given = self.names.get(name)
        if isinstance(given, Members) and (not given or as_array(next(iter(given.values()))).item() != 0):
            raise NotTranslated(f"the enumeration {name} does not begin with 0")
        elements = given.get("Elements", []) if isinstance(given, dict) else []
        for one in elements if isinstance(elements, list) else [elements]:
            self._begins_with_0(str(one.get("DataType", "")))

    def _initial(self, part: Form, kind: Kind) -> Value:
        values, name = part["values"], part["name"]
        text = values.get("props/initialValue", values.get("initialValue", "")).strip()
        sizes = values.get("props/array/size", "1").strip()
        if values.get("initFromWorkspace", "0") == "1":
            text = name
        if not text:
            self._begins_with_0(values.get("dataType", ""))
        if isinstance(kind, Bus):
            if text or sizes not in ("1", "-1"):
                raise NotTranslated(f"the data {name} of a bus has an initial value or a size")
            return zero_of(Port(name, kind))
        if not isinstance(kind, str):
            raise NotTranslated(f"the data {name} of type {kind} is not translated")
        try:
            start = as_array(number(evaluate(text, self.names, name))) if text else np.zeros((1, 1))
            shape = [int(n) for n in as_array(evaluate(sizes or "1", self.names, name)).flatten()]
        except DiagramError as reason:
            raise NotTranslated(f"the data {name}: {reason.what}") from None
        if len(shape) > 2 or (shape != [-1] and min(shape) < 1):
            raise NotTranslated(f"the data {name} has the size {sizes}")
        whole = (shape[0], shape[1]) if len(shape) == 2 else (max(shape[0], 1), 1)
        if shape == [-1] or start.size == np.prod(whole):
            whole = start.shape if start.size > 1 and 1 in start.shape else whole
        elif start.size != 1:
            raise NotTranslated(f"the data {name} has {start.size} initial values for the size {sizes}")
        whole_array = np.full(whole, start.item()) if start.size == 1 else start.reshape(whole, order="F")
        return typed(kind, whole_array)

    def _block(self, write: Callable[[], None]) -> list[tuple[str, str]]:
        self.lines, self.owners = [], []
        write()
        return list(zip(self.lines, self.owners, strict=True))

    def _say(self, text: str, owner: str = "") -> None:
        for line in text.splitlines() or [""]:
            self.lines.append(line)
            self.owners.append(owner)
        if len(self.lines) > MOST_LINES:
            raise NotTranslated(f"it takes more than {MOST_LINES} lines")

    def _act(self, state: _State, action: str) -> None:
        if text := state.actions.get(action, ""):
            self._perform(_CHANGED.sub(self._changed, text), f"{action} of {state.name}", state)

    def _perform(self, text: str, owner: str, sender: _State) -> None:
        """Write actions of a state, or of a transition drawn in it; an event is processed where they send it."""
        at = 0
        for found in SEND.finditer(text):
            self._say(text[at : found.start()], owner)
            at = found.end()
            around = [self.root, *sender.chain()]
            beside = [one for state in around if state.parallel for one in state.children]
            target = next((one for one in beside if found[2] and one.name == found[2].rpartition(".")[2]), None)
            if found[1] not in self.events or target is None or target in (*around, *self.busy):
                raise NotTranslated(f"{owner}: {found[0]} is not an event to a parallel state beside it")
            if target in self.asleep:
                continue
            before = self.event, self.busy
            self.event, self.busy = found[1], [*self.busy, *around]
            self._tick(target)
            self.event, self.busy = before
        self._say(text[at:], owner)

    def _by_child(self, parent: _State, write: Callable[[_State], None]) -> None:
        """Write a branch for each state of a group, of which one is active."""
        for k, child in enumerate(parent.children):
            self._say(f"{'if' if k == 0 else 'elseif'} {parent.active} == {child.number}")
            write(child)
        if parent.children:
            self._say("end")

    def _begin(self, parent: _State) -> None:
        """Enter what is in a state that was just entered."""
        if parent.parallel:
            self.asleep.update(parent.children)
            for child in parent.children:
                self.asleep.discard(child)
                self._enter(child)
        elif parent.children or any(not way.source for way in parent.ways):  # of a flow chart, too
            defaults = [way for way in parent.ways if not way.source]
            if not defaults and len(parent.children) == 1:
                self._enter(parent.children[0])
                return
            if not defaults:
                raise NotTranslated(f"{parent.name}: it has no default transition")
            self._flow(defaults, self._flag(), None, parent)

    def _enter(self, state: _State) -> None:
        assert state.parent is not None
        if not state.parent.parallel:
            self._say(f"{state.parent.active} = {state.number};")
        self._say(f"{state.since} = 0;")
        self._act(state, "entry")
        self._begin(state)

    def _leave(self, state: _State) -> None:
        """Leave a state that is active, and all that is inside it."""
        self._leave_inside(state)
        self._act(state, "exit")

    def _leave_inside(self, parent: _State) -> None:
        if parent.parallel:
            for child in reversed(parent.children):
                self._leave(child)
                self.asleep.add(child)
            self.asleep.difference_update(parent.children)
        elif parent.children:
            self._by_child(parent, self._leave)
            self._say(f"{parent.active} = 0;")

    def _children_act(self, parent: _State) -> None:
        if parent.parallel:
            for child in parent.children:
                self._tick(child)
        elif parent.children:
            self._by_child(parent, self._tick)
        elif parent is self.root:
            self._begin(parent)  # a chart without states takes its default transitions at each tick

    def _tick(self, state: _State) -> None:
        """Write what an active state does in a tick."""
        ways = self._from(state.id)
        outer = [way for way in ways if way.parent is not state]
        inner = [way for way in ways if way.parent is state]
        if not ways:
            self._act(state, "during")
            self._children_act(state)
            return
        flag = self._flag()
        self._flow(outer, flag, state, None)
        self._say(f"if ~{flag}")
        self._act(state, "during")
        self._flow(inner, flag, state, state)
        self._say(f"if ~{flag}")
        self._children_act(state)
        self._say("end\nend")

    def _flag(self) -> str:
        """Return a new name that says whether a transition was taken."""
        self.flags += 1
        self._say(f"taken_{self.flags} = false;")
        return f"taken_{self.flags}"

    def _flow(
        self, ways: Sequence[_Way], flag: str, source: _State | None, within: _State | None, path: Sequence[_Way] = ()
    ) -> None:
        """Try ways in their order; junctions lead on, and back where none of theirs reaches a state."""
        if len(path) > MOST_JUNCTIONS:
            raise NotTranslated(f"{_shown(path[0])}: junctions lead on more than {MOST_JUNCTIONS} times")
        for way in ways:
            if way.events and self.event not in way.events:
                continue
            owner = _shown(way)
            condition = self._timed(way, source)
            self._say(f"if ~{flag}\nif {condition}", owner)
            self._perform(way.action, owner, way.parent)
            onward = [*path, way]
            if way.target in self.states:
                self._take(onward, self.states[way.target], source, within)
                self._say(f"{flag} = true;")
            elif way.target in [one.target for one in path]:
                self._say(f"again_{way.target} = true;\n{flag} = true;")
            elif (follow := self._from(way.target)) and way.target in self.circles:
                self._say(f"again_{way.target} = true;\nwhile again_{way.target}")
                self._say(f"again_{way.target} = false;\n{flag} = false;")
                self._flow(follow, flag, source, within, onward)
                self._say("end")
            elif follow:
                self._flow(follow, flag, source, within, onward)
            elif self.states and within not in self.functions and (within is None or within.children):
                raise NotTranslated(f"{owner}: it ends at a junction")
            else:
                for one in onward:
                    self._perform(one.at_end, owner, one.parent)
                self._say(f"{flag} = true;")
            self._say("end\nend")

    def _take(self, path: Sequence[_Way], target: _State, source: _State | None, within: _State | None) -> None:
        """Write the exit of what is left, the transition's own action, and the entry of the target."""
        owner = _shown(path[0])
        # The innermost state around the whole way: all that is active in it is left.
        around = min((way.parent for way in path), key=lambda one: len(one.chain()))
        common = around if within is None or len(around.chain()) < len(within.chain()) else within
        if source is not None:
            if common is source:
                self._leave_inside(source)
            else:
                chain = [one for one in source.chain() if common is self.root or common in one.chain()[:-1]]
                if not chain or any(one.parent is not None and one.parent.parallel for one in chain):
                    raise NotTranslated(f"{owner}: a transition out of a parallel state is not translated")
                for one in reversed(chain):
                    self._leave(one) if one is source else self._act(one, "exit")
                    assert one.parent is not None
                    self._say(f"{one.parent.active} = 0;")
        elif common is not within:
            raise NotTranslated(f"{owner}: a default transition that leaves its state is not translated")
        for way in path:
            self._perform(way.at_end, owner, way.parent)
        if target is common:
            self._begin(target)
            return
        entered = [one for one in target.chain() if common is self.root or common in one.chain()[:-1]]
        if not entered or any(one.parent is not None and one.parent.parallel for one in entered):
            raise NotTranslated(f"{owner}: a transition into a parallel state is not translated")
        for one in entered[:-1]:
            assert one.parent is not None
            self._say(f"{one.parent.active} = {one.number};\n{one.since} = 0;")
            self._act(one, "entry")
        self._enter(entered[-1])

    def _timed(self, way: _Way, source: _State | None) -> str:
        """Return a condition in which `after` counts the ticks since the source was entered."""

        def count(found: re.Match[str]) -> str:
            if source is None:
                raise NotTranslated(f"{_shown(way)}: after() without a state")
            self.clocks[source.since] = source
            if found[2] == "tick" and self.event:
                raise NotTranslated(f"{_shown(way)}: after() of ticks where an event acts")
            if found[2] == "tick":
                return f"({source.since} >= ({found[1]}))"
            # As in MathWorks' code: the first tick that is not before the time.
            return f"({source.since} >= ceil(({found[1]}) * {_SECONDS[found[2]]!r} / {self.dt!r} * (1 - 1e-12)))"

        return _CHANGED.sub(self._changed, AFTER.sub(count, way.condition)) or "true"

    def _changed(self, found: re.Match[str]) -> str:
        """Return whether a name had another value at the start of the tick before than at the start of this one."""
        how, name, value = found.groups()
        if name not in self.watched:
            self.watched.append(name)
        at = {"From": f" && before_{name} == {value}", "To": f" && start_{name} == {value}"}.get(how, "")
        return f"(before_{name} ~= start_{name}{at})"


def _shown(way: _Way) -> str:
    label = f"[{way.condition}]" if way.condition else f"{way.order} of {way.parent.name}"
    return f"the transition {label[:60]}"


def _check_overflow(chart: SimulinkChart, item: MatlabFunction) -> None:
    """Raise NotTranslated for integers that wrap around: here they saturate. A chart whose file does not say it wraps.

    Actions in C compute nothing with whole numbers; functions in such a chart may.
    """
    kinds = {one.kind for one in (*item.inputs, *item.outputs)} | {one.kind for one in item.states}
    whole: Any = not kinds.isdisjoint(INTEGER_TYPES) or re.search(r"\bu?int(8|16|32)\b", chart.text)
    values = {} if chart.form is None else chart.form["values"]
    if not chart.function and values.get("actionLanguage", "") != "2":
        texts = [one["values"].get("eml/script", "") for one in parts_inside(chart.form or {"inside": ()})]
        whole = whole and any(re.search(r"[-+*/]", COMMENT.sub("", text)) for text in texts)
    if whole and values.get("saturateOnIntegerOverflow", "1" if chart.function else "0") == "0":
        raise NotTranslated("its integers wrap around: let it saturate on integer overflow")


def declared_buses(chart: SimulinkChart, names: Mapping[str, Value]) -> dict[str, Bus]:
    """Return the buses that outputs of a MATLAB Function are declared to be."""
    inside = [one for one in (chart.form or {}).get("inside", []) if one["tag"] == "data"]
    outputs = {one["name"]: one["values"] for one in inside if one["values"].get("scope") == "OUTPUT_DATA"}
    found: dict[str, Bus] = {}
    for name, values in outputs.items():
        with suppress(NotTranslated):  # of a bus that is not known, the structure says the fields
            kind = kind_of(values.get("dataType", "double"), names)
            found |= {name: kind} if isinstance(kind, Bus) else {}
    return found


def function_rule(chart: SimulinkChart | None) -> Rule:
    """Return the rule of a MATLAB Function or a chart, which may call the functions of .m files.

    Its ports have the names of those in its subsystem.
    """

    def made(c: Asked) -> Made:
        if chart is None:
            raise NotTranslated("its code is not in the file")
        inner = c.block.system or System({}, [])
        inputs, outputs = ([one.removesuffix("()") for one in inner.ports(kind)] for kind in ("Inport", "Outport"))
        if inner.blocks and not outputs:
            return Made(None, [])
        if chart.function:
            buses = declared_buses(chart, c.names)
            item = MatlabFunction(chart.text, c.inputs, c.names, inputs, None, c.folders, buses)
        elif chart.form is None or len(inputs) != len(c.inputs):
            raise NotTranslated("its chart is not read from this form of file")
        else:
            doubles = all(one.kind in ("real", "bool") for one in c.inputs)
            code = chart_code(chart.form, inputs, outputs, c.names, c.dt, doubles)
            c.notes += code.notes
            enumerations = {name: value for name, value in c.names.items() if isinstance(value, Members)}
            try:
                known, buses = enumerations | code.known, {k: v for k, v in code.declared.items() if isinstance(v, Bus)}
                item = MatlabFunction(code.text, c.inputs, known, inputs, code.declared, c.folders, buses)
            except DiagramError as reason:
                line = re.match(r"line (\d+): (.*)", reason.what, re.DOTALL)
                owner = code.owners[int(line[1]) - 1] if line is not None else ""
                raise NotTranslated(f"{owner}: {line[2]}" if line is not None and owner else reason.what) from None
        _check_overflow(chart, item)
        c.notes += item.notes
        ports = [replace(one, kind=item.buses.get(one.name, one.kind)) for one in grouped(item.outputs)]
        return Made(item, [Signal(port.kind, port.width, port.shape) for port in ports])

    return made
