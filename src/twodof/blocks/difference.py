"""Difference of two diagrams: a readable list of the changes from one to the other."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from twodof.blocks.block import Block
from twodof.blocks.declarations import Param, shape
from twodof.blocks.diagram import Diagram, Part
from twodof.blocks.schema.traced_block import graph_to_json

WHATS = ("input", "output", "parameter", "initial value", "block", "connection")
_SHOWN = 8  # elements of an array


@dataclass(frozen=True)
class Change:
    """A change at `path` of a thing in `WHATS` (`what`), from `before` to `after`; "" if it was or is not there."""

    what: str
    path: str
    before: str
    after: str

    @property
    def kind(self) -> str:
        """Kind of the change: "added", "removed" or "changed"."""
        return "added" if not self.before else "changed" if self.after else "removed"

    def __str__(self) -> str:
        if self.kind == "added":
            return f"+ {self.what} {self.path}: {self.after}"
        if self.kind == "removed":
            return f"- {self.what} {self.path}: {self.before}"
        return f"~ {self.what} {self.path}: {self.before} -> {self.after}"


@dataclass(frozen=True)
class Difference:
    """Changes from one diagram to another: ports first, then parameters, blocks and connections, each by path."""

    changes: tuple[Change, ...]

    def __bool__(self) -> bool:
        """Return True if there are changes."""
        return bool(self.changes)

    def to_json(self) -> list[dict[str, str]]:
        """Return the changes as JSON objects."""
        return [
            {"what": c.what, "kind": c.kind, "path": c.path, "before": c.before, "after": c.after} for c in self.changes
        ]


def difference(before: Diagram, after: Diagram) -> Difference:
    """Return the difference of what `before` and `after` compute. Names of diagrams, texts and layout do not count.

    A sub-diagram is compared part by part, at paths such as "pid.gain". A part that was added or removed is listed with
    its parameters and connections, without its contents. A renamed part is listed as removed and added. Custom blocks
    are compared by their traced expressions. Raises DiagramError for a connection from an unknown source.
    """
    old, new = _listing(before), _listing(after)
    moved = old["block"].keys() ^ new["block"].keys()
    changes: list[Change] = []
    for what in WHATS:
        was, now = old[what], new[what]
        for path in sorted({*was, *now}):
            a, b = was.get(path, ""), now.get(path, "")
            # What is inside a part that came or went does so with it; only its own parameters and connections are news.
            at = path.rpartition(".")[0] if what in ("parameter", "initial value", "connection") else path
            if a != b and not moved.intersection(_above(at)):
                changes.append(Change(what, path, a, b))
    return Difference(tuple(changes))


def _above(path: str) -> Iterator[str]:
    """Return the paths of the parts that the one at `path` is in."""
    while "." in path:
        path = path.rpartition(".")[0]
        yield path


def _listing(diagram: Diagram) -> dict[str, dict[str, str]]:
    """Everything in a diagram: how it reads, by what it is and by path."""
    rows: dict[str, dict[str, str]] = {what: {} for what in WHATS}

    def enter(diagram: Diagram, prefix: str) -> None:
        for port in diagram.inputs.values():
            rows["input"][f"{prefix}{port.name}"] = f"{shape(port)} {port.unit}".rstrip()
        for name, source in diagram.outputs.items():
            rows["output"][f"{prefix}{name}"] = f"from {_full(diagram, source, prefix)}"
        for param in diagram.params.values():
            rows["parameter"][f"{prefix}{param.name}"] = _parameter(param)
        for part in diagram.parts.values():
            path = f"{prefix}{part.name}"
            what = "sub-diagram" if isinstance(part.item, Diagram) else _block(part.item)
            rows["block"][path] = f"{what}{_settings(part, prefix)}"
            if isinstance(part.item, Diagram):
                enter(part.item, f"{path}.")
                continue
            free = (param for param in part.item.params if param.name not in part.params)
            for param in free:
                rows["initial value" if param.is_initial else "parameter"][f"{path}.{param.name}"] = _parameter(param)
        for (name, port_name), source in diagram.connections.items():
            rows["connection"][f"{prefix}{name}.{port_name}"] = f"from {_full(diagram, source, prefix)}"

    enter(diagram, "")
    return rows


def _full(diagram: Diagram, source: str | None, prefix: str) -> str:
    """Return a source as a path, with its port written out."""
    if source is None:
        return "nothing"
    part, port = diagram.source(source)
    return f"{prefix}{port}" if part is None else f"{prefix}{part}.{port}"


def _settings(part: Part, prefix: str) -> str:
    """How a part runs and what its parameters are bound to, where that is not the ordinary way."""
    words = [] if tuple(part.rate) == (1, 0) else [f"rate {part.rate.divider}, offset {part.rate.offset}"]
    words += [f"enabled by {prefix}{part.enable}"] if part.enable else []
    words += [f"reset by {prefix}{part.reset}"] if part.reset else []
    words += [f"at {part.edge} edges of {prefix}{part.trigger}"] if part.trigger else []
    if isinstance(part.disabled, dict):
        words += [f"{output} is {_number(value)} when disabled" for output, value in sorted(part.disabled.items())]
    elif part.disabled != "hold":
        words.append(f"outputs when disabled: {part.disabled}")
    words += [f"{output} starts at {_number(value)}" for output, value in sorted(part.initial.items())]
    words += ["starts afresh when enabled again"] if part.enabling == "restart" else []
    words += [f"{inner} is {prefix}{outer}" for inner, outer in sorted(part.params.items())]
    return f"; {', '.join(words)}" if words else ""


def _block(block: Block) -> str:
    """Return the type of a block and the arguments of its constructor, without the values of parameters."""
    if not type(block).type_name:
        label = getattr(block, "label", "") or type(block).__name__
        # The expressions themselves are no reading; that they changed is.
        return f"{label} (custom, {hashlib.sha256(_expressions(block).encode()).hexdigest()[:12]})"
    values = {param.name.lower() for param in block.params}
    values |= {"limits"} if {"low", "high"} <= values else set()
    config: dict[str, Any] = getattr(block, "config", {})
    told = [
        f"{key}={value!r}"
        for key, value in config.items()
        if key.lower() not in values and value is not None and value is not False and value != ""
    ]
    arguments = f" ({', '.join(told)})" if told else ""
    return type(block).type_name + arguments


def _expressions(block: Block) -> str:
    declared = [getattr(block, which) for which in ("inputs", "outputs", "states", "derived")]
    names = [(param.name, param.kind, param.width, param.shape) for param in block.params]
    return repr(([list(ports) for ports in declared], names, block.crossing, graph_to_json(block.trace)))


def _parameter(param: Param) -> str:
    bounds = (f"{float(param.low):.9g}", f"{float(param.high):.9g}")
    ranged = "" if bounds == ("-inf", "inf") else f", {bounds[0]} to {bounds[1]}"
    value = _number(param.value) if param.enum is None or param.width else param.enum.name_of(param.value)
    return f"{value} {param.unit}".rstrip() + ranged + ("" if param.tunable else ", fixed")


def _number(value: Any) -> str:
    """Return a value with all its digits, so that a difference of two doubles shows."""
    if isinstance(value, (list, tuple)):
        whole = "" if len(value) <= _SHOWN else f" and {len(value) - _SHOWN} more"
        digest = "" if not whole else f", {hashlib.sha256(repr(list(value)).encode()).hexdigest()[:12]}"
        return f"[{', '.join(_number(v) for v in value[:_SHOWN])}{whole}{digest}]"
    return repr(value)
