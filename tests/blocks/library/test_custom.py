"""A Python function becomes a block, keeps its parameters and travels as JSON."""

from typing import Any

import numpy as np

from tests.blocks.library.harness import alone, assert_close, noise, run, run_y
from twodof.blocks.declarations import Param, Port
from twodof.blocks.elementary.functions import atan, cos
from twodof.blocks.expressions.expr import int32, where
from twodof.blocks.library import function_block
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json

ONE = int32(1)


def projection(f_dx: Any, *, T_bar: Any = 0.4, eta_T: Any = 6.3386) -> Any:
    """The drone's projection of the wanted force onto pitch and thrust."""
    theta = -atan(f_dx / (T_bar * eta_T))
    return theta, T_bar / cos(theta)


def test_a_function_is_a_block_with_its_parameters() -> None:
    f = noise(30)
    block = function_block(projection, outputs=(Port("theta", unit="rad"), "T"))
    rows = run(block, 30, inputs={"f_dx": f}, params={"T_bar": 0.5})
    assert_close(rows["theta"], -np.arctan(f / (0.5 * 6.3386)))
    assert_close(rows["T"], 0.5 / np.cos(np.arctan(f / (0.5 * 6.3386))))
    assert type(block).__name__ == "projection"


def test_results_may_be_bare_or_named() -> None:
    u = noise(5)
    assert run_y(function_block(lambda a, *, k=3.0: k * a), u).tolist() == (3.0 * u).tolist()
    named = function_block(lambda a: {"low": a - 1.0, "high": a + 1.0}, outputs=("high", "low"))
    assert run(named, 5, inputs={"a": u})["low"].tolist() == (u - 1.0).tolist()


def test_ports_and_parameters_of_other_types() -> None:
    def pick(values: Any, index: Any, *, table: Any = (1.0, 2.0), shift: Any = ONE, on: Any = True) -> Any:
        return where(on, values[index + shift] * table[1], 0.0)

    block = function_block(pick, inputs=[Port("values", width=3), Port("index", "int32")])
    rows = run(block, 2, inputs={"values": [5.0, 6.0, 7.0], "index": np.array([0, 1])})
    assert rows["y"].tolist() == [12.0, 14.0]
    bounded = function_block(lambda a, *, k=1.0: k * a, params=[Param("k", 2.0, low=0.0, unit="s")])
    assert bounded.params[0].low == 0.0
    assert run_y(bounded, np.ones(1)).tolist() == [2.0]


def test_it_travels_as_its_expressions() -> None:
    d = alone(function_block(projection, outputs=("theta", "T")))
    text = to_json(d)
    assert "def " not in text
    again = from_json(text)
    f = noise(20)
    first, second = (Reference(x, 0.01).machine().run(20, {"f_dx_in": f}) for x in (d, again))
    for name in first:
        assert first[name].tolist() == second[name].tolist()
    assert to_json(again) == text
