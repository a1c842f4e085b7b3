"""A large diagram: from source to loaded machine code in bounded time."""

import gc
import resource
from pathlib import Path

import pytest

from twodof.blocks import Diagram
from twodof.blocks.library import DiscreteIntegrator, Gain, LowPass, Product, Saturation, Sum, Trigonometry, UnitDelay
from twodof.compile import CompiledProgram, build

pytestmark = pytest.mark.slow


def chain(blocks: int) -> Diagram:
    """Make a chain of `blocks` blocks of several types, with feedback through delays."""
    d = Diagram("chain")
    d.input("r")
    last, older = "r", "r"
    for k in range(blocks):
        name = f"b{k}"
        match k % 9:
            case 0:
                d.add(name, Sum("+-"))
                d.connect(last, f"{name}.{d.parts[name].item.inputs[0].name}")
                d.connect(older, f"{name}.{d.parts[name].item.inputs[1].name}")
            case 1:
                d.add(name, Gain(0.5 + 0.001 * k), u=last)
            case 2:
                d.add(name, Saturation(), u=last)
            case 3:
                d.add(name, LowPass(20.0), u=last)
            case 4:
                d.add(name, Product("**"))
                for port in d.parts[name].item.inputs:
                    d.connect(last, f"{name}.{port.name}")
            case 5:
                d.add(name, Trigonometry("sin"), u=last)
            case 6:
                d.add(name, UnitDelay(), u=last)
                older = name
            case 7:
                d.add(name, DiscreteIntegrator(), u=last)
            case _:
                d.add(name, Gain(-0.3), u=last)
        last = name
    d.output("y", last)
    return d


def processor_time() -> float:
    """Seconds that this process and the compilers it has run have computed; others add little to it."""
    return sum(
        used.ru_utime + used.ru_stime
        for used in (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def build_s(d: Diagram, target: str) -> float:
    """Processor time in which a diagram becomes a program [s]."""
    start = processor_time()
    build(d, 0.001, target=target)
    return processor_time() - start


@pytest.mark.long
@pytest.mark.parametrize(
    ("target", "blocks"), [("native", 300), ("wasm", 1200), pytest.param("native", 900, marks=pytest.mark.soak)]
)
def test_many_blocks_are_emitted_compiled_and_cached(
    target: str, blocks: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path))
    d, third = chain(blocks), chain(blocks // 3)
    first = build_s(d, target)
    program = build(d, 0.001, target=target)
    build(third, 0.001, target=target)
    assert isinstance(program, CompiledProgram)
    assert len(program.machine().run(100, {"r": 1.0})["y"]) == 100
    assert first < 6.0, f"{first:.2f} s"  # the aim is 3 s; a core that others load is half as fast
    # In turn, so that a slow moment of the machine meets both; without the garbage collector, whose full rounds cost by
    # what earlier tests left in the process, and fall into the longer build.
    gc.collect()
    gc.disable()
    try:
        pairs = [(build_s(d, target), build_s(third, target)) for _ in range(5)]
    finally:
        gc.enable()
    again, least = map(min, zip(*pairs, strict=True))
    # 3 times is linear, 9 times quadratic. Beyond 300 blocks the C is split, which costs 10 % once: 400 beside 1,200.
    assert again < 5.0 * least, f"{again:.2f} s, a third of the blocks {least:.2f} s"
