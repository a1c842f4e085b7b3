"""Every block of the library: JSON, both precisions, the same bits interpreted and compiled, wrong arguments."""

from dataclasses import replace

import pytest

from tests.blocks.library.samples import EXTRA, LIBRARY, ROOMS, SAMPLES
from tests.compile.differential import KINDS, emitted, reference_run, same
from tests.compile.whole_library import library_cases
from tests.toolchains import need
from twodof.blocks import library
from twodof.blocks.block import Block, check_steady
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.blocks.trace import MAX_PORTS
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow


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


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", ROOMS)
def test_compiled_blocks_give_the_same_bits(name: str, precision: str) -> None:
    """As `make thorough` does on all targets, at length."""
    need("gcc")
    cases = [case for extra in (False, True) for case in library_cases([name], 60, extra)]
    expected = [reference_run(case, precision, "rk4") for case in cases]
    assert KINDS["gcc-O0"].differences(cases, expected, emitted(cases, precision, "rk4")) == []


@pytest.mark.parametrize("name", ROOMS)
def test_json_keeps_every_block(name: str) -> None:
    for case in [case for extra in (False, True) for case in library_cases([name], 10, extra)]:
        text = to_json(case.diagram)
        again = from_json(text)
        assert to_json(again) == text
        signals = [reference_run(replace(case, diagram=d), "float64", "rk4").signals for d in (case.diagram, again)]
        assert all(same(column, signals[1][path]).all() for path, column in signals[0].items())


def test_a_port_after_z_is_named_by_its_number() -> None:
    names = [port.name for port in library.Mux(MAX_PORTS).inputs]
    assert names[:28] == [*"abcdefghijklmnopqrstuvwxyz", "u27", "u28"]
    assert names[-1] == f"u{MAX_PORTS}"
    with pytest.raises(DiagramError, match=rf"ports=1001 is not valid \(give an integer within 1 .. {MAX_PORTS}\)"):
        library.Sum("+" * 1001)


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
