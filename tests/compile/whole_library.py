"""Every block of the library with inputs that break things: rooms of blocks side by side, and what is fed to them."""

import math
import random
from collections.abc import Sequence
from typing import Any

from tests.blocks.library.samples import LIBRARY, SAMPLES, add_store, flat_output, shaped_input, under
from tests.compile.differential import Case
from twodof.blocks import Diagram
from twodof.blocks.library import Integrator

CALM = 0.1  # of all steps: no input is NaN, infinite or huge, as these stay in a state for ever
PATTERN = 0.025  # of all steps: each kind thereafter
BENIGN = (0.0, -0.0, 5e-324, -1e-310, 1e-45, 1e-38, -1e-20)
SPECIAL = (*BENIGN, math.nan, math.inf, -math.inf, 3e38, -1e300, 1.7e308, 2147483648.0, -4294967296.5, 0.5, 1.0)
WORDS = (0, 1, -1, 2, 31, 32, -(2**31), 2**31 - 1)


def library_cases(rooms: Sequence[str], steps: int, extra: bool) -> list[Case]:
    """The rooms, of blocks with their default arguments or (`extra`) with others, as cases of `steps` steps."""
    diagrams = [room(name, extra) for name in rooms]
    return [Case(d, [], strange_inputs(d, steps, k), {}) for k, d in enumerate(diagrams)]


def room(name: str, extra: bool) -> Diagram:
    """A module's blocks side by side; an output with an edge inside the step is integrated."""
    d = Diagram(f"{name}_extra" if extra else name)
    for type_name, cls in LIBRARY.items():
        if cls.__module__.rpartition(".")[2] != name:
            continue
        for number, config in enumerate(SAMPLES[type_name]):
            if bool(number) != extra:
                continue
            block, part = cls(**config), f"{type_name}_{number}"
            d.add(part, block)
            for position, port in enumerate(block.inputs):
                source = f"{port.kind}{port.width or ''}_{position}"
                if source not in d.inputs:
                    d.input(source, port.kind, port.width)
                d.connect(shaped_input(d, source, port), f"{part}.{port.name}")
            for port in block.outputs:
                d.output(f"{part}_{under(port)}", flat_output(d, part, port))
                if port.name in block.trace.edges:
                    d.add(f"{part}_{under(port)}_sum", Integrator(), u=f"{part}.{port.name}")
            add_store(d, block)
    return d


def strange_inputs(d: Diagram, steps: int, seed: int) -> list[dict[str, Any]]:
    """Rows of inputs: calm at first (subnormals and signed zeros among normal numbers), then stretches of all kinds."""
    rng = random.Random(seed)
    calm, pattern = int(CALM * steps), max(1, int(PATTERN * steps))
    rows = []
    for k in range(steps):
        wild = 0.0 if k < calm else (0.02, 0.5, 0.0)[(k - calm) // pattern % 3]
        row: dict[str, Any] = {}
        for name, port in d.inputs.items():
            if rng.random() < 0.5:
                continue  # keeps its value
            values = [_value(rng, port.kind, wild) for _ in range(port.width or 1)]
            row[name] = values if port.width else values[0]
        rows.append(row)
    return rows


def _value(rng: random.Random, kind: str, wild: float) -> Any:
    if kind == "bool":
        return rng.random() < 0.5
    if kind == "real":
        if rng.random() < wild:
            return rng.choice(SPECIAL)
        return rng.choice(BENIGN) if rng.random() < 0.05 else rng.gauss(0.0, 1.0)
    low = -(2**31) if kind == "int32" else 0
    if rng.random() < 0.3:
        return (rng.choice(WORDS) - low) % 2**32 + low
    return rng.randrange(low, low + 2**32) if rng.random() < wild else rng.randrange(7)
