"""A diagram as an SVG picture that a person reads: laid out in columns, with the field's symbols. Deterministic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html import escape as escape_html
from importlib import resources
from string import Template

from twodof.blocks.block import Block
from twodof.blocks.bus import Bus, grouped
from twodof.blocks.declarations import Port, shape, unknown_name
from twodof.blocks.diagram import CONDITIONS, Diagram, Part, carried_fields
from twodof.drawing.layered_layout import Box, GraphLayout, Net, layout
from twodof.drawing.text_width import shortened, text_width
from twodof.drawing.wire_channels import Segment
from twodof.errors import DiagramError
from twodof.report.symbols import TERMINAL, BlockSymbol, SymbolText, arrow, input_names, symbol, terminal, wire_class

MAX_PARTS = 5000  # in one picture
HEADER = 26.0  # above what an opened sub-diagram shows


def escape(text: str) -> str:
    """User's text for XML, which cannot hold control characters or marks that turn the direction of reading."""
    return escape_html("".join(c if c.isprintable() else " " for c in text))


def document(
    name: str, about: str, described: str, size: tuple[float, float], drawing: Sequence[str], legend: Sequence[str] = ()
) -> str:
    """Return an SVG document: a heading with `about`, below it the drawing of this size, and the legend."""
    about = shortened(about, 12.0, 700.0)
    head = 50.0 if about else 34.0
    width = max(size[0], text_width(name, 17.0, True) + 32.0, text_width(about, 12.0) + 32.0)
    height = size[1] + head + (20.0 if legend else 0.0)
    key = ["", f'<g transform="translate(16 {height - 16:g})">', *legend, "</g>"] if legend else []
    template = resources.files(__package__).joinpath("diagram.svg").read_text(encoding="utf-8")
    return Template(template).substitute(
        width=f"{width:g}",
        height=f"{height:g}",
        title=escape(name),
        described=escape(described[:2000]),
        about=f'\n<text class="soft" x="16" y="44" font-size="12">{escape(about)}</text>' if about else "",
        head=f"{head:g}",
        drawing="\n".join(drawing),
        legend="\n".join(key),
    )


@dataclass
class Drawing:
    """A diagram that has been laid out, to be measured or written."""

    diagram: Diagram
    symbols: list[BlockSymbol]
    nets: list[Net]
    sources: list[tuple[str, Port | None]]  # of each net: its name and what it carries
    placed: GraphLayout
    inner: dict[int, Drawing] = field(default_factory=dict)  # symbol -> what an opened sub-diagram shows


def draw(diagram: Diagram, depth: int = 0) -> Drawing:
    """Lay out `diagram`, with sub-diagrams down to `depth` opened in place.

    Raises DiagramError for one that has a connection to nowhere, or more than 5000 parts.
    """
    return _draw(diagram, depth, False, [0])


def find(diagram: Diagram, path: str) -> Diagram:
    """Return the sub-diagram at `path`, "part.sub". Raises DiagramError if there is none."""
    at = diagram
    for name in path.split(".") if path else []:
        part = at.parts.get(name)
        if part is None or isinstance(part.item, Block):
            known = [n for n, p in at.parts.items() if isinstance(p.item, Diagram)]
            raise unknown_name("sub-diagram", name, known, at.name)
        at = part.item
    return at


def to_svg(diagram: Diagram, depth: int = 0) -> str:
    """Return the picture as text; the same diagram gives the same bytes. Raises DiagramError as `draw` does."""
    drawing = draw(diagram, depth)
    tops = [port.name for port in grouped(diagram.inputs.values())]
    inputs, parts, outputs = (", ".join(names) or "none" for names in (tops, diagram.parts, diagram.outputs))
    described = f"Block diagram {diagram.name} with the inputs {inputs}, the parts {parts} and the outputs {outputs}."
    size = drawing.placed.width, drawing.placed.height
    return document(diagram.name, diagram.text, described, size, _written(drawing), _legend(drawing))


def to_inline_svg(diagram: Diagram, title: str) -> str:
    """Return the picture without a heading as an element of a page, coloured by the page's style sheet.

    Raises DiagramError as `draw` does.
    """
    drawing = draw(diagram)
    view = f"0 0 {drawing.placed.width:g} {drawing.placed.height:g}"
    head = f'<svg class="diagram" viewBox="{view}" role="img" aria-label="{escape(title)}">'
    return "\n".join([head, *_written(drawing), "</svg>"])


def _legend(drawing: Drawing) -> list[str]:
    """Return the legend of wire styles; empty if all wires carry single reals."""
    found: set[str] = set()
    stack = [drawing]
    while stack:
        at = stack.pop()
        stack += at.inner.values()
        for _, port in at.sources:
            if port is not None:
                found.update(wire_class(port).split()[1:] or [""])
    lines: list[str] = []
    x = 0.0
    for style, meaning in (("", "real"), ("whole", "integer"), ("truth", "bool"), ("array", "array"), ("bus", "bus")):
        if style in found and len(found) > 1:
            lines.append(f'<path class="wire {style}" d="M{x:g} 0H{x + 28:g}"/>')
            lines.append(f'<text class="soft" x="{x + 34:g}" y="3.5" font-size="10">{meaning}</text>')
            x += 90.0
    return lines


def _draw(diagram: Diagram, depth: int, border: bool, count: list[int]) -> Drawing:
    count[0] += len(diagram.parts)
    if count[0] > MAX_PARTS:
        raise DiagramError(f"more than {MAX_PARTS} parts", diagram.name, "open fewer levels, or one sub-diagram")
    given = grouped(diagram.inputs.values())
    symbols = [terminal(p.name, "in", _remark(p)) for p in given]
    place: dict[tuple[str | None, str], int] = {(None, p.name): i for i, p in enumerate(given)}
    inner: dict[int, Drawing] = {}
    for part in diagram.parts.values():
        place[part.name, ""] = len(symbols)
        if depth > 0 and isinstance(part.item, Diagram):
            inner[len(symbols)] = _draw(part.item, depth - 1, True, count)
            symbols.append(_frame(part, part.item, inner[len(symbols)], input_names(part, diagram)))
        else:
            symbols.append(symbol(part, input_names(part, diagram)))
    for name in diagram.outputs:
        place["", name] = len(symbols)
        symbols.append(terminal(name, "out", ""))
    nets, sources = _nets(diagram, place)
    drawing = Drawing(diagram, symbols, nets, sources, layout([s.box for s in symbols], nets, border), inner)
    flipped = _flips(drawing, place)
    for name in flipped:
        part = diagram.parts[name]
        symbols[place[name, ""]] = symbol(part, input_names(part, diagram), flip=True)
    if flipped:
        drawing.placed = layout([s.box for s in symbols], nets, border)
    return drawing


def _remark(port: Port) -> str:
    if isinstance(port.kind, Bus):
        return "bus"
    kind = "" if port.kind == "real" and port.width is None else shape(port)
    return " ".join(([f"[{port.unit}]"] if port.unit else []) + ([kind] if kind else []))


def _nets(
    diagram: Diagram, place: dict[tuple[str | None, str], int]
) -> tuple[list[Net], list[tuple[str, Port | None]]]:
    """Return a net for each pin that drives others, and each net's name and port."""
    given = {port.name: port for port in grouped(diagram.inputs.values())}
    sinks: dict[tuple[int, int], list[tuple[int, int]]] = {}
    about: dict[tuple[int, int], tuple[str, Port | None]] = {}

    def drive(source: str, to: tuple[int, int]) -> None:
        part, port = diagram.source(source)
        name = port.partition(".")[0]  # of a bus all fields leave from one pin
        if part is None:
            pin = place[None, name], 0
            about[pin] = name, given[name]
        else:
            item = diagram.parts[part].item
            names = [p.name for p in grouped(item.outputs)] if isinstance(item, Block) else list(item.outputs)
            pin = place[part, ""], names.index(name)
            fields = carried_fields(item, name)
            bus = [replace(p, name=f"{name}.{field}") for field, p in fields.items() if field]
            about[pin] = f"{part}.{name}", grouped(bus)[0] if bus else fields.get("")
        sinks.setdefault(pin, []).append(to)

    for part in diagram.parts.values():
        for i, name in enumerate(input_names(part, diagram)):
            fed = diagram.connections.get((part.name, name)) or (getattr(part, name) if name in CONDITIONS else None)
            if fed:
                drive(fed, (place[part.name, ""], i))
    for name, feeder in diagram.outputs.items():
        if feeder is not None:
            drive(feeder, (place["", name], 0))
    ordered = sorted(sinks)
    return [Net(pin, tuple(sinks[pin])) for pin in ordered], [about[pin] for pin in ordered]


def _frame(part: Part, diagram: Diagram, shown: Drawing, pins: Sequence[str]) -> BlockSymbol:
    """Return the frame around an opened sub-diagram's drawing, with pins at its terminals."""
    name = shortened(part.name, 13.0, 300.0, True)
    header = HEADER
    width = float(round(max(shown.placed.width, text_width(name, 13.0, True) + 20.0)))
    height = float(round(shown.placed.height + header))
    last = len(shown.symbols) - len(diagram.outputs)
    corners = shown.placed.corners
    ports = [port.name for port in grouped(diagram.inputs.values())]
    terminals = [ports.index(name.partition(".")[0]) for name in pins if name.partition(".")[0] in ports]
    beside = [terminals[:k].count(i) - 0.5 * (terminals.count(i) - 1) for k, i in enumerate(terminals)]
    left = [header + corners[i][1] + 0.5 * TERMINAL + 4.0 * at for i, at in zip(terminals, beside, strict=True)]
    right = [header + corners[last + i][1] + 0.5 * TERMINAL for i in range(len(diagram.outputs))]
    wires = [f'<path class="wire" d="M0 {y:g}H{corners[i][0]:g}"/>' for i, y in zip(terminals, left, strict=True)]
    for i, y in enumerate(right):
        edge = corners[last + i][0] + shown.symbols[last + i].box.width
        wires.append(f'<path class="wire" d="M{edge:g} {y:g}H{width:g}"/>')
    texts = [SymbolText(10.0, 18.0, name, 13.0, "start", "name")]
    for what in CONDITIONS:
        if getattr(part, what):
            left.append(height + 10.0)
            texts.append(SymbolText(7.0, height + 14.0, what, 11.0, "start", "italic"))
            height += 18.0
    shapes = [f'<rect class="frame" width="{width:g}" height="{height:g}" rx="6"/>', *wires]
    return BlockSymbol(Box(width, height, left, right, "", part.position), shapes, texts, part.name)


def _flips(drawing: Drawing, place: dict[tuple[str | None, str], int]) -> set[str]:
    """Return the sums whose second input comes from above."""
    symbols, corners = drawing.symbols, drawing.placed.corners
    fed = {sink: net.source for net in drawing.nets for sink in net.sinks}
    found = set()
    for name, part in drawing.diagram.parts.items():
        i = place[name, ""]
        ends = [fed[i, pin] for pin in (0, 1) if (i, pin) in fed]
        if getattr(type(part.item), "type_name", "") != "sum" or len(symbols[i].box.left) != 2 or len(ends) < 2:
            continue
        heights = [corners[box][1] + symbols[box].box.right[pin] for box, pin in ends]
        if heights[1] < heights[0] and all(corners[box][0] < corners[i][0] for box, _ in ends):
            found.add(name)
    return found


def _written(drawing: Drawing) -> list[str]:
    lines = []
    for net, wire, (name, port) in zip(drawing.nets, drawing.placed.wires, drawing.sources, strict=True):
        unit = f" [{port.unit}]" if port is not None and port.unit else ""
        lines.append(f'<path class="{wire_class(port)}" d="{_path(wire)}"><title>{escape(name + unit)}</title></path>')
        for box, pin in net.sinks:
            if not drawing.symbols[box].own_heads:
                x, y = drawing.placed.corners[box]
                lines.append(arrow(x, y + drawing.symbols[box].box.left[pin], 1, 0))
    lines += [f'<circle class="joint" cx="{x:g}" cy="{y:g}" r="2.6"/>' for x, y in drawing.placed.joints]
    for i, (made, (x, y)) in enumerate(zip(drawing.symbols, drawing.placed.corners, strict=True)):
        lines.append(f'<g transform="translate({x:g} {y:g})"><title>{escape(made.title)}</title>')
        lines += made.shapes
        lines += [text_element(t) for t in made.texts]
        if i in drawing.inner:
            lines.append(f'<g transform="translate(0 {HEADER:g})">')
            lines += _written(drawing.inner[i])
            lines.append("</g>")
        lines.append("</g>")
    return lines


def text_element(t: SymbolText) -> str:
    """Return a text as SVG, stretched to its measured width in any font."""
    style = f' class="{t.style}"' if t.style else ""
    left, _, right, _ = t.extent
    fit = f' textLength="{right - left:.1f}" lengthAdjust="spacingAndGlyphs"' if len(t.text) > 1 else ""
    return (
        f'<text{style} x="{t.x:g}" y="{t.y:g}" font-size="{t.size:g}" text-anchor="{t.anchor}"{fit}>'
        f"{escape(t.text)}</text>"
    )


def _path(wire: list[Segment]) -> str:
    """Return a wire's path without empty pieces, with adjoining pieces joined."""
    rows: dict[tuple[bool, float], list[list[float]]] = {}
    for x1, y1, x2, y2 in wire:
        level = y1 == y2
        ends = sorted((x1, x2) if level else (y1, y2))
        if ends[0] < ends[1]:
            rows.setdefault((level, y1 if level else x1), []).append(ends)
    path = ""
    for (level, at), spans in sorted(rows.items()):
        merged: list[list[float]] = []
        for low, high in sorted(spans):
            if merged and low <= merged[-1][1]:
                merged[-1][1] = max(high, merged[-1][1])
            else:
                merged.append([low, high])
        path += "".join(f"M{a:g} {at:g}H{b:g}" if level else f"M{at:g} {a:g}V{b:g}" for a, b in merged)
    return path
