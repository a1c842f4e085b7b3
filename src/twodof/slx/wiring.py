"""From translated Simulink blocks to diagrams: one for each system, with its parts, conditions and connections."""

import re
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from twodof.blocks import Diagram
from twodof.blocks.block import Block as LibraryBlock
from twodof.blocks.diagram import BASE, Rate
from twodof.blocks.library import Constant, DataStore, Logic, Merge, RateTransition, StoreRead, ZeroOrderHold
from twodof.slx.conditions import Activation, ControlEdge
from twodof.slx.connections import PASSING, Connections, Output, store_name
from twodof.slx.data_types import signal_of, value_of
from twodof.slx.matlab.program import evaluate
from twodof.slx.matlab.values import as_array, number
from twodof.slx.model import Pin, SimulinkBlock, System, below, collapsed, escaped, port_number, split_path
from twodof.slx.network import Iterated
from twodof.slx.translation import Asked, Made, NotTranslated, Signal, expanded, names_of, plain


class Wiring(Connections):
    """Writes the diagrams of a model whose blocks are translated."""

    def _diagram(self, path: str) -> Diagram:
        system = self.sheets[path].system
        title = split_path(path)[-1] if path else self.model.name
        diagram = Diagram(safe(title, set()), f"{self.model.name}/{path}".rstrip("/"))
        names = self.sheets[path].parts
        self.sheets[path].diagram = diagram
        taken: set[str] = set()
        for sid, block in self._ordered(system):
            names[sid] = safe(f"store_{store_name(block)}" if block.type == "DataStoreMemory" else block.name, taken)
            taken.add(names[sid])
        outports = [(sid, block) for sid, block in self._ordered(system) if block.type == "Outport"]
        for sid, block in self._ordered(system):
            if block.type == "Inport":
                owner = self.sheets[path].owner
                outer = None if owner is None else self._type(owner[0], Pin(owner[1], "in", port_number(block)))
                signal = outer or self.signals.get((path, sid, 1)) or Signal()
                diagram.declare(signal.port(names[sid]))
                self._report(path, sid, "imported")
        for sid, block in system.blocks.items():
            self._try((path, sid), partial(self._add, diagram, path, sid, block, names))
        for sid, block in system.blocks.items():
            self._try((path, sid), partial(self._wire, diagram, path, sid, block, names))
        for sid, _ in outports:
            self._try((path, sid), partial(self._lead_out, diagram, path, sid, names, taken))
        return diagram

    def _lead_out(self, diagram: Diagram, path: str, sid: str, names: Mapping[str, str], taken: set[str]) -> None:
        """Feed an output of a diagram."""
        source = self._name(path, self._source(path, Pin(sid, "in", 1)), names, diagram)
        if "." not in source and source not in diagram.parts:  # an output of a diagram is fed by a part
            signal = self._type(path, Pin(sid, "in", 1)) or Signal()
            passed = safe(f"{source}_passed", taken)
            taken.add(passed)
            diagram.add(passed, ZeroOrderHold(signal.kind, signal.width))
            diagram.connect(source, passed)
            source = passed
        diagram.output(names[sid], source)
        self._report(path, sid, "imported")

    @staticmethod
    def _ordered(system: System) -> Iterator[tuple[str, SimulinkBlock]]:
        """Yield the ports by number, then the other blocks, so that names are the ports' first."""

        def rank(item: tuple[str, SimulinkBlock]) -> tuple[int, int]:
            kinds = {"DataStoreMemory": -1, "Inport": 0, "Outport": 1}
            return kinds.get(item[1].type, 2), port_number(item[1]) if item[1].type in kinds else 0

        return iter(sorted(system.blocks.items(), key=rank))

    def _add(self, diagram: Diagram, path: str, sid: str, block: SimulinkBlock, names: Mapping[str, str]) -> None:
        inner = below(path, block)
        if block.commented:
            self._report(path, sid, "dropped", "commented out")
            return
        if block.type in PASSING:
            if block.type not in ("Inport", "Outport"):
                self._report(path, sid, "imported")
            return
        if self._is_system(block):
            whole, how = self._diagram(inner), self.iterated.get(inner)
            if how is None:
                diagram.add(names[sid], whole, initial=self._initial(inner), position=_corner(block))
            else:
                diagram.add(names[sid], Iterated(whole, how))
            if how is not None and how.bounded:
                self.approximated.setdefault((path, sid), []).append(f"it is iterated {how.most} times at most")
            self._report(path, sid, "imported")
            return
        made = self.made[path, sid]
        if made.item is None:
            self._report(path, sid, "dropped", "it shows or keeps a signal and computes nothing")
            return
        diagram.add(names[sid], made.item, rate=self._rate((path, sid)) or BASE, position=_corner(block))
        self._report(path, sid, "imported")

    def _wire(self, diagram: Diagram, path: str, sid: str, block: SimulinkBlock, names: Mapping[str, str]) -> None:
        name = names[sid]
        if name not in diagram.parts:
            return
        item = diagram.parts[name].item
        if isinstance(item, StoreRead):  # the store feeds it
            return
        if isinstance(item, DataStore):  # and a StoreWrite that one, if there is any
            if not self._writers((path, sid)):
                diagram.connect(f"{name}.y", f"{name}.u")
            return
        ports = names_of(item)
        if isinstance(item, Diagram):
            self._condition(path, sid, below(path, block))
        if isinstance(item, Merge):
            for letter, pin in zip(item.names, self._inputs((path, sid)), strict=True):
                diagram.connect(self._acts(path, pin), f"{name}.{letter}_acts")
            ports = list(item.names)
        widths = {} if isinstance(item, Diagram) else {port.name: port.width for port in item.inputs}
        for k, port in enumerate(ports):
            pin = Pin(sid, "in", k + 1)
            inner = below(path, block)
            if isinstance(item, Diagram) and (inner, port) in self.acting:
                number, element = self.acting[inner, port]
                diagram.connect(self._acts(path, Pin(sid, "in", number), element), f"{name}.{port}")
                continue
            if isinstance(item, Diagram) and (inner, port) in self.beyond:
                diagram.connect(self._name(path, self.beyond[inner, port], names, diagram), f"{name}.{port}")
                continue
            driver = self._source(path, pin)
            declared = item.inputs.values() if isinstance(item, Diagram) else item.inputs
            wanted = next((one for one in declared if one.name == port), None) if driver is None else None
            if wanted is not None and isinstance(wanted.kind, str) and (wanted.kind, wanted.width) != ("real", None):
                start = value_of(np.zeros((1, 1)), signal_of(wanted))
                zero = Constant(start, wanted.kind, wanted.width, shape=wanted.shape)
                diagram.connect(f"{diagram.add(f'{name}_{port}_ground', zero)}.y", f"{name}.{port}")
                continue
            source = self._name(path, driver, names, diagram)
            signal = self._type(path, pin) or Signal()
            if signal.width is None:
                source = expanded(diagram, source, signal, widths.get(port))
            source = self._sampled(path, sid, pin, source)
            diagram.connect(source, f"{name}.{port}")

    def _initial(self, path: str) -> dict[str, Any]:
        """Return what the outputs of a conditional subsystem are before it acts, where the file says it."""
        found: dict[str, Any] = {}
        sheet = self.sheets[path]
        for sid, block in sheet.system.blocks.items():
            if block.type == "Outport" and self.conditions.get(path):
                said = {**self.defaults[path].get("Outport", {}), **block.values}.get("InitialOutput", "[]")
                values = as_array(number(evaluate(said, sheet.names, "InitialOutput"))).flatten()
                if not values.size:
                    self.notes.append(f"{path}/{escaped(block.name)}: InitialOutput [] is taken for 0")
                else:
                    signal = self._type(path, Pin(sid, "in", 1)) or Signal()
                    given = [plain(v, signal.kind) for v in values]
                    whole = given * (signal.width or 1) if len(given) == 1 else given
                    found[sheet.parts[sid]] = given[0] if signal.width is None else whole
        return found

    def _condition(self, path: str, sid: str, inner: str) -> None:
        """Connect what makes a subsystem act, start afresh, or have its initial outputs while it does not act."""
        sheet = self.sheets[path]
        part = sheet.diagram.parts[sheet.parts[sid]]
        for one in self.conditions.get(inner, ()):
            flag = self._flag(path, sid, one)
            if one.pin == "reset":
                part.reset = flag
                continue
            part.enable, part.enabling = flag, "restart" if one.restart else "keep"
            outports = [b for b in self.sheets[inner].system.blocks.values() if b.type == "Outport"]
            resets = [b for b in outports if b.values.get("OutputWhenDisabled", "held") == "reset"]
            if resets and one.pin != "trigger":
                if len(resets) < len(outports):
                    raise NotTranslated("some of its outputs are held and some reset while it is disabled")
                part.disabled = "reset"

    def _flag(self, path: str, sid: str, condition: Activation) -> str:
        """Return the source of the bool that makes a subsystem act; it is made if there is none yet."""
        sheet, pin = self.sheets[path], Pin(sid, condition.pin, 1)
        source = self._name(path, self._source(path, pin), sheet.parts, sheet.diagram)
        signal = self._type(path, pin) or Signal()
        if signal.width is not None:
            raise NotTranslated(f"its {condition.pin} is a vector")
        if signal.kind == "bool" and condition.edge in ("", "level hold"):
            return source
        edge = ControlEdge(condition.edge, signal.number, condition.pin == "reset")
        return self._helper(path, f"{sheet.parts[sid]}_{condition.pin}s", edge, source)

    def _helper(self, path: str, wanted: str, block: LibraryBlock, *sources: str, rate: Rate = BASE) -> str:
        """Return the output of a block that no Simulink block stands for, added once to a sheet's diagram."""
        sheet = self.sheets[path]
        if wanted not in sheet.helpers:
            name = safe(wanted, {*sheet.diagram.parts, *sheet.diagram.inputs, *sheet.parts.values()})
            ports = [port.name for port in block.inputs]
            sheet.diagram.add(name, block, rate=rate, inputs=dict(zip(ports, sources, strict=True)))
            sheet.helpers[wanted] = f"{name}.{block.outputs[0].name}"
        return sheet.helpers[wanted]

    def _acts(self, path: str, pin: Pin, element: tuple[str, ...] = ()) -> str:
        """Return the source of the bool that says whether what drives an input of a Merge acts.

        It is looked for through buses, of which the input is this `element`, and outside the Merge's subsystem.
        """
        sheet, source = self.sheets[path], self._source(path, pin)
        if source is None:
            raise NotTranslated("nothing drives an input")
        block = self.blocks[source[:2]]
        inner = below(path, block)
        if block.type == "BusSelector" and source[0] == path:
            taken = block.values.get("OutputSignals", "").split(",")[source[2] - 1].split(".")
            return self._acts(path, Pin(source[1], "in", 1), (*taken, *element))
        if block.type == "BusCreator" and element and source[0] == path:
            pins = self._inputs((path, source[1]))
            labels = [self._label(path, one) or f"signal{one.number}" for one in pins]
            if element[0] in labels:
                return self._acts(path, pins[labels.index(element[0])], element[1:])
        if block.type == "Inport" and source[0] == path and sheet.owner and path not in self.iterated:
            port = safe("_".join((sheet.parts[source[1]], *element, "acts")), set(sheet.parts.values()))
            if (path, port) not in self.acting:
                sheet.diagram.input(port, "bool")
                self.acting[path, port] = port_number(block), element
            return port
        acting = [one for one in self.conditions.get(inner, ()) if one.pin != "reset"] if source[0] == path else []
        if acting:
            return self._flag(path, source[1], acting[0])
        if block.type == "Merge" and source[0] == path:
            inputs = [self._acts(path, one) for one in self._inputs((path, source[1]))]
            return self._helper(path, f"{sheet.parts[source[1]]}_acts", Logic("or", len(inputs)), *inputs)
        if (
            source[0] == path
            and self._is_system(block)
            and (out := self.sheets[inner].ports.get(("Outport", source[2])))
        ):
            within = self._acts(inner, Pin(out, "in", 1))
            diagram, name = self.sheets[inner].diagram, f"{self.sheets[inner].parts[out]}_acts"
            if name not in diagram.outputs:
                diagram.output(name, within)
            return f"{sheet.parts[source[1]]}.{name}"
        raise NotTranslated(f"its input {pin.number} is not the output of a conditional subsystem")

    def _sampled(self, path: str, sid: str, pin: Pin, source: str) -> str:
        """Return a source for a block of another rate: it reads the signal at its own ticks."""
        origin = self._origin(path, pin)
        if self._is_system(self.blocks[path, sid]):
            return source
        before, own = None if origin is None else self._rate(origin[:2]), self._rate((path, sid)) or BASE
        if before in (None, own):
            return source
        signal = self._type(path, pin) or Signal()
        wanted = f"{source.replace('.', '_')}_every_{own.divider}" + (f"_{own.offset}" if own.offset else "")
        return self._helper(path, wanted, ZeroOrderHold(signal.kind, signal.width), source, rate=own)

    def _name(self, path: str, source: tuple[str, str, int] | None, names: Mapping[str, str], diagram: Diagram) -> str:
        """Return the source's name in the diagram; an unconnected input is 0, as in Simulink."""
        if source is None:
            if "ground" not in diagram.parts:
                diagram.add("ground", Constant(0.0))
            return "ground"
        if source[0] != path:
            block, owner = self.blocks[source[:2]], self.sheets[source[0]].owner
            if block.type in ("Inport", "InportShadow") and owner is not None:  # what drives it is as good
                return self._name(path, self._source(owner[0], Pin(owner[1], "in", port_number(block))), names, diagram)
            return self._reach(path, source)
        _, sid, output = source
        block = self.blocks[path, sid]
        if block.type == "EnablePort":
            enabling = self._resolved(source)
            return self._name(path, None, names, diagram) if enabling is None else self._reach(path, enabling)
        if block.type in ("Inport", "InportShadow"):
            shown = self.sheets[path].ports.get(("Inport", port_number(block)))
            return names[shown or sid]
        if names[sid] not in diagram.parts:
            raise NotTranslated("it hangs on a part that is refused")
        return f"{names[sid]}.{names_of(diagram.parts[names[sid]].item, outputs=True)[output - 1]}"

    def _reach(self, path: str, source: Output) -> str:
        """Return a sheet's name for an output of another sheet: it leads out of and into the systems between."""
        sheet, place = self.sheets[path], source[0]
        if place.startswith(f"{path}/".lstrip("/")):
            owners = {one: self.sheets[one].owner for one in self.sheets if f"{place}/".startswith(f"{one}/")}
            below, part = next((one, sheet.parts[of[1]]) for one, of in owners.items() if of and of[0] == path)
            inner = self.sheets[below]
            within = self._name(below, source, inner.parts, inner.diagram)
            wanted = f"{within.replace('.', '_')}_out"
            if wanted not in inner.helpers:
                inner.helpers[wanted] = safe(wanted, {*inner.diagram.outputs, *inner.parts.values()})
                inner.diagram.output(inner.helpers[wanted], within)
            return f"{part}.{inner.helpers[wanted]}"
        wanted = f"{'_'.join(source[:2])}_{source[2]}_in"
        if wanted not in sheet.helpers:
            taken = {*sheet.diagram.parts, *sheet.diagram.inputs, *sheet.parts.values()}
            name = sheet.helpers[wanted] = safe(f"from_{self.blocks[source[:2]].name}", taken)
            self.beyond[path, name] = source
            origin = self._resolved(source)
            signal = Signal() if origin is None else self.signals[origin]
            sheet.diagram.declare(signal.port(name))
        return sheet.helpers[wanted]

    def _transition(self, key: tuple[str, str], c: Asked) -> Made | None:
        """Return the delay of a Rate Transition whose input is slower; None where it only samples.

        One that need not be deterministic is late by a tick: the task of the slower blocks comes after that of the
        faster ones, as in MathWorks' multitasking code.
        """
        origin = self._origin(key[0], self._inputs(key)[0])
        if origin is None:
            return None
        inport = self.blocks[origin[:2]].type == "Inport"  # the diagram's is read in every tick
        before = self.rates.get(origin[:2], BASE) if inport else self._rate(origin[:2])
        if before is None or before.divider <= self.rates.get(key, BASE).divider:
            return None
        one, start = c.inputs[0], c.scalar("InitialCondition" if "InitialCondition" in c.values else "X0", "0")
        late = RateTransition(plain(start, one.kind), one.kind, one.width)
        if c.text("Deterministic", "on") == "on":
            self.held[key] = before
            return Made(late, [one])
        self.held[key] = BASE
        c.notes.append("passes a slower value on a tick later, as MathWorks' multitasking code does")
        d = Diagram("transition")
        d.input("u", one.kind, one.width)
        d.add("held", ZeroOrderHold(one.kind, one.width), rate=before, u="u")
        d.add("late", late, u="held")
        d.add("y", ZeroOrderHold(one.kind, one.width), rate=self.rates.get(key, BASE), u="late")
        d.output("y", "y")
        return Made(d, [one])

    def _report(self, path: str, sid: str, status: str, why: str = "") -> None:
        notes = self.approximated.get((path, sid), [])
        if notes and status == "imported":
            status, why = "approximated", "; ".join(notes)
        self._line(path, sid, status, why)


def _corner(block: SimulinkBlock) -> tuple[float, float] | None:
    """Return the place in the editor, whose blocks are twice as large as Simulink's."""
    return None if block.place is None else (2 * block.place[0], 2 * block.place[1])


def safe(name: str, taken: set[str]) -> str:
    """Return a legal name near to a block's that is not taken."""
    plain = re.sub(r"^(?![A-Za-z])", "b", re.sub(r"\W+", "_", collapsed(name), flags=re.ASCII).strip("_"))[:50] or "b"
    made, k = plain, 2
    while made in taken:
        made, k = f"{plain}_{k}", k + 1
    return made
