"""A large diagram: from source to loaded machine code in bounded time."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from twodof.blocks import Diagram
from twodof.blocks.library import DiscreteIntegrator, Gain, LowPass, Product, Saturation, Sum, Trigonometry, UnitDelay
from twodof.compile import Program, build


def chain(blocks: int) -> Diagram:
    """`blocks` blocks of several types, each of which drives the next, with feedback through delays."""
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


def test_900_blocks_are_emitted_compiled_and_cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path))
    d = chain(900)
    start = time.perf_counter()
    program = build(d, 0.001)
    first = time.perf_counter() - start
    start = time.perf_counter()
    build(d, 0.001)
    second = time.perf_counter() - start
    assert isinstance(program, Program)
    assert len(program.machine().run(100, {"r": 1.0})["y"]) == 100
    # The aim is 3 s and 0.5 s on an idle machine; the bounds leave room for a loaded one.
    assert first < 30.0, f"{first:.2f} s"
    assert second < 10.0, f"{second:.2f} s"
