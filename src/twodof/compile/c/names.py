"""Identifiers for emitted C: unique in their scope, and different from keywords and names of headers and helpers."""

import re
from dataclasses import dataclass, field

from twodof.blocks.elementary.functions import ARGUMENTS
from twodof.compile.c.helpers import NAMES as HELPERS

RESERVED = """
    auto break case char const continue default do double else enum extern float for goto if inline int
    long register restrict return short signed sizeof static struct switch typedef union unsigned void
    volatile while asm typeof real bool true false offsetof linux unix memcpy memmove memset NULL
"""
# A header is for C++ too, and for whoever includes others before it, which define these as macros.
FOREIGN = """
    alignas alignof and and_eq bitand bitor catch char16_t char32_t char8_t class co_await co_return co_yield compl
    concept const_cast consteval constexpr constinit decltype delete dynamic_cast explicit export friend mutable
    namespace new noexcept not not_eq nullptr operator or or_eq private protected public reinterpret_cast requires
    static_assert static_cast template this thread_local throw try typeid typename using virtual wchar_t xor xor_eq
    complex imaginary noreturn assert errno stdin stdout stderr EOF INFINITY NAN HUGE_VAL BUFSIZ
"""
KEYWORDS = frozenset((RESERVED + FOREIGN).split())
# What the included headers and the emitted file itself define beside those: macros, types, helpers, a header's guard.
DEFINED = re.compile(r"[A-Z][A-Z0-9_]*_(MAX|MIN|C|WIDTH)|[a-z0-9_]+_t|td_inline|td_apart|\w+_INCLUDED")
FUNCTIONS = HELPERS | {f"td_{name}{kind}" for name in ARGUMENTS for kind in ("", "_float32", "_float64")}


@dataclass
class CNames:
    """Identifiers of one C scope, each different."""

    taken: set[str] = field(default_factory=set)
    last: dict[str, int] = field(default_factory=dict)
    tried: dict[str, int] = field(default_factory=dict)  # of a stem that is taken: the number that was tried last

    def new(self, stem: str) -> str:
        """`stem` with dots as underscores; with a number behind it if that is taken."""
        name = base = stem.replace(".", "_")
        number = self.tried.get(base, 2)
        while name in self.taken or name in KEYWORDS or name in FUNCTIONS or DEFINED.fullmatch(name):
            name = f"{base}_{number}"
            self.tried[base] = number
            number += 1
        self.taken.add(name)
        return name

    def numbered(self, stem: str) -> str:
        """`stem` with the next number behind it."""
        base = stem.replace(".", "_")
        self.last[base] = self.last.get(base, 0) + 1
        return self.new(f"{base}{self.last[base]}")
