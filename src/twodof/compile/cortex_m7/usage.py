"""Usage of functions: bytes of flash and RAM, and the worst-case depth of the stack."""

import re
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from twodof.compile.cortex_m7.image import Image
from twodof.errors import CompileError

# System V ABI, chapter 4, "Object Files"; 32 bits, little-endian.
_HEADER = struct.Struct("<16sHHIIIIIHHHHHH")
_SECTION = struct.Struct("<10I")
_SYMBOL = struct.Struct("<IIIBBH")
_RELOCATION = struct.Struct("<II")
SYMTAB, RELA, NOBITS, REL = 2, 4, 8, 9
WRITE, ALLOC, EXECUTE = 1, 2, 4
FUNCTION = 2
CALL = 10  # R_ARM_THM_CALL
_FIRST_RESERVED = 0xFF00
_ARM = 40


@dataclass
class ElfSection:
    """`refers` has the indices of the symbols that its relocations name, `calls` those of them that it calls."""

    name: str
    kind: int
    flags: int
    data: bytes
    size: int
    link: int
    refers: set[int] = field(default_factory=set)
    calls: set[int] = field(default_factory=set)

    @property
    def loaded(self) -> bool:
        """True if the section takes memory of the target."""
        return bool(self.flags & ALLOC) and self.size > 0

    @property
    def use(self) -> str:
        """Which memory: "text", "rodata", "data" (in flash and RAM) or "bss" (in RAM)."""
        if self.kind == NOBITS:
            return "bss"
        if self.flags & EXECUTE:
            return "text"
        return "data" if self.flags & WRITE else "rodata"


@dataclass(frozen=True)
class ElfSymbol:
    """`section` is the index of the section that has it, 0 if another file has it, or 0xff00 and more."""

    name: str
    value: int
    kind: int
    local: bool
    section: int


@dataclass(frozen=True)
class Elf:
    """The sections and symbols of a file, by index."""

    sections: list[ElfSection]
    symbols: list[ElfSymbol]

    def globals(self) -> dict[str, int]:
        """Return the sections of the symbols that other files can name."""
        return {s.name: s.section for s in self.symbols if not s.local and 0 < s.section < _FIRST_RESERVED}


def read_elf(data: bytes, where: str = "object file") -> Elf:
    """Read the object file with the bytes `data`. Raises CompileError if it is not an ELF file for Arm."""
    try:
        return _read(data)
    except (struct.error, IndexError, ValueError) as error:
        raise CompileError(f"no readable ELF file: {error}", where, "check that the compiler works") from error


def _read(data: bytes) -> Elf:
    ident, _, machine, _, _, _, start, _, _, _, _, entry, count, names = _HEADER.unpack_from(data)
    if ident[:6] != b"\x7fELF\x01\x01" or machine != _ARM or entry != _SECTION.size:
        raise ValueError("another kind of file")
    rows = [_SECTION.unpack_from(data, start + entry * i) for i in range(count)]

    def content(row: tuple[int, ...]) -> bytes:
        return b"" if row[1] == NOBITS else data[row[4] : row[4] + row[5]]

    titles = content(rows[names])
    sections = [ElfSection(_text(titles, r[0]), r[1], r[2], content(r), r[5], r[6]) for r in rows]
    symbols: list[ElfSymbol] = []
    for section in sections:
        if section.kind == SYMTAB:
            strings = sections[section.link].data
            for name, value, _, info, _, index in _SYMBOL.iter_unpack(section.data):
                symbols.append(ElfSymbol(_text(strings, name), value, info & 15, info >> 4 == 0, index))
    for row, section in zip(rows, sections, strict=True):
        if section.kind == REL:
            named = [(info >> 8, info & 255) for _, info in _RELOCATION.iter_unpack(section.data)]
            sections[row[7]].refers |= {symbol for symbol, _ in named}
            sections[row[7]].calls |= {symbol for symbol, kind in named if kind == CALL}
        elif section.kind == RELA:
            raise ValueError("relocations with addends")
    return Elf(sections, symbols)


def _text(strings: bytes, at: int) -> str:
    return strings[at : strings.index(b"\0", at)].decode("utf-8", "replace")


Place = tuple[int, int]  # object file, section: each function and each constant has a section of its own


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
    return _summed(s for s in read_elf(image.elf).sections if s.loaded and s.name != ".stacks")


class Usage:
    """The call graph of an image's programs: relocations say which section refers to which."""

    def __init__(self, image: Image) -> None:
        self.image = image
        self.files: list[Elf] = [read_elf(data) for data in image.objects]
        self._defined: dict[str, Place] = {}
        for i, file in enumerate(self.files):
            for name, section in file.globals().items():
                self._defined.setdefault(name, (i, section))

    def sizes(self, functions: Sequence[str]) -> SectionSizes:
        """Return the sizes of the functions with all that they call and the constants that they read."""
        found: set[Place] = set()
        stack = [self._place(name) for name in functions]
        while stack:
            place = stack.pop()
            if place not in found:
                found.add(place)
                stack += self._referred(place)
        return _summed(self.files[i].sections[j] for i, j in found)

    def stack(self, function: str) -> int | None:
        """Return the bound of the stack [bytes] of a call of `function`: the largest sum of frames in its call graph.

        None stands for no bound: recursion, frames of variable size, library functions without a figure. A static
        function that calls itself leaves no relocation and is missed; emitted C never does that.
        Interrupts come on top.
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
            raise CompileError(f"the image does not have the function {name!r:.80}", "", "name one that the C exports")
        return self._defined[name]

    def _referred(self, place: Place) -> list[Place]:
        i, j = place
        file, found = self.files[i], []
        for k in file.sections[j].refers:
            symbol = file.symbols[k]
            if symbol.section == 0:
                found += [self._defined[symbol.name]] if symbol.name in self._defined else []
            elif symbol.section < len(file.sections) and file.sections[symbol.section].loaded:
                if symbol.section != j or k in file.sections[j].calls:
                    found.append((i, symbol.section))
        return found

    def _frame(self, place: Place) -> int | None:
        i, j = place
        section = self.files[i].sections[j]
        if section.use != "text":
            return 0
        if any(self._elsewhere(self.files[i].symbols[k]) for k in section.refers if k):
            return None
        if place in self._clang_frames:
            return self._clang_frames[place]
        named = [s.name for s in self.files[i].symbols if s.section == j and s.kind == FUNCTION]
        frames = [0 if name.endswith(".cold") else self._gcc_frame(name) for name in named]
        bounded = [f for f in frames if f is not None]
        return max(bounded) if bounded and len(bounded) == len(frames) else None

    def _elsewhere(self, symbol: ElfSymbol) -> bool:
        return symbol.section == 0 and symbol.name not in self._defined

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
                    found[i, section.link] = max(_stack_sizes(section.data))
        return found


def _stack_sizes(data: bytes) -> list[int]:
    sizes, at = [], 0
    while at + 4 < len(data):
        at += 4
        end = next(k for k in range(at, len(data)) if data[k] < 0x80) + 1
        sizes.append(sum((byte & 0x7F) << 7 * k for k, byte in enumerate(data[at:end])))
        at = end
    return sizes


def _summed(sections: Iterable[ElfSection]) -> SectionSizes:
    bytes_of = {"text": 0, "rodata": 0, "data": 0, "bss": 0}
    for section in sections:
        bytes_of[section.use] += section.size
    return SectionSizes(**bytes_of)
