"""Random custom blocks: their methods are random Python source in the block language, over all operations and types."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any

from twodof import blocks
from twodof.blocks import Block, Param, Port, State
from twodof.blocks.elementary import functions
from twodof.blocks.expressions import expr

KINDS = ("real", "real", "real", "int32", "uint32", "bool")
FLOATS = ("real", "float32", "float64")
STORED = ("int8", "uint8", "int16", "uint16")
MIXED = (*KINDS, *FLOATS[1:], *STORED, "real", "int32", "bool")
WORDS = """where minimum maximum sqrt to_real to_int32 to_uint32 int32 uint32 real multiply_high vector store array_of
    fold to_float32 to_float64 to_int8 to_uint8 to_int16 to_uint16"""
NAMESPACE = {
    **{name: getattr(blocks, name) for name in WORDS.split()},
    **{name: getattr(functions, name) for name in functions.ARGUMENTS if not name.endswith("octant")},
    "bits_of": expr.bits_of,
}
CHEAP = ("floor", "trunc", "ceil")
NEAREST = ("round_half_even", "round_half_away")
DEAR = ("sin", "cos", "atan2", "exp", "log", "pow", "tanh", "hypot", "atan")


@dataclass
class Pool:
    """Python expressions at hand, by kind; arrays by (kind, width)."""

    scalars: dict[str, list[str]] = field(default_factory=dict)
    arrays: list[tuple[str, str, int]] = field(default_factory=list)

    def add(self, text: str, kind: str, width: int | None = None) -> None:
        if width is None:
            self.scalars.setdefault(kind, []).append(text)
        else:
            self.arrays.append((text, kind, width))

    def copy(self) -> Pool:
        return Pool({k: list(v) for k, v in self.scalars.items()}, list(self.arrays))


class Body:
    """Random straight-line code for one method."""

    def __init__(self, rng: random.Random, pool: Pool, kinds: Sequence[str] = KINDS) -> None:
        self.rng = rng
        self.pool = pool
        self.kinds = kinds
        self.lines: list[str] = []

    def pick(self, kind: str) -> str:
        """An expression of `kind` at hand, or a literal (typed, so that two may meet)."""
        at_hand = self.pool.scalars.get(kind, [])
        if at_hand and self.rng.random() < 0.85:
            return self.rng.choice(at_hand[-6:] if self.rng.random() < 0.6 else at_hand)
        return self.literal(kind)

    def literal(self, kind: str) -> str:
        r = self.rng
        if kind == "bool":
            return r.choice(("uint32(1) == 1", "uint32(1) == 2")).join("()")
        if kind in FLOATS:
            made = "real" if kind == "real" else f"to_{kind}"
            return f"{made}({r.choice((0.0, -0.0, 1.0, 0.1, -2.5, 1e-310, 3e38, 1e30, r.uniform(-3, 3)))!r})"
        if kind in STORED:
            return f"to_{kind}({r.choice((0, 1, 7, 127))})"
        limit = r.choice((3, 40, 2**31 - 1))
        return f"{kind}({r.randint(0 if kind == 'uint32' else -limit, limit)})"

    def operation(self, kind: str, dear: bool = True) -> str:
        """A random operation that gives a scalar of `kind`."""
        r, p = self.rng, self.pick
        choices: list[Callable[[], str]] = [lambda: f"where({p('bool')}, {p(kind)}, {p(kind)})"]
        arrays = [a for a in self.pool.arrays if a[1] == kind]
        if arrays:
            name, _, width = r.choice(arrays)
            choices += [lambda: f"{name}[{r.randrange(width)}]", lambda: f"{name}[{p(r.choice(('int32', 'uint32')))}]"]
        if kind == "bool":
            of = r.choice(self.kinds[2:])
            order = r.choice(("==", "!=")) if of == "bool" else r.choice(("<", "<=", ">", ">=", "==", "!="))
            choices += [
                lambda: f"{p(of)} {order} {p(of)}",
                lambda: f"{p('bool')} {r.choice('&|^')} {p('bool')}",
                lambda: f"~{p('bool')}",
            ]
            return r.choice(choices)().join("()")
        if kind in STORED:
            rule = f'overflow="{r.choice(("wrap", "saturate"))}"'
            whole = r.choice(("int32", "uint32", *STORED))
            choices += [
                lambda: f"minimum({p(kind)}, {p(kind)})",
                lambda: f"to_{kind}({p(whole)}, {rule})",
                lambda: f"to_{kind}({p(kind)} {r.choice(('+', '-', '*', '//', '>>', '^'))} {p('int32')}, {rule})",
                lambda: f"to_{kind}({r.choice((*CHEAP, *NEAREST))}({p(r.choice(FLOATS))}), {rule})",
                lambda: f"to_{kind}({p('bool')})",
            ]
            return r.choice(choices)()
        choices += [lambda: f"{p(kind)} {r.choice('+-*')} {p(kind)}"] * 3
        choices += [
            lambda: f"-{p(kind)}",
            lambda: f"abs({p(kind)})",
            lambda: f"minimum({p(kind)}, {p(kind)})",
            lambda: f"maximum({p(kind)}, {p(kind)})",
        ]
        if kind in FLOATS:
            choices += [
                lambda: f"{p(kind)} / {p(kind)}",
                lambda: f"sqrt({p(kind)})",
                lambda: f"to_{kind}({p(r.choice(self.others(kind)))})",
                lambda: f"{p(kind)} {r.choice('+-*/')} {r.choice((2, 0.5, -3.25, 1e-3))}",
                lambda: f"{r.choice((1, 0.25, -7.5))} {r.choice('+-*/')} {p(kind)}",
                lambda: f"{r.choice(CHEAP)}({p(kind)})",
            ]
            if dear and r.random() < 0.15:
                name = r.choice(DEAR)
                two = functions.ARGUMENTS[name] == 2
                return f"{name}({p(kind)}, {p(kind)})" if two else f"{name}({p(kind)})"
        else:
            choices += [lambda: f"{p(kind)} {r.choice(('//', '%', '&', '|', '^', '<<', '>>'))} {p(kind)}"] * 3
            choices += [
                lambda: f"~{p(kind)}",
                lambda: f"to_{kind}({p(r.choice(FLOATS) if self.kinds is MIXED else 'real')})",
                lambda: f"to_{kind}({p(r.choice(self.others(kind)))})",
                lambda: f"{p(kind)} {r.choice(('+', '*', '//', '%', '<<', '>>', '&'))} {r.randint(0, 33)}",
            ]
            if kind == "uint32":
                choices += [lambda: f"multiply_high({p('uint32')}, {p('uint32')})", lambda: f"bits_of({p('real')})"]
        return r.choice(choices)().join("()")

    def statement(self, name: str) -> None:
        """One more value at hand."""
        r = self.rng
        shape = r.random()
        if shape < 0.05:
            kind = r.choice(self.kinds)
            width = r.randint(1, 4)
            self.let(name, f"vector([{', '.join(self.pick(kind) for _ in range(width))}])", kind, width)
        elif shape < 0.10 and self.pool.arrays:
            array, kind, width = r.choice(self.pool.arrays)
            self.let(name, f"store({array}, {self.pick('int32')}, {self.pick(kind)})", kind, width)
        elif shape < 0.14:
            kind, width = r.choice(self.kinds), r.choice((2, 3, 3, 3, 18))
            self.let(name, f"array_of({width}, lambda i_{name}: {self.inner(f'i_{name}', kind)})", kind, width)
        elif shape < 0.18:
            first, second = self.carried(), self.carried()
            pool, self.pool = self.pool, self.pool.copy()
            for local, kind in ((f"i_{name}", "int32"), (f"a_{name}", first), (f"b_{name}", second)):
                self.pool.add(local, kind)
            bodies = f"[{self.operation(first, dear=False)}, {self.operation(second, dear=False)}]"
            self.pool = pool
            starts = f"[{self.pick(first)}, {self.pick(second)}]"
            arguments = f"i_{name}, a_{name}, b_{name}"
            self.lines.append(f"{name}, {name}_2 = fold({r.randint(1, 4)}, {starts}, lambda {arguments}: {bodies})")
            self.pool.add(name, first)
            self.pool.add(f"{name}_2", second)
        elif shape < 0.22:
            kind, width = r.choice(self.kinds), r.choice((2, 3, 3, 18))
            self.let(name, f"array_of({width}, lambda i_{name}: {self.nested(name, kind)})", kind, width)
        else:
            kind = r.choice(self.kinds)
            self.let(name, self.operation(kind), kind)

    def others(self, kind: str) -> Sequence[str]:
        """Return the kinds that convert to `kind`, a float or an integer of 32 bits."""
        more = (*STORED, *(f for f in FLOATS if f != kind and kind in FLOATS)) if self.kinds is MIXED else ()
        return ("int32", "uint32", "bool", *more)

    def carried(self) -> str:
        """A kind that a loop carries: what is stored would become int32."""
        kind = self.rng.choice(self.kinds)
        return "int32" if kind in STORED else kind

    def inner(self, counter: str, kind: str) -> str:
        """The element of a loop."""
        with self.loop(counter):
            return self.operation(kind, dear=False)

    def nested(self, name: str, kind: str) -> str:
        """The element of a loop that is computed in another loop, which may or may not read the outer one's counter."""
        length = self.rng.randint(1, 4)
        with self.loop(f"i_{name}") if self.rng.random() < 0.7 else nullcontext():
            start = self.pick(kind)
            with self.loop(f"j_{name}"):
                if self.rng.random() < 0.5 or kind in STORED:
                    return f"array_of({length}, lambda j_{name}: {self.operation(kind)})[i_{name}]"
                self.pool.add(f"s_{name}", kind)
                body = self.operation(kind, dear=False)
                return f"fold({length}, [{start}], lambda j_{name}, s_{name}: [{body}])[0]"

    @contextmanager
    def loop(self, counter: str) -> Iterator[None]:
        """Add the counter to the pool within the block."""
        pool, self.pool = self.pool, self.pool.copy()
        self.pool.add(counter, "int32")
        self.pool.add(f"to_real({counter})", "real")
        yield
        self.pool = pool

    def let(self, name: str, text: str, kind: str, width: int | None = None) -> None:
        self.lines.append(f"{name} = {text}")
        self.pool.add(name, kind, width)

    def value(self, kind: str, width: int | None, tame: bool) -> str:
        """The text of a value to return; a tame real is finite and small, so that states do not stay NaN."""
        if width is not None:
            arrays = [a for a in self.pool.arrays if a[1:] == (kind, width)]
            if arrays and self.rng.random() < 0.7:
                array = self.rng.choice(arrays)[0]
                stored = f"store({array}, {self.pick('int32')}, {self.tamed(self.pick(kind), kind)})"
                return stored if self.rng.random() < 0.7 else array
            return f"vector([{', '.join(self.tamed(self.pick(kind), kind) for _ in range(width))}])"
        return self.tamed(self.operation(kind), kind) if tame else self.operation(kind)

    def tamed(self, text: str, kind: str) -> str:
        return f"tame({text})" if kind in FLOATS else text


def tame(v: Any) -> Any:
    """`v` if it is small, else a small number."""
    return expr.where(abs(v) < 100.0, v, 0.5)


class RandomBlock(Block):
    """A block whose methods are compiled from random source, which `source` keeps."""

    def __init__(self, seed: int, continuous: bool = False, size: int = 8, kinds: Sequence[str] = KINDS) -> None:
        rng = random.Random(seed)
        self.kinds = kinds
        self.inputs = [Port(f"u{i}", *self._shape(rng)) for i in range(rng.randint(1, 3))]
        self.outputs = [Port(f"y{i}", *self._shape(rng)) for i in range(rng.randint(1, 2))]
        self.params = [Param("p0", rng.uniform(-2, 2)), Param("p1", rng.randint(-5, 5), kind="int32")]
        self.derived = [Port("d0"), Port("d1", "real", 3)] if rng.random() < 0.4 else []
        self.states = [self._state(rng, i) for i in range(rng.randint(0, 3))]
        moving = [State(f"c{i}", rng.uniform(-1, 1), continuous=True) for i in range(rng.randint(1, 2))]
        if continuous:
            self.states = [*(self.states if rng.random() < 0.3 else []), *moving]
            if rng.random() < 0.3:
                self.states.append(State("c9", [0.5, -1.0, 0.25], width=3, continuous=True))
        self.source = ""
        self._write(rng, continuous, size)

    def _state(self, rng: random.Random, i: int) -> State:
        kind, width = self._shape(rng)
        if kind == "real" and width is None and rng.random() < 0.4:
            return State(f"x{i}", "d0" if self.derived and rng.random() < 0.5 else "p0")
        if kind in FLOATS:
            return State(f"x{i}", rng.uniform(-1, 1), kind, width)
        return State(f"x{i}", rng.random() < 0.5 if kind == "bool" else rng.randint(0, 9), kind, width)

    def _write(self, rng: random.Random, continuous: bool, size: int) -> None:
        inputs, states, params = Pool(), Pool(), Pool()
        for port in self.inputs:
            inputs.add(f"u.{port.name}", port.kind, port.width)
        for state in self.states:
            states.add(f"x.{state.name}", state.kind, state.width)
        params.add("p.p0", "real")
        params.add("p.p1", "int32")
        if self.derived:
            self._method(rng, "prepare", "p, t", [params], self.derived, 2)
            params.add("p.d0", "real")
            params.add("p.d1", "real", 3)
        clock = Pool()
        clock.add("t.dt", "real")
        clock.add("t.tick", "uint32")
        clock.add("t.time", "real")
        everything = [params, inputs, states, clock]
        see = everything if rng.random() < 0.7 or not self.states else [params, states, clock]
        self._method(rng, "output", "u, x, p, t", see, self.outputs, size)
        discrete = [s for s in self.states if not s.continuous]
        if discrete:
            named = discrete if rng.random() < 0.7 else discrete[:1]
            self._method(rng, "update", "u, x, p, t", everything, named, size)
        if continuous:
            moving = [s for s in self.states if s.continuous]
            self._method(rng, "derivative", "u, x, p, t", everything, moving, size)
            if rng.random() < 0.6:
                self._method(rng, "project", "u, x, p, t", everything, moving, 3)

    def _method(
        self, rng: random.Random, name: str, arguments: str, see: list[Pool], give: list[Any], size: int
    ) -> None:
        pool = Pool()
        for part in see:
            for kind, texts in part.scalars.items():
                for text in texts:
                    pool.add(text, kind)
            pool.arrays += part.arrays
        body = Body(rng, pool, self.kinds)
        for i in range(rng.randint(1, size)):
            body.statement(f"v{i}")
        tame_all = name != "output" or rng.random() < 0.5
        given = ", ".join(f'"{g.name}": {body.value(g.kind, g.width, tame_all)}' for g in give)
        lines = "\n".join(f"    {line}" for line in [*body.lines, f"return {{{given}}}"])
        text = f"def {name}({arguments}):\n{lines}\n"
        self.source += text
        scope: dict[str, Any] = {**NAMESPACE, "tame": tame}
        exec(text, scope)
        setattr(self, name, scope[name])

    def _shape(self, rng: random.Random) -> tuple[str, int | None]:
        return rng.choice(self.kinds), rng.choice((None,) * 15 + (3, 3, 3, 18))
