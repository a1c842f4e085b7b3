"""Cost of a program on the Cortex-M7: bytes of flash and RAM, depth of the stack, instructions of a step."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from typing import Any, cast

import numpy as np
from elftools.elf.constants import SH_FLAGS
from elftools.elf.elffile import ELFFile
from numpy.typing import NDArray

from twodof.compile.cortex_m7.image import Image
from twodof.compile.cortex_m7.processor import CortexM7Backend, CortexM7Instance, Processor
from twodof.compile.machine import CompiledProgram
from twodof.errors import CompileError

CALL = 10  # R_ARM_THM_CALL

Place = tuple[int, int]  # object file, section: each function and each constant has a section of its own


class ObjectFile:
    """Sections and symbols of an object file, and the symbols that each section refers to, by index."""

    def __init__(self, data: bytes) -> None:
        self.sections: list[Any] = list(ELFFile(BytesIO(data)).iter_sections())
        self.symbols: list[Any] = []
        self.refers: dict[int, set[int]] = {}
        self.calls: dict[int, set[int]] = {}
        for section in self.sections:
            if section["sh_type"] == "SHT_SYMTAB":
                self.symbols += section.iter_symbols()
            if section["sh_type"] == "SHT_REL":
                for relocation in section.iter_relocations():
                    symbol, place = relocation["r_info_sym"], section["sh_info"]
                    self.refers.setdefault(place, set()).add(symbol)
                    if relocation["r_info_type"] == CALL:
                        self.calls.setdefault(place, set()).add(symbol)

    def section_of(self, symbol: int) -> int | None:
        """Return the section that has a symbol, None for a symbol of another file or of no section."""
        index = self.symbols[symbol]["st_shndx"]
        return index if isinstance(index, int) else None


def _loaded(section: Any) -> bool:
    """Return True if a section takes memory of the target."""
    return bool(section["sh_flags"] & SH_FLAGS.SHF_ALLOC) and section["sh_size"] > 0


def _use(section: Any) -> str:
    """Return the memory of a section: "text", "rodata", "data" (in flash and RAM) or "bss" (in RAM)."""
    if section["sh_type"] == "SHT_NOBITS":
        return "bss"
    if section["sh_flags"] & SH_FLAGS.SHF_EXECINSTR:
        return "text"
    return "data" if section["sh_flags"] & SH_FLAGS.SHF_WRITE else "rodata"


@dataclass(frozen=True)
class SectionSizes:
    """Bytes of machine code, constants, initialised variables and zeroed variables."""

    text: int = 0
    rodata: int = 0
    data: int = 0
    bss: int = 0

    @property
    def flash(self) -> int:
        """Bytes of flash: code, constants, and the first values of variables."""
        return self.text + self.rodata + self.data

    @property
    def ram(self) -> int:
        """Bytes of RAM outside the stack."""
        return self.data + self.bss


def image_sizes(image: Image) -> SectionSizes:
    """Return the sizes of the whole image (programs, server, start-up) without the stacks."""
    return _summed(s for s in ObjectFile(image.elf).sections if _loaded(s) and s.name != ".stacks")


class Usage:
    """Memory and stack of the functions in an image, by their call graph, which the relocations of sections tell."""

    def __init__(self, image: Image) -> None:
        self.image = image
        self.files = [ObjectFile(data) for data in image.objects]
        self._defined: dict[str, Place] = {}
        for i, file in enumerate(self.files):
            for k, symbol in enumerate(file.symbols):
                section = file.section_of(k)
                if section is not None and symbol["st_info"]["bind"] != "STB_LOCAL":
                    self._defined.setdefault(symbol.name, (i, section))

    def sizes(self, functions: Sequence[str]) -> SectionSizes:
        """Return the total sizes of the functions, of those that they call and of the constants that they read."""
        found: set[Place] = set()
        stack = [self._place(name) for name in functions]
        while stack:
            place = stack.pop()
            if place not in found:
                found.add(place)
                stack += self._referred(place)
        return _summed(self.files[i].sections[j] for i, j in found)

    def stack(self, function: str) -> int | None:
        """Return a bound of the stack [bytes] of a call of `function`: the largest sum of frames in its call graph.

        None means no bound: recursion, frames of variable size, or library functions of unknown frame. A static
        function that calls itself leaves no relocation and is missed; emitted C has none. Interrupts need more.
        """
        return self._depth(self._place(function), {}, frozenset())

    def _depth(self, place: Place, known: dict[Place, int | None], above: frozenset[Place]) -> int | None:
        if place in above:
            return None
        if place not in known:
            below = [self._depth(p, known, above | {place}) for p in self._referred(place)]
            frame, bounded = self._frame(place), [depth for depth in below if depth is not None]
            known[place] = None if frame is None or len(bounded) < len(below) else frame + max(bounded, default=0)
        return known[place]

    def _place(self, name: str) -> Place:
        if name not in self._defined:
            raise CompileError(f"the image has no function {name!r:.80}", "", "name a function that the C exports")
        return self._defined[name]

    def _referred(self, place: Place) -> list[Place]:
        i, j = place
        file, found = self.files[i], []
        for k in file.refers.get(j, ()):
            section = file.section_of(k)
            if section is None:
                found += [self._defined[name]] if (name := file.symbols[k].name) in self._defined else []
            elif _loaded(file.sections[section]) and (section != j or k in file.calls.get(j, ())):
                found.append((i, section))
        return found

    def _frame(self, place: Place) -> int | None:
        i, j = place
        file = self.files[i]
        if _use(file.sections[j]) != "text":
            return 0
        unknown = (k for k in file.refers.get(j, ()) if k and file.section_of(k) is None)
        if any(file.symbols[k].name not in self._defined for k in unknown):
            return None
        if place in self._clang_frames:
            return self._clang_frames[place]
        own = (s for s in file.symbols if s["st_shndx"] == j and s["st_info"]["type"] == "STT_FUNC")
        frames = [0 if s.name.endswith(".cold") else self._gcc_frame(s.name) for s in own]
        bounded = [f for f in frames if f is not None]
        return max(bounded) if bounded and len(bounded) == len(frames) else None

    def _gcc_frame(self, name: str) -> int | None:
        while name not in self._gcc_frames and "." in name:  # a clone goes by the name of its function
            name = name.rpartition(".")[0]
        return self._gcc_frames.get(name)

    @cached_property
    def _gcc_frames(self) -> dict[str, int | None]:
        """Function -> bytes, from the lines `place:line:column:name TAB bytes TAB kind` of -fstack-usage."""
        found: dict[str, int | None] = {}
        for line in self.image.stack_usage.splitlines():
            if match := re.fullmatch(r".*:\d+:\d+:(\S+)\t(\d+)\t(\S+)", line):
                name, size, kind = match.groups()
                before = found.get(name, 0)
                bounded = kind in ("static", "dynamic,bounded") and before is not None
                found[name] = max(int(size), before or 0) if bounded else None
        return found

    @cached_property
    def _clang_frames(self) -> dict[Place, int]:
        """Section of a function -> bytes, from the sections `.stack_sizes`: an address, then the size in LEB128."""
        found: dict[Place, int] = {}
        for i, file in enumerate(self.files):
            for section in file.sections:
                if section.name == ".stack_sizes":
                    found[i, section["sh_link"]] = max(_stack_sizes(section.data()))
        return found


def _stack_sizes(data: bytes) -> list[int]:
    sizes, at = [], 0
    while at + 4 < len(data):
        at += 4
        end = next(k for k in range(at, len(data)) if data[k] < 0x80) + 1
        sizes.append(sum((byte & 0x7F) << 7 * k for k, byte in enumerate(data[at:end])))
        at = end
    return sizes


def _summed(sections: Iterable[Any]) -> SectionSizes:
    bytes_of = {"text": 0, "rodata": 0, "data": 0, "bss": 0}
    for section in sections:
        bytes_of[_use(section)] += section["sh_size"]
    return SectionSizes(**bytes_of)


STEPS = 1000
FUNCTIONS = ("defaults", "prepare", "init", "step")


@dataclass(frozen=True)
class CortexM7Report:
    """Bytes, stack and instructions of a program.

    `code` counts its four functions (defaults, prepare, init, step) and their callees, `step` the step and its
    callees, `image` the whole image with start-up and server. `structs` has the bytes of P, S, U and Y. `stack` is
    the bound of a step by the call graph (None: unknown), `stack_seen` the stack that the measured steps used, both in
    bytes and without interrupts. `instructions` (steps,) are those of each measured step, without call and return.
    """

    name: str
    precision: str
    compiler: str
    optimise: str
    code: SectionSizes
    step: SectionSizes
    image: SectionSizes
    structs: Mapping[str, int]
    stack: int | None
    stack_seen: int
    instructions: NDArray[np.int64]

    @property
    def flash(self) -> int:
        """Bytes of flash of the program's own code and constants."""
        return self.code.flash

    @property
    def ram(self) -> int:
        """Bytes of RAM of one instance: its structs and the code's variables, without the stack."""
        return sum(self.structs.values()) + self.code.ram

    def to_json(self) -> dict[str, Any]:
        """Return the figures as a JSON object."""
        own = {"name": self.name, "precision": self.precision, "compiler": self.compiler, "optimise": self.optimise}
        return own | {
            "flash_bytes": self.flash,
            "flash_bytes_step": self.step.flash,
            "flash_bytes_image": self.image.flash,
            "ram_bytes": self.ram,
            "struct_bytes": dict(self.structs),
            "stack_bytes_bound": self.stack,
            "stack_bytes_seen": self.stack_seen,
            "instructions_mean": float(self.instructions.mean()),
            "instructions_max": int(self.instructions.max()),
            "steps": len(self.instructions),
        }


def measure(
    program: CompiledProgram,
    steps: int = STEPS,
    inputs: Mapping[str, Any] | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> CortexM7Report:
    """Measure the cost of `program`, built for the Cortex-M7.

    Its steps are run with these inputs (as `Machine.run` takes them) and parameters, which decide the instructions
    that are reached.

    Raises CompileError if it was built for another target or no step is asked for, ParameterError for the parameters,
    DiagramError for the inputs, ControllerFault if a step faults.
    """
    backend = program.backend
    if not isinstance(backend, CortexM7Backend):
        raise CompileError(
            "the program is built for another target", program.flat.name, 'build it with target="cortex-m7"'
        )
    if steps < 1:
        raise CompileError(f"{steps} steps cannot be measured", program.flat.name, "ask for at least one")
    image = backend.processor.image
    with Processor(image, counting=True) as processor:
        counting = CompiledProgram(program.emitted, CortexM7Backend(program.emitted, processor, backend.index))
        machine = counting.machine()
        machine.set_many(parameters or {})
        machine.reset()
        machine.run(steps, inputs)
    instance = cast(CortexM7Instance, machine.instance)
    usage = Usage(image)
    prefix = program.flat.name
    return CortexM7Report(
        name=prefix,
        precision=program.precision,
        compiler=image.compiler,
        optimise=image.optimise,
        code=usage.sizes([f"{prefix}_{f}" for f in FUNCTIONS]),
        step=usage.sizes([f"{prefix}_step"]),
        image=image_sizes(image),
        structs={k: program.dtypes[k].itemsize for k in "PSUY"},
        stack=usage.stack(f"{prefix}_step"),
        stack_seen=instance.stack,
        instructions=instance.instructions,
    )
