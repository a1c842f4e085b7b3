"""Blocks and programs take numpy's arrays and scalars like lists and numbers."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.blocks.library.harness import alone
from tests.blocks.library.samples import LIBRARY, SAMPLES
from twodof.blocks import Block, Diagram, Param, Port, State
from twodof.blocks.library import (
    Concatenate,
    Constant,
    Delay,
    Gain,
    Lookup,
    MatrixGain,
    MultisineSource,
    Selector,
    StateSpace,
    Table,
)
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import build
from twodof.errors import DiagramError, ExperimentError, ParameterError
from twodof.excitation import Steps

pytestmark = pytest.mark.slow


def ragged(rows: Any) -> bool:
    """Return True if the rows differ in length: numpy has no array of them."""
    return len({len(row) if isinstance(row, (list, tuple)) else 0 for row in rows}) > 1


def arrays(value: Any) -> Any:
    """A list as an array, a number as a scalar of numpy."""
    if isinstance(value, (list, tuple)):
        return [arrays(v) for v in value] if ragged(value) else np.array(value)
    if isinstance(value, (bool, int, float)):
        return {bool: np.bool_, int: np.int64, float: np.float64}[type(value)](value)
    return value


def views(value: Any) -> Any:
    """A list as an array with gaps and backwards in memory, a number as an array of no dimension."""
    if isinstance(value, (list, tuple)):
        if ragged(value):
            return [views(v) for v in value]
        made = np.array(value)
        return np.repeat(made[::-1], 3, axis=0)[::-3]
    return np.array(value) if isinstance(value, (bool, int, float)) else value


@pytest.mark.parametrize("given", [arrays, views])
@pytest.mark.parametrize("type_name", LIBRARY)
def test_every_block_made_with_numpy_has_the_json_of_the_one_made_with_lists(
    type_name: str, given: Callable[[Any], Any]
) -> None:
    for config in SAMPLES[type_name]:
        plain, numpy = (LIBRARY[type_name](**c) for c in (config, {k: given(v) for k, v in config.items()}))
        assert to_json(alone(numpy)) == to_json(alone(plain))
        assert repr([*numpy.params, *numpy.states, *numpy.inputs]) == repr(
            [*plain.params, *plain.states, *plain.inputs]
        )


@pytest.mark.parametrize("type_name", LIBRARY)
def test_what_is_no_number_is_refused_with_the_block_and_the_argument(type_name: str) -> None:
    made = LIBRARY[type_name]()
    for argument, value in getattr(made, "config", {}).items():
        if isinstance(value, (str, type(None))):
            continue
        for wrong in (1j, np.complex64(1j), np.array([1.0], dtype=object), np.array([1j]), [[1j]]):
            with pytest.raises(DiagramError) as caught:
                LIBRARY[type_name](**{argument: wrong})
            assert caught.value.where == f"{type(made).__name__}.{argument}"


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Selector(3, 5), "Selector: indices=5 is not a list (give a list of integers within 0 .. 2)"),
        (lambda: Concatenate(2), "Concatenate: widths=2 is not a list (give a list of integers within 1 .. 1000000)"),
        (
            lambda: MultisineSource(3),
            "MultisineSource: harmonics=3 is not a list (give a list of integers within 1 .. 10000)",
        ),
        (
            lambda: StateSpace(np.eye(2), np.ones(2)),
            "StateSpace: B[0]=1.0 is not valid (give a list of 1 or more numbers)",
        ),
        (lambda: MatrixGain([[1.0, np.inf]]), "MatrixGain: K[0][1] = inf is not finite (give finite numbers)"),
        (lambda: Table([0.0, 1.0], [0.0, np.nan]), "Table: values[1] = nan is not finite (give finite numbers)"),
        (lambda: Lookup([0.0, np.inf], [0.0, 1.0]), "Lookup: breakpoints[1] = inf is not finite (give finite numbers)"),
        (lambda: Delay(2.5), "Delay: bound=2.5 is not valid (give an integer within 1 .. 100000)"),
        (
            lambda: Gain(gain=2.0),
            "Gain: it got an unexpected keyword argument 'gain' (its arguments: k, width, gain_unit, input_unit, unit)",
        ),
        (lambda: Gain(np.ones(2)), "Gain.k: it takes real, not [1.0, 1.0] of type list (convert it, as in to_real(x))"),
    ],
)
def test_an_argument_that_does_not_fit_is_refused_in_words(make: Callable[[], Block], text: str) -> None:
    with pytest.raises(DiagramError) as caught:
        make()
    assert str(caught.value) == text


def test_a_block_keeps_what_was_given_when_the_array_changes_later() -> None:
    K = np.eye(2)
    first, second = MatrixGain(K), Constant(K[0], width=2)
    K[:] = 7.0
    assert first.config == {"K": [[1.0, 0.0], [0.0, 1.0]], "unit": ""}
    assert (first.params[0].value, second.params[0].value) == ([1.0, 0.0, 0.0, 1.0], [1.0, 0.0])


class Scaled(Block):
    """A user's block, declared with numpy."""

    crossing = True

    inputs = (Port("u", width=np.int64(2)),)
    outputs = (Port("y", width=2),)
    params = (Param("k", np.array([2.0, 4.0]), width=np.int8(2), low=np.float32(0)),)
    states = (State("x", np.array([0, 1]), width=2),)

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return [p.k[i] * u.u[i] + x.x[i] for i in range(2)]

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.u


class Doubled(Gain):
    """A user's block made from one of the library."""

    def of(self, p: Any, u: Any) -> Any:
        return 2.0 * p.k * u


def diagram() -> Diagram:
    d = Diagram("d")
    d.input("u", width=np.int64(2))
    d.param("g", np.array([1, 3]), width=np.int32(2), high=np.float32(8))
    d.add(
        "scaled",
        Scaled(),
        u="u",
        params={"k": "g"},
        rate=np.array([2, 0]),
        position=np.array([1, 2.5], dtype=np.float32),
    )
    d.output("y", "scaled")
    return d


@pytest.mark.parametrize("make", [Reference, build])
def test_a_program_takes_numpy_where_it_takes_numbers(make: Any) -> None:
    d = from_json(to_json(diagram()))
    assert to_json(d) == to_json(diagram())
    one, two = (make(d, dt).machine() for dt in (np.float32(0.5), 0.5))
    for machine, of in ((one, lambda v: np.array(v, dtype=np.float32)[::-1]), (two, lambda v: v[::-1])):
        machine.set("g", of([0.5, 4]))
        machine.set_state("scaled.x", of([3, 2]))
    rows = np.array([[1.0, 9.0, 2.0], [3.0, 9.0, 4.0]])[:, ::2]
    assert one.run(np.int64(2), {"u": rows})["y"].tolist() == two.run(2, {"u": rows.tolist()})["y"].tolist()
    assert one.step({"u": np.array([1, 2], dtype=np.int8)}) == two.step({"u": [1, 2]})
    for value in (1j, np.array([1j, 2.0]), np.array([None, 2.0])):
        with pytest.raises(ParameterError, match="g: "):
            one.set("g", value)
        with pytest.raises(DiagramError, match=r"^scaled\.x: "):
            one.set_state("scaled.x", value)
        with pytest.raises(DiagramError, match="u: "):
            one.run(3, {"u": value})
    with pytest.raises(DiagramError, match="u: its rows differ in length"):
        one.run(2, {"u": [[1.0], [2.0, 3.0]]})


def test_a_rate_and_a_position_are_pairs_of_numbers() -> None:
    d = diagram()
    assert d.parts["scaled"].rate == (2, 0)
    assert d.parts["scaled"].position == (1.0, 2.5)
    for argument, wrong in (("rate", 4), ("rate", (4, 0, 0)), ("position", (1.0, "x")), ("position", np.ones(3))):
        with pytest.raises(DiagramError, match=rf"^d\.late: {argument}=.* \(give {argument}=\(number, number\)\)"):
            d.add("late", Gain(), **{argument: wrong})
    with pytest.raises(DiagramError, match=r"^d\.late: rate \(4\.0, 0\) is impossible"):
        d.add("late", Gain(), rate=(4.0, 0))


def test_a_block_made_from_one_of_the_library_travels_as_its_own() -> None:
    d = alone(Doubled(np.float32(3)))
    for made in (d, from_json(to_json(d))):
        assert Reference(made, 0.1).machine().step({"u_in": 1.0})["y_out"] == 6.0


def test_an_integer_of_numpy_in_a_method_is_refused_with_the_remedy() -> None:
    class Shifted(Block):
        inputs = (Port("u", "int32"),)
        outputs = (Port("y", "int32"),)

        def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
            return u.u + np.int64(2)

    with pytest.raises(DiagramError, match=r"int64 is not a number of the language \(write int\(\.\.\.\) around it\)"):
        Reference(alone(Shifted()), 0.1)


def test_lists_within_lists_without_end_are_refused() -> None:
    endless: list[Any] = [1.0]
    endless.append(endless)
    for make in (lambda: Gain(endless), lambda: Param("k", endless), lambda: Steps(endless, 1.0)):
        with pytest.raises((DiagramError, ExperimentError), match="lists are nested more than 8 deep"):
            make()
