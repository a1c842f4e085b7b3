"""Level: a diagram or sub-diagram at its path, and the signals to which its connections lead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from twodof.blocks.diagram import Diagram, not_connected
from twodof.compile.program.flat_program import Condition, FlatSignal, Node
from twodof.errors import DiagramError, nearest


@dataclass(eq=False)
class Level:
    """A diagram or sub-diagram at its path; `parts` are its blocks' nodes and its sub-diagrams' levels, by name."""

    diagram: Diagram
    path: str  # of this diagram, for messages
    prefix: str  # of its parts
    parent: Level | None = None
    name: str = ""  # in the parent
    parts: dict[str, Node | Level] = field(default_factory=dict)
    condition: Condition | None = None
    root_inputs: dict[str, FlatSignal] = field(default_factory=dict)

    @property
    def conditions(self) -> list[Condition]:
        """Conditions of this diagram and of those around it, the innermost first."""
        found = [] if self.condition is None else [self.condition]
        return found if self.parent is None else [*found, *self.parent.conditions]

    def driver(self, output: str) -> FlatSignal:
        """Return the signal that drives one of this diagram's outputs, or a field of one."""
        return scalar(self._driven(output), f"{self.path}.{output}")

    def drivers(self, output: str) -> dict[str, FlatSignal]:
        """Return the signals that drive one of this diagram's outputs, by path: one signal, or the fields of a bus."""
        return {f"{output}.{field}" if field else output: s for field, s in self._driven(output).items()}

    def _driven(self, output: str) -> dict[str, FlatSignal]:
        source = self.diagram.outlet(output)
        if source is None:
            raise not_connected("output", f"{self.path}.{output}")
        return self.signals(source)

    def resolve(self, source: str) -> FlatSignal:
        """Return the signal named `source` in this diagram. Raises DiagramError for a bus."""
        return scalar(self.signals(source), f"{self.path}.{source}")

    def signals(self, source: str) -> dict[str, FlatSignal]:
        """Follow `source` through the borders of sub-diagrams; return {"": signal}, or a bus's signals by field."""
        at, text = self, source
        seen: set[tuple[int, str]] = set()
        while (id(at), text) not in seen:
            seen.add((id(at), text))
            try:
                part, port = at.diagram.source(text)
            except DiagramError as error:
                raise DiagramError(error.what, at.path, error.remedy) from error
            if part is None:
                if at.parent is None:
                    return _fields(at.root_inputs, port)
                above = at.parent.diagram.feed(at.name, port)
                if above is None:
                    raise not_connected("input", f"{at.path}.{port}")
                at, text = at.parent, above
                continue
            inner = at.parts.get(part)
            if inner is None:
                raise DiagramError(
                    "its source is in sub-diagrams nested too deep", f"{self.path}.{source}", "use fewer levels"
                )
            if isinstance(inner, Node):
                return _fields(inner.outputs, port)
            below = inner.diagram.outlet(port)
            if below is None:
                raise not_connected("output", f"{inner.path}.{port}")
            at, text = inner, below
        raise DiagramError("a connection leads back to itself", f"{self.path}.{source}", "put a block into the loop")


def _fields(signals: Mapping[str, FlatSignal], name: str) -> dict[str, FlatSignal]:
    if name in signals:
        return {"": signals[name]}
    return {path[len(name) + 1 :]: s for path, s in signals.items() if path.startswith(f"{name}.")}


def scalar(found: Mapping[str, FlatSignal], where: str) -> FlatSignal:
    """Return the signal in `found`, from `Level.signals`. Raises DiagramError for a bus."""
    if "" not in found:
        raise DiagramError(f"it is a bus, with the fields {nearest('', found)}", where, "name one of its fields")
    return found[""]
