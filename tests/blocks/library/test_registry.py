"""Every block of the library: JSON, both precisions, the same bits interpreted and compiled, wrong arguments."""

import numpy as np
import pytest

from tests.blocks.library.samples import EXTRA, LIBRARY, ROOMS, SAMPLES, random_inputs, room
from twodof.blocks import library
from twodof.blocks.block import Block, check_steady
from twodof.blocks.diagram import Diagram
from twodof.blocks.reference.interpreter import Reference, ReferenceMachine
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import build
from twodof.compile.machine import CompiledMachine
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow

DT = 0.004


def test_the_library_exports_what_it_registers() -> None:
    exported = {c for c in vars(library).values() if isinstance(c, type) and issubclass(c, Block)}
    assert {c for c in exported if c.type_name} == set(LIBRARY.values())
    assert set(EXTRA) <= set(LIBRARY)


@pytest.mark.parametrize("type_name", LIBRARY)
def test_every_block_has_defaults_and_a_docstring(type_name: str) -> None:
    cls = LIBRARY[type_name]
    assert cls.__doc__
    for config in SAMPLES[type_name]:
        block = cls(**config)
        assert isinstance(block.trace.outputs, dict)
        check_steady(block)  # a user's block is checked at each build, those of the library here
        assert len(block.outputs) >= 1


def feed(
    machine: CompiledMachine | ReferenceMachine, d_inputs: dict[str, np.ndarray], steps: int
) -> dict[str, np.ndarray]:
    return {name: np.asarray(rows) for name, rows in machine.run(steps, d_inputs).items()}


def different(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> list[str]:
    """The signals that differ in a bit; every NaN is the same, -0.0 is not 0.0."""
    names = []
    for name, a in first.items():
        b = second[name]
        if a.dtype.kind == "f":
            same = (a == b) & (np.signbit(a) == np.signbit(b)) | (np.isnan(a) & np.isnan(b))
        else:
            same = a == b
        if a.shape != b.shape or not np.all(same):
            names.append(name)
    return names


def tunable_reals(blocks: dict[str, Block]) -> dict[str, float]:
    """Scalar real parameters by path, each a quarter larger where that is allowed."""
    return {
        f"{part}.{p.name}": 1.25 * p.value
        for part, block in blocks.items()
        for p in block.params
        if p.kind == "real" and p.width is None and p.low <= 1.25 * p.value <= p.high
    }


@pytest.mark.parametrize(
    ("precision", "rate", "steps"),
    [
        ("float64", (1, 0), 45),
        ("float32", (3, 1), 60),
        *(pytest.param(p, r, 120, marks=pytest.mark.soak) for p in ("float32", "float64") for r in ((1, 0), (3, 1))),
    ],
)
@pytest.mark.parametrize("name", [n for n in ROOMS if n != "continuous"])
def test_compiled_blocks_give_the_same_bits(name: str, precision: str, rate: tuple[int, int], steps: int) -> None:
    compare(room(name, rate), precision, steps)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("steps", [45, pytest.param(120, marks=pytest.mark.soak)])
def test_compiled_continuous_blocks_give_the_same_bits(precision: str, steps: int) -> None:
    compare(room("continuous"), precision, steps)


def compare(d: Diagram, precision: str, most: int) -> None:
    """The reference and the compiled program agree in every output and state. They run `most` steps of ordinary inputs,
    a few with other parameters, and a few of strange inputs.
    """
    blocks = {part: p.item for part, p in d.parts.items() if isinstance(p.item, Block)}
    program = build(d, DT, precision)
    assert not isinstance(program, Reference), "there is no compiler to compare with"
    machines = (Reference(d, DT, precision).machine(), program.machine())
    for seed, strange, steps in ((1, False, most), (2, False, 10), (3, True, 15)):
        with np.errstate(over="ignore"):  # 1e300 is infinite in float32
            inputs = {
                name: values.astype(precision) if values.dtype.kind == "f" else values
                for name, values in random_inputs(d, steps, seed, strange).items()
            }
        rows = [feed(machine, inputs, steps) for machine in machines]
        assert different(*rows) == []
        for machine in machines:
            machine.set_many(tunable_reals(blocks))
    for part, block in blocks.items():
        for state in block.states:
            path = f"{part}.{state.name}"
            ends = [{path: np.asarray(machine.state(path))} for machine in machines]
            assert different(*ends) == []


@pytest.mark.parametrize("name", ROOMS)
def test_json_keeps_every_block(name: str) -> None:
    d = room(name)
    text = to_json(d)
    again = from_json(text)
    assert to_json(again) == text
    inputs = random_inputs(d, 10, 4, False)
    rows = [feed(Reference(x, DT).machine(), inputs, 10) for x in (d, again)]
    assert different(*rows) == []


WRONG: list[tuple[type[Block], dict[str, object]]] = [
    (library.TransferFunction, {"numerator": [1.0, 0.0, 0.0], "denominator": [1.0, 1.0]}),
    (library.TransferFunction, {"denominator": [0.0, 1.0]}),
    (library.TransferFunction, {"denominator": [1.0]}),
    (library.StateSpace, {"A": [[0.0, 1.0]], "B": [[1.0]]}),
    (library.Integrator, {"limits": [1.0]}),
    (library.Pid, {"integral": "tustin"}),
    (library.Pid, {"anti_windup": "clamping"}),
    (library.Pid, {"reset": "state"}),
    (library.Delay, {"samples": 0}),
    (library.Delay, {"samples": 5, "bound": 3}),
    (library.Delay, {"samples": 2.0}),
    (library.DiscreteIntegrator, {"limits": [1.0, -1.0]}),
    (library.DiscreteFilter, {"denominator": [0.0, 1.0]}),
    (library.DiscreteTransferFunction, {"numerator": [1.0, 2.0, 3.0], "denominator": [1.0, 2.0]}),
    (library.DiscreteStateSpace, {"A": [[1.0, 2.0]]}),
    (library.DiscreteStateSpace, {"A": [[1.0]], "B": [[1.0]], "C": [[1.0, 2.0]]}),
    (library.MovingAverage, {"samples": 1}),
    (library.Sum, {"signs": "+x"}),
    (library.Sum, {"signs": ""}),
    (library.Product, {"operations": "*-"}),
    (library.MatrixGain, {"K": [[1.0, 2.0], [3.0]]}),
    (library.MatrixGain, {"K": []}),
    (library.Sign, {"kind": "uint32"}),
    (library.Convert, {"target": "float"}),
    (library.Selector, {"width": 3, "indices": [3]}),
    (library.Mux, {"inputs": 0}),
    (library.SumOfElements, {"width": 1}),
    (library.MatrixMultiply, {"a": [2, 3], "b": [2, 3]}),
    (library.Transpose, {"shape": [2, 0]}),
    (library.Norm, {"shape": 3}),
    (library.Reshape, {"shape": [2, 3], "to": [5]}),
    (library.Compare, {"operation": "=<"}),
    (library.Bitwise, {"kind": "real"}),
    (library.Saturation, {"kind": "bool"}),
    (library.Lookup, {"breakpoints": [0.0, 0.0], "values": [1.0, 2.0]}),
    (library.Lookup, {"breakpoints": [0.0, 1.0], "values": [1.0]}),
    (library.Lookup2D, {"rows": [0.0, 1.0, 2.0], "values": [[1.0, 2.0], [3.0, 4.0]]}),
    (library.Table, {"times": [0.0, "a"], "values": [1.0, 2.0]}),
    (library.PrbsSource, {"order": 17}),
    (library.MultisineSource, {"harmonics": [1, 2], "amplitudes": [1.0], "phases": [0.0]}),
    (library.Noise, {"width": 5}),
    (library.Noise, {"seed": -1}),
]


@pytest.mark.parametrize(("cls", "arguments"), WRONG)
def test_wrong_arguments_are_refused_with_a_remedy(cls: type[Block], arguments: dict[str, object]) -> None:
    with pytest.raises(DiagramError, match=cls.__name__) as caught:
        cls(**arguments)
    assert caught.value.remedy


CHOICE_WORDS = [
    (cls, argument)
    for cls in LIBRARY.values()
    for argument, value in getattr(cls(), "config", {}).items()
    if isinstance(value, str) and value and not argument.endswith("unit") and argument not in ("store", "kind")
]


@pytest.mark.parametrize(("cls", "argument"), CHOICE_WORDS)
def test_an_unknown_word_is_refused_with_the_choices(cls: type[Block], argument: str) -> None:
    with pytest.raises(DiagramError, match=cls.__name__) as caught:
        cls(**{argument: "?"})
    assert caught.value.remedy
