"""Protocols of a target: machine code from emitted C, and instances with memory and calls."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from twodof.compile.c.functions import Mark
from twodof.compile.program.flat_program import FlatProgram
from twodof.compile.program.layout import MemoryLayout

LONG = 6000
"""Lines of C from which on -O3 would take seconds, and soon minutes: its time grows with the square of the lines."""


@dataclass(frozen=True)
class EmittedProgram:
    """A program's C, and the flattened diagram from which it was made.

    `source` may contain other programs too; `marks` has the block of each of its lines. `cost` estimates the work of a
    compiler that optimises it: the sum, over all statements, of the squared number of local values that a later
    statement still reads.
    """

    flat: FlatProgram
    source: str
    layout: MemoryLayout
    precision: str
    marks: Sequence[Mark] = ()
    cost: int = 0

    @property
    def name(self) -> str:
        """Prefix of the program's names in C."""
        return self.flat.name

    @property
    def optimise(self) -> str:
        """Option by which the compiler of this computer optimises the C."""
        return "-O3" if len(self.marks) < LONG else "-O1"

    @cached_property
    def dtypes(self) -> dict[str, np.dtype[Any]]:
        """Numpy types of the structs "P", "S", "U" and "Y", the same on all targets."""
        return self.layout.dtypes(self.precision)

    @cached_property
    def sizes(self) -> list[int]:
        """Sizes [bytes] of real, P, S, U and Y."""
        return [np.dtype(self.precision).itemsize, *(self.dtypes[k].itemsize for k in "PSUY")]

    @cached_property
    def places(self) -> dict[str, dict[str, tuple[int, int]]]:
        """(offset, size) [bytes] of each struct's members, by struct and name in C; a continuous state is `x.name`."""
        found: dict[str, dict[str, tuple[int, int]]] = {}
        for struct, whole in self.dtypes.items():
            members = found[struct] = {}
            empty = not getattr(self.layout, struct.lower()).members  # its only field is a byte that is no member
            fields: Mapping[str, Any] = {} if empty else whole.fields or {}
            for name, (dtype, offset, *_) in fields.items():
                inner: Mapping[str, Any] = dtype.fields or {}
                members |= {f"{name}.{n}": (offset + at, item.itemsize) for n, (item, at, *_) in inner.items()}
                if not inner:
                    members[name] = offset, dtype.itemsize
        return found


def layout_checks(programs: Sequence[EmittedProgram]) -> str:
    """Return C that refuses to compile if a struct of `programs` differs from its numpy type."""
    lines = []
    for program in programs:
        for kind, size in zip("PSUY", program.sizes[1:], strict=True):
            struct = f"{program.name}_{kind}"
            lines.append(f'_Static_assert(sizeof({struct}) == {size}, "size of {struct}");')
            for member, (offset, width) in program.places[kind].items():
                place = f"offsetof({struct}, {member}) == {offset} && sizeof((({struct} *)0)->{member}) == {width}"
                lines.append(f'_Static_assert({place}, "place of {member}");')
    return "\n" + "\n".join(lines) + "\n"


class TargetInstance(Protocol):
    """One running program: its structs, and calls that work on them.

    A target with memory elsewhere (an emulator) carries the structs there and back in each call: a caller may write
    into the arrays between two calls, and after a call they hold its results. A call that fails raises
    ControllerFault.
    """

    @property
    def structs(self) -> Mapping[str, NDArray[Any]]:
        """The structs "P", "S", "U" and "Y": always the same arrays, of one element of `EmittedProgram.dtypes`."""

    def defaults(self) -> None:
        """Write the defaults of the given parameters into P."""

    def prepare(self) -> None:
        """Write the derived parameters into P."""

    def init(self) -> None:
        """Write the initial states into S."""

    def step(self) -> None:
        """Run one tick: read P and U, advance S, write Y."""

    def run(self, steps: int, u: NDArray[Any], y: NDArray[Any]) -> None:
        """Run `steps` ticks on P and S, with the inputs `u` into the outputs `y`, contiguous arrays of their structs.

        Each has `steps` elements, or one that is read (or written) at each tick. `u` may be `structs["U"]`;
        otherwise U and Y stay as they are.
        """


class Backend(Protocol):
    """A compiled program on its target."""

    def instance(self) -> TargetInstance:
        """Return a fresh instance with zeroed memory of its own."""


class Target(Protocol):
    """A kind of machine code, with its compiler's options."""

    @property
    def name(self) -> str:
        """Name of the target, as in `build(..., target=name)`."""

    def compile(self, programs: Sequence[EmittedProgram]) -> Sequence[Backend]:
        """Compile `programs`, which share one source, and return their backends.

        Raises CompileError if the tool chain is missing, with the package to install, or refuses the source.
        """
