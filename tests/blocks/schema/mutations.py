"""Files that are nearly diagrams: valid ones with something in them changed."""

import copy
import inspect
import json
import random
from collections.abc import Iterator
from typing import Any

from tests.blocks.library.samples import LIBRARY

VALUES: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    2,
    10**6,
    10**30,
    0.5,
    -0.0,
    1e308,
    "",
    "u",
    "y",
    "real",
    "bool",
    "k",
    "b0.u",
)
VALUES += ([], [0], [0, 1], {}, {"float": "inf"}, {"float": "nan"}, {"float": "x"}, "∞", "int32", "hold", "reset")


def mutate(value: Any, rng: random.Random) -> Any:
    """`value` with one place in it changed to something else, doubled, left out or exchanged for another."""
    if isinstance(value, dict) and value and rng.random() < 0.93:
        key = rng.choice(list(value))
        if rng.random() < 0.95:
            return {**value, key: mutate(value[key], rng)}
        kept = {k: v for k, v in value.items() if k != key}
        return (
            kept if rng.random() < 0.7 else {**kept, rng.choice(["text", "width", "initial", "low", "x"]): value[key]}
        )
    if isinstance(value, list) and value and rng.random() < 0.93:
        i = rng.randrange(len(value))
        if rng.random() < 0.9:
            return [*value[:i], mutate(value[i], rng), *value[i + 1 :]]
        j = rng.randrange(len(value))
        return rng.choice([value[:i] + value[i + 1 :], [*value, value[i]], [*value[:i], value[j], *value[i + 1 :]]])
    if isinstance(value, int) and rng.random() < 0.5:
        return value + rng.choice((-1, 1, 2, 100))
    return copy.deepcopy(rng.choice(VALUES))


def altered(text: str, rng: random.Random) -> str:
    """`text` with characters changed, a piece left out, doubled or moved, as by a bad disk or a hand in an editor."""
    for _ in range(rng.randint(1, 3)):
        i, j = sorted((rng.randrange(len(text)), rng.randrange(len(text))))
        j = min(j, i + rng.choice((1, 1, 3, 30, 300)))
        k = rng.randrange(len(text))
        piece = text[i:j]
        text = (
            rng.choice(
                [
                    text[:i] + chr(rng.choice((rng.randrange(32, 127), rng.randrange(0x2100), 0))) + text[i + 1 :],
                    text[:i] + text[j:],
                    text[:j] + piece + text[j:],
                    text[:k] + piece + text[k:],
                    text[:i]
                    + rng.choice(("1e999", "-", "[[", "}", '"', "null", "9" * 30, "NaN", "\\ud800"))
                    + text[j:],
                    text[:j],
                ]
            )
            or text
        )
    return text


def mutants(bases: list[str], count: int, seed: int) -> Iterator[str]:
    """`count` files, changed by structure and by character in turn."""
    rng = random.Random(seed)
    parsed = [json.loads(b) for b in bases]
    for k in range(count):
        which = rng.randrange(len(bases))
        if k % 2:
            yield altered(bases[which], rng)
            continue
        data = parsed[which]
        for _ in range(rng.randint(1, 3)):
            data = mutate(data, rng)
        yield json.dumps(data)


INF, NAN = {"float": "inf"}, {"float": "nan"}
ARGUMENTS: tuple[Any, ...] = (
    0,
    -1,
    3,
    1000,
    10**6,
    10**9,
    2**32,
    10**39,
    0.0,
    -1.0,
    1e-320,
    1e308,
    INF,
    NAN,
    True,
    None,
)
ARGUMENTS += ("", "x", "+-" * 20, [], [1], [2.0, 1.0], [[1.0]], [[1, 2], [3]], [NAN, INF], list(range(50)), [0] * 3000)
ARGUMENTS += ([[0.5] * 40] * 40, [["a"]], {}, {"a": 1}, [None], [True, False], [10**39], ["real"])


def constructions() -> Iterator[tuple[str, str]]:
    """(what, file): every argument of every block of the library with every of ARGUMENTS."""
    for name, cls in LIBRARY.items():
        for argument in list(inspect.signature(cls.__init__).parameters)[1:]:
            for value in ARGUMENTS:
                part = {"name": "g", "block": {"type": name, "config": {argument: value}}}
                data = {"schema": "twodof/diagram", "version": 1, "diagram": {"name": "d", "parts": [part]}}
                yield f"{name}({argument}={str(value)[:60]})", json.dumps(data)


OPERATIONS = (
    ("neg", "abs", "not", "sqrt"),
    ("add", "sub", "mul", "div", "quot", "rem", "shl", "shr", "and", "or", "xor", "lt", "le", "eq", "ne", "mulhi"),
    ("where", "store"),
)
REALS = ("nan", "inf", "-inf", "-0x0.0p+0", "0x1p-1074", "0x1.fffffep+127", "0x1p+1023", "0x1.8p+0", "0x1p+31")


def retouched(text: str, rng: random.Random) -> str:
    """`text` with one operation, constant, argument or loop of a custom block changed so that it may still be one."""
    data = json.loads(text)
    rows: list[Any] = []
    stack = [data["diagram"]]
    while stack:
        for part in stack.pop()["parts"]:
            stack += [part["diagram"]] if "diagram" in part else []
            rows += part.get("block", {}).get("nodes", [])
    row = rng.choice(rows)
    if row[0] == "const":
        row[3] = (
            rng.choice(REALS) if row[2] == "real" else rng.choice((True, False)) if row[2] == "bool" else row[3] + 1
        )
    elif row[0] in ("build", "fold"):
        row[2] = rng.choice((0, 1, row[2] + 1, 1000))
    elif row[1] and rng.random() < 0.4:
        place = rng.randrange(len(row[1]))
        row[1][place] = rng.randrange(row[1][place] + 1)
    else:
        like = [ops for ops in OPERATIONS if row[0] in ops]
        row[0] = rng.choice(like[0]) if like else row[0]
    return json.dumps(data)
