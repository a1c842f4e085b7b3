"""A module's controller on a flight controller's processor: it fits the stack that its CMakeLists.txt promises."""

from pathlib import Path

import pytest

from tests.compile.differential import random_cases
from tests.compile.px4.build import C_FLAGS, PX4_FLAGS, run
from tests.compile.px4.host import controller_files
from tests.compile.px4.modules import pitch
from tests.compile.test_large import chain
from twodof.blocks import Diagram
from twodof.blocks import library as lib
from twodof.compile.px4.controller import EXACT
from twodof.compile.px4.export import make_module
from twodof.errors import DiagramError
from twodof.flight.starters import STARTERS, starter

pytestmark = pytest.mark.slow

# PX4's board fmu-v6x (STM32H7), whose build also has -Wframe-larger-than=STACK_MAX of the module.
BOARD = ["-Os", "-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"]


def compile_for_the_board(diagram: Diagram, folder: Path) -> str:
    """Return the undefined symbols after a build without a warning."""
    made, path = controller_files(diagram, [], folder)
    frame = f"-Wframe-larger-than={made.stack}"
    flags = [*C_FLAGS, *PX4_FLAGS.split(), *BOARD, *EXACT, frame, f"-I{folder}"]
    run(["arm-none-eabi-gcc", *flags, "-c", str(path), "-o", str(folder / "c.o")])
    return run(["arm-none-eabi-nm", "-u", str(folder / "c.o")])


@pytest.mark.parametrize("name", STARTERS)
def test_a_starter_fits_its_stack_and_needs_no_library(name: str, tmp_path: Path) -> None:
    assert set(compile_for_the_board(starter(name), tmp_path).split()) <= {"U", "memcpy", "memset"}


@pytest.mark.parametrize("seed", [800, *(pytest.param(n, marks=pytest.mark.soak) for n in range(801, 812))])
def test_a_random_diagram_fits_its_stack(seed: int, tmp_path: Path) -> None:
    compile_for_the_board(random_cases([seed], 1)[0].diagram, tmp_path)


@pytest.mark.long
def test_a_large_diagram_fits_its_stack(tmp_path: Path) -> None:
    compile_for_the_board(chain(190), tmp_path)


def test_arrays_that_do_not_fit_are_refused() -> None:
    d = pitch()
    d.add("wide", lib.Constant(1.0, width=200))
    d.add("twice", lib.Gain(2.0, width=200), u="wide")
    d.add("more", lib.Gain(2.0, width=200), u="twice")
    d.add("zero", lib.Constant(0, "int32"))
    d.add("first", lib.Index(200), u="more", index="zero")
    d.output("first", "first")
    with pytest.raises(DiagramError, match="PX4's work queue has room for 1400"):
        make_module(d)
