"""Diagrams as Python writes them, for the page's own writer."""

from tests.compile.random_diagrams import Maker
from twodof.blocks import Bus, Diagram, Port
from twodof.blocks import library as lib
from twodof.blocks.schema.json_form import to_json
from twodof.flight.starters import STARTERS, starter

NUMBERS = (0.0, -0.0, 1.0, -1.5, 1e-4, 9.99e-5, 1e-5, 1e15, 1e16, 1.5e16, 123456789012345680.0, 1e22, 5e-324, 0.1)
NUMBERS += (1 / 3, 2**53 + 2.0, 1.7976931348623157e308, float("inf"), -float("inf"), 1e21, 1.2345678901234567e-7)


def odd_diagram() -> Diagram:
    """Numbers, texts and forms that are easily written otherwise."""
    d = Diagram("odd", 'Übung: "q" \\ \t 中文 😀 and a text that is longer than the eighty characters of a line')
    d.input("in_1", unit="m/s^2")
    d.declare(Port("att", Bus("Attitude", [Port("roll", unit="rad"), Port("pitch")])))
    for i, value in enumerate(NUMBERS):
        d.param(f"p{i}", value, text="ä" * 70)
    d.param("whole", 2**32 - 1, kind="uint32")
    d.add("table", lib.Lookup(list(range(30)), [x / 7 for x in range(30)]), u="in_1", position=(-0.0, 1e-7))
    d.add("sub", _inner(), rate=(4, 1), inputs={"u": "in_1"}, enable="on", disabled={"y": 2.5}, position=(12, 3.25))
    d.parts["table"].flipped = True
    d.add("on", lib.Constant(True, "bool"))
    d.add("cases", lib.CaseChoice(((0, 5), (-1, 2))))
    d.output("y", "sub.y")
    d.output("nothing")
    d.input_positions = {"att": (-120.0, 0.5), "in_1": (0.0, 1e5)}
    d.output_positions = {"nothing": (700.25, -40.0)}
    return d


def _inner() -> Diagram:
    d = Diagram("inner")
    d.input("u")
    d.add("k", lib.Gain(2), u="u")
    d.add("deeper", Diagram("empty"))
    d.output("y", "k")
    return d


def texts() -> list[str]:
    """All of them."""
    made = [starter(name) for name in STARTERS] + [Maker(seed).diagram(f"random_{seed}") for seed in range(12)]
    return [to_json(d) for d in [*made, odd_diagram()]]


def wide_diagram(blocks: int) -> Diagram:
    """A controller of so many blocks: the PID, and a chain of gains and sums that moves M by nothing."""
    d = starter("pid-attitude")
    moment, before = d.outputs["M"], "theta"
    for i in range(blocks - len(d.parts) - 2):
        place = (900.0 + 120.0 * (i % 20), 20.0 + 80.0 * (i // 20))
        if i % 3:
            d.add(f"g{i}", lib.Gain(0.99), u=before, position=place)
        else:
            d.add(f"g{i}", lib.Sum("+-"), a=before, b="q", position=place)
        before = f"g{i}"
    d.add("nothing", lib.Gain(0.0), u=before, position=(3400.0, 600.0))
    d.add("total", lib.Sum("++"), a=str(moment), b="nothing", position=(3500.0, 600.0))
    d.outputs["M"] = "total"
    return d
