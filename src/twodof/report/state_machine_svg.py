"""A state machine as an SVG picture: modes in a column, transitions beside them with their order, guard and action.

Deterministic. Each transition has a lane of its own where others run, and each end a height of its own, so that no text
lies on a line.
"""

from dataclasses import dataclass, field
from inspect import cleandoc

from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions.graph import machine_text
from twodof.blocks.state_machine import Mode, StateMachine
from twodof.blocks.state_machine.chart import ACTIONS
from twodof.drawing.text_width import shortened, text_width
from twodof.report.diagram_svg import document, find, text_element
from twodof.report.symbols import SymbolText, arrow

LINE, SLOT, PAD = 16.0, 24.0, 12.0  # heights of a line of text, of an end of a transition, and around them
LEFT = 46.0  # where outer boxes begin; before it the start
GAP = 18.0  # between boxes, and of a box within a frame
LANE = 16.0
SMALL, NAME = 11.0, 13.0  # sizes of text
WIDEST = 420.0


@dataclass
class ModeBox:
    """A mode in its place; `ends` are the heights at which transitions leave it, in their order, and then arrive."""

    mode: Mode
    lines: list[str]
    x: float = 0.0
    y: float = 0.0
    width: float = 0.0
    height: float = 0.0
    leaving: list[int] = field(default_factory=list)
    arriving: list[int] = field(default_factory=list)
    head: float = 0.0  # of a frame: the height above its inner modes

    def end(self, number: int, leaves: bool) -> float:
        """Return the height at which a transition ends here."""
        slot = self.leaving.index(number) if leaves else len(self.leaving) + self.arriving.index(number)
        return self.y + PAD + SLOT * (slot + 0.5)


@dataclass(frozen=True)
class TransitionLine:
    """A transition's line: from the height `start` of the mode at its left by a lane to the height `stop`."""

    number: int
    label: str
    left: float
    start: float
    right: float
    stop: float
    lane: int


@dataclass
class MachineDrawing:
    """A machine that has been laid out, to be measured or written."""

    boxes: dict[str, ModeBox]
    lines: list[TransitionLine]
    label_x: float
    lanes_x: float
    width: float
    height: float


def machine_at(diagram: Diagram, path: str) -> StateMachine | None:
    """Return the state machine at `path`, "part.machine", or None."""
    above, _, name = path.rpartition(".")
    part = find(diagram, above).parts.get(name)
    return part.item if part is not None and isinstance(part.item, StateMachine) else None


def draw_machine(machine: StateMachine) -> MachineDrawing:
    """Lays out a machine. Raises DiagramError for one that is wrong."""
    chart = machine.chart
    boxes = {name: ModeBox(mode, _action_lines(machine, mode)) for name, mode in chart.by_name.items()}
    for number, t in enumerate(chart.transitions):
        boxes[t.source].leaving.append(number)
        boxes[t.target].arriving.append(number)
    texts = [(_title(m), NAME, True) for m in chart.by_name.values()]
    texts += [(line, SMALL, False) for box in boxes.values() for line in box.lines]
    inner = max(text_width(*text) for text in texts) + 2 * PAD
    outer = inner + 2 * GAP + 10.0 if chart.outers else inner
    y = 12.0
    for mode in chart.modes:
        y = _place(boxes, mode, LEFT, y, outer, inner) + GAP
    label_x = LEFT + outer + 10.0
    labels = [_label(boxes[t.source].leaving.index(k) + 1, machine, k) for k, t in enumerate(chart.transitions)]
    lanes_x = label_x + max((text_width(text, SMALL) for text in labels), default=0.0) + 12.0
    spans = [(boxes[t.source].end(k, True), boxes[t.target].end(k, False)) for k, t in enumerate(chart.transitions)]
    lanes = _lanes(spans)
    lines = [
        TransitionLine(k, labels[k], _right(boxes[t.source]), start, _right(boxes[t.target]), stop, lanes[k])
        for k, (t, (start, stop)) in enumerate(zip(chart.transitions, spans, strict=True))
    ]
    width = lanes_x + LANE * (max(lanes, default=-1) + 1) + 12.0
    return MachineDrawing(boxes, lines, label_x, lanes_x, width, y)


def machine_svg(machine: StateMachine, name: str) -> str:
    """Return the picture as text; the same machine gives the same bytes. Raises DiagramError as `draw_machine` does."""
    drawing = draw_machine(machine)
    about = (cleandoc(machine.__doc__ or "") if not machine.label else "").partition("\n")[0]
    modes, ways = ", ".join(drawing.boxes), ", ".join(t.text for t in machine.chart.transitions) or "none"
    described = f"State machine {name} with the modes {modes} and the transitions {ways}."
    return document(name, about, described, (drawing.width, drawing.height), _written(drawing, machine))


def _place(boxes: dict[str, ModeBox], mode: Mode, x: float, y: float, width: float, inner: float) -> float:
    """Put a mode, and those inside it, below the height `y`; where it ends."""
    box = boxes[mode.name]
    box.x, box.y, box.width = x, y, width
    ends = SLOT * (len(box.leaving) + len(box.arriving))
    box.head = max(LINE * (1 + len(box.lines)), ends) + 2 * PAD
    below = y + box.head
    for one in mode.inner:
        below = _place(boxes, one, x + GAP + 10.0, below, inner, inner) + GAP
    box.height = below - y
    return below


def _right(box: ModeBox) -> float:
    return box.x + box.width


def _lanes(spans: list[tuple[float, float]]) -> list[int]:
    """Return a lane for each transition: short ones near, no two overlapping."""
    taken: list[list[tuple[float, float]]] = []
    found = [0] * len(spans)
    for k in sorted(range(len(spans)), key=lambda k: (abs(spans[k][0] - spans[k][1]), k)):
        low, high = min(spans[k]), max(spans[k])
        free = (i for i, lane in enumerate(taken) if all(high < a or b < low for a, b in lane))
        found[k] = next(free, len(taken))
        if found[k] == len(taken):
            taken.append([])
        taken[found[k]].append((low, high))
    return found


def _action_lines(machine: StateMachine, mode: Mode) -> list[str]:
    """Return the actions of a mode, a line for each value."""
    lines = []
    for action in ACTIONS:
        given = machine.graph.action(mode.name, action)
        function = machine.chart.actions.get((mode.name, action))
        if function is not None and function.text is not None:
            lines.append(f"{action}: {function.text}")
        else:
            lines += [f"{action}: {name} = {machine_text(e)}" for name, e in given.items()]
    return [shortened(line, SMALL, WIDEST) for line in lines]


def _label(order: int, machine: StateMachine, number: int) -> str:
    """Return a transition's label: its order in its mode, guard and actions, as they were written if as texts."""
    chart, guard, does = machine.chart, machine.graph.guards[number], machine.graph.does[number]
    test = "always" if guard.op == "const" else chart.guards[number].text or machine_text(guard)
    function = chart.does[number]
    doing = "; ".join(f"{name} = {machine_text(e)}" for name, e in does.items())
    doing = (function and function.text) or doing
    return shortened(f"{order}: {test}" + (f" / {doing}" if doing else ""), SMALL, WIDEST)


def _written(drawing: MachineDrawing, machine: StateMachine) -> list[str]:
    lines: list[str] = []
    ordered = sorted(drawing.boxes.values(), key=lambda box: box.x)  # frames before what stands in them
    for box in ordered:
        lines += _box(box)
    for group in (machine.chart.modes, *(m.inner for m in machine.chart.outers)):
        lines += _start(drawing.boxes[group[0].name])
    for t in drawing.lines:
        lane = drawing.lanes_x + LANE * t.lane
        lines.append(f'<path class="wire" d="M{t.left:g} {t.start:g}H{lane:g}V{t.stop:g}H{t.right:g}"/>')
        lines.append(arrow(t.right, t.stop, -1, 0))
        lines.append(text_element(SymbolText(drawing.label_x, t.start - 4.0, t.label, SMALL, "start")))
    return lines


def _box(box: ModeBox) -> list[str]:
    kind, radius = ("frame", 8) if box.mode.inner else ("block", 10)
    place = f'x="{box.x:g}" y="{box.y:g}" width="{box.width:g}" height="{box.height:g}"'
    lines = [f'<rect class="{kind}" {place} rx="{radius}"/>']
    x, y = box.x + PAD, box.y + PAD + 11.0
    lines.append(text_element(SymbolText(x, y, _title(box.mode), NAME, "start", "name")))
    for k, line in enumerate(box.lines, 1):
        lines.append(text_element(SymbolText(x, y + LINE * k, line, SMALL, "start", "soft")))
    return lines


def _title(mode: Mode) -> str:
    """Return the name of a mode, with the usual H for history."""
    return f"{mode.name} (H)" if mode.history else mode.name


def _start(box: ModeBox) -> list[str]:
    """Return the dot and arrow of the initial mode."""
    y, x = box.y + PAD + 7.0, box.x - 20.0
    return [
        f'<circle class="joint" cx="{x:g}" cy="{y:g}" r="4"/>',
        f'<path class="wire" d="M{x:g} {y:g}H{box.x:g}"/>',
        arrow(box.x, y, 1, 0),
    ]
