"""Random diagrams: library and random blocks, rates, enabled and reset sub-diagrams, continuous states, edges."""

import random
from dataclasses import dataclass
from typing import Any

from tests.compile.random_blocks import FLOATS, MIXED, STORED, RandomBlock
from tests.compile.random_machines import machine_block, random_table
from tests.compile.random_matrices import FilledMatrix, RandomMatrices
from twodof.blocks import Block, Bus, Diagram, Enumeration, Port
from twodof.blocks import library as lib
from twodof.blocks.block import EDGES
from twodof.blocks.bus import grouped
from twodof.blocks.declarations import mismatch
from twodof.blocks.expressions.conversions import OVERFLOW
from twodof.blocks.library import Constant, FractionalDelay, ZeroOrderHold
from twodof.blocks.library.discrete import METHODS, RESETS

LIBRARY: tuple[Any, ...] = (
    lambda r: lib.Sum(r.choice(("++", "+-", "-+-"))),
    lambda r: lib.Sum("+-", "int32"),
    lambda r: lib.Gain(r.uniform(-2, 2)),
    lambda r: lib.Product(r.choice(("**", "*/"))),
    lambda r: lib.Divide("int32"),
    lambda r: lib.Remainder("real"),
    lambda r: lib.Abs(),
    lambda r: lib.Sign(),
    lambda r: lib.Minimum(3),
    lambda r: lib.Maximum(2, "uint32"),
    lambda r: lib.Saturation(),
    lambda r: lib.DeadZone(),
    lambda r: lib.RateLimit(),
    lambda r: lib.Relay(),
    lambda r: lib.Backlash(0.3),
    lambda r: lib.Quantiser(0.25),
    lambda r: lib.Compare("<"),
    lambda r: lib.Logic("xor"),
    lambda r: lib.Bitwise("and", "uint32"),
    lambda r: lib.EdgeDetector(),
    lambda r: lib.FlipFlop(),
    lambda r: lib.Counter(7),
    lambda r: lib.Timer(0.02),
    lambda r: lib.Switch(),
    lambda r: lib.MultiportSwitch(3),
    lambda r: lib.Mux(3),
    lambda r: lib.Demux(3),
    lambda r: lib.Index(3),
    lambda r: lib.UnitDelay(0.5),
    lambda r: lib.UnitDelay(width=3),
    lambda r: lib.Delay(r.choice((1, 3, 40))),
    lambda r: lib.DiscreteIntegrator(),
    lambda r: lib.DiscreteDerivative(),
    lambda r: lib.DiscreteFilter(),
    lambda r: lib.MovingAverage(4),
    lambda r: lib.LowPass(20.0),
    lambda r: lib.Notch(),
    lambda r: lib.Pid(),
    lambda r: lib.Noise(),
    lambda r: lib.UniformNoise(),
    lambda r: lib.Step(0.05),
    lambda r: lib.Convert("real", "int32"),
    lambda r: lib.Convert("uint32", "real"),
    lambda r: lib.Rounding("floor"),
)
LATER: tuple[Any, ...] = (
    lambda r: lib.FirstTrue(3),
    lambda r: lib.CaseChoice(((0, 5), (-1, 2))),
    lambda r: lib.Merge(2, r.uniform(-2, 2)),
    lambda r: lib.Merge(3, width=3),
    lambda r: lib.DiscreteIntegrator(r.choice(METHODS), 1.5, "input", reset=r.choice(RESETS)),
    lambda r: lib.ResetLatch(r.choice(RESETS), r.choice(("input", r.uniform(-2, 2)))),
    lambda r: lib.VariableDelay(6, r.uniform(-2, 2), r.random() < 0.5),
)
"""What came later is drawn by itself."""
LIGHT = Enumeration("Light", green=0, amber=2, red=5)
ENUMERATED: tuple[Any, ...] = (
    lambda r: lib.Convert("int32", LIGHT),
    lambda r: lib.Convert("real", LIGHT, "nearest"),
    lambda r: lib.Switch(LIGHT),
    lambda r: lib.MultiportSwitch(3, LIGHT),
    lambda r: lib.UnitDelay(r.choice(("red", "green")), LIGHT),
    lambda r: lib.CompareToConstant(r.choice(("==", "!=")), "amber", LIGHT),
    lambda r: lib.Convert("int32", "real"),
)
BUS = Bus(
    "Mixed", [Port("a"), Port("more", Bus("More", [Port("n", "int32"), Port("v", width=3)])), Port("light", LIGHT)]
)
BUSED: tuple[Any, ...] = (
    lambda r: lib.UnitDelay({"a": r.uniform(-2, 2), "light": "amber"}, BUS),
    lambda r: lib.Switch(BUS),
    lambda r: lib.Merge(2, kind=BUS),
    lambda r: lib.BusSelect(BUS, ["more.v", "light"]),
    lambda r: lib.BusAssign(BUS, [r.choice(("a", "more", "light"))]),
    lambda r: lib.BusCreate(BUS),
    lambda r: lib.Delay(r.randint(1, 3), 4, {"a": r.uniform(-2, 2), "light": "red"}, BUS),
    lambda r: lib.VariableDelay(5, r.choice(({"a": 1.5}, {"light": "amber"})), r.random() < 0.5, BUS),
)
CONTINUOUS: tuple[Any, ...] = (
    lambda r: lib.Integrator(),
    lambda r: lib.FirstOrder(1.5, 0.3),
    lambda r: lib.SecondOrder(),
    lambda r: lib.TransferFunction((1.0,), (0.5, 1.0, 1.0)),
)
CONVERTED: tuple[Any, ...] = (
    lambda r: lib.Convert(r.choice(FLOATS), r.choice(STORED), r.choice(ROUNDED), overflow=r.choice(OVERFLOW)),
    lambda r: lib.Convert(r.choice(("int32", "uint32")), r.choice(STORED), overflow=r.choice(OVERFLOW)),
    lambda r: lib.Convert(r.choice((*STORED, *FLOATS)), r.choice(FLOATS)),
    lambda r: lib.Sum("+-", r.choice(FLOATS)),
    lambda r: lib.UnitDelay(1, r.choice((*STORED, *FLOATS)), 3),
    lambda r: lib.Minimum(2, r.choice(STORED)),
)
ROUNDED = ("trunc", "floor", "half_even", "half_away")
DIVIDERS = (1, 1, 1, 1, 2, 3, 4)
SLOW = (1, 1, 3, 5, 8)


@dataclass
class Source:
    """A signal of a diagram that is being made."""

    text: str
    port: Port
    rate: tuple[int, int]
    early: bool  # may drive a part that was added before: it does not depend on inputs in the same tick


class Maker:
    """Makes one random diagram; `paths` are all its blocks' output ports.

    A `small` one has few blocks, many of them at slow rates, so that the reference can run 20,000 steps of it.
    """

    def __init__(self, seed: int, small: bool = False) -> None:
        self.rng = random.Random(seed)
        self.more = random.Random(~seed)  # for what came later, so that the seeds' diagrams stay what they were
        self.machines = random.Random(seed + 1)  # the same for state machines
        self.mixed = random.Random(f"mixed {seed}")
        self.enumerated = random.Random(f"enumerated {seed}")
        self.matrices = random.Random(f"matrices {seed}")
        self.small = small
        self.size = 3 if small else 8
        self.paths: list[str] = []
        self.sources: dict[str, str] = {}  # of random blocks, for a failure's report

    def diagram(self, name: str) -> Diagram:
        """The whole, with one input of each type and an array."""
        d = Diagram(name)
        d.input("real_in")
        d.input("int_in", "int32")
        d.input("uint_in", "uint32")
        d.input("flag", "bool")
        d.input("vector_in", width=3)
        sources = [Source(n, p, (1, 0), True) for n, p in d.inputs.items()]
        self.unwritten = self.stores = self.more.random() < 0.3
        if self.stores:
            d.add("cell", lib.DataStore(self.more.uniform(-2, 2)))
        self.fill(d, "", sources, (1, 0), self.rng.randint(2, 3) if self.small else self.rng.randint(3, 6), 0)
        if self.unwritten:
            d.add("write", lib.StoreWrite("cell"), u="real_in")
        for i, path in enumerate(self.rng.sample(self.paths, min(2, len(self.paths)))):
            part = path.split(".")[0]
            item = d.parts[part].item
            if isinstance(item, Block):
                d.output(f"out{i}", path)
        return d

    def fill(
        self, d: Diagram, prefix: str, sources: list[Source], rate: tuple[int, int], count: int, depth: int
    ) -> list[Source]:
        """Add `count` parts to `d`, whose own rate is `rate`, and connect them. Returns the signals of its parts."""
        r = self.rng
        waiting: list[tuple[str, Port, tuple[int, int], int]] = []  # inputs to connect, with what was there before
        conditions: list[tuple[str, int]] = []
        made: list[Source] = []
        for k in range(count):
            name = f"{r.choice('abcdefg')}{k}"
            before = len(made)
            if depth < 2 and r.random() < (0.3 if depth == 0 else 0.15):
                made += self.sub(d, name, prefix, rate, depth, waiting, conditions, before)
                continue
            divider = r.choice(SLOW if self.small else DIVIDERS)
            own = (divider, r.randrange(divider))
            whole = (rate[0] * own[0], rate[1] + rate[0] * own[1])
            block = self.block(whole)
            if isinstance(block, RandomBlock):
                self.sources[prefix + name] = block.source
                block.crossing = r.random() < 0.15
            d.add(name, block, rate=own, params=self.binding(d, block))
            buses = {p.name: p.kind for p in grouped(block.inputs) if isinstance(p.kind, Bus)}
            wired = [bus for bus in buses if self.enumerated.random() < 0.5]
            for bus in wired:  # as one, from where its fields are put together
                maker = d.add(f"{name}_{bus}", lib.BusCreate(buses[bus]), rate=own)
                d.connect(maker, f"{name}.{bus}")
                waiting += [(f"{maker}.{leaf.name}", leaf, own, before) for leaf in buses[bus].leaves]
            if block.outputs and self.more.random() < 0.2 and not isinstance(block, lib.StoreWrite):
                held = self.more.choice(block.outputs)
                number = {"real": self.more.uniform(-2, 2), "bool": True}.get(held.kind, 3)
                value = number if held.enum is None else "red"
                d.parts[name].initial = {held.name: value}
            if not isinstance(block, lib.StoreRead):
                free = [p for p in block.inputs if p.name.partition(".")[0] not in wired]
                waiting += [(f"{name}.{p.name}", p, own, before) for p in free]
            for p in block.outputs:
                self.paths.append(f"{prefix}{name}.{p.name}")
                made.append(Source(f"{name}.{p.name}", p, own, not block.trace.feedthrough[p.name]))
        for destination, port, own, before in waiting:
            crossing = self.crossing(d, destination)
            driver = self.driver(
                d, port, own, [*sources, *made[:before], *(s for s in made[before:] if s.early)], crossing
            )
            d.connect(driver, destination)
        for name, before in conditions:
            flags = [*sources, *made[:before], *(m for m in made[before:] if m.early)]
            flags = [s for s in flags if s.port.kind == "bool" and s.port.width is None]
            if flags:
                part = d.parts[name]
                if r.random() < 0.8:
                    part.enable = r.choice(flags).text
                    part.disabled = r.choice(("hold", "reset"))
                if r.random() < 0.6:
                    part.reset = r.choice(flags).text
            if self.more.random() < 0.3:
                d.parts[name].enabling = "restart"
            if flags and self.more.random() < 0.15:
                d.parts[name].trigger = self.more.choice(flags).text
                d.parts[name].edge = self.more.choice(EDGES)
        return made

    def crossing(self, d: Diagram, destination: str) -> bool:
        item = d.parts[destination.split(".")[0]].item
        return isinstance(item, Block) and item.crossing

    def binding(self, d: Diagram, block: Block) -> dict[str, str]:
        if isinstance(block, RandomBlock) and self.rng.random() < 0.3:
            if "shared" not in d.params:
                d.param("shared", self.rng.uniform(-1, 1))
            return {"p0": "shared"}
        return {}

    def block(self, rate: tuple[int, int]) -> Block:
        r = self.rng
        what = r.random()
        if what < 0.4:
            made: Block = r.choice(LIBRARY)(r)
            if self.more.random() < 0.15:
                made = self.more.choice(LATER)(self.more)
            if self.stores and self.more.random() < 0.3:
                made = lib.StoreWrite("cell") if self.unwritten else lib.StoreRead("cell")
                self.unwritten = False
        elif what < 0.75 or rate != (1, 0):
            made = RandomBlock(r.randrange(2**31), size=self.size)
        elif what < 0.85:
            made = RandomBlock(r.randrange(2**31), continuous=True, size=self.size)
        elif what < 0.93:
            made = r.choice(CONTINUOUS)(r)
        else:
            made = FractionalDelay(r.uniform(0.0, 0.05))
        if isinstance(made, lib.StoreWrite):
            return made  # it is counted on
        if what < 0.75 and self.enumerated.random() < 0.1:
            made = self.enumerated.choice((*ENUMERATED, *BUSED))(self.enumerated)
        if rate == (1, 0) and self.more.random() < 0.05:
            made = lib.ResetIntegrator()
        if what < 0.93 and self.mixed.random() < 0.2:
            continuous = isinstance(made, RandomBlock) and bool(made.trace.derivative)
            made = RandomBlock(self.mixed.randrange(2**31), continuous, self.size, MIXED)
            if self.mixed.random() < 0.3 and not continuous:
                made = self.mixed.choice(CONVERTED)(self.mixed)
        if self.machines.random() < 0.08:
            made = machine_block(random_table(self.machines))
        if what < 0.75 and self.matrices.random() < 0.1:
            made = RandomMatrices(self.matrices.randrange(2**31), self.size)
        return made

    def sub(
        self,
        d: Diagram,
        name: str,
        prefix: str,
        rate: tuple[int, int],
        depth: int,
        waiting: list[Any],
        conditions: list[Any],
        before: int,
    ) -> list[Source]:
        r = self.rng
        divider = r.choice((1, 1, 1, 2))
        own = (divider, r.randrange(divider))
        inner = Diagram(name)
        inner.input("in0")
        inner.input("in1", "bool")
        if self.enumerated.random() < 0.3:
            inner.input("bus", BUS)
        whole = (rate[0] * own[0], rate[1] + rate[0] * own[1])
        fed = [Source(n, p, (1, 0), True) for n, p in inner.inputs.items()]
        made = self.fill(inner, f"{prefix}{name}.", fed, whole, 1 if self.small else r.randint(1, 3), depth + 1)
        outside = []
        for i, s in enumerate(r.sample(made, min(2, len(made)))):
            if s.rate == (1, 0):
                inner.output(f"o{i}", s.text)
                outside.append(Source(f"{name}.o{i}", s.port, own, False))
        for part in list(inner.parts.values()):
            outputs = grouped(part.item.outputs) if isinstance(part.item, Block) and part.rate == (1, 0) else []
            if any(p.name == "y" and isinstance(p.kind, Bus) for p in outputs) and "bus" not in inner.outputs:
                inner.output("bus", f"{part.name}.y")
                outside += [Source(f"{name}.bus.{leaf.name}", leaf, own, False) for leaf in BUS.leaves]
        d.add(name, inner, rate=own)
        waiting += [(f"{name}.{p.name}", p, own, before) for p in inner.inputs.values()]
        conditions.append((name, before))
        return outside

    def driver(self, d: Diagram, port: Port, own: tuple[int, int], sources: list[Source], crossing: bool) -> str:
        """A source for an input: one of the same type, held at the reader's rate if need be, or a constant."""
        r = self.rng
        fits = [s for s in sources if mismatch(port, s.port, "") is None]
        extra = f"h{len(d.parts)}"
        if port.shape is not None:
            here = [s for s in fits if s.rate == own]
            if here:
                return r.choice(here).text
            d.add(extra, FilledMatrix(), rate=own)
            d.connect(self.driver(d, FilledMatrix.inputs[0], own, sources, False), f"{extra}.v")
            return extra
        if not fits:
            value = {"real": r.uniform(-2, 2), "bool": True}.get(port.kind, r.randint(0, 5))
            value = value if port.enum is None else "amber"
            d.add(extra, Constant(value, port.enum or port.kind, port.width), rate=own)
            return extra
        source = r.choice(fits)
        if source.rate == own or crossing:
            return source.text
        d.add(extra, ZeroOrderHold(source.port.enum or port.kind, port.width), rate=own)
        d.connect(source.text, f"{extra}.{d.parts[extra].item.inputs[0].name}")
        return extra


SPECIAL = (0.0, -0.0, float("nan"), float("inf"), -float("inf"), 5e-324, -1e-310, 1e-42, 1e300, -3e38, 1e-20, 1.0)


def random_inputs(seed: int, steps: int) -> list[dict[str, Any]]:
    """For each tick the inputs that change, special values among them; all are exact in float32 or round alike."""
    r = random.Random(seed)
    rows: list[dict[str, Any]] = []
    for _ in range(steps):
        row: dict[str, Any] = {}
        if r.random() < 0.3:
            row["real_in"] = r.choice(SPECIAL) if r.random() < 0.1 else r.gauss(0, 2)
        if r.random() < 0.05:
            row["int_in"] = r.choice((0, -1, 1, -(2**31), 2**31 - 1, r.randint(-50, 50)))
            row["uint_in"] = r.choice((0, 1, 2**32 - 1, 2**31, r.randint(0, 50)))
        if r.random() < 0.1:
            row["flag"] = r.random() < 0.6
        if r.random() < 0.1:
            row["vector_in"] = [r.choice(SPECIAL) if r.random() < 0.05 else r.gauss(0, 1) for _ in range(3)]
        rows.append(row)
    return rows
