"""Blocks of more ports than there are letters."""

import numpy as np
import pytest

from twodof.blocks import Block, Diagram
from twodof.blocks.library import (
    Concatenate,
    Demux,
    Logic,
    Maximum,
    Minimum,
    MultiportSwitch,
    Mux,
    Product,
    Sum,
)
from twodof.blocks.reference.interpreter import Reference
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.blocks.trace import MAX_PORTS
from twodof.compile import build
from twodof.errors import DiagramError

N = 40
STEPS = 5
BLOCKS: dict[str, Block] = {
    "sum": Sum("+-" * (N // 2)),
    "product": Product("*/" * (N // 2)),
    "least": Minimum(N),
    "most": Maximum(N),
    "odd": Logic("xor", N),
    "chosen": MultiportSwitch(N - 1),
    "joined": Mux(N),
    "chain": Concatenate((2, 1) * (N // 2)),
    "split": Demux(N),
}


def diagram() -> Diagram:
    """The blocks side by side, each series of their ports fed by inputs of the diagram; `split` is fed by `joined`."""
    d = Diagram("wide")
    for name, block in BLOCKS.items():
        d.add(name, block)
        for place, port in enumerate(block.inputs):
            source = "joined"
            if name != "split":
                source = "index" if port.name == "index" else f"{port.kind}{port.width or ''}_{place}"
                if source not in d.inputs:
                    d.input(source, port.kind, port.width)
            d.connect(source, f"{name}.{port.name}")
        if name != "split":
            d.output(f"y_{name}", name)
    d.output("first", "split.a")
    d.output("last", f"split.u{N}")
    return d


def test_forty_ports_compute_what_numpy_does_on_the_reference_and_compiled_and_travel_as_json() -> None:
    rng = np.random.default_rng(3)
    real, flags = rng.normal(size=(STEPS, N)), rng.random((STEPS, N)) < 0.5
    index, pairs = np.array([-3, 0, 26, 38, 99]), rng.normal(size=(STEPS, N, 2))
    inputs = {f"real_{i}": real[:, i] for i in range(N)} | {f"bool_{i}": flags[:, i] for i in range(N)}
    inputs |= {"index": index} | {f"real2_{i}": pairs[:, i] for i in range(0, N, 2)}
    inputs |= {f"real1_{i}": pairs[:, i, :1] for i in range(1, N, 2)}
    d = from_json(to_json(diagram()))
    expected = {
        "least": real.min(axis=1),
        "most": real.max(axis=1),
        "odd": flags.sum(axis=1) % 2 == 1,
        "chosen": real[np.arange(STEPS), 1 + np.clip(index, 0, N - 2)],
        "joined": real,
        "chain": np.concatenate([pairs[:, i, : 2 - i % 2] for i in range(N)], axis=1),
    }
    for machine in (Reference(d, 0.01).machine(), build(d, 0.01).machine()):
        found = machine.run(STEPS, inputs)
        assert {name: found[f"y_{name}"].tolist() for name in expected} == {k: v.tolist() for k, v in expected.items()}
        total, quotient = np.zeros(STEPS), np.ones(STEPS)
        for i in range(N):
            total, quotient = total + (-1) ** i * real[:, i], quotient * real[:, i] ** (-1) ** i
        assert found["first"].tolist() == real[:, 0].tolist()
        assert found["last"].tolist() == real[:, -1].tolist()
        assert found["y_sum"].tolist() == total.tolist()
        np.testing.assert_allclose(found["y_product"], quotient, rtol=1e-13)


def test_a_port_after_z_is_named_by_its_number_and_those_before_keep_their_letters() -> None:
    names = [port.name for port in Mux(MAX_PORTS).inputs]
    assert names[:26] == list("abcdefghijklmnopqrstuvwxyz")
    assert names[26:28] == ["u27", "u28"]
    assert names[-1] == f"u{MAX_PORTS}"
    assert [port.name for port in Demux(28).outputs][25:] == ["z", "u27", "u28"]
    with pytest.raises(
        DiagramError, match=rf"number of ports=1001 is not valid \(give an integer within 1 .. {MAX_PORTS}\)"
    ):
        Sum("+" * 1001)
