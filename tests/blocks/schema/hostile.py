"""Diagram files made to harm: too large, too deep, endless, malformed, or named like something else."""

import json
from collections.abc import Callable
from functools import cache
from typing import Any

from tests.blocks.samples import Gain, chain
from twodof.blocks.schema.json_form import to_json

Form = dict[str, Any]
BLOCK: Form = json.loads(to_json(chain(Gain())))["diagram"]["parts"][0]["block"]


def file(**diagram: Any) -> bytes:
    """A diagram's file; lone surrogates and all else escaped."""
    return json.dumps({"schema": "twodof/diagram", "version": 1, "diagram": {"name": "d", **diagram}}).encode()


def custom(**changes: Any) -> bytes:
    """A diagram of one custom block, connected; `changes` are to the block."""
    block = {**BLOCK, **changes}
    inputs = [{k: v for k, v in i.items() if k != "unit"} for i in block["inputs"]]
    return file(
        inputs=inputs,
        parts=[{"name": "g", "block": block}],
        connections=[[i["name"], f"g.{i['name']}"] for i in inputs],
        outputs=[[o["name"], f"g.{o['name']}"] for o in block["outputs"]],
    )


def library(kind: str, **config: Any) -> bytes:
    """A diagram of one block of the library, not connected."""
    return file(parts=[{"name": "g", "block": {"type": kind, "config": config}}])


def part(**changes: Any) -> bytes:
    """A diagram of one sub-diagram, `changes` being to the part."""
    return file(parts=[{"name": "part", "diagram": {"name": "part"}, **changes}])


def gain(**changes: Any) -> bytes:
    """A diagram of one gain, not connected, `changes` being to the part."""
    return file(parts=[{"name": "g", "block": {"type": "gain"}, **changes}])


def param(rest: str) -> bytes:
    """A diagram of one parameter, the rest of whose declaration is written by hand."""
    return raw(f'{{"name": "d", "params": [{{"name": "k", {rest}}}]}}')


def nested(depth: int, **leaf: Any) -> Form:
    """A diagram within `depth` others."""
    data: Form = {"name": "leaf", **leaf}
    for _ in range(depth):
        data = {"name": "level", "parts": [{"name": "inner", "diagram": data}]}
    return data


def restarting(depth: int, states: int) -> bytes:
    """States within diagrams that all restart, each at half of the rate of the one around."""
    delays = [{"name": f"d{k}", "block": {"type": "unit_delay", "config": {}}} for k in range(states)]
    data: Form = {"name": "leaf", "parts": delays}
    for _ in range(depth):
        data = {"name": "level", "parts": [{"name": "in", "rate": [2, 0], "enabling": "restart", "diagram": data}]}
    return file(**data)


def endless_rate(levels: int, divider: int) -> bytes:
    """A counter that runs at every divider ** levels ticks."""
    data: Form = {"name": "leaf", "parts": [{"name": "n", "block": {"type": "counter", "config": {}}}]}
    for _ in range(levels):
        data = {"name": "level", "parts": [{"name": "inner", "rate": [divider, 0], "diagram": data}]}
    return file(**data)


def raw(diagram: str) -> bytes:
    """A file whose diagram is written by hand."""
    return f'{{"schema": "twodof/diagram", "version": 1, "diagram": {diagram}}}'.encode()


class Nodes:
    """The nodes of a custom block, from the input u, node 0."""

    def __init__(self) -> None:
        self.rows: list[Any] = [["input", [], "u"]]

    def add(self, op: str, *args: int, data: tuple[Any, ...] = ()) -> int:
        self.rows.append([op, list(args), *data])
        return len(self.rows) - 1

    def block(self, last: int | None = None, **changes: Any) -> bytes:
        return custom(nodes=self.rows, output={"y": len(self.rows) - 1 if last is None else last}, **changes)


def doubling(count: int) -> bytes:
    """x = x + x, `count` times: 2^count operations, if it were followed as a tree."""
    n = Nodes()
    at = 0
    for _ in range(count):
        at = n.add("add", at, at)
    return n.block()


def shared_loops(count: int, steady: bool = False) -> bytes:
    """Each loop's body holds the two loops before it: as many bodies as rabbits.

    Each reads the loop around it; a `steady` one reads nothing, so that all are computed once, one after the other.
    """
    n = Nodes()
    before, last = 0, 0
    for k in range(count + 1):
        around = n.add("bound", data=("real", (k + 1) % 2, 1))
        body = n.add("add", n.add("add", before, last), 0 if steady or k == count else around)
        before, last = last, n.add("fold", 0, body, data=(2, k % 2, 0))
    n.add("fold", 0, last, data=(2, (count + 1) % 2, 0))
    return n.block()


def loops(lengths: list[int], depth: Callable[[int], int] = lambda k: k, steady: bool = False) -> bytes:
    """Loops within one another, the first innermost; `depth(k)` is how the file labels the k-th from the inside.

    Each reads the counter of the loop around it; a `steady` one does not, and is computed once before that loop.
    """
    n = Nodes()
    last = 0
    for k, length in enumerate(lengths):
        counter = n.add("bound", data=("int32", depth(k), 0))
        carried = n.add("bound", data=("real", depth(k), 1))
        body = n.add("add", n.add("add", carried, n.add("convert", counter, data=("real",))), last)
        if k + 1 < len(lengths) and not steady:
            around = n.add("bound", data=("int32", depth(k + 1), 0))
            body = n.add("add", body, n.add("convert", around, data=("real",)))
        last = n.add("fold", 0, body, data=(length, depth(k), 0))
    return n.block()


def many_variables(count: int) -> bytes:
    """A sum of thousands of loop variables: each node depends on all before it."""
    n = Nodes()
    total = 0
    for k in range(count):
        total = n.add("add", total, n.add("bound", data=("real", k % 8, 1 + k // 8 % 32)))
    return n.block()


def stores(count: int, width: int) -> bytes:
    """Return a block with `count` writes into a wide array; each write may copy it."""
    n = Nodes()
    at = n.add("build", 0, data=(width, 0))
    for k in range(count):
        index = n.add("const", data=("int32", k))
        at = n.add("store", at, index, 0)
    n.add("select", at, n.add("const", data=("int32", 3)))
    return n.block()


def shared_outputs(count: int, size: int) -> bytes:
    """Many outputs that are all computed from one large graph."""
    n = Nodes()
    at = 0
    for _ in range(size):
        at = n.add("add", at, 0)
    outputs = {f"y{k}": n.add("neg", at) for k in range(count)}
    return custom(nodes=n.rows, outputs=[{"name": o} for o in outputs], output=outputs)


def many_edges(count: int) -> bytes:
    """Signals with an edge inside the step: each adds a piece to every integration."""
    late = {"type": "fractional_delay", "config": {"delay": 0.003}}
    lag = {"type": "integrator", "config": {}}
    parts: list[Any] = [{"name": f"e{k}", "block": late} for k in range(count)]
    parts += [{"name": f"i{k}", "block": lag} for k in range(count)]
    wires = [["u", f"e{k}"] for k in range(count)] + [[f"e{k}", f"i{k}"] for k in range(count)]
    return file(inputs=[{"name": "u"}], parts=parts, connections=wires)


def gains(count: int) -> bytes:
    """Return a chain of `count` gains."""
    gain = {"type": "gain", "config": {}}
    return file(
        inputs=[{"name": "u"}],
        parts=[{"name": f"g{k}", "block": gain} for k in range(count)],
        connections=[["u" if k == 0 else f"g{k - 1}", f"g{k}"] for k in range(count)],
        outputs=[["y", f"g{count - 1}"]],
    )


WIDE = {"name": "u", "width": 10**6}


def too_large(share: int) -> dict[str, tuple[bytes, str]]:
    """Files that are refused for their size; made when they are asked for, as they are tens of megabytes.

    Those whose refusal takes time in proportion to their size have a `share`-th of it.
    """
    return {
        "a delay of 10^9 steps": (library("delay", samples=10**9, bound=10**9), "within 1 .. "),
        "a state of 10^9 values": (custom(states=[{"name": "ring", "width": 10**9}]), "more than 1000000 values"),
        "a state of 10^39 values": (custom(states=[{"name": "ring", "width": 10**39}]), "more than 1000000 values"),
        "a matrix of 10^10 values": (
            custom(inputs=[{"name": "u", "shape": [10**5, 10**5]}]),
            "more than 1000000 values",
        ),
        "a shape of many long numbers": (custom(inputs=[{"name": "u", "shape": [10**39 + 7] * 40_000}]), "not one of"),
        "a shape of one number": (custom(inputs=[{"name": "u", "shape": [2]}]), "not one of a matrix"),
        "a negative shape": (custom(inputs=[{"name": "u", "shape": [2, -3]}]), "not"),
        "too many blocks in a row": (gains(150_000 if share == 1 else 105_000), "bytes of diagram"),
        "120,000 blocks": (
            file(parts=[{"name": f"g{k}", "block": {"type": "gain"}} for k in range(120_000 // share)]),
            "more than 10000 parts",
        ),
        "a table of a gigabyte": (
            custom(
                params=[
                    {"name": "k", "width": 10**6, "value": 1},
                    *({"name": f"k{i}", "width": 10**6} for i in range(3)),
                ]
            ),
            "more than 1000000 values",
        ),
        "a table as long as a file may be": (
            library("playback", values=[1] * (2_500_000 // share)),
            "more than 100000 numbers",
        ),
        "a matrix of 90,000 numbers": (library("matrix_gain", K=[[1] * 300] * 300), "more than 1000000 operations"),
        "a delay of wide samples": (library("delay", samples=4, width=70_000 // share), "operations"),
        "wide arrays side by side": (library("concatenate", widths=[150_000] * 3), "too many operations"),
        "100,000 inputs": (
            custom(inputs=[{"name": "u"}, *({"name": f"u{k}"} for k in range(100_000 // share))]),
            "at most 1000|more than 100000",
        ),
        "90,000 inputs of a diagram": (
            file(inputs=[{"name": f"u{k}"} for k in range(110_000)]),
            "more than 100000 ports",
        ),
        "arrays that are copied": (
            file(
                inputs=[WIDE],
                parts=[{"name": "h", "block": {"type": "unit_delay", "config": {"width": 10**6}}} for _ in range(5)],
            ),
            "more than 1000000 values|used twice",
        ),
        "lists within lists": (library("lookup", values=[[[[[[[1]]]]]]]), "more than 4 lists"),
        "empty lists": (
            raw('{"name": "d", "parts": [' + "[]," * (2_700_000 // share) + "[]]}"),
            "more than 10000 parts",
        ),
        "empty objects": (
            raw('{"name": "d", "parts": [' + "{}," * (2_700_000 // share) + "{}]}"),
            "more than 10000 parts",
        ),
        "an object of a million keys": (
            raw('{"name": "d", ' + ", ".join(f'"{k:x}":0' for k in range(700_000 // share)) + "}"),
            "unknown key",
        ),
        "a name of 8 MB": (file(name="a" * (8_000_000 // share)), "is not a name"),
        "a text of 8 MB": (file(text="a" * (8_000_000 // share)), "a text of 80+ characters"),
        "a unit of 1 MB": (file(inputs=[{"name": "u", "unit": "m" * 10**6}]), "a text of 1000000 characters"),
        "an argument of 1 MB": (library("sum", signs="+" * 10**6), "a text of 1000000 characters"),
        "sub-diagrams 900 deep": (file(**nested(200)), "nested more than 64"),
        "sub-diagrams 10^5 deep": (
            raw('{"name":"a","parts":[{"name":"b","diagram":' * 100_000 + "{}" + "}]}" * 100_000),
            "no JSON",
        ),
        "arrays 900 deep": (library("lookup", values=json.loads("[" * 900 + "]" * 900)), "lists within more than"),
        "arrays 900 deep for a part": (file(parts=json.loads("[" * 900 + "]" * 900)), "is not a part"),
        "arrays 10^6 deep": (raw("[" * 10**6 + "]" * 10**6), "no JSON"),
        "rates that multiply without end": (endless_rate(40, 2**31 - 1), "is impossible"),
    }


def endless(share: int) -> dict[str, tuple[bytes, str]]:
    """Files that are small and would compute without end; of those that are large, a `share`-th."""
    return {
        "loops that share loops": (shared_loops(400), "nested more than 8|more than 50000 operations"),
        "seven loops of a million": (loops([10**6 - 1] * 7), "a step of more than 1000000 operations"),
        "two loops of a million": (loops([10**6 - 1] * 2), "a step of more than 1000000 operations"),
        "a loop of 10^9": (loops([10**9]), "is not in 0"),
        "loops 9 deep": (loops([1] * 9, lambda k: k % 8), "nested more than 8"),
        "loops 8,000 deep": (loops([1] * (8_000 // share), lambda k: k % 8), "nested more than 8"),
        "eight loops of 100": (loops([100] * 8), "a step of more than 1000000 operations"),
        "20,000 variables of no loop": (many_variables(20_000 // share), "outside its loop"),
        "5,000 stores into 10^6 values": (stores(5000 // share, 10**6), "operations"),
        "1,000 outputs of 40,000 nodes": (shared_outputs(1000 // share, 40_000 // share), "more than 50000 operations"),
        "500 edges inside a step": (many_edges(500), "a step of more than 1000000 operations"),
        "200,000 nodes": (doubling(200_000 if share == 1 else 55_000), "more than 50000"),
    }


# Names as they could come in to run as code or to pass for another name.
NAMES = {
    "C code": "x; system(1)",
    "a C comment": "a/**/",
    "a preprocessor line": "a\n#include <stdlib.h>",
    "a newline": "a\n",
    "a carriage return": "a\r",
    "a quote": 'a"',
    "a backslash": "a\\",
    "a NUL": "a\0b",
    "a dot": "a.b",
    "a space": "a b",
    "a slash": "../../etc/passwd",
    "a percent sign": "%s%n",
    "markup": "<script>alert(1)</script>",
    "a template": "${x}",
    "a leading digit": "1a",
    "a leading underscore": "__class__",
    "nothing": "",
    "64 letters": "a" * 64,
    "a Cyrillic а": "gаin",
    "a Greek ο": "lοop",
    "a full-width ａ": "ａ",
    "a mathematical 𝐚": "𝐚",
    "an e with a combining accent": "e\u0301",
    "an é": "\u00e9",
    "a right-to-left override": "a\u202eb",
    "a zero-width space": "a\u200bb",
    "a zero-width joiner": "a\u200db",
    "a byte order mark": "\ufeffa",
    "a soft hyphen": "a\u00adb",
    "an Arabic digit": "a\u0661",
    "a superscript": "a²",
    "half a surrogate pair": "a\ud800",
}


def named(name: str) -> dict[str, bytes]:
    """Files that have `name` wherever a name may stand."""
    gain = {"type": "gain", "config": {}}
    return {
        "diagram": file(name=name),
        "input": file(inputs=[{"name": name}]),
        "output": file(inputs=[{"name": "u"}], outputs=[[name, "u"]]),
        "param": file(params=[{"name": name, "value": 1.0}]),
        "part": file(parts=[{"name": name, "block": gain}]),
        "sub-diagram": file(parts=[{"name": "s", "diagram": {"name": name}}]),
        "source": file(parts=[{"name": "g", "block": gain}], connections=[[name, "g.u"]], outputs=[["y", "g"]]),
        "destination": file(inputs=[{"name": "u"}], parts=[{"name": "g", "block": gain}], connections=[["u", name]]),
        "port": file(inputs=[{"name": "u"}], parts=[{"name": "g", "block": gain}], connections=[["u", f"g.{name}x"]]),
        "inner parameter": file(params=[{"name": "k"}], parts=[{"name": "g", "block": gain, "params": {name: "k"}}]),
        "outer parameter": file(
            inputs=[{"name": "u"}],
            parts=[{"name": "g", "block": gain, "params": {"k": name or "?"}}],
            connections=[["u", "g.u"]],
        ),
        "enable": file(parts=[{"name": "s", "diagram": {"name": "s"}, "enable": name or "?"}]),
        "block": file(parts=[{"name": "g", "block": {"type": name}}]),
        "argument": file(parts=[{"name": "g", "block": {"type": "gain", "config": {name: 1}}}]),
        "custom block": custom(name=name),
        "custom input": custom(inputs=[{"name": name}]),
        "custom output": custom(outputs=[{"name": name}]),
        "custom state": custom(states=[{"name": name}]),
        "custom parameter": custom(params=[{"name": name}]),
        "custom derived": custom(derived=[{"name": name}]),
        "section": custom(output={name: 0}),
        "edge": custom(edges={name: [0, 0]}),
        "leaf": custom(nodes=[["input", [], name]], output={"y": 0}),
        "function": custom(nodes=[["input", [], "u"], ["call", [0], name]], output={"y": 1}),
        "operation": custom(nodes=[["input", [], "u"], [name, [0]]], output={"y": 1}),
        "kind": custom(inputs=[{"name": "u", "kind": name}]),
        "initial": custom(states=[{"name": "x", "initial": name}]),
    }


SECTION = '"name": "d", "inputs": [{"name": "u"}]'
CIRCLE: Form = {"name": "s", "diagram": {"name": "s", "inputs": [{"name": "a"}], "outputs": [["b", "a"]]}}
KINDS = "is missing or of the wrong kind"
MANY = {"y": [0] * 200_000}
MALFORMED: dict[str, tuple[bytes, str]] = {
    "nothing": (b"", "no JSON"),
    "no UTF-8": (b'{"schema": "\xff"}', "no JSON"),
    "NaN": (param('"value": NaN'), "NaN is no JSON number"),
    "Infinity": (param('"value": -Infinity'), "-Infinity is no JSON number"),
    "1e999": (param('"value": 1e999'), "beyond the largest float64"),
    "-1e999": (param('"low": -1e999'), "beyond the largest float64"),
    "1.8e308": (param('"value": 1.8e308'), "beyond the largest float64"),
    "a float of 10^6 digits": (param(f'"value": {"1" * 10**6}.0'), "beyond the largest float64"),
    "an integer of 10^5 digits": (param(f'"value": {"1" * 10**5}'), "an integer of 100000 digits"),
    "a version of 10^5 digits": (b'{"schema": "twodof/diagram", "version": ' + b"1" * 10**5 + b"}", "100000 digits"),
    "a true version": (b'{"schema": "twodof/diagram", "version": true, "diagram": {}}', "version True"),
    "a key twice": (raw(f'{{{SECTION}, "name": "e"}}'), "'name' stands twice"),
    "a schema twice": (b'{"schema": "twodof/diagram", "schema": "x", "version": 1}', "'schema' stands twice"),
    "an argument twice": (
        raw('{"name": "d", "parts": [{"name": "g", "block": {"type": "gain", "config": {"k": 1, "k": 2}}}]}'),
        "'k' stands twice",
    ),
    "an escaped key twice": (raw(f'{{{SECTION}, "n\\u0061me": "e"}}'), "'name' stands twice"),
    "an unknown key of the file": (file()[:-1] + b', "run": "x"}', "unknown key 'run'"),
    "an unknown key of a diagram": (file(part=[]), "unknown key 'part'"),
    "an unknown key of a part": (gain(reset_="u"), "'reset_'"),
    "an unknown key of a block": (custom(python="import os"), "unknown key 'python'"),
    "an unknown key beside a block's type": (gain(block={"type": "gain", "nodes": []}), "unknown key 'nodes'"),
    "half a surrogate pair in a text": (file(text="a\udc80"), r"U\+DC80"),
    "a text that is reordered": (file(text="abc\u202edef"), r"U\+202E"),
    "a text of no width": (file(params=[{"name": "k", "text": "\u200b"}]), r"U\+200B"),
    "a NUL in a text": (file(text="\0"), r"U\+0000"),
    "an escape sequence in a text": (file(text="\x1b[2J"), r"U\+001B"),
    "a line separator in a text": (file(text="a\u2028b"), r"U\+2028"),
    "a newline in a unit": (file(inputs=[{"name": "u", "unit": "m\n"}]), r"U\+000A"),
    "a unit that looks like another": (file(inputs=[{"name": "u", "unit": "\u212b"}]), "NFKC"),
    "a unit in another normal form": (file(inputs=[{"name": "u", "unit": "A\u030a"}]), "NFKC"),
    "a position of an input that is not there": (file(input_positions={"nobody": [0.0, 0.0]}), "input_positions"),
    "an output beyond all screens": (file(outputs=[["y", None]], output_positions={"y": [0.0, -1e300]}), "position"),
    "a flip that is a number": (gain(flipped=1), "flipped"),
    "a block commented without a sub-diagram": (gain(commented="out"), "of a sub-diagram"),
    "a word for a comment": (part(commented="away"), "write .out. or .through."),
    "a position beyond all screens": (gain(position=[1e300, 0]), "position"),
    "a rate of 2^31": (gain(rate=[2**31, 0]), "is impossible"),
    "a negative offset": (gain(rate=[2, -1]), "is impossible"),
    "a rate of a half": (gain(rate=[0.5, 0]), "is impossible"),
    "the argument self": (library("gain", self=1), "cannot be made"),
    "an argument that is no argument": (library("gain", __class__=1), "unexpected keyword argument '__class__'"),
    "a matrix with NaN": (library("matrix_gain", K=[[{"float": "nan"}]]), r"K\[0\]\[0\] = nan is not finite"),
    "a table in a table": (custom(params=[{"name": "k", "width": 2, "value": [[1], [2]]}]), "it takes real"),
    "an object for a number": (custom(params=[{"name": "k", "value": {"a": 1}}]), "it takes real"),
    "a trigger that is a number": (part(trigger=1), f"'trigger' {KINDS}"),
    "another edge": (part(trigger="u", edge="rise"), "edge='rise'"),
    "another enabling": (part(enabling="afresh"), "enabling='afresh'"),
    "a value when disabled of nothing": (part(enable="u", disabled={"y": 1}), "no output named 'y' to reset"),
    "a number when disabled": (part(disabled=1), f"'disabled' {KINDS}"),
    "values when disabled beyond number": (part(enable="u", disabled=MANY), "more than 100000 numbers"),
    "an initial value of nothing": (part(initial={"y": 1}), "no output named 'y'"),
    "initial values that are none": (part(initial=[1]), f"'initial' {KINDS}"),
    "an initial value of 200,000 numbers": (part(initial=MANY), "more than 100000 numbers"),
    "60 diagrams that restart 600 states": (restarting(60, 600), "100000 ports and states in diagrams that restart"),
    "a connection in a circle": (
        file(inputs=[{"name": "u"}], parts=[CIRCLE], connections=[["s", "s.a"]], outputs=[["y", "s"]]),
        "leads back to itself",
    ),
}


@cache
def large(share: int = 1) -> dict[str, bytes]:
    """Return large files that are allowed, and must stay bounded too; each has a `share`-th of its size."""
    return {
        "a chain of 45,000 doublings": doubling(45_000 // share),
        "10,000 gains": gains(10_000 // share),
        "a loop of 140,000 rounds": loops([140_000 // share]),
        "64 sub-diagrams": file(**nested(60)),
        "a table of 90,000 numbers": library("playback", values=[0.1, 0.2] * (45_000 // share), period=0.01),
        "a state of 900,000 values": custom(states=[{"name": "ring", "width": 900_000}]),
        "400 loops that share loops and do not change": shared_loops(400 // share, steady=True),
        "8,000 loops, each computed once before the next": loops([1] * (8_000 // share), lambda k: k % 8, steady=True),
        "300 outputs of one graph": shared_outputs(300 // share, 100),
    }
