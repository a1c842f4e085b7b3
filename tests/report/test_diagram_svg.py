"""Drawings measured: nothing overlaps, no wire runs through a box, every connection is drawn, texts are inside."""

import random
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable

import pytest

from tests.compile.random_diagrams import Maker
from twodof.blocks import Diagram
from twodof.blocks import library as lib
from twodof.drawing.text_width import shortened, text_width
from twodof.errors import DiagramError
from twodof.flight.cascade import cascade
from twodof.flight.core import core
from twodof.flight.starters import STARTERS, starter
from twodof.report.diagram_svg import Drawing, draw, find, to_svg
from twodof.report.symbols import SymbolText
from twodof.rig.rig import rig
from twodof.sim.closed_loop import closed_loop

pytestmark = pytest.mark.slow


def loop() -> Diagram:
    """Every symbol of a control loop, feedback within feedback, two wires that swap their heights."""
    d = Diagram("loop", "a rate loop")
    d.input("r", unit="rad/s")
    d.input("d")
    d.param("k", 2.0)
    d.add("error", lib.Sum("+-"), a="r", b="plant")
    d.add("P", lib.Gain(0.0854), u="error", params={"k": "k"})
    d.add("I", lib.DiscreteIntegrator("backward", 0.251), u="error")
    d.add("D", lib.DiscreteTransferFunction((0.04, -0.04), (1.0, -0.714)), u="error")
    d.add("pid", lib.Sum("+++"), a="P", b="I", c="D")
    d.add("limit", lib.Saturation(), u="pid")
    d.add("tau", lib.Delay(5), u="limit")
    d.add("disturbed", lib.Sum("++"), a="tau", b="d")
    d.add("plant", lib.TransferFunction((358.5, 0.0), (1.0, 0.57, 11.8)), u="disturbed")
    d.add("memory", lib.UnitDelay(), u="swap.b")
    d.add("split", lib.Demux(2), u="mux")
    d.add("mux", lib.Mux(2), a="plant", b="memory")
    d.add("swap", lib.Demux(2), u="cross")
    d.add("cross", lib.Mux(2), a="split.b", b="split.a")
    d.output("q", "plant")
    d.output("other", "swap.a")
    return d


def wired(seed: int, parts: int) -> Diagram:
    """Sums, gains and delays connected at random, backwards too where a delay reads."""
    r = random.Random(seed)
    d = Diagram(f"wired{seed}")
    sources = [d.input(f"u{i}") for i in range(3)]
    names = [f"p{i}" for i in range(parts)]
    for name in names:
        kind = r.randrange(4)
        if kind == 0:
            d.add(name, lib.UnitDelay(), u=r.choice(names))
        elif kind == 1:
            d.add(name, lib.Gain(r.uniform(-9, 9)), u=r.choice(sources[-12:]))
        else:
            d.add(name, lib.Sum("+-+"[:kind]), **{p: r.choice(sources[-12:]) for p in "ab"[:kind]})
        sources.append(name)
    for i in range(3):
        d.output(f"y{i}", r.choice(sources))
    return d


DRAWINGS: dict[str, Callable[[], Drawing]] = {
    "loop": lambda: draw(loop()),
    "core": lambda: draw(core()),
    "core opened": lambda: draw(core(), 3),
    "cascade": lambda: draw(cascade()),
    "rig": lambda: draw(rig()),
    "closed loop": lambda: draw(closed_loop()),
    "closed loop opened": lambda: draw(closed_loop(), 9),
    **{name: lambda name=name: draw(starter(name)) for name in STARTERS},
    **{f"wired {seed}": lambda seed=seed: draw(wired(seed, 30)) for seed in range(8)},
    **{f"random {seed}": lambda seed=seed: draw(Maker(seed).diagram("random"), 9) for seed in range(8)},
}


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_drawing_can_be_read(name: str) -> None:
    stack = [DRAWINGS[name]()]
    while stack:
        drawing = stack.pop()
        stack += drawing.inner.values()
        measure(drawing)


def measure(drawing: Drawing) -> None:
    placed = drawing.placed
    rects = [
        (x, y, x + s.box.width, y + s.box.height) for s, (x, y) in zip(drawing.symbols, placed.corners, strict=True)
    ]
    for i, a in enumerate(rects):
        assert 0.0 <= a[0] <= a[2] <= placed.width
        assert 0.0 <= a[1] <= a[3] <= placed.height
        for b in rects[i + 1 :]:
            assert not _meet(a, b), "two boxes overlap"
    for k, (net, wire) in enumerate(zip(drawing.nets, placed.wires, strict=True)):
        for x1, y1, x2, y2 in wire:
            assert x1 == x2 or y1 == y2, "a wire is slanted"
            piece = (min(x1, x2), min(y1, y2), max(x1, x2), max(y1, y2))
            assert not any(_meet(piece, r) for r in rects), "a wire runs through a box"
        ends = [_pin(drawing, net.source, False), *(_pin(drawing, sink, True) for sink in net.sinks)]
        assert _connected(wire, ends), f"net {k} is not all drawn"
    pieces = [(k, s) for k, wire in enumerate(placed.wires) for s in wire if s[:2] != s[2:]]
    by_line: dict[tuple[bool, float], list[tuple[float, float, int]]] = {}
    for k, (x1, y1, x2, y2) in pieces:
        level = y1 == y2
        span = (min(x1, x2), max(x1, x2)) if level else (min(y1, y2), max(y1, y2))
        by_line.setdefault((level, y1 if level else x1), []).append((*span, k))
    for spans in by_line.values():
        spans.sort()
        reach, owner = spans[0][1], spans[0][2]
        for low, high, k in spans[1:]:
            assert k == owner or low >= reach, "two wires lie upon each other"
            if high > reach:
                reach, owner = high, k
    for symbol in drawing.symbols:
        for text in symbol.texts:
            left, top, right, bottom = text.extent
            assert left >= -0.5, text
            assert top >= -0.5, text
            assert right <= symbol.box.width + 0.5, text
            assert bottom <= symbol.box.height + 0.5, text


def _meet(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    """Return True if two rectangles share more than their borders; one may be a line."""
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _pin(drawing: Drawing, end: tuple[int, int], left: bool) -> tuple[float, float]:
    box, pin = end
    x, y = drawing.placed.corners[box]
    made = drawing.symbols[box].box
    return (x, y + made.left[pin]) if left else (x + made.width, y + made.right[pin])


def _connected(wire: list[tuple[float, float, float, float]], ends: list[tuple[float, float]]) -> bool:
    """Return True if the pieces of a wire hang together and reach all `ends`."""
    todo, seen = [ends[0]], set()
    reached = {ends[0]}
    while todo:
        at = todo.pop()
        for j, s in enumerate(wire):
            if j not in seen and _on(at, s):
                seen.add(j)
                corners = {(s[0], s[1]), (s[2], s[3])}
                touching = {p for o in wire for p in ((o[0], o[1]), (o[2], o[3])) if _on(p, s)}
                new = (corners | touching | {e for e in ends if _on(e, s)}) - reached
                reached |= new
                todo += new
    return set(ends) <= reached and len(seen) == len(wire)


def _on(p: tuple[float, float], s: tuple[float, float, float, float]) -> bool:
    return min(s[0], s[2]) <= p[0] <= max(s[0], s[2]) and min(s[1], s[3]) <= p[1] <= max(s[1], s[3])


@pytest.mark.parametrize("parts", [50, pytest.param(1000, marks=pytest.mark.soak)])
def test_many_blocks_are_drawn_in_seconds_and_always_alike(parts: int) -> None:
    """A thousand take four here; what grows with the cube of the wires took eighteen."""
    start = time.process_time()
    drawn = to_svg(wired(1, parts))
    assert time.process_time() - start < 15.0
    assert to_svg(wired(1, parts)) == drawn


def test_the_author_decides_where_blocks_stand() -> None:
    d = Diagram("placed")
    d.input("u")
    for name, position in {"a": (400.0, 0.0), "b": (0.0, 10.0), "c": (200.0, 300.0), "e": (200.0, 100.0)}.items():
        d.add(name, lib.Gain(), u="u", position=position)
    drawing = draw(d)
    at = {s.title: corner for s, corner in zip(drawing.symbols, drawing.placed.corners, strict=True)}
    assert at["b"][0] < at["c"][0] == at["e"][0] < at["a"][0]
    assert at["e"][1] < at["c"][1]
    assert at["c"][1] - at["e"][1] == pytest.approx(200.0, abs=60.0)  # moved by 30 at most, each


HOSTILE = '"><script>alert(1)</script>]]>&lt;\x00\u202e\ud7ff'


def test_hostile_texts_stay_texts() -> None:
    d = Diagram("hostile", HOSTILE)
    d.input("u", unit=HOSTILE[:40])
    d.add("g", lib.Gain(unit=HOSTILE, input_unit=HOSTILE[:40]), u="u")
    inner = Diagram("inner", HOSTILE)
    inner.input("v")
    inner.output("w", "v")
    d.add("s", inner, v="g")
    d.output("y", "s.w")
    for depth in (0, 1):
        text = to_svg(d, depth)
        root = ElementTree.fromstring(text)  # well formed, though the text holds what XML forbids
        tags = {element.tag.partition("}")[2] for element in root.iter()}
        assert tags <= {"svg", "title", "desc", "style", "rect", "text", "g", "path", "circle"}
        assert not any(name.startswith("on") for element in root.iter() for name in element.attrib)


def words(diagram: Diagram) -> set[str]:
    root = ElementTree.fromstring(to_svg(diagram))
    assert root.attrib["role"] == "img"
    assert root.find("{http://www.w3.org/2000/svg}desc") is not None
    return {"".join(e.itertext()) for e in root.iter("{http://www.w3.org/2000/svg}text")}


def test_picture_names_values_signs_units_and_conditions() -> None:
    said = {"loop", "k", "0.251 T z", "z − 1", "358.5s", "s² + 0.57s + 11.8", "z⁻⁵", "−", "[rad/s]", "array"}
    assert said <= words(loop())
    d = Diagram("decided")
    for name in "abcd":
        d.input(name)
    d.add("total", lib.Sum("+--+"), a="a", b="b", c="c", d="d")
    d.output("y", "total.y")
    d.input("on", "bool")
    d.add("part", Diagram("part"), enable="on", trigger="on", edge="falling", enabling="restart")
    said = {"+ a", "− b", "− c", "+ d", "enable", "trigger", "at falling edges", "starts afresh when enabled"}
    assert said <= words(d)


def test_a_sub_diagram_is_found_by_its_path() -> None:
    assert find(closed_loop(), "flight.cascade").name == "cascade"
    with pytest.raises(DiagramError, match="no sub-diagram"):
        find(closed_loop(), "flight.mixer")


def test_widths_are_those_of_helvetica() -> None:
    assert text_width("Hello, world", 1000.0) == 722 + 556 + 222 + 222 + 556 + 278 + 278 + 722 + 556 + 333 + 222 + 556
    assert shortened("a" * 100, 10.0, 60.0).endswith("…")
    assert text_width(shortened("a" * 100, 10.0, 60.0), 10.0) <= 60.0
    assert SymbolText(0.0, 0.0, "i" * 10, 10.0).extent[2] == pytest.approx(11.1)
