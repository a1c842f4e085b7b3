"""Differences between two Simulink models, for a reviewer: blocks, parameters, wires and code, by name.

Blocks are matched by their path; those left over by their identifier (SID), which survives a new name and a move. Looks
(places, colours, fonts) are counted and not listed. A wire is said by its ends, `Gain1 -> Sum:2`.
"""

import difflib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from twodof.slx.model import Model, Pin, SimulinkBlock, SimulinkChart, System, below, collapsed, split_path

_LOOKS = re.compile(
    "Position|ZOrder|Location|Font|.*Color|Orientation|Block(Mirror|Rotation)|NamePlacement|NameLocation|ShowName"
    "|HideAutomaticName|DropShadow|Open|ZoomFactor|ContentPreview|PortBlocksUseCompact|Labels|IconDisplay|WindowPosition"
    "|ScopeSpecificationString|NumericTypeScope|Floating|LibraryVersion|UserData|SIDHighWatermark|SimulinkSubDomain$"
)


@dataclass
class ModelDifference:
    """Differences. Each change of a value is (path, name, before, after); "" where there was none."""

    added: list[tuple[str, str]] = field(default_factory=list)
    """Path and kind of each block that only the second model has."""
    removed: list[tuple[str, str]] = field(default_factory=list)
    renamed: list[tuple[str, str]] = field(default_factory=list)
    """Path before and after of a block with a new name or place in the tree."""
    values: list[tuple[str, str, str, str]] = field(default_factory=list)
    wires: list[tuple[str, str, bool]] = field(default_factory=list)
    """System, wire, and whether it is new."""
    code: list[tuple[str, list[str]]] = field(default_factory=list)
    """Path and lines of difference of a MATLAB Function, chart or callback."""
    looks: int = 0
    """Blocks of which only the looks differ."""

    @property
    def equal(self) -> bool:
        """True if nothing but looks differs."""
        return not (self.added or self.removed or self.renamed or self.values or self.wires or self.code)


def difference(before: Model, after: Model) -> ModelDifference:
    """Return what differs between two models."""
    found = ModelDifference()
    old, new = dict(before.blocks()), dict(after.blocks())
    pairs = {path: path for path in old if path in new and old[path].type == new[path].type}
    left = {(block.sid, block.type): path for path, block in old.items() if path not in pairs}
    for path, block in new.items():
        if path not in pairs.values() and (was := left.pop((block.sid, block.type), None)) is not None:
            pairs[was] = path
    renames = {was: path for was, path in pairs.items() if was != path}
    # What stands in a renamed subsystem has moved with it: one line is enough.
    found.renamed = [(was, path) for was, path in renames.items() if not _moved_along(was, path, renames)]
    found.added = _outermost({p: b for p, b in new.items() if p not in set(pairs.values())})
    found.removed = _outermost({p: b for p, b in old.items() if p not in pairs})
    for was, path in pairs.items():
        _compare(old[was], new[path], path, found)
    _compare_wires(before, after, pairs, found)
    for name in sorted({*before.solver, *after.solver}):
        _note(found, "solver", name, before.solver.get(name, ""), after.solver.get(name, ""))
    _compare_code(_texts(before), _texts(after), found)
    return found


def _moved_along(was: str, path: str, renames: Mapping[str, str]) -> bool:
    above, now = split_path(was), split_path(path)
    return above[-1] == now[-1] and len(above) > 1 and renames.get("/".join(above[:-1])) == "/".join(now[:-1])


def _outermost(blocks: Mapping[str, SimulinkBlock]) -> list[tuple[str, str]]:
    """Return paths and kinds, without the blocks inside a listed subsystem."""
    return [(path, block.kind) for path, block in blocks.items() if "/".join(split_path(path)[:-1]) not in blocks]


def _compare(old: SimulinkBlock, new: SimulinkBlock, path: str, found: ModelDifference) -> None:
    before, after = _said(old), _said(new)
    looks = False
    for name in sorted({*before, *after}):
        if before.get(name, "") == after.get(name, ""):
            continue
        if _LOOKS.match(name):
            looks = True
        else:
            _note(found, path, name, before.get(name, ""), after.get(name, ""))
    found.looks += looks


def _said(block: SimulinkBlock) -> dict[str, str]:
    """Return all that is said of a block by name, with the mask's own parameters before the block's."""
    mask = {} if block.mask is None else {name: text for name, (_, text) in block.mask.parameters.items()}
    ports = {} if block.ports is None else {"ports": f"{block.ports[0]} in, {block.ports[1]} out"}
    signals = {f"signal {number}": collapsed(name) for number, name in block.signals.items()}
    return {**mask, **block.values, **block.instance, **ports, **signals}


def _note(found: ModelDifference, path: str, name: str, before: str, after: str) -> None:
    if collapsed(before) != collapsed(after):
        found.values.append((path, name, before, after))


def _compare_wires(before: Model, after: Model, pairs: Mapping[str, str], found: ModelDifference) -> None:
    old = {wire for path, system in before.root.walk() for wire in _wires(path, system, pairs)}
    new = {wire for path, system in after.root.walk() for wire in _wires(path, system, {})}
    gone = {system for system, _ in old} - {path for path, _ in after.root.walk()}
    fresh = {system for system, _ in new} - {pairs.get(path, path) for path, _ in before.root.walk()}
    found.wires = sorted(
        [(system, wire, False) for system, wire in old - new if system not in gone]
        + [(system, wire, True) for system, wire in new - old if system not in fresh]
    )


def _wires(path: str, system: System, pairs: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Yield system and wire, with the names that the other model has for them."""
    at = pairs.get(path, path)

    def end(pin: Pin) -> str:
        block = system.blocks.get(pin.sid)
        name = below(path, block) if block is not None else pin.sid
        short = split_path(pairs.get(name, name))[-1]
        return short if (pin.kind in ("in", "out") and pin.number == 1) else f"{short}:{_port(pin)}"

    for line in system.lines:
        for sink in line.wire.sinks():
            if line.source is not None:
                yield at, f"{end(line.source)} -> {end(sink)}"


def _port(pin: Pin) -> str:
    return str(pin.number) if pin.kind in ("in", "out") else pin.kind


def _texts(model: Model) -> dict[str, str]:
    def title(chart: SimulinkChart) -> str:
        return f"{chart.path} ({'MATLAB Function' if chart.function else 'chart'})"

    return {**model.callbacks, **{title(chart): chart.text for chart in model.charts}}


def _compare_code(before: Mapping[str, str], after: Mapping[str, str], found: ModelDifference) -> None:
    for name in sorted({*before, *after}):
        old, new = before.get(name, "").splitlines(), after.get(name, "").splitlines()
        if old != new:
            lines = list(difflib.unified_diff(old, new, "before", "after", lineterm="", n=1))
            found.code.append((name, lines[2:]))
