"""A Simulink model's sheet as an SVG picture, as its author drew it: blocks at their places, lines along their ways.

`sheet_svg(model, path)` draws one system. Each subsystem links to the file that `sheet_name` names, so that the sheets
of a model in one folder are pages of each other.
"""

import math
import re
from collections.abc import Callable, Iterator
from html import escape

from twodof.drawing.text_width import shortened, text_width
from twodof.slx.model import CODED, Line, Model, Pin, SimulinkBlock, System, Wire, below, collapsed, split_path

Point = tuple[float, float]
Rectangle = tuple[float, float, float, float]
MARGIN = 24.0
TEXT = 10.0
_STYLE = """
svg { color-scheme: light dark; font-family: system-ui, sans-serif; --line: #333; --soft: #5b6470; --paper: #fff;
  --fill: #f4f6f8; --inner: #dfe9f5; }
@media (prefers-color-scheme: dark) { svg { --line: #d8dde3; --soft: #98a2ad; --paper: #14181d; --fill: #20262d;
  --inner: #22364d; } }
.paper { fill: var(--paper); } .block { fill: var(--fill); stroke: var(--line); } .inner { fill: var(--inner); }
.bar { fill: var(--line); } text { fill: var(--line); font-size: 10px; text-anchor: middle; }
.name { fill: var(--soft); } .wire { fill: none; stroke: var(--line); } .joint, .arrow { fill: var(--line); }
.off { opacity: .35; } .in { text-anchor: start; } .out { text-anchor: end; } .title { font-size: 14px;
  font-weight: 600; text-anchor: start; } a:hover .block { stroke-width: 2; }
""".strip()

_TEMPLATES = """
Constant {Value=1}; Gain {Gain=1}; Integrator 1/s; DiscreteIntegrator K Ts/(z-1); UnitDelay 1/z;
Delay z^-{DelayLength=2}; Memory memory; Derivative du/dt; Goto [{GotoTag=A}]; From [{GotoTag=A}];
Math {Operator|Function=exp}; Trigonometry {Operator|Function=sin}; RelationalOperator {Operator|Function=>=};
Logic {Operator|Function=AND}; MinMax {Function=min}; Abs |u|; Sqrt sqrt; Bias u + {Bias=0.0};
Saturate {LowerLimit=-0.5} .. {UpperLimit=0.5}; ZeroOrderHold ZOH; DataTypeConversion {OutDataTypeStr=convert};
TransferFcn {Numerator=[1]} / {Denominator=[1 1]}; DiscreteTransferFcn {Numerator=[1]} / {Denominator=[1 0.5]};
SubSystem ; Selector sel; Scope scope; RandomNumber noise; TransportDelay delay; ToWorkspace {VariableName=simout};
FromWorkspace {VariableName=simin}; StateSpace x' = Ax+Bu; Terminator =; Ground 0; Product {Inputs=2}
"""
# What stands in a block of a type: a text with its values, `{name=default}`; any other has its type.
_INSIDE = dict(re.findall(r"\s*(\w+) ([^;\n]*)", _TEMPLATES))
_VALUE = re.compile(r"\{(\w+)(?:\|(\w+))?=([^}]*)\}")


def _inside(block: SimulinkBlock) -> str:
    """Return what stands in a block."""
    values = block.values
    if block.type in ("Inport", "Outport", "InportShadow"):
        return values.get("Port", "1")
    if block.type == "Sum":
        signs = values.get("Inputs", "++")
        return "+" * int(signs) if signs.strip().isdigit() and len(signs) < 3 else signs.replace("|", "")
    if block.kind in CODED or block.type not in _INSIDE:
        return block.kind
    text = _VALUE.sub(lambda v: values.get(v[1], values.get(v[2] or "", v[3])), _INSIDE[block.type])
    if block.type == "Product":
        return "x" if text.strip().isdigit() else text.replace("*", "x").replace("/", "÷")
    return text.replace("Inherit: Inherit via back propagation", "convert")


def sheet_name(model: Model, path: str) -> str:
    """Return the file name of a system's picture: `flight.svg`, `flight.Controller.PID.svg`."""
    safe = re.sub(r"[^\w .+-]", "_", path.replace("//", "_").replace("/", "."))
    return f"{model.name}.{safe}.svg" if path else f"{model.name}.svg"


def sheet_svg(model: Model, path: str = "") -> str:
    """Return the picture of the system at `path`; the same model gives the same bytes. Raises DiagramError if none."""
    sheet = _Sheet(model, model.system(path), model.place(path))
    return "\n".join(sheet.document())


def pin_points(block: SimulinkBlock, box: Rectangle, counts: tuple[int, int]) -> Callable[[Pin], Point]:
    """Return where the pins of a block are: spread over its sides as Simulink does, turned and mirrored with it."""
    turns = _turns(block)
    round_sum = block.type == "Sum" and block.values.get("IconShape", "round") == "round"
    left, top, right, bottom = box
    middle = (left + right) / 2, (top + bottom) / 2
    signs = block.values.get("Inputs", "++")
    slots = signs if round_sum and not signs.strip().isdigit() else ""

    def at(pin: Pin) -> Point:
        if pin.kind not in ("in", "out"):  # enable, trigger and their like are at the top
            across, along = (0.2 if pin.kind == "trigger" else 0.0), -1.0
        elif pin.kind == "out":
            across, along = 1.0, _spread(pin.number, counts[1])
        elif slots:
            places = [i for i, sign in enumerate(slots) if sign in "+-"]
            slot = places[min(pin.number, len(places)) - 1] if places else 0
            angle = math.pi / 2 * (2 * slot / max(len(slots) - 1, 1)) if len(slots) > 1 else math.pi / 2
            across, along = -math.sin(angle), -math.cos(angle)
        else:
            across, along = -1.0, _spread(pin.number, counts[0])
        x, y = _turned(across, along, turns)
        return middle[0] + x * (right - left) / 2, middle[1] + y * (bottom - top) / 2

    return at


def _turns(block: SimulinkBlock) -> tuple[int, bool]:
    """Return by how many quarters a block is turned clockwise, and whether it is mirrored."""
    older = {"left": (0, True), "down": (1, False), "up": (3, False)}
    if (said := block.values.get("Orientation", "")) in older:
        return older[said]
    rotation = block.values.get("BlockRotation", "0")
    return (int(rotation) // 90 % 4 if rotation.isdigit() else 0), block.values.get("BlockMirror") == "on"


def _turned(x: float, y: float, turns: tuple[int, bool]) -> Point:
    quarters, mirrored = turns
    x = -x if mirrored else x
    # 270 is a quarter clockwise on the screen: the outputs point down.
    for _ in range(-quarters % 4):
        x, y = -y, x
    return x, y


def _spread(number: int, count: int) -> float:
    return (2 * number - 1) / max(count, number, 1) - 1.0


class _Sheet:
    def __init__(self, model: Model, system: System, path: str) -> None:
        self.model, self.system, self.path = model, system, path
        self.boxes = {sid: _box(block, index) for index, (sid, block) in enumerate(system.blocks.items())}
        used: dict[tuple[str, str], int] = {}
        for line in system.lines:
            for pin in (*([line.source] if line.source else []), *line.wire.sinks()):
                used[pin.sid, pin.kind] = max(used.get((pin.sid, pin.kind), 0), pin.number)
        self.counts = {
            sid: block.ports or (used.get((sid, "in"), 0), used.get((sid, "out"), 0))
            for sid, block in system.blocks.items()
        }
        self.points = {
            sid: pin_points(block, self.boxes[sid], self.counts[sid]) for sid, block in system.blocks.items()
        }

    def document(self) -> Iterator[str]:
        wires = [piece for line in self.system.lines for piece in self.wire(line)]
        blocks = [piece for block in self.system.blocks.values() for piece in self.block(block)]
        title = f"{self.model.name}/{self.path}".rstrip("/")
        corners = [(x, y) for box in self.boxes.values() for x, y in (box[:2], box[2:])] or [(0.0, 0.0)]
        left, top = min(x for x, _ in corners) - MARGIN, min(y for _, y in corners) - 2 * MARGIN
        right = max(max(x for x, _ in corners) + MARGIN, left + text_width(title, 14.0, True) + 2 * MARGIN)
        bottom = max(y for _, y in corners) + 2 * MARGIN
        width, height = right - left, bottom - top
        yield (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}" height="{height:g}" '
            f'viewBox="{left:g} {top:g} {width:g} {height:g}" role="img" aria-label="{_text(title)}">'
        )
        yield f"<title>{_text(title)}</title><style>{_STYLE}</style>"
        yield f'<rect class="paper" x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}"/>'
        yield f'<text class="title" x="{left + MARGIN / 2:g}" y="{top + 18:g}">{_text(title)}</text>'
        if self.path:
            above = _parent(self.path)
            yield (
                f'<a href="{_text(sheet_name(self.model, above))}"><text class="name in" x="{left + MARGIN / 2:g}" '
                f'y="{top + 32:g}">up to {_text(f"{self.model.name}/{above}".rstrip("/"))}</text></a>'
            )
        yield from wires
        yield from blocks
        yield "</svg>"

    def wire(self, line: Line) -> Iterator[str]:
        if line.source is None or line.source.sid not in self.points:
            return
        start = self.points[line.source.sid](line.source)
        if line.name:
            x, y = start
            yield _label(line.name, x + 4, y - 4, 90.0, "name in")
        yield from self.pieces(line.wire, start)

    def pieces(self, wire: Wire, start: Point) -> Iterator[str]:
        way = [start]
        for dx, dy in wire.points:
            way.append((way[-1][0] + dx, way[-1][1] + dy))
        if wire.sink is not None and wire.sink.sid in self.points:
            end = self.points[wire.sink.sid](wire.sink)
            way += _corners(way[-1], end, self.boxes[wire.sink.sid], len(way) == 1)
            yield _arrow(way[-2], end)
        if wire.branches:
            yield f'<circle class="joint" cx="{way[-1][0]:g}" cy="{way[-1][1]:g}" r="2.2"/>'
        if len(way) > 1:
            yield f'<polyline class="wire" points="{" ".join(f"{x:g},{y:g}" for x, y in way)}"/>'
        for branch in wire.branches:
            yield from self.pieces(branch, way[-1])

    def block(self, block: SimulinkBlock) -> Iterator[str]:
        left, top, right, bottom = self.boxes[block.sid]
        width, height, x = right - left, bottom - top, (left + right) / 2
        link = sheet_name(self.model, below(self.path, block)) if block.system else ""
        yield '<g class="off">' if block.commented else "<g>"
        if link:
            yield f'<a href="{_text(link)}">'
        yield f"<title>{_text(f'{collapsed(block.name)}: {block.kind}')}</title>"
        yield self.outline(block, left, top, width, height)
        inside = _inside(block)
        if inside and block.type not in ("Mux", "Demux", "BusCreator"):
            yield _label(inside, x, top + height / 2 + 3.5, max(width - 2.0, 30.0))
        if block.system is not None and width > 60:
            yield from self.port_names(block, block.system, width)
        if block.values.get("ShowName", "on") != "off" and not _unnamed(block):
            yield _label(block.name, x, bottom + 11, max(width, 110.0), "name")
        if link:
            yield "</a>"
        yield "</g>"

    def outline(self, block: SimulinkBlock, left: float, top: float, width: float, height: float) -> str:
        if block.type in ("Mux", "Demux", "BusCreator", "BusSelector") and min(width, height) < 14:
            return f'<rect class="bar" x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}"/>'
        if block.type == "Sum" and block.values.get("IconShape", "round") == "round":
            x, y = left + width / 2, top + height / 2
            return f'<ellipse class="block" cx="{x:g}" cy="{y:g}" rx="{width / 2:g}" ry="{height / 2:g}"/>'
        if block.type == "Gain" and _turns(block)[0] % 2 == 0:
            tip, base = (left, left + width) if _turns(block)[1] else (left + width, left)
            middle, bottom = top + height / 2, top + height
            return f'<path class="block" d="M{base:g} {top:g} L{tip:g} {middle:g} L{base:g} {bottom:g} Z"/>'
        rounded = f' rx="{min(width, height) / 2:g}"' if block.type in ("Inport", "Outport", "InportShadow") else ""
        inner = " inner" if block.system is not None else ""
        return f'<rect class="block{inner}" x="{left:g}" y="{top:g}" width="{width:g}" height="{height:g}"{rounded}/>'

    def port_names(self, block: SimulinkBlock, inner: System, width: float) -> Iterator[str]:
        turned, mirrored = _turns(block)
        if turned:
            return
        for kind, side in (("Inport", "in"), ("Outport", "out")):
            for port in inner.blocks.values():
                number = port.values.get("Port", "1")
                if port.type == kind and number.isdigit():
                    x, y = self.points[block.sid](Pin(block.sid, side, int(number)))
                    anchor = "in" if (side == "in") != mirrored else "out"
                    shift = 4 if anchor == "in" else -4
                    yield _label(port.name, x + shift, y + 3.5, width / 2 - 6, anchor)


def _label(text: str, x: float, y: float, most: float, kind: str = "") -> str:
    styled = f' class="{kind}"' if kind else ""
    return f'<text{styled} x="{x:g}" y="{y:g}">{_text(shortened(collapsed(text), TEXT, most))}</text>'


def _unnamed(block: SimulinkBlock) -> bool:
    """Return True if Simulink hides the name: one that it gave itself, such as Gain2."""
    stem = re.sub(r"[\s\d]+", "", block.name).lower()
    if block.values.get("HideAutomaticName", "on") == "off" or block.type in ("Inport", "Outport", "SubSystem"):
        return False
    return stem in (block.type.lower(), block.kind.lower())


def _box(block: SimulinkBlock, index: int) -> Rectangle:
    """Return left, top, right and bottom; a block without a place stands in a grid."""
    if block.place is not None:
        return block.place
    row, column = divmod(index, 8)
    return 100.0 * column, 70.0 * row, 100.0 * column + 60.0, 70.0 * row + 34.0


def _corners(last: Point, end: Point, box: Rectangle, straight: bool) -> list[Point]:
    """Return the points from the last one of the file to a pin: the file leaves the last corner out."""
    (x, y), (to_x, to_y) = last, end
    if x == to_x or y == to_y:
        return [end]
    if box[0] < to_x < box[2]:  # the pin is above or below the block
        return [(to_x, y), end]
    if straight:  # from pin to pin
        return [((x + to_x) / 2, y), ((x + to_x) / 2, to_y), end]
    return [(x, to_y), end]


def _arrow(before: Point, end: Point) -> str:
    length = math.hypot(end[0] - before[0], end[1] - before[1]) or 1.0
    ux, uy = (end[0] - before[0]) / length, (end[1] - before[1]) / length
    back = end[0] - 6 * ux, end[1] - 6 * uy
    return (
        f'<path class="arrow" d="M{end[0]:.2f} {end[1]:.2f} L{back[0] - 3 * uy:.2f} {back[1] + 3 * ux:.2f} '
        f'L{back[0] + 3 * uy:.2f} {back[1] - 3 * ux:.2f} Z"/>'
    )


def _parent(path: str) -> str:
    return "/".join(split_path(path)[:-1])


def _text(text: str) -> str:
    return escape("".join(c if c.isprintable() else " " for c in text))
