"""How crowded C is: optimisers take time with the values that are alive at once, far more than with its length."""

from __future__ import annotations

import re

_WORD = re.compile(r"[A-Za-z_]\w*")
_LOCAL = re.compile(r" +(?:const )?(?:real|int32_t|uint32_t|bool) (\w+) = ")
OPTIMISATION_BUDGET = 100_000_000
"""From here on code is not optimised: zig's -O3 needs about 4 s of processor time for as much; cubic in the values."""


def optimisation_cost(source: str) -> int:
    """The sum over the lines of C of the square of the number of local values that a later line still reads.

    `source` is as the emitter writes it: a local value a line, a function's end at the line's beginning.
    """
    total = 0
    body: list[str] = []
    for line in source.splitlines():
        if line.startswith("}"):
            total += _function(body)
            body = []
        else:
            body.append(line)
    return total


def _function(lines: list[str]) -> int:
    last: dict[str, int] = {}
    for number, line in enumerate(lines):
        if match := _LOCAL.match(line):
            last[match[1]] = number
        for word in _WORD.findall(line):
            if word in last:
                last[word] = number
    alive = total = 0
    ends = [0] * (len(lines) + 1)
    for number, line in enumerate(lines):
        if match := _LOCAL.match(line):
            alive += 1
            ends[last[match[1]]] += 1
        total += alive * alive
        alive -= ends[number]
    return total
