"""The JSON form: a round trip to the bit, and files that are broken or hostile are refused at the door."""

import json
from typing import Any

import numpy as np
import pytest

from tests.blocks.samples import Bouncer, Gain, Lag, Late, Memory, chain
from twodof.blocks import Block, Diagram, Param, Port, array_of, fold, int32, where
from twodof.blocks.elementary.functions import atan2, sin
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.errors import TwodofError

pytestmark = pytest.mark.slow


class Everything(Block):
    """Uses what an expression may use: functions, loops, arrays, all types, both clocks."""

    inputs = (Port("u"),)
    outputs = (Port("y"), Port("n", "int32"))
    params = (Param("c", [0.1, -2.0, 3.0], width=3), Param("top", float("inf")))
    derived = (Port("scaled", width=3),)

    def prepare(self, p: Any, t: Any) -> Any:
        return {"scaled": array_of(3, lambda i: p.c[i] * t.dt)}

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        poly = fold(3, [u.u * -0.0], lambda i, s: [s * u.u + p.scaled[2 - i]])[0]
        return {
            "y": where(u.u < p.top, sin(poly) + atan2(u.u, t.time), -0.0),
            "n": where((t.tick >> 1) % 3 == 1, int32(3), int32(-3)),
        }


def everything() -> Diagram:
    d = chain(Gain(), Late(), Lag(), Everything(), Memory())
    d.text = 'quotes " and Greek θ'
    d.param("k", 2.5, low=-3.0, text="shared")
    inner = Diagram("inner")
    inner.add("ball", Bouncer())
    inner.add("gain", Gain(), u="ball.h")
    inner.output("h", "gain")
    d.input("on", "bool")
    d.add("sub", inner, enable="on", reset="on", disabled="reset", position=(1.0, 2.5), initial={"h": float("inf")})
    d.parts["sub"].enabling = "restart"
    d.parts["sub"].flipped = True
    d.parts["sub"].commented = "out"
    d.add("elsewhere", inner, enable="on", disabled={"h": float("-inf")})
    d.add("edge", inner, trigger="on", edge="falling")
    d.add("slow", Memory(), rate=(5, 2))
    d.add("zero", Gain(), rate=(5, 2))
    d.connect("slow", "zero.u")
    d.connect("zero", "slow.u")
    d.output("h", "sub")
    d.input_positions["on"], d.output_positions["h"] = (-60.0, 2.5), (700.0, 1e-3)
    return d


@pytest.mark.long
def test_the_round_trip_is_the_same_text_and_flies_the_same_bits() -> None:
    text = to_json(everything())
    again = from_json(text)
    assert to_json(again) == text
    u = np.random.default_rng(0).normal(size=40)
    for precision in ("float64", "float32"):
        flown = [
            Reference(d, 0.01, precision, ["b3.n"]).machine().run(40, {"r": u, "on": u > 0})
            for d in (everything(), again)
        ]
        for name in flown[0]:
            assert flown[0][name].tobytes() == flown[1][name].tobytes()


def test_the_text_diffs_well() -> None:
    a, b = everything(), everything()
    b.parts["sub"].position = (9.0, 9.0)
    lines = [set(to_json(d).splitlines()) for d in (a, b)]
    assert len(lines[0] ^ lines[1]) == 2


def form(**changes: Any) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(to_json(everything()))
    data["diagram"].update(changes)
    return data


GAIN = {"name": "g", "block": json.loads(to_json(chain(Gain())))["diagram"]["parts"][0]["block"]}


def custom(**changes: Any) -> dict[str, Any]:
    return form(parts=[{"name": "g", "block": {**GAIN["block"], **changes}}], connections=[], outputs=[])


HOSTILE = {
    "another schema": ({"schema": "x"}, "not a diagram"),
    "a future version": ({"schema": "twodof/diagram", "version": 2, "diagram": {}}, "version 2 is unknown"),
    "an unknown block": (
        form(parts=[{"name": "g", "block": {"type": "os.system", "config": {}}}]),
        "unknown block type",
    ),
    "an unknown field": (form(inputs=[{"name": "a", "__class__": "x"}]), "unknown key .__class__."),
    "a node that looks ahead": (custom(nodes=[["neg", [0]]]), r"node 0 uses node \[0\], which does not come before"),
    "an operation of another type": (custom(nodes=[["input", [], "u"], ["and", [0, 0]]]), "not defined on real"),
    "a foreign operation": (custom(nodes=[["__import__", []]]), "not well formed"),
    "a long array of arrays": (
        custom(nodes=[["input", [], "u"], ["build", [0], 1000, 0], ["build", [1], 1001, 0]]),
        "1000999 is not in 0..999999",
    ),
    "an operation on an array": (
        custom(nodes=[["input", [], "u"], ["build", [0], 9, 0], ["neg", [1]]]),
        "neg is applied to an array of 9",
    ),
    "a missing output": (custom(output={}), "does not give 'y'"),
    "a node that is not there": (custom(output={"y": 99}), "node 99, which is not there"),
    "a connection to nowhere": (form(connections=[["r", "nowhere.u"]]), "no output or part named .nowhere."),
    "an input fed twice": (form(connections=[["r", "b0.u"], ["r", "b0.u"]]), "has two sources"),
    "a name used twice": (form(parts=[GAIN, GAIN], connections=[], outputs=[]), "used twice"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_with_a_reason(name: str) -> None:
    data, message = HOSTILE[name]
    with pytest.raises(TwodofError, match=message):
        from_json(data if isinstance(data, bytes) else json.dumps(data))
