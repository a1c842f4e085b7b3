"""What emitted C needs where there is no C library: four functions on memory, and a check of the structs' layout."""

from collections.abc import Sequence
from importlib import resources

from twodof.compile.target import EmittedProgram

_TEMPLATES = resources.files(__package__).joinpath("templates")
FILES = {"string.h": _TEMPLATES.joinpath("string.h").read_text(encoding="utf-8")}
"""For `toolchain.compiled(..., files=FILES)` with the option `-I.`."""
MEMORY = "\n" + _TEMPLATES.joinpath("memory.c").read_text(encoding="utf-8")
"""C to append to a source that is linked without a C library."""


def layout_checks(programs: Sequence[EmittedProgram]) -> str:
    """C to append to the source of `programs`, which does not compile if a struct is not where numpy expects it."""
    lines = []
    for program in programs:
        for kind, size in zip("PSUY", program.sizes[1:], strict=True):
            struct = f"{program.name}_{kind}"
            lines.append(f'_Static_assert(sizeof({struct}) == {size}, "size of {struct}");')
            for member, (offset, width) in program.places[kind].items():
                place = f"offsetof({struct}, {member}) == {offset} && sizeof((({struct} *)0)->{member}) == {width}"
                lines.append(f'_Static_assert({place}, "place of {member}");')
    return "\n" + "\n".join(lines) + "\n"
