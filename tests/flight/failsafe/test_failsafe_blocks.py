"""Thresholds, limits, gate and reasons: at and beside every threshold what is meant, and every mutant is seen."""

import functools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.flight.failsafe.block_meanings import MEANINGS, Meaning
from tests.flight.failsafe.expr_arrays import graph_of, mutants, mutants_on_arrays, on_arrays
from tests.flight.failsafe.unrolled import unrolled

pytestmark = pytest.mark.slow

CASES, FIRST = 6_000, 500
COMPILED_CASES = 4_000
DERIVED = {
    "per_tick": ("descent", 0.1, 1.0 / 25.0),
    "per_band": ("band", 7.8125, 7.8125 * 0.004),
    "per_answer": ("answer", 0.016, 0.25),
    "per_dt": ("", 0.0, 250.0),
}
"""Derived parameter -> the one that it is made of, what that is set to, and what is made of it."""
IDS = [type(meaning.block).__name__ for meaning in MEANINGS]


def cases(meaning: Meaning, count: int = CASES) -> dict[str, NDArray[Any]]:
    """Cases drawn from the values of each input, state and parameter; states are called `last_NAME`."""
    rng = np.random.default_rng(1)
    return {name: np.array(values)[rng.integers(len(values), size=count)] for name, values in meaning.values.items()}


@functools.cache
def table(index: int) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """The cases of a row of MEANINGS, and what is expected in them."""
    drawn = cases(MEANINGS[index])
    return drawn, expected(MEANINGS[index], drawn)


def columns_of(meaning: Meaning, drawn: dict[str, NDArray[Any]]) -> dict[tuple[str, str], NDArray[Any]]:
    """The same by kind of leaf and name, as the expressions have them."""
    states = {s.name for s in meaning.block.states}
    parameters = {p.name for p in (*meaning.block.params, *meaning.block.derived)}
    return {
        ("state", name.removeprefix("last_"))
        if name.startswith("last_") and name.removeprefix("last_") in states
        else ("param" if name in parameters else "input", name): column
        for name, column in drawn.items()
    }


def expected(meaning: Meaning, drawn: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    rows = zip(*(column.tolist() for column in drawn.values()), strict=True)
    results = [meaning.meant(dict(zip(drawn, row, strict=True))) for row in rows]
    return {name: np.array([result[name] for result in results]) for name in results[0]}


def differing(out: dict[str, NDArray[Any]], wanted: dict[str, NDArray[Any]]) -> list[str]:
    """The names in `out` whose values differ somewhere; 0 and -0 are the same, NaN is NaN."""
    return [name for name in out if not np.array_equal(out[name], wanted[name], equal_nan=out[name].dtype.kind == "f")]


@pytest.mark.parametrize("meaning", MEANINGS, ids=IDS)
def test_a_block_does_what_is_meant_at_and_beside_every_threshold(meaning: Meaning) -> None:
    drawn, wanted = table(MEANINGS.index(meaning))
    out = on_arrays(graph_of(meaning.block), columns_of(meaning, drawn))
    assert set(out) == set(wanted)
    assert differing(out, wanted) == []
    for name, values in wanted.items():
        assert len(np.unique(values)) > 1 or name == "output.user_given", f"{name} is always the same: more cases"


@pytest.mark.parametrize("meaning", MEANINGS, ids=IDS)
def test_the_compiled_block_does_the_same(meaning: Meaning) -> None:
    drawn = cases(meaning, COMPILED_CASES)
    block = meaning.block
    machine = unrolled(block)
    settable = {p.name for p in block.params} & set(drawn)
    for name in settable - {"watch_bits"}:
        machine.set(f"block.{name}", float(drawn[name][0]))
    for name, (parameter, value, made) in DERIVED.items():
        if name in drawn:
            machine.set_many({f"block.{parameter}": value} if parameter else {})
            drawn[name] = np.full(COMPILED_CASES, made)
    if "watch_bits" in drawn:
        drawn["watch_bits"] = np.full(COMPILED_CASES, True)
    inputs = {
        ("before_" + name.removeprefix("last_") if name.startswith("last_") else name): column
        for name, column in drawn.items()
        if name not in settable and name not in DERIVED
    }
    out = machine.run(COMPILED_CASES, inputs)
    named = {
        f"update.{name.removeprefix('after_')}" if name.startswith("after_") else f"output.{name}": column
        for name, column in out.items()
    }
    wanted = expected(meaning, drawn)
    assert set(named) == set(wanted)
    assert differing(named, wanted) == []


@pytest.mark.parametrize("meaning", MEANINGS, ids=IDS)
def test_no_mutant_of_a_block_survives_but_those_explained(meaning: Meaning) -> None:
    drawn, wanted = table(MEANINGS.index(meaning))
    columns, graph = columns_of(meaning, drawn), graph_of(meaning.block)
    assert differing(on_arrays(graph, columns), wanted) == []
    left = list(mutants(graph))
    for count in (FIRST, CASES):  # nearly all of them are seen in the first cases
        some, meant = ({name: column[:count] for name, column in table.items()} for table in (columns, wanted))
        seen = {what for what, out in mutants_on_arrays(graph, left, some) if differing(out, meant)}
        left = [(what, mutant) for what, mutant in left if what not in seen]
    assert {what.partition(" ")[2] for what, _ in left} == set(meaning.equivalent)
