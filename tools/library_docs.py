"""Writes docs/reference/blocks.md from the docstrings of the library's blocks: `python tools/library_docs.py`.

A test compares the page with what this gives.
"""

import inspect
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path

from twodof.blocks import library
from twodof.blocks.block import REGISTRY, Block
from twodof.blocks.declarations import Param, Port
from twodof.blocks.library.functions import function_block

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "blocks.md"
ROOMS = ("sources", "waveforms", "playback", "math", "functions", "nonlinear", "logic", "routing", "delays")
MORE_ROOMS = ("discrete", "filters", "control", "estimation", "continuous")

INTRODUCTION = """# The library of blocks

Made by `tools/library_docs.py` from the docstrings; do not edit.
[The block language](../explanation/language.md) says how blocks are written and run.

All blocks are imported from `twodof.blocks.library`. The arguments in parentheses are those of the constructor, and
what a diagram's JSON keeps beside the type's name; the tables show a block made with the defaults. Ports and parameters
are real scalars unless it is said otherwise; `width` n makes a block work on arrays of n, element by element; `kind` is
one of real, int32, uint32 and bool, an enumeration, or, where values are only passed on, a bus; `unit` "" is compared
with nothing. All parameters may be changed while the diagram runs; a state starts from the parameter `initial` where
there is one. T is the block's own period [s], [k] its k-th sample. A series of ports has the names a, b, ..., z and
then u27, u28, ... by number; a block has at most 1,000 inputs. Numpy's arrays and numbers are taken wherever lists and
numbers are; tables and matrices are finite.
"""


def render() -> str:
    """The page's text."""
    lines = [INTRODUCTION]
    for name in (*ROOMS, *MORE_ROOMS):
        module = import_module(f"{library.__name__}.{name}")
        lines += [f"## {name.capitalize()}", "", _text(module.__doc__), ""]
        for cls in REGISTRY.values():
            if cls.__module__ == module.__name__:
                lines += _block(cls)
    lines += ["## Custom", "", "A block from a Python function.", "", "### function_block", ""]
    lines += ["```text", f"function_block{_signature(function_block)}", "", _text(function_block.__doc__), "```"]
    return "\n".join(lines) + "\n"


def _block(cls: type[Block]) -> Iterator[str]:
    block = cls()
    yield f"### {cls.__name__}"
    yield ""
    yield from ("```text", f"{cls.__name__}{_signature(cls)}", "", _text(cls.__doc__), "```", "")
    crossing = "; may read another rate" if cls.crossing else ""
    yield f"Type `{cls.type_name}`. In: {_ports(block.inputs)}. Out: {_ports(block.outputs)}{crossing}."
    yield ""
    if block.params:
        yield "| parameter | default | unit | bounds | |"
        yield "|---|---|---|---|---|"
        for p in block.params:
            yield f"| `{p.name}` | {_value(p)} | {p.unit} | {_bounds(p)} | {_kind(p)}{p.text} |"
        yield ""


def _signature(call: Callable[..., object]) -> str:
    """The arguments with their defaults, without annotations."""
    arguments = [p.replace(annotation=p.empty) for p in inspect.signature(call).parameters.values()]
    return f"({', '.join(map(str, arguments))})"


def _text(doc: str | None) -> str:
    return inspect.cleandoc(doc or "")


def _ports(ports: Sequence[Port]) -> str:
    return ", ".join(f"`{p.name}`" + _shape(p.kind, p.width, p.shape) for p in ports) or "none"


def _shape(kind: str, width: int | None, shape: tuple[int, int] | None = None) -> str:
    size = "" if width is None else f"[{shape[0]}x{shape[1]}]" if shape else f"[{width}]"
    return f" ({kind}{size})" if kind != "real" or size else ""


def _kind(p: Param) -> str:
    return f"{_shape(p.kind, p.width).strip()} " if _shape(p.kind, p.width) else ""


def _value(p: Param) -> str:
    return f"{p.value:.6g}" if isinstance(p.value, float) else str(p.value)


def _bounds(p: Param) -> str:
    low = "" if p.low == -float("inf") else f">= {p.low:g}"
    high = "" if p.high == float("inf") else f"<= {p.high:g}"
    return ", ".join(part for part in (low, high) if part)


if __name__ == "__main__":
    PAGE.write_text(render(), encoding="utf-8")
    sys.stdout.write(f"{PAGE} written\n")
