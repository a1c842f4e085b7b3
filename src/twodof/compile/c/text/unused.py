"""What a C function does not use: compilers warn of it, so it goes, or is said to be left unused."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

_COMMENT = re.compile(r"/\*.*?\*/")
_WORD = re.compile(r"[A-Za-z_]\w*")
_MADE = re.compile(r" +const \w+ (?:\*const )?(\w+)(?:\[\d+\])? = ")
_DECLARED = re.compile(r"( +)(?!return )\w+ (\w+)(?:\[\d+\])?(?: = .*)?;")
_TARGET = re.compile(r" +(\w+)(?:\[[^\]]*\])? = ")
_POINTERS = re.compile(r"\*(?:restrict )?(\w+)")


def without_unused(functions: str) -> tuple[str, set[str]]:
    """`functions` without the constants that nothing reads, and the words that stood only there.

    A value may be named for a reader that in the end takes a simpler one. Nothing in a line of C has an effect but an
    assignment.
    """
    lines = functions.split("\n")
    words = [_WORD.findall(_COMMENT.sub("", line)) for line in lines]
    count = Counter(chain.from_iterable(words))
    made = {found[1]: i for i, line in enumerate(lines) if (found := _MADE.match(line))}
    idle = [name for name in made if count[name] == 1]
    left_out: set[int] = set()
    while idle:
        i = made[idle.pop()]
        left_out.add(i)
        for word in words[i]:
            count[word] -= 1
            if count[word] == 1 and word in made:
                idle.append(word)
    kept = _marked([line for i, line in enumerate(lines) if i not in left_out], count)
    return "\n".join(kept), {word for word, times in count.items() if times == 0}


def _marked(lines: Sequence[str], count: Mapping[str, int]) -> Iterator[str]:
    """`lines`, with one behind each variable that is only assigned, as a loop does with what nobody reads."""
    stored = Counter(found[1] for line in lines if (found := _TARGET.match(line)))
    for line in lines:
        yield line
        found = _DECLARED.match(line)
        if found and found[2] in stored and count[found[2]] == 1 + stored[found[2]]:
            yield f"{found[1]}(void){found[2]};"


def with_idle_parameters(functions: str) -> str:
    """`functions` with a line for each parameter that is not used."""
    made = []
    for text in re.split(r"(?m)(?<=^}\n)", functions):
        head, brace, body = text.partition("\n{\n")
        named = _POINTERS.findall(head.rpartition("(")[2])
        idle = [n for n in named if not re.search(rf"\b{n}\b", body)]
        made.append(head + brace + "".join(f"    (void){n};\n" for n in idle) + body)
    return "".join(made)
