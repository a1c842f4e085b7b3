"""Memory of a block outside its states is refused, or gives the same bits on every target."""

import itertools
import random
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.blocks.library.harness import alone
from tests.blocks.mine import line_of, mine
from twodof.blocks import array_of, fold, vector
from twodof.blocks.block import Block
from twodof.blocks.declarations import Port, State
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions.expr import Expr
from twodof.blocks.library.functions import function_block
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import to_json
from twodof.compile import build
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError

Written = Callable[..., Any]


def output_state(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    x.s = x.s + u.u  # here
    return x.s


def output_parameter(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    p.k = 2.0 * p.k  # here
    return p.k


def output_clock(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    t.tick = t.tick + 1  # here
    return u.u


def output_attribute(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    self.count += 1  # here
    return u.u * self.count


def output_element(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    u.a[0] = 1.0  # here
    return u.a[0]


ASSIGNED: dict[str, tuple[Written, str]] = {
    "a state": (output_state, "the state 's' is assigned.*update"),
    "a parameter": (output_parameter, "the parameter 'k' is assigned.*prepare"),
    "the clock": (output_clock, "the clock value 'tick' is assigned"),
    "an attribute": (output_attribute, "the attribute 'count'.*state"),
    "an element": (output_element, r"store\(a, i, value\)"),
}


def compiled(d: Diagram) -> Any:
    return lower(d, 0.01)


@pytest.mark.parametrize("case", ASSIGNED)
@pytest.mark.parametrize("made", [lambda d: Reference(d, 0.01), compiled], ids=["reference", "compiler"])
def test_an_assignment_in_a_method_is_an_error_with_its_line(case: str, made: Callable[[Diagram], Any]) -> None:
    written, words = ASSIGNED[case]
    with pytest.raises(DiagramError) as caught:
        made(alone(mine("output", written, count=0)()))
    assert f"block, block Mine.output, {line_of(written)}: " in str(caught.value)
    assert re.search(words, str(caught.value))


COUNTER = itertools.count()


def rolled(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    self.__dict__["count"] += 1
    return u.u * self.count


def shared(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    self.result["y"] = u.u + 2.0 * self.result["y"]
    return self.result


def exhausted(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    return u.u * next(self.gains)  # here


def escaped(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    kept: list[Any] = []
    array_of(3, lambda i: kept.append(i) or u.a[i])  # type: ignore[func-returns-value]
    return u.a[kept[0]]


# Refused before anything runs: the second trace differs from the first, or holds what it may not.
TRACED: dict[str, tuple[Written, str]] = {
    "random numbers": (lambda self, u, x, p, t: u.u * random.random(), "another 'y'"),
    "a counter of the module": (lambda self, u, x, p, t: u.u * next(COUNTER), "another 'y'"),
    "a list": (lambda self, u, x, p, t: self.seen.append(u.u) or sum(self.seen), "another 'y'"),
    "its own __dict__": (rolled, "another 'y'"),
    "a result that is kept": (shared, "another 'y'"),
    "an iterator that ends": (exhausted, "StopIteration"),
    "a variable that left its loop": (escaped, "variable of a loop outside that loop"),
}


def smuggler(method: str, written: Written) -> Block:
    made = mine(method, written, total=0)()
    vars(made).update(count=0, seen=[], result={"y": 0.0}, gains=iter([2.0]))
    return made


@pytest.mark.parametrize("case", TRACED)
@pytest.mark.parametrize(
    "made", [lambda d: Reference(d, 0.01), compiled, to_json], ids=["reference", "compiler", "JSON"]
)
def test_what_a_method_remembers_is_refused_when_it_is_traced_again(case: str, made: Callable[[Diagram], Any]) -> None:
    written, words = TRACED[case]
    with pytest.raises(DiagramError) as caught:
        made(alone(smuggler("output", written)))
    assert f"block, block Mine.output, {line_of(written)}: " in str(caught.value)
    assert re.search(words, str(caught.value))


@pytest.mark.parametrize("method", ["prepare", "output", "edges", "update", "derivative", "project"])
def test_every_method_is_traced_again(method: str) -> None:
    names = {"prepare": "g", "output": "y", "edges": "y", "update": "s", "derivative": "c", "project": "c"}

    def written(self: Any, *seen: Any) -> Any:
        value = vector([next(COUNTER), 0.0])[0]
        return {names[method]: (0.5, value) if method == "edges" else value}

    with pytest.raises(DiagramError) as caught:
        Reference(alone(mine(method, written)()), 0.01)
    assert f"block Mine.{method}, {line_of(written)}: {method} computes another {names[method]!r}" in str(caught.value)


def counted(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    calls = itertools.count(1)
    return fold(3, [u.u], lambda i, total: [total + next(calls)])[0]


def rare(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    self.seen.append(None)
    return u.u + len(self.seen) // 6


def looked(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    return u.u if isinstance(u.u, Expr) else 2.0 * u.u


def kept(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    return self.result.setdefault("first", u.u)


# Traced twice, these give one graph. On numbers they give something else, and the reference compares.
COMPUTED: dict[str, tuple[Written, str]] = {
    "a count within a loop": (counted, r"output gives 'y' = 6\.0 now, and 3\.0 as it was traced"),
    "a count that shows late": (rare, r"output gives 'y' = -?\d\.0 now, and -?\d\.0 as it was traced"),
    "a look at the type": (looked, r"output gives 'y' = 2\.0 now, and 1\.0 as it was traced"),
    "a value kept from tracing": (
        kept,
        "gives a value that it kept from when it was traced.*keep what changes in a state",
    ),
}


@pytest.mark.parametrize("case", COMPUTED)
def test_a_method_that_gives_another_number_than_its_trace_is_refused_by_the_reference(case: str) -> None:
    written, words = COMPUTED[case]
    machine = Reference(alone(smuggler("output", written)), 0.01).machine()
    with pytest.raises(DiagramError) as caught:
        machine.run(5, {"u_in": np.array([0.0, -0.0, 1.0, -1.0, 1.0])})
    assert f"block, block Mine.output, {line_of(written)}: " in str(caught.value)
    assert re.search(words, str(caught.value)), caught.value


class Scaled(Block):
    """Attributes that __init__ sets: y = gain * table[0] * u."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)

    def __init__(self, gain: float = 2.0) -> None:
        self.gain = gain
        self.table = [1.0, 2.0]

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self.gain * self.table[0] * u.u


def test_attributes_are_fixed_once_a_block_is_traced() -> None:
    block = Scaled()
    block.gain = 3.0
    d = alone(block)
    assert Reference(d, 0.01).machine().step({"u_in": 1.0}) == {"y_out": 3.0}
    with pytest.raises(DiagramError, match=r"test_hidden_state\.py:\d+: the attribute 'gain' is assigned.*__init__"):
        block.gain = 4.0
    assert block.gain == 3.0


def test_a_block_whose_trace_failed_can_be_mended() -> None:
    block = Scaled()
    block.table = []
    with pytest.raises(DiagramError, match="IndexError"):
        _ = block.trace
    block.table = [1.0]
    assert Reference(alone(block), 0.01).machine().step({"u_in": 1.0}) == {"y_out": 2.0}


def test_what_is_changed_in_place_after_tracing_is_refused_when_it_is_built_and_when_it_runs() -> None:
    block = Scaled()
    d = alone(block)
    machine = Reference(d, 0.01).machine()
    machine.step({"u_in": 1.0})
    block.table[0] = 5.0
    for use in (lambda: Reference(d, 0.01), lambda: compiled(d), lambda: to_json(d)):
        with pytest.raises(DiagramError, match="output computes another 'y' when it is traced again"):
            use()
    with pytest.raises(DiagramError, match=r"output gives 'y' = 10\.0 now, and 2\.0 as it was traced"):
        machine.step()


def test_a_value_of_another_block_is_refused() -> None:
    given: list[Any] = []

    def gives(elsewhere: Any) -> Any:
        given[:] = [elsewhere]
        return elsewhere

    def takes(here: Any) -> Any:
        return given[0] + here

    _ = function_block(gives).trace
    for made in (lambda d: Reference(d, 0.01), compiled):
        with pytest.raises(DiagramError, match="output uses input:elsewhere:real, which is not one"):
            made(alone(function_block(takes)))


class Allowed(Block):
    """A block that changes values of its own within one call."""

    inputs = (Port("u"), Port("a", width=3))
    outputs = (Port("y"), Port("z", width=3))
    states = (State("s"),)

    def __init__(self) -> None:
        self.gains = {"low": 0.1, "high": 3}
        self.result: dict[str, Any] = {}

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        terms: list[Any] = []
        for name, gain in self.gains.items():
            terms.append(gain * u.u if name == "low" else u.u / gain)
        total = sum(terms)
        total += sum(u.a)
        vars(x)["s"] = x.s + 1.0  # its view of the states is a copy
        self.result.update(y=total + x.s, z=[total * v for v in u.a])
        return self.result

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        def pulled(i: Any, s: Any) -> list[Any]:
            sums = [s]
            sums.append(sums[-1] + 0.1 * u.a[i])
            return sums[-1:]

        return fold(3, [x.s], pulled)[0]


def test_a_double_of_numpy_in_single_precision_is_refused_by_the_reference() -> None:
    tenth = np.float64(0.1)
    d = alone(function_block(lambda u: tenth * u))
    assert Reference(d, 0.01).machine().step({"u_in": 3.0}) == {"y_out": 3.0 * 0.1}
    with pytest.raises(DiagramError, match=r"as it was traced.*write float\(\.\.\.\) around numbers of numpy"):
        Reference(d, 0.01, "float32").machine().run(50, {"u_in": np.sin(np.arange(50.0))})


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_what_stays_allowed_is_the_same_on_the_reference_and_compiled(precision: str) -> None:
    d = alone(Allowed())
    inputs = {"u_in": np.linspace(-1.0, 1.0, 20), "a_in": np.sin(np.arange(60.0)).reshape(20, 3)}
    reference = Reference(d, 0.01, precision).machine().run(20, inputs)
    native = build(d, 0.01, precision).machine().run(20, inputs)
    assert all(np.asarray(native[name], rows.dtype).tobytes() == rows.tobytes() for name, rows in reference.items())
    assert len(set(reference["y_out"].tolist())) == 20
