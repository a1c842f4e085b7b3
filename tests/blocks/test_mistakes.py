"""A mistake in a block's Python is one error: block and method, line, and remedy."""

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.blocks.library.harness import alone
from tests.blocks.mine import WellMeant, line_of, mine
from twodof.blocks import fold, matrix, minimum
from twodof.blocks.block import Block
from twodof.blocks.declarations import Port
from twodof.blocks.diagram import Diagram
from twodof.blocks.library.functions import function_block
from twodof.blocks.reference.interpreter import Reference
from twodof.compile.program.lower import lower
from twodof.errors import DiagramError

Written = Callable[..., Any]


def forgetful(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    _ = u.u * p.k


def indirect(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    value = u.u * p.k
    return helped(value)


def helped(value: Any) -> Any:
    doubled = 2.0 * value
    return np.sin(doubled)  # here


def at_the_end(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    gains = {"low": 1.0}
    return (
        u.u * gains["high"]  # here
    )


RECORDED: dict[str, tuple[Written, str]] = {
    "a ufunc of numpy": (lambda self, u, x, p, t: np.sin(u.u), "function of numpy.*functions of twodof.blocks"),
    "np.where": (lambda self, u, x, p, t: np.where(u.u > 0.0, 1.0, 2.0), r"np\.where.*where"),
    "np.dot": (lambda self, u, x, p, t: np.dot(u.a, u.a), r"np\.dot.*fold"),
    "np.array": (lambda self, u, x, p, t: np.array([u.u, 1.0])[0], r"array of numpy.*vector"),
    "math.sin": (lambda self, u, x, p, t: math.sin(u.u), r"math\.\*.*twodof\.blocks"),
    "math.floor": (lambda self, u, x, p, t: math.floor(u.u), r"math\.floor.*use floor"),
    "round": (lambda self, u, x, p, t: round(u.u, 2), r"round\(\).*floor\(x \+ 0\.5\)"),
    "divmod": (lambda self, u, x, p, t: divmod(2.0, u.u)[0], r"divmod\(\).*a // b"),
    "a format": (lambda self, u, x, p, t: f"{u.u:.3f}", "recorded values.*format string"),
    "a method of arrays": (lambda self, u, x, p, t: u.a.sum(), "recorded values.*'sum'"),
    "no clock value": (lambda self, u, x, p, t: t.t, "no clock value named 't'.*dt, base_dt, tick"),
    "no input": (lambda self, u, x, p, t: u.nope.x, "no input named 'nope'.*u, a, n"),
    "an element assigned": (lambda self, u, x, p, t: u.a.__setitem__(0, 1.0), r"assigned.*store\(a, i, value\)"),
    "an element deleted": (lambda self, u, x, p, t: u.a.__delitem__(0), "deleted.*fixed length"),
    "an index of text": (lambda self, u, x, p, t: u.a["x"], "indexed with str"),
    "a matrix": (lambda self, u, x, p, t: np.linalg.norm(matrix([[u.u, 1.0]])), r"np\.linalg\.norm.*@ for products"),
    "a bare body of fold": (lambda self, u, x, p, t: fold(3, [0.0], lambda i, s: s)[0], "iterated over"),
    "nothing returned": (forgetful, "output returns nothing.*return"),
    "text": (lambda self, u, x, p, t: "u.u", "str is not a number"),
    "an array for a number": (lambda self, u, x, p, t: u.a, r"'y' is given a real\[3\]"),
    "an unknown name": (lambda self, u, x, p, t: {"z": u.u}, "gives 'z', which is not declared.*y"),
    "a name too few": (lambda self, u, x, p, t: {}, "does not give 'y'"),
    "too few arguments": (lambda self, u: u.u, r"cannot be called.*write def output\(self, u, x, p, t\)"),
    "a key that is not there": (at_the_end, r"its code raises KeyError: 'high'.*correct this line"),
    "endless recursion": (lambda self, u, x, p, t: self.output(u, x, p, t), "RecursionError"),
}


def refused(block: Block) -> list[str]:
    """The errors, as the user sees them, of the reference and of the compiler."""
    d = Diagram("rig")
    inner = alone(block)
    d.add("part", inner, **{name: d.input(name, p.kind, p.width) for name, p in inner.inputs.items()})
    for name in inner.outputs:
        d.output(name, f"part.{name}")
    found = []
    for make in (lambda: Reference(d, 0.01), lambda: lower(d, 0.01, log=["part.block.y"])):
        with pytest.raises(DiagramError) as caught:
            make()
        found.append(str(caught.value))
    return found


def assert_told(text: str, path: str, method: str, line: str, words: str) -> None:
    """The error names path, block, method and line, and then says `words`."""
    where, _, told = text.partition(": ")
    assert where == f"{path}block Mine.{method}, {line}", text
    assert re.search(words, told), text


@pytest.mark.parametrize("case", RECORDED)
def test_a_mistake_in_output_names_block_method_line_and_remedy(case: str) -> None:
    written, words = RECORDED[case]
    for text in refused(mine("output", written)()):
        assert_told(text, "part.block, ", "output", line_of(written), words)


def test_a_mistake_in_a_function_that_a_method_calls_is_named_there() -> None:
    for text in refused(mine("output", indirect)()):
        assert_told(text, "part.block, ", "output", line_of(helped), "function of numpy")


# Whatever the method, a mistake in its code, a forgotten return and a bare value for no name are the same errors.
METHODS: dict[str, tuple[Written, Written]] = {
    "prepare": (lambda self, p, t: p.k * t.tick, lambda self, p, t: None),
    "output": (lambda self, u, x, p, t: np.sin(u.u), lambda self, u, x, p, t: None),
    "update": (lambda self, u, x, p, t: {"s": np.sin(u.u)}, lambda self, u, x, p, t: None),
    "derivative": (lambda self, u, x, p, t: {"c": np.sin(u.u)}, lambda self, u, x, p, t: None),
    "project": (lambda self, u, x, p, t: {"c": np.sin(u.u)}, lambda self, u, x, p, t: None),
    "edges": (lambda self, u, x, p, t: {"y": np.sin(u.u)}, lambda self, u, x, p, t: None),
}


@pytest.mark.parametrize("method", METHODS)
def test_mistakes_in_every_method_are_told(method: str) -> None:
    wrong, forgotten = METHODS[method]
    words = "no clock value named 'tick'" if method == "prepare" else "function of numpy"
    for text in refused(mine(method, wrong)()):
        assert_told(text, "part.block, ", method, line_of(wrong), words)
    for text in refused(mine(method, forgotten)()):
        assert_told(text, "part.block, ", method, line_of(forgotten), f"{method} returns (nothing|None)")
    few = lambda self: {}  # noqa: E731
    arguments = "self, p, t" if method == "prepare" else "self, u, x, p, t"
    for text in refused(mine(method, few)()):
        assert_told(text, "part.block, ", method, line_of(few), rf"write def {method}\({arguments}\)")


@pytest.mark.parametrize(("method", "name"), [("output", "y"), ("derivative", "c"), ("prepare", "g")])
def test_a_method_that_is_missing_is_told_how_to_write(method: str, name: str) -> None:
    for text in refused(mine(method, getattr(Block, method))()):
        assert text.startswith(f"part.block, block Mine.{method}: {method} does not give {name!r} (write def {method}(")


EDGES: dict[str, tuple[Written, str]] = {
    "one value": (lambda self, u, x, p, t: {"y": u.u}, r"one recorded value for 'y'.*\(fraction, value after\)"),
    "three values": (lambda self, u, x, p, t: {"y": (0.5, u.u, u.u)}, r"for 'y'.*\(fraction, value after\)"),
    "no mapping": (lambda self, u, x, p, t: (0.5, u.u), "return a dict"),
    "an unknown output": (lambda self, u, x, p, t: {"z": (0.5, u.u)}, "'z', which is not a scalar output"),
    "a fraction of integers": (lambda self, u, x, p, t: {"y": (u.n, u.u)}, "int32 meets real"),
}


@pytest.mark.parametrize("case", EDGES)
def test_what_edges_returns_is_checked(case: str) -> None:
    written, words = EDGES[case]
    for text in refused(mine("edges", written)()):
        assert_told(text, "part.block, ", "edges", line_of(written), words)


def unready(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    if type(u.u) is np.float64:
        return {1.0: u.u}[u.u]  # here
    return u.u


def mixed(self: Any, u: Any, x: Any, p: Any, t: Any) -> Any:
    if type(u.u) is np.float64:
        return minimum(u.n + 0.5, u.u)  # here
    return u.u


@pytest.mark.parametrize(
    ("written", "words"), [(unready, r"KeyError: (np\.float64\()?0\.0"), (mixed, "int32 meets float.*convert")]
)
def test_a_mistake_that_only_numbers_meet_is_told_by_the_reference(written: Written, words: str) -> None:
    machine = Reference(alone(mine("output", written)()), 0.01).machine()
    with pytest.raises(DiagramError) as caught:
        machine.step()
    assert_told(str(caught.value), "block, ", "output", line_of(written), words)


def test_a_function_block_names_the_function_and_its_line() -> None:
    def Mine(u: Any) -> Any:
        return np.sqrt(u)  # here

    for made in (function_block(Mine), function_block(Mine, outputs=[Port("y", width=2)])):
        for text in refused(made):
            assert_told(text, "part.block, ", "output", line_of(Mine), "function of numpy")


DECLARED: dict[str, tuple[dict[str, Any], str]] = {
    "names instead of ports": ({"inputs": ["u"]}, r'inputs holds \'u\'.*write inputs = \[Port\("name"\), ...\]'),
    "no list": ({"inputs": Port("u")}, "inputs is Port.*, not a list"),
    "a dictionary": ({"params": {"k": 1.0}}, r"params is {'k': 1.0}.*Param\(\"name\"\)"),
    "names instead of states": ({"states": ["s"]}, "states holds 's'.*State"),
}


@pytest.mark.parametrize("case", DECLARED)
def test_what_is_declared_comes_as_lists_of_declarations(case: str) -> None:
    declared, words = DECLARED[case]
    block = mine("update", lambda self, u, x, p, t: {}, **declared)()
    with pytest.raises(DiagramError, match=f"^rig.part: {words}"):
        Diagram("rig").add("part", block)
    with pytest.raises(DiagramError, match=f"^Mine: {words}"):
        _ = block.trace


def test_what_is_no_block_is_not_a_part() -> None:
    for what, words in ((WellMeant, "call the class"), (lambda u: u, "see function_block")):
        with pytest.raises(DiagramError, match=f"rig.part: .* is not a block or a diagram .{words}"):
            Diagram("rig").add("part", what)  # type: ignore[arg-type]
    with pytest.raises(DiagramError, match="function_block: 3 is not a function"):
        function_block(3)  # type: ignore[arg-type]
