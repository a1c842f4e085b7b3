"""Configurations of every block of the library, and diagrams that hold them all."""

from types import MappingProxyType
from typing import Any

import numpy as np

from twodof.blocks import library
from twodof.blocks.block import REGISTRY, Block
from twodof.blocks.declarations import Port
from twodof.blocks.diagram import Diagram
from twodof.blocks.expressions.numbers import STORED

Config = dict[str, Any]

LIBRARY = MappingProxyType({n: c for n, c in REGISTRY.items() if c.__module__.startswith(library.__name__)})

_RULES = ("forward", "backward", "trapezoidal")
_COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
_MATRIX = [[0.5, -0.25, 0.1], [0.2, 0.3, -0.4], [0.0, 0.6, -0.7]]

_RATES = [{"name": "rates.p", "unit": "rad/s"}, {"name": "rates.q", "kind": "bool", "width": 2}]
_BUS = {"name": "Sample", "fields": [{"name": "n", "kind": "int32"}, *_RATES]}
_LIGHT = {"name": "Light", "members": {"green": 0, "red": 3}}

# What is run besides the defaults.
EXTRA: dict[str, list[Config]] = {
    "abs": [{"width": 3}, {"kind": "int32"}, {"kind": "uint32"}],
    "atan2": [{"width": 2}],
    "backlash": [{"width": 0.3, "initial": 0.5}],
    "bias": [{"bias": 0.3, "width": 3}],
    "bitwise": [
        *({"operation": o} for o in ("or", "xor", "left", "right")),
        {"operation": "right", "kind": "int32", "width": 2},
    ],
    "bus_assign": [{"bus": _BUS, "fields": ["rates", "n"]}],
    "bus_create": [{"bus": _BUS}],
    "bus_select": [{"bus": _BUS, "fields": ["rates.q", "n"]}, {"bus": _BUS, "fields": ["rates"]}],
    "case_choice": [{"cases": [[3, -1], [0, 4], [3, 2**31 - 1]]}, {"cases": [[1], [1]]}],
    "compare": [*({"operation": o} for o in _COMPARISONS), {"kind": "int32"}, {"kind": "uint32", "width": 2}],
    "compare_to_constant": [
        *({"operation": o, "constant": 0.5} for o in _COMPARISONS),
        {"operation": ">=", "constant": 3, "kind": "uint32"},
    ],
    "concatenate": [{"widths": [1, 3, 2], "kind": "int32"}],
    "constant": [{"value": [1.0, 0.1], "width": 2}, {"value": -7, "kind": "int32"}, {"value": True, "kind": "bool"}],
    "convert": [
        *({"source": s, "target": t} for s in ("real", "int32", "uint32", "bool") for t in ("real", "uint32", "bool")),
        *({"rounding": r} for r in ("nearest", "floor", "ceil", "half_even", "half_away")),
        *({"source": s, "target": _LIGHT, "width": 3} for s in ("int32", "uint32", "real")),
        {"width": 3},
        *({"target": t, "overflow": o} for t, o in zip(STORED, ("wrap", "saturate") * 2, strict=True)),
        {"source": "float32", "target": "float64"},
    ],
    "counter": [{"modulus": 5}],
    "dead_zone": [{"low": -0.2, "high": 0.7, "width": 2}],
    "delay": [
        {"samples": 3, "bound": 5, "initial": 0.5},
        {"samples": 2, "width": 3, "initial": [1.0, 2.0, 3.0]},
        {"samples": 4, "kind": "bool", "initial": True},
        {"samples": 2, "bound": 2, "kind": "int32", "width": 2},
    ],
    "demux": [{"outputs": 3, "kind": "uint32"}, {"outputs": 40}],
    "discrete_derivative": [{"gain": 0.5, "width": 2}],
    "discrete_filter": [
        {"numerator": [1.0, 0.5, -0.2], "denominator": [2.0, -0.9]},
        {"numerator": [0.3], "denominator": [1.0, -1.2, 0.5], "initial": [0.1, 0.2]},
    ],
    "discrete_integrator": [
        *({"method": m, "gain": 0.7} for m in _RULES),
        *({"method": m, "limits": [-0.01, 0.02], "reset": True, "initial": 0.01, "width": 2} for m in _RULES),
        *({"reset": e, "initial": "input", "width": 2} for e in ("none", "level", "rising", "falling", "either")),
        {"reset": "falling", "initial": 0.5, "method": "backward"},
    ],
    "discrete_state_space": [
        {"A": _MATRIX, "B": [[1.0], [0.5], [0.1]], "C": [[1.0, 2.0, 3.0]], "D": [[0.5]], "initial": [1.0, 0.0, -1.0]},
        {"A": _MATRIX, "B": _MATRIX, "C": _MATRIX[:2], "D": _MATRIX[1:]},
    ],
    "discrete_transfer_function": [{"numerator": [1.0, 0.5], "denominator": [1.0, -1.2, 0.5, 0.1], "initial": 0.3}],
    "divide": [{"kind": "int32"}, {"kind": "uint32", "width": 2}],
    "dot_product": [{"width": 4}],
    "doublet": [{"start": 0.012, "period": 0.1, "amplitude": 0.03, "bias": 0.01}],
    "dynamic_saturation": [{"width": 2}],
    "edge_detector": [{"edge": "falling"}, {"edge": "either", "initial": True}],
    "elementary": [*({"function": f} for f in ("log", "sqrt", "square", "reciprocal")), {"width": 2}],
    "first_order": [{"gain": 2.0, "time_constant": 0.05, "initial": 0.3}],
    "first_true": [{"conditions": 1}, {"conditions": 5}],
    "flip_flop": [{"dominant": "set", "initial": True}],
    "fractional_delay": [
        {"delay": 0.0093, "samples": 5, "initial": 0.5},
        {"delay": 0.0021, "samples": 5, "direct": False},
        {"delay": 0.012, "samples": 3},
        {"delay": 0.5, "samples": 8},
    ],
    "gain": [{"k": -0.3, "width": 4}],
    "hypot": [{"width": 2}],
    "index": [{"width": 5, "kind": "bool"}],
    "integrator": [{"initial": [0.1, 0.2], "limits": [-0.05, 0.05], "width": 2}],
    "lead_lag": [{"gain": 0.5, "lead": 0.03, "lag": 0.2, "initial": 1.0}],
    "logic": [*({"operation": o, "inputs": 3} for o in ("or", "xor", "nand", "nor")), {"operation": "not", "width": 2}],
    "lookup": [
        {"breakpoints": [-1.0, -0.3, 0.1, 0.9, 2.0], "values": [3.0, 1.0, -2.0, 0.5, 0.7], "outside": o}
        for o in ("clip", "extrapolate")
    ],
    "lookup_2d": [
        {"rows": [-1.0, 0.2, 3.0], "columns": [0.0, 0.5], "values": [[3.0, 1.0], [-2.0, 0.5], [0.7, 9.0]], "outside": o}
        for o in ("clip", "extrapolate")
    ],
    "low_pass": [{"cutoff": 3.0, "method": m, "initial": 0.5} for m in ("forward", "backward", "trapezoidal", "zoh")],
    "low_pass_2": [{"cutoff": 400.0, "initial": 1.0}],
    "matrix_multiply": [
        {"a": [3, 2], "b": [2, 4]},
        {"a": [2], "b": [2]},
        {"a": [2], "b": [2, 3]},
        {"a": [9, 8], "b": [8, 3]},
    ],
    "norm": [{"shape": [2, 3]}],
    "reshape": [{"shape": [2, 3], "to": [3, 2], "kind": "int32"}, {"shape": [2, 2], "to": [4]}],
    "transpose": [{"shape": [3, 2], "kind": "int32"}, {"shape": [9, 8]}],
    "matrix_gain": [{"K": _MATRIX}, {"K": _MATRIX[:1]}, {"K": [[1.0], [2.0]]}],
    "maximum": [{"inputs": 3, "width": 2}, {"kind": "int32"}],
    "merge": [{"kind": _BUS}, {"inputs": 3, "initial": [1.0, 2.0], "width": 2}, {"initial": True, "kind": "bool"}],
    "minimum": [{"inputs": 3, "width": 2}, {"kind": "uint32"}],
    "moving_average": [{"samples": 7, "initial": 0.2}],
    "multiport_switch": [{"kind": _BUS}, {"inputs": 39}, {"inputs": 3, "kind": "int32"}, {"inputs": 4, "width": 2}],
    "multisine": [
        {"harmonics": [1, 3, 7], "amplitudes": [1.0, 0.5, 0.2], "phases": [0.0, 1.0, 2.0], "period": 0.4, "start": 0.02}
    ],
    "mux": [{"inputs": 4, "kind": "bool"}, {"inputs": 40}],
    "noise": [{"deviation": 0.3, "mean": 1.0, "seed": 5, "stream": 7, "width": w} for w in (None, 2, 3, 4)],
    "notch": [{"frequency": 30.0, "width": 0.3, "depth": 0.1, "initial": 0.5}],
    "pid": [
        *({"Kp": 0.1, "Ki": 0.5, "Kd": 0.002, "integral": i, "derivative": d} for i in _RULES for d in _RULES),
        *(
            {"Kp": 0.1, "Ki": 5.0, "Kd": 0.002, "integral": i, "limits": [-0.1, 0.15], "anti_windup": a, "reset": r}
            for i in _RULES
            for a, r in (("clamping", "integral"), ("back-calculation", "all"), ("none", "all"))
        ),
    ],
    "playback": [{"values": [1.0, 2.0, 4.0], "period": 0.01, "start": 0.02, "repeat": r} for r in (True, False)],
    "polynomial": [{"coefficients": [0.1, -2.0, 3.0, 1.0]}],
    "power": [{"width": 2}],
    "prbs": [{"clock": 0.01, "amplitude": 0.5, "order": o, "seed": 77, "start": 0.02} for o in (3, 8, 16)],
    "product": [{"operations": "/*/", "width": 2}],
    "pulse": [{"start": 0.05, "duration": 0.02, "amplitude": 0.1, "period": 0.1}],
    "quantiser": [{"step": 0.3, "width": 2}, {"step": 0.0}],
    "ramp": [{"start": 0.05, "slope": 0.3, "bias": 1.0}],
    "rate_limit": [{"rising": 10.0, "falling": 25.0, "initial": [0.5, 0.1], "width": 2}],
    "rate_transition": [{"initial": 3, "kind": "int32"}, {"width": 2}],
    "relay": [{"on_at": 0.2, "off_at": -0.1, "on_value": 0.3, "off_value": 0.1, "initial": True}],
    "remainder": [{"kind": "int32"}, {"kind": "uint32", "width": 2}],
    "rounding": [{"function": f} for f in ("ceil", "trunc", "nearest")],
    "saturation": [{"low": -0.3, "high": 0.4, "width": 2}, {"low": -3, "high": 40, "kind": "int32"}],
    "second_order": [{"gain": 2.0, "natural_frequency": 20.0, "damping": 0.1, "initial": 0.1, "initial_rate": -1.0}],
    "selector": [{"width": 4, "indices": [3, 0, 0, 2], "kind": "uint32"}],
    "sign": [{"width": 2}, {"kind": "int32"}],
    "sine": [{"frequency": 3.7, "amplitude": 0.3, "phase": 1.0, "bias": 0.1, "start": 0.03}],
    "state_space": [
        {"A": _MATRIX, "B": [[1.0], [0.5], [0.1]], "C": [[1.0, 2.0, 3.0]], "D": [[0.5]], "initial": [1.0, 0.0, -1.0]},
        {"A": _MATRIX, "B": _MATRIX, "C": _MATRIX[:2]},
    ],
    "recursive_least_squares": [{"width": 3, "every": 4, "memory": 0.2, "noise": 0.1, "initial": [1.0, 0.0, -1.0]}],
    "reset_integrator": [{"limits": [-0.01, 0.02], "width": 2}],
    "reset_latch": [
        *({"reset": e, "initial": "input"} for e in ("none", "level", "rising")),
        {"reset": "either", "initial": [1.0, 2.0], "width": 2},
    ],
    "variable_delay": [
        {"bound": 3, "initial": 0.5, "direct": False},
        {"bound": 5, "kind": "uint32", "width": 2, "initial": [1, 2]},
        {"bound": 1, "kind": "bool", "initial": True},
    ],
    "store_read": [{"store": "other", "kind": "int32", "width": 2}],
    "store_write": [{"store": "other", "kind": "int32", "width": 2}],
    "step": [{"start": 0.1, "before": 0.2, "after": 0.3}],
    "sum": [
        {"signs": "+-" * 20},
        {"signs": "-+-", "width": 2},
        {"signs": "+-", "kind": "int32"},
        {"signs": "++", "kind": "uint32"},
    ],
    "sum_of_elements": [{"width": 5}],
    "sweep": [
        *({"start_hz": 0.5, "end_hz": 20.0, "length": 0.6, "law": law} for law in ("linear", "logarithmic")),
        {"start_hz": 2.0, "end_hz": 2.0, "law": "logarithmic", "start": 0.1, "phase": 1.0, "bias": 0.3},
    ],
    "switch": [{"kind": _BUS}, {"kind": "bool"}, {"kind": "int32", "width": 2}],
    "table": [
        {"times": [0.05, 0.1, 0.3, 0.35], "values": [1.0, -1.0, 2.0, 0.5], "method": m} for m in ("hold", "linear")
    ],
    "three_two_one_one": [{"start": 0.02, "step": 0.05, "amplitude": 0.1, "bias": 0.2}],
    "timer": [{"duration": 0.01}],
    "transfer_function": [
        {"numerator": [1.0, 2.0, 3.0], "denominator": [2.0, 1.5, 7.0], "initial": [0.1, -0.2]},
        {"numerator": [358.5], "denominator": [1.0, 0.575, 11.81]},
    ],
    "trigonometry": [*({"function": f} for f in ("cos", "tan", "asin", "acos", "atan", "tanh")), {"width": 2}],
    "uniform_noise": [{"low": -1.0, "seed": 5, "stream": 7, "width": w} for w in (None, 3)],
    "unit_delay": [{"kind": _BUS}, {"initial": True, "kind": "bool"}, {"initial": [1, 2], "kind": "int32", "width": 2}],
    "zero_order_hold": [{"kind": _BUS}, {"kind": "bool"}, {"width": 3}],
}
SAMPLES: dict[str, list[Config]] = {name: [{}, *EXTRA.get(name, [])] for name in LIBRARY}

ROOMS = sorted({c.__module__.rpartition(".")[2] for c in LIBRARY.values()})


def add_store(d: Diagram, block: Block) -> None:
    """The data store that a sample writes."""
    if isinstance(block, library.StoreWrite):
        port = block.inputs[0]
        d.add(block.store, library.DataStore(0, port.kind, port.width))


def under(port: Port) -> str:
    """A port's name without the dots that the fields of buses have."""
    return port.name.replace(".", "_")


def flat_output(d: Diagram, part: str, port: Port) -> str:
    """The source of an output's elements: of a matrix as a vector."""
    if port.shape is None or port.width is None:
        return f"{part}.{port.name}"
    flat = library.Reshape(port.shape, (port.width,), port.kind)
    return d.add(f"{part}_{under(port)}_flat", flat, u=f"{part}.{port.name}")


def shaped_input(d: Diagram, source: str, port: Port) -> str:
    """A source for `port` from one of its elements: of a matrix from a vector."""
    if port.shape is None or port.width is None:
        return source
    name = f"{source}_{port.shape[0]}x{port.shape[1]}"
    if name in d.parts:
        return name
    return d.add(name, library.Reshape((port.width,), port.shape, port.kind), u=source)


def random_inputs(d: Diagram, steps: int, seed: int, strange: bool) -> dict[str, np.ndarray]:
    """Inputs of each type; with `strange`, non-finite, huge and subnormal reals and integers of all sizes."""
    rng = np.random.default_rng(seed)
    special = [0.0, -0.0, np.nan, np.inf, -np.inf, 1e-310, -1e-45, 3e38, 1e300, -4294967296.5, 2147483648.0, 0.5]
    found = {}
    for name, port in d.inputs.items():
        shape = (steps,) if port.width is None else (steps, port.width)
        if port.kind == "bool":
            found[name] = rng.random(shape) < 0.5
        elif port.kind == "real":
            values = rng.standard_normal(shape)
            found[name] = np.where(rng.random(shape) < 0.3, rng.choice(special, shape), values) if strange else values
        else:
            low, high = (-(2**31), 2**31) if port.kind == "int32" else (0, 2**32)
            small = rng.integers(-4 if low else 0, 7, shape)
            found[name] = np.where(rng.random(shape) < 0.5, rng.integers(low, high, shape), small) if strange else small
    return found
