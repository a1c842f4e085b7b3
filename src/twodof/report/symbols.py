"""How a block is drawn: a sum as a circle with signs, a gain as a triangle, a transfer function as a fraction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from twodof.blocks.block import Block
from twodof.blocks.bus import Bus, grouped
from twodof.blocks.declarations import Port
from twodof.blocks.diagram import BASE, CONDITIONS, Diagram, Part, bus_paths
from twodof.blocks.expressions.numbers import INTEGERS
from twodof.blocks.library.delays import StoreRead, StoreWrite
from twodof.blocks.library.math import Sum
from twodof.drawing.layered_layout import Box
from twodof.drawing.text_width import shortened, text_width

NAME, PORT, VALUE, SMALL = 12.0, 11.0, 13.0, 10.0  # sizes of text
LINE = 13.0
ROW = 20.0  # between ports, and between terminals, so that wires between them are straight
MOST = 220.0  # a text is cut beyond
MANY_PARAMETERS = 5
RADIUS = 14.0
HIGH = 44.0  # a symbol with its name below
TERMINAL = 16.0  # height of a terminal
_SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


@dataclass(frozen=True)
class SymbolText:
    """A text whose baseline starts, ends or is centred (`anchor` start, end, middle) at x, y."""

    x: float
    y: float
    text: str
    size: float = PORT
    anchor: str = "middle"
    style: str = ""  # "name", "soft" or "italic"

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom."""
        width = text_width(self.text, self.size, self.style == "name")
        left = self.x - {"start": 0.0, "middle": 0.5, "end": 1.0}[self.anchor] * width
        return left, self.y - 0.75 * self.size, left + width, self.y + 0.25 * self.size


@dataclass
class BlockSymbol:
    """A drawing at the origin: `shapes` are SVG elements without user's text, `texts` stand inside the box.

    With `own_heads` the drawing has the arrows at which wires end; else they end at its left pins.
    """

    box: Box
    shapes: list[str] = field(default_factory=list)
    texts: list[SymbolText] = field(default_factory=list)
    title: str = ""
    own_heads: bool = False

    def path(self, style: str, d: str) -> None:
        """Draw a path with this class."""
        self.shapes.append(f'<path class="{style}" d="{d}"/>')

    def write(self, x: float, y: float, text: str, size: float = PORT, anchor: str = "middle", style: str = "") -> None:
        """Write a text; see `SymbolText`."""
        self.texts.append(SymbolText(x, y, text, size, anchor, style))


def terminal(name: str, side: str, remark: str) -> BlockSymbol:
    """Return the symbol of an input or output of the diagram."""
    label = shortened(name, NAME, MOST, True)
    small = shortened(remark, SMALL, MOST)
    inner = text_width(label, NAME, True) + (text_width(small, SMALL) + 6.0 if small else 0.0)
    width, middle = float(round(inner + 22.0)), 0.5 * TERMINAL
    left, right = ([], [middle]) if side == "in" else ([middle], [])
    made = BlockSymbol(Box(width, TERMINAL, left, right, side), title=name)
    made.path(
        "terminal", f"M8 0H{width - 8:g}L{width:g} {middle:g}L{width - 8:g} {TERMINAL:g}H8A8 {middle:g} 0 0 1 8 0Z"
    )
    made.write(9.0, middle + 4.0, label, NAME, "start", "name")
    if small:
        made.write(15.0 + text_width(label, NAME, True), middle + 3.5, small, SMALL, "start", "soft")
    return made


def symbol(part: Part, pins: Sequence[str], flip: bool = False) -> BlockSymbol:
    """Return the symbol of a part with the inputs `pins`. `flip` lets the second input of a sum come from above."""
    item = part.item
    if isinstance(item, Block):
        fields = any("." in name for name in pins)
        made = (None if fields else _special(part, item, flip)) or _block(part, item, pins)
    else:
        made = _subdiagram(part, item, pins)
    made.box.preferred = part.position
    return made


def input_names(part: Part, diagram: Diagram) -> list[str]:
    """Return the pins on a part's left side: inputs, then conditions. `diagram` is the one around it.

    A bus is one pin, or one for each field that is connected by itself.
    """
    item = part.item
    own = item.inputs if isinstance(item, Block) else item.inputs.values()
    names = []
    for port in grouped(own):
        inside = [f"{port.name}.{leaf.name}" for leaf in port.kind.leaves] if isinstance(port.kind, Bus) else []
        paths = dict.fromkeys(path for name in inside for path in (*reversed(bus_paths(name)[:-1]), name))
        names += [path for path in paths if (part.name, path) in diagram.connections] or [port.name]
    return names + [what for what in CONDITIONS if getattr(part, what)]


def value_text(part: Part, block: Block, name: str) -> str:
    """Return a parameter's default, or the name of the parameter to which it is bound."""
    if name in part.params:
        return part.params[name]
    value = next(p.value for p in block.params if p.name == name)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_number(v) for v in value[:6]) + (", …]" if len(value) > 6 else "]")
    return _number(value)


def _number(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    return f"{value:.4g}".replace("e+0", "e").replace("e-0", "e-").replace("-", "−")


def _block(part: Part, block: Block, pins: Sequence[str]) -> BlockSymbol:
    """Return a rectangle with name, type, parameters and named ports."""
    kind = getattr(block, "label", "") or type(block).__name__
    lines = []
    if 0 < len(block.params) <= MANY_PARAMETERS:
        for p in block.params:
            if part.params.get(p.name) != p.name:
                unit = f" {p.unit}" if p.unit and p.name not in part.params else ""
                lines.append(f"{p.name} = {value_text(part, block, p.name)}{unit}")
    elif block.params:
        lines.append(f"{len(block.params)} parameters")
    lines += [f"of {block.store}"] if isinstance(block, (StoreRead, StoreWrite)) else []
    lines += _starts(part)
    outputs = [(p.name, p.unit) for p in grouped(block.outputs)]
    signs = block.signs if isinstance(block, Sum) else ""  # of a sum with more inputs than a circle has places for
    return _rectangle(part, pins, kind, lines, outputs, "block", [s.replace("-", "−") for s in signs])


def _subdiagram(part: Part, diagram: Diagram, pins: Sequence[str]) -> BlockSymbol:
    count = len(diagram.parts)
    lines = [f"{count} part{'s' if count != 1 else ''}"] if count else []
    lines += _starts(part)
    lines += [f"at {part.edge} edges"] if part.trigger else []
    lines += ["starts afresh when enabled"] if part.enabling == "restart" else []
    lines += [f"{inner} = {outer}" for inner, outer in part.params.items() if inner != outer][:MANY_PARAMETERS]
    made = _rectangle(part, pins, "", lines, [(name, "") for name in diagram.outputs], "sub")
    made.title = f"{part.name}: {diagram.text}" if diagram.text else part.name
    return made


def _rectangle(
    part: Part,
    pins: Sequence[str],
    kind: str,
    lines: list[str],
    outputs: list[tuple[str, str]],
    style: str,
    signs: Sequence[str] = (),
) -> BlockSymbol:
    names = list(pins)
    inputs = [f"{sign} {name}" for sign, name in zip(signs, names, strict=False)] + names[len(signs) :]
    name = shortened(part.name, NAME, MOST, True)
    about = " · ".join([*([kind] if kind else []), *_rate(part)])
    small = [shortened(t, SMALL, MOST) for t in ([about] if about else []) + lines]
    named = [shortened(f"{n} [{u}]" if u else n, PORT, MOST) for n, u in outputs]
    left = max((text_width(n, PORT) for n in inputs), default=0.0)
    right = max((text_width(n, PORT) for n in named), default=0.0)
    widest = max([text_width(name, NAME, True), *(text_width(t, SMALL) for t in small), left + right + 18.0])
    width = float(round(widest + 18.0))
    top = 33.0 + LINE * len(small)
    rows = [top + ROW * i for i in range(max(len(inputs), len(outputs)))]
    height = top + ROW * len(rows) - 5.0
    heights = [at - 4.0 for at in rows]
    box = Box(width, height, heights[: len(inputs)], heights[: len(outputs)])
    made = BlockSymbol(box, title=f"{part.name}: {kind}".rstrip(": "))
    made.shapes.append(f'<rect class="{style}" width="{width:g}" height="{height:g}" rx="4"/>')
    if rows:
        made.path("rule", f"M0 {top - 14.0:g}H{width:g}")
    made.write(0.5 * width, 16.0, name, NAME, "middle", "name")
    for i, t in enumerate(small, 1):
        made.write(0.5 * width, 16.0 + LINE * i, t, SMALL, "middle", "soft")
    wired = len(inputs) - sum(1 for what in CONDITIONS if getattr(part, what))
    for i, (at, n) in enumerate(zip(rows, inputs, strict=False)):
        made.write(7.0, at, n, PORT, "start", "" if i < wired else "italic")
    for at, n in zip(rows, named, strict=False):
        made.write(width - 7.0, at, n, PORT, "end")
    return made


def _starts(part: Part) -> list[str]:
    return [f"{output} starts at {_number(value)}" for output, value in part.initial.items()][:MANY_PARAMETERS]


def _rate(part: Part) -> list[str]:
    if part.rate == BASE:
        return []
    divider, offset = part.rate
    return [f"every {divider} ticks" + (f" from {offset}" if offset else "")]


def _label(part: Part, block: Block) -> str:
    """Return the text below a symbol: the part's name, its unit and its rate."""
    unit = str(grouped(block.outputs)[0].unit) if block.outputs else ""
    return shortened(part.name + (f" [{unit}]" if unit else "") + "".join(f" · {r}" for r in _rate(part)), SMALL, MOST)


def _labelled(part: Part, block: Block, width: float, outline: str) -> tuple[BlockSymbol, float]:
    """Return a symbol of this width with its name below and pins at half its height, and the left edge of its outline.

    `outline` is that of a shape at the origin, within the width and HIGH.
    """
    label = _label(part, block)
    wide = float(round(max(width, text_width(label, SMALL) + 2.0)))
    middle, left = 0.5 * HIGH, 0.5 * (wide - width)
    inputs, outputs = grouped(block.inputs), grouped(block.outputs)
    made = BlockSymbol(Box(wide, HIGH + 15.0, [middle] * len(inputs), [middle] * len(outputs)), title=part.name)
    made.write(0.5 * wide, HIGH + 11.0, label, SMALL, "middle", "soft")
    if left >= 1.0:  # the name is wider than the shape: wires go on to it
        for ports, x1, x2 in ((inputs, 0.0, left), (outputs, wide - left, wide)):
            for port in ports:
                made.path(wire_class(port), f"M{x1:g} {middle:g}H{x2:g}")
        made.own_heads = True
        made.shapes += [arrow(left, middle, 1, 0)] * len(inputs)
    made.shapes.append(outline.format(left=left, right=left + width, width=width))
    return made, left


def wire_class(port: Port | None) -> str:
    """Return the CSS classes of a wire that carries the signal of `port`."""
    if port is None:
        return "wire"
    if isinstance(port.kind, Bus):
        return "wire bus"
    kind = " truth" if port.kind == "bool" else " whole" if port.kind in INTEGERS else ""
    return "wire" + (" array" if port.width is not None else "") + kind


def _sum(part: Part, block: Any, flip: bool) -> BlockSymbol | None:
    signs = block.signs
    if len(signs) > 3:
        return None
    label = _label(part, block)
    width = float(round(max(4.0 * RADIUS + 2.0, text_width(label, SMALL) + 2.0)))
    places = {1: "l", 2: "lt" if flip else "lb", 3: "tlb"}[len(signs)]
    x, y = 0.5 * width, RADIUS + 2.0 + (14.0 if "t" in places else 0.0)
    foot = y + RADIUS + (14.0 if "b" in places else 0.0)
    heights = {"l": y, "t": y - RADIUS - 12.0, "b": foot}
    box = Box(width, foot + 15.0, [heights[p] for p in places], [y])
    made = BlockSymbol(box, title=part.name, own_heads=True)
    made.path("wire", f"M{x + RADIUS:g} {y:g}H{width:g}")
    for p, sign in zip(places, signs, strict=True):
        mark = "+" if sign == "+" else "−"
        if p == "l":
            made.path("wire", f"M0 {y:g}H{x - RADIUS - 4:g}")
            made.shapes.append(arrow(x - RADIUS, y, 1, 0))
            made.write(x - RADIUS - 7.0, y - 4.0, mark, VALUE)
        else:
            down = 1 if p == "t" else -1
            made.path("wire", f"M0 {heights[p]:g}H{x:g}V{y - down * (RADIUS + 4.0):g}")
            made.shapes.append(arrow(x, y - down * RADIUS, 0, down))
            made.write(x + 9.0, y + (-RADIUS - 3.0 if p == "t" else RADIUS + 12.0), mark, VALUE)
    made.shapes.append(f'<circle class="block" cx="{x:g}" cy="{y:g}" r="{RADIUS:g}"/>')
    made.write(x, foot + 11.0, label, SMALL, "middle", "soft")
    return made


def arrow(x: float, y: float, dx: int, dy: int) -> str:
    """Return an arrow's head with its point at x, y that points along (dx, dy)."""
    a, b = (x - 7 * dx - 3.5 * dy, y - 7 * dy - 3.5 * dx), (x - 7 * dx + 3.5 * dy, y - 7 * dy + 3.5 * dx)
    return f'<path class="head" d="M{x:g} {y:g}L{a[0]:g} {a[1]:g}L{b[0]:g} {b[1]:g}Z"/>'


def _special(part: Part, block: Any, flip: bool) -> BlockSymbol | None:
    """Return the usual symbol of a block; None if it does not have one that fits."""
    kind = type(block).type_name
    if kind == "sum":
        return _sum(part, block, flip)
    if kind == "gain":
        return _gain(part, block)
    if len(grouped(block.inputs)) > 1 or len(grouped(block.outputs)) > 1:
        return None
    if kind in _GRAPHS:
        return _graph(part, block, _GRAPHS[kind])
    if kind in _EQUATIONS:
        return _framed(part, block, _EQUATIONS[kind])
    return _framed(part, block, _FORMULAS[kind](part, block), fraction=True) if kind in _FORMULAS else None


_FRAME = f'<rect class="block" x="{{left:g}}" width="{{width:g}}" height="{HIGH:g}" rx="3"/>'


def _gain(part: Part, block: Any) -> BlockSymbol:
    value = shortened(value_text(part, block, "k"), VALUE, 90.0)
    width = float(round(max(44.0, (text_width(value, VALUE) + 6.0) / 0.56)))
    triangle = '<path class="block" d="M{left:g} 0L{right:g} 22L{left:g} 44Z"/>'
    made, left = _labelled(part, block, width, triangle)
    made.write(left + 4.0, 26.5, value, VALUE, "start")
    return made


def _framed(part: Part, block: Block, lines: Sequence[str], fraction: bool = False) -> BlockSymbol | None:
    """Return a box with a formula of one line, or two, as a `fraction` or below each other."""
    inner = max(text_width(t, VALUE) for t in lines)
    if inner > MOST:
        return None
    made, _ = _labelled(part, block, float(round(max(46.0, inner + 18.0))), _FRAME)
    middle = 0.5 * made.box.width
    if fraction and len(lines) > 1:
        made.path("bar", f"M{middle - 0.5 * inner - 3:g} 22H{middle + 0.5 * inner + 3:g}")
    for y, line in zip((26.5,) if len(lines) == 1 else (16.5, 36.0), lines, strict=True):
        made.write(middle, y, line, VALUE)
    return made


def _graph(part: Part, block: Block, path: str) -> BlockSymbol:
    """Return a box with a small graph on axes, and two limits below and above, if it has them."""
    limits = ("low", "high") if type(block).type_name in _LIMITED else ()
    texts = [shortened(value_text(part, block, name), SMALL, 60.0) for name in limits]
    inner = max((text_width(t, SMALL) + 4.0 for t in texts), default=0.0)
    made, left = _labelled(part, block, float(round(50.0 + inner)), _FRAME)
    axes = '<path class="axes" d="M5 22H45M25 5V39"/>'
    made.shapes.append(f'<g transform="translate({left:g} 0)">{axes}<path class="bar" d="{path}"/></g>')
    for y, t in zip((38.0, 14.0), texts, strict=False):
        made.write(left + 48.0, y, t, SMALL, "start", "soft")
    return made


def _polynomial(values: Any, variable: str, falling: bool = True) -> str:
    """Coefficients in descending powers (or, not `falling`, ascending powers of 1/variable) as text."""
    text = ""
    for i, c in enumerate(values):
        power = len(values) - 1 - i if falling else -i
        if c == 0.0:
            continue
        base = "" if power == 0 else variable if power == 1 else variable + str(power).translate(_SUPERSCRIPT)
        sign = "−" if c < 0 else "+"
        text += (f" {sign} " if text else sign.strip("+")) + ("" if abs(c) == 1.0 and power else _number(abs(c))) + base
    return text or "0"


def _rational(variable: str, falling: bool = True) -> _Formula:
    def formula(part: Part, block: Any) -> list[str]:
        unknown = [f"B({variable})", f"A({variable})"]
        if {"numerator", "denominator"} & set(part.params):
            return unknown
        value = {p.name: p.value for p in block.params}
        known = [_polynomial(value[n], variable, falling) for n in ("numerator", "denominator")]
        return unknown if max(text_width(t, VALUE) for t in known) > MOST else known

    return formula


def _delay(part: Part, block: Any) -> list[str]:
    samples = value_text(part, block, "samples") if any(p.name == "samples" for p in block.params) else "1"
    return [f"z{f'-{samples}'.translate(_SUPERSCRIPT)}" if samples.isdecimal() else f"z^−{samples}"]


def _discrete_integrator(part: Part, block: Any) -> list[str]:
    top = {"forward": "T", "backward": "T z", "trapezoidal": "T (z + 1)"}[block.method]
    return [_factor(part, block, "gain") + top, "2 (z − 1)" if block.method == "trapezoidal" else "z − 1"]


def _factor(part: Part, block: Block, name: str) -> str:
    value = value_text(part, block, name)
    return "" if value == "1" else f"{value} "


def _function(part: Part, block: Any) -> list[str]:
    return [str(block.config.get("function", "f"))]


_Formula = Callable[[Part, Any], Sequence[str]]

# By the type's name: a formula of one line or, of two, numerator and denominator.
_FORMULAS: dict[str, _Formula] = {
    "unit_delay": _delay,
    "delay": _delay,
    "rate_transition": _delay,
    "fractional_delay": lambda part, block: [f"exp(−{value_text(part, block, 'delay')} s)"],
    "integrator": lambda part, block: ["1", "s"],
    "discrete_integrator": _discrete_integrator,
    "discrete_derivative": lambda part, block: ["z − 1", "T z"],
    "first_order": lambda p, block: [value_text(p, block, "gain"), f"{_factor(p, block, 'time_constant')}s + 1"],
    "transfer_function": _rational("s"),
    "discrete_transfer_function": _rational("z"),
    "discrete_filter": _rational("z", falling=False),
    "constant": lambda part, block: [shortened(value_text(part, block, block.params[0].name), VALUE, 120.0)],
    "abs": lambda part, block: ["|u|"],
    "elementary": _function,
    "trigonometry": _function,
}
_EQUATIONS = {
    "state_space": ("x' = A x + B u", "y = C x + D u"),
    "discrete_state_space": ("x⁺ = A x + B u", "y = C x + D u"),
}
_LIMITED = ("saturation", "dead_zone")
_GRAPHS = {
    "sign": "M7 36H25V8H43",
    "saturation": "M7 34H15L35 10H43",
    "dead_zone": "M8 36L18 22H32L42 8",
    "rate_limit": "M8 38L20 22H30L42 8",
    "quantiser": "M7 36H16V27H25V17H34V8H43",
    "relay": "M7 36H32V8M18 36V8H43",
    "backlash": "M10 36L30 8H40L20 36Z",
    "zero_order_hold": "M7 36H14V28H22V18H30V10H43",
    "step": "M7 36H25V10H43",
    "ramp": "M7 36H20L42 8",
    "sine": "M7 22C13 4 19 4 25 22S37 40 43 22",
    "doublet": "M7 22H14V8H25V36H36V22H43",
    "pulse": "M7 34H16V10H32V34H43",
}
