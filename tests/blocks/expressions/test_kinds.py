"""float32, float64 and the integers of 8 and 16 bits: against numpy's scalars, and refusals."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.blocks import (
    Block,
    Diagram,
    Param,
    Port,
    State,
    exp,
    fold,
    maximum,
    minimum,
    pow,
    round_half_away,
    round_half_even,
    sin,
    sqrt,
    to_float32,
    to_float64,
    to_int8,
    to_int16,
    to_int32,
    to_real,
    to_uint8,
    to_uint16,
    vector,
    where,
)
from twodof.blocks.expressions import numbers
from twodof.blocks.expressions.numbers import BY_NAME, STORED
from twodof.blocks.reference import Reference
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow

TO = {"int8": to_int8, "uint8": to_uint8, "int16": to_int16, "uint16": to_uint16}
wholes = st.integers(-(2**31), 2**31 - 1)
any_float = st.floats(width=32)


class Written(Block):
    """One output of a kind, from inputs of kinds."""

    def __init__(self, kind: str, inputs: dict[str, str], of: Any) -> None:
        self.inputs = [Port(name, given) for name, given in inputs.items()]
        self.outputs = [Port("y", kind)]
        self.of = of

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return self.of(u)


def value(kind: str, inputs: dict[str, tuple[str, Any]], of: Any, precision: str = "float64") -> Any:
    """Return the output of one step of the reference."""
    d = Diagram("one")
    block = Written(kind, {name: of_kind for name, (of_kind, _) in inputs.items()}, of)
    for name, (of_kind, _) in inputs.items():
        d.input(f"in_{name}", of_kind)
    d.add("block", block, **{name: f"in_{name}" for name in inputs})
    d.output("y", "block")
    machine = Reference(d, 0.01, precision).machine()
    return machine.step({f"in_{name}": number for name, (_, number) in inputs.items()})["y"]


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_arithmetic_is_that_of_numpys_scalars_in_every_build(kind: str, precision: str) -> None:
    scalar = np.dtype(kind).type
    rng = np.random.default_rng(1)
    for a, b in rng.normal(size=(20, 2)) * 10.0 ** rng.integers(-15, 15, (20, 1)):
        first, second = scalar(a), scalar(b)
        inputs = {"a": (kind, float(a)), "b": (kind, float(b))}
        expected = (first + second * scalar(0.1)) / (first * first + scalar(1)) - np.sqrt(abs(second))
        got = value(kind, inputs, lambda u: (u.a + u.b * 0.1) / (u.a * u.a + 1) - sqrt(abs(u.b)), precision)
        assert got == expected


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("kind", ["float32", "float64"])
def test_elementary_functions_have_the_definition_of_their_kind(kind: str, precision: str) -> None:
    """As a real of a build of that precision has it."""
    for x in (0.3, -2.7, 11.25):
        alone = value("real", {"x": ("real", x)}, lambda u: exp(sin(u.x)) + pow(abs(u.x), 0.1), kind)
        assert value(kind, {"x": (kind, x)}, lambda u: exp(sin(u.x)) + pow(abs(u.x), 0.1), precision) == alone


@given(any_float, st.sampled_from(STORED), st.sampled_from(["real", "float32", "float64"]))
def test_a_float_is_truncated_to_int32_and_then_saturates_or_wraps(x: float, kind: str, source: str) -> None:
    limits = np.iinfo(kind)
    whole = 0 if np.isnan(x) else int(np.clip(x, -(2**31), 2**31 - 1))
    with numbers.precision("float64"):
        given = np.float32(x) if source == "float32" else np.float64(x)
        assert TO[kind](given, overflow="saturate").value == np.clip(whole, limits.min, limits.max)
        assert TO[kind](given, overflow="wrap").value == np.int64(whole).astype(kind)


@given(wholes, st.sampled_from(STORED), st.sampled_from(["int32", "uint32", *STORED]))
def test_an_integer_saturates_or_keeps_its_low_bits(x: int, kind: str, source: str) -> None:
    limits, given = np.iinfo(kind), int(np.int64(x).astype(source))
    number = numbers.INTEGER_TYPES[source](given)
    assert TO[kind](number, overflow="saturate").value == np.clip(given, limits.min, limits.max)
    assert TO[kind](number, overflow="wrap").value == np.int64(given).astype(kind)


@given(st.data(), st.sampled_from(STORED), st.sampled_from(STORED))
def test_what_is_stored_computes_as_int32(data: Any, one: str, other: str) -> None:
    a, b = (data.draw(st.integers(BY_NAME[k].low, BY_NAME[k].high)) for k in (one, other))
    first, second = numbers.INTEGER_TYPES[one](a), numbers.INTEGER_TYPES[other](b)
    assert (first * second + first - 7).value == int(np.int32(np.int64(a) * b + a - 7))
    assert (~first).value == ~a
    assert (-first).kind == (first << 3).kind == (first + 1).kind == "int32"
    assert bool(first < second) == (a < b)


def test_the_smaller_of_two_that_are_stored_is_stored_and_a_mixture_is_an_int32() -> None:
    both = {"a": ("int8", -5), "b": ("int8", 3)}
    assert value("int8", both, lambda u: minimum(u.a, u.b)) == -5
    assert value("int8", both, lambda u: maximum(where(u.a < u.b, u.b, u.a), -7)) == 3
    mixed = {"a": ("int8", -5), "b": ("uint16", 60000)}
    assert value("int32", mixed, lambda u: maximum(u.a, u.b)) == 60000
    assert value("int32", mixed, lambda u: vector([u.a, u.b])[1] + fold(3, [u.a], lambda i, s: [s + u.b])[0]) == 239995


def test_rounding_to_the_nearest_is_exact() -> None:
    """Round exactly where floor(x + 0.5) does not: just below one half, and at large odd numbers."""
    odd = 2.0**52 + 1.0
    for x, even, away in ((0.49999999999999994, 0.0, 0.0), (odd, odd, odd), (-2.5, -2.0, -3.0)):
        with numbers.precision("float64"):
            assert (round_half_even(x), round_half_away(x)) == (even, away)


def test_a_conversion_rounds_once() -> None:
    """0.1 is the literal that the user wrote, of the kind that it meets."""
    assert value("float64", {"a": ("float32", 0.0)}, lambda u: to_float64(u.a + 0.1)) == float(np.float32(0.1))
    assert value("float64", {"a": ("float64", 0.0)}, lambda u: u.a + 0.1, "float32") == 0.1
    assert value("float32", {"a": ("float64", 1 + 2**-24)}, lambda u: to_float32(u.a)) == 1.0
    assert value("float32", {"a": ("int32", 2**24 + 1)}, lambda u: to_float32(u.a)) == 2.0**24


REFUSED: dict[str, tuple[dict[str, str], str, Any, str]] = {
    "two floats": (
        {"a": "float32", "b": "float64"},
        "float32",
        lambda u: u.a + u.b,
        r"float64 meets float32.*to_float32\(x\), or",
    ),
    "real and float64": (
        {"a": "real", "b": "float64"},
        "real",
        lambda u: u.a * u.b,
        r"float64 meets real.*to_real\(x\), or to_float64",
    ),
    "chosen": ({"a": "real", "b": "float32"}, "real", lambda u: where(u.a < 0.0, u.a, u.b), r"float32 meets real"),
    "a call": ({"a": "float32", "b": "float64"}, "float32", lambda u: pow(u.a, u.b), r"float64 meets float32"),
    "uint8 and uint32": ({"a": "uint8", "b": "uint32"}, "uint32", lambda u: u.a + u.b, r"uint32 meets int32"),
    "an unsaid overflow": ({"a": "int32"}, "int8", lambda u: to_int8(u.a), r"int32 may not fit int8.*saturate.*wrap"),
    "an unknown overflow": ({"a": "int32"}, "int8", lambda u: to_int8(u.a, overflow="clip"), r"clip.*wrap, saturate"),
    "a large literal": ({"a": "uint8"}, "uint8", lambda u: where(u.a < 3, u.a, 256), r"256.*uint8.*0 to 255"),
    "a sum in an int8": ({"a": "int8"}, "int8", lambda u: u.a + 1, r"given a int32.*to_int8\(x, overflow"),
    "a number of numpy": ({"a": "float32"}, "float32", lambda u: u.a * np.float64(0.1), r"0\.1.*meets float32"),
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_what_does_not_go_together_is_an_error_with_block_line_and_remedy(mistake: str) -> None:
    inputs, kind, of, said = REFUSED[mistake]
    with pytest.raises(DiagramError, match=r"Written\.output") as raised:
        _ = Written(kind, inputs, of).trace
    assert __file__ in str(raised.value)
    with pytest.raises(DiagramError, match=said):
        _ = Written(kind, inputs, of).trace


def test_a_declared_value_has_its_kind_and_a_continuous_state_is_real() -> None:
    with pytest.raises(DiagramError, match=r"300 does not fit uint8.*0 to 255"):
        Param("k", 300, "uint8")
    with pytest.raises(DiagramError, match="a continuous state cannot be float64"):
        State("x", 0.0, "float64", continuous=True)
    with numbers.precision("float64"):
        assert to_int32(to_real(to_uint8(255))).value == 255
