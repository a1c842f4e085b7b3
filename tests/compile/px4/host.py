"""A module's controller on this machine: its C file, built with PX4's flags, fed with rows of words."""

import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.compile.px4.build import C_FLAGS, DEADLINE, PX4_FLAGS, run
from twodof.blocks import Diagram
from twodof.compile.px4.controller import (
    EXACT,
    ControllerCode,
    MessageField,
    MessageFields,
    controller,
    fields,
    header,
    source,
)
from twodof.compile.px4.names import module_names
from twodof.compile.px4.parameters import exported

DTYPES = {"real": np.float32, "int32": np.int32, "uint32": np.uint32, "bool": np.uint32}

_MAIN = """#include "{n}.h"
#include <stdio.h>

int main(void)
{{
    static {n}_Controller c;
    {n}_Inputs in;
    {n}_Outputs out;
    uint32_t in_words[{n}_INPUT_WORDS + 1], out_words[{n}_OUTPUT_WORDS + 1];
    {n}_begin(&c);
    while (fread(in_words, 4, {n}_INPUT_WORDS, stdin) == {n}_INPUT_WORDS) {{
        {n}_unpack(in_words, &in);
        {n}_tick(&c, &in, &out);
        {n}_pack(&out, out_words);
        if (fwrite(out_words, 4, {n}_OUTPUT_WORDS, stdout) != {n}_OUTPUT_WORDS)
            return 1;
    }}
    return 0;
}}
"""


def controller_files(diagram: Diagram, log: Sequence[str], folder: Path) -> tuple[ControllerCode, Path]:
    """A diagram's controller, written as the C and H files that a module has; the diagram may have any ports."""
    names = module_names(diagram.name)
    made = controller(diagram, names, log)
    rows, _ = exported(made.program, names, True)
    found = fields(made.program, len(diagram.outputs))
    (folder / f"{names.module}.h").write_text(header(names, found, rows, made))
    (folder / f"{names.module}.c").write_text(source(names, found, rows, made))
    return made, folder / f"{names.module}.c"


def build_controller(
    diagram: Diagram,
    log: Sequence[str],
    folder: Path,
    more: Sequence[str] = EXACT,
    edit: Callable[[Path], None] | None = None,
) -> tuple[Path, MessageFields]:
    """A program that maps rows of input words to rows of output words, and what the words are.

    It is built with PX4's flags and `more`; `edit` may change the C file before.
    """
    made, path = controller_files(diagram, log, folder)
    found, n = fields(made.program, len(diagram.outputs)), path.stem
    if edit:
        edit(path)
    (folder / "main.c").write_text(_MAIN.format(n=n))
    flags = ["gcc", *C_FLAGS, "-O2", *PX4_FLAGS.split(), *more, f"-I{folder}"]
    run([*flags, "-c", str(path), "-o", str(folder / f"{n}.o")])
    run(["gcc", f"-I{folder}", str(folder / "main.c"), str(folder / f"{n}.o"), "-o", str(folder / n)])
    return folder / n, found


def replay(program: Path, found: MessageFields, columns: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The outputs, by path, that the program gives for columns of inputs by path."""
    steps = len(next(iter(columns.values())))
    words = np.hstack([to_words(f, columns[f.path]).reshape(steps, -1) for f in found.inputs])
    done = subprocess.run([program], input=words.tobytes(), capture_output=True, timeout=DEADLINE, check=True)
    return from_words(found.outputs, np.frombuffer(done.stdout, np.uint32).reshape(steps, -1))


def to_words(field: MessageField, column: NDArray[Any]) -> NDArray[np.uint32]:
    """A column of values as 32-bit words."""
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(np.asarray(column).astype(DTYPES[field.kind])).view(np.uint32)


def from_words(members: Sequence[MessageField], words: NDArray[np.uint32]) -> dict[str, NDArray[Any]]:
    """Rows of words as columns of values by path."""
    found, at = {}, 0
    for f in members:
        part = np.ascontiguousarray(words[:, at : at + f.words]).view(DTYPES[f.kind])
        part = part != 0 if f.kind == "bool" else part
        found[f.path] = part[:, 0] if f.width is None else part
        at += f.words
    return found
