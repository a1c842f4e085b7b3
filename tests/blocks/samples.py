"""Small blocks that the tests of the language share."""

from typing import Any

from twodof.blocks import Block, Diagram, Param, Port, State, where


class Gain(Block):
    inputs = (Port("u"),)
    outputs = (Port("y"),)
    params = (Param("k", 2.0, low=-100.0, high=100.0),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return p.k * u.u


class Lag(Block):
    """tau y' = u - y, continuous."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    states = (State("x", "start", continuous=True),)
    params = (Param("start", 0.0), Param("tau", 0.5, low=1e-3, unit="s"))

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.x

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return (u.u - x.x) / p.tau


class Memory(Block):
    """One sample of delay."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    states = (State("x"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.x

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.u


class Counter(Block):
    """Counts its own ticks."""

    outputs = (Port("n", "int32"),)
    states = (State("n", 0, "int32"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.n

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.n + 1


class Hold(Block):
    """Reads a signal of another rate."""

    crossing = True
    inputs = (Port("u"),)
    outputs = (Port("y"),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.u


class Late(Block):
    """A held signal that changes to `after` at the fraction f of each step."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)
    states = (State("old"),)
    params = (Param("f", 0.25, low=0.0, high=1.0),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return x.old

    def edges(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"y": (p.f, u.u)}

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.u


class Bouncer(Block):
    """A point in free fall above a floor with restitution: continuous states with `project`."""

    outputs = (Port("h", unit="m"), Port("v", unit="m/s"))
    states = (State("h", 1.0, continuous=True), State("v", 0.0, continuous=True))
    params = (Param("e", 0.5),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"h": x.h, "v": x.v}

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"h": x.v, "v": -9.81 + 0.0 * x.v}

    def project(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        from_above = (x.h < 0.0) & (x.v < 0.0)
        return {"h": where(x.h < 0.0, 0.0, x.h), "v": where(from_above, -p.e * x.v, x.v)}


def chain(*blocks: Block) -> Diagram:
    """The blocks in series, from the input "r" to the output "y"."""
    d = Diagram("chain")
    source = d.input("r")
    for i, block in enumerate(blocks):
        source = f"{d.add(f'b{i}', block, u=source)}.{block.outputs[0].name}"
    d.output("y", source)
    return d
