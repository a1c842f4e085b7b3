"""A user's block with one method replaced, and the expected line of a mistake in it."""

import inspect
from collections.abc import Callable
from typing import Any

from twodof.blocks.block import Block
from twodof.blocks.declarations import Param, Port, State

HERE = "# here"


class WellMeant(Block):
    """Every method does something; a test replaces one of them."""

    inputs = (Port("u"), Port("a", width=3), Port("n", "int32"))
    outputs = (Port("y"),)
    states = (State("s"), State("c", continuous=True))
    params = (Param("k", 2.0),)
    derived = (Port("g"),)

    def prepare(self, p: Any, t: Any) -> Any:
        return {"g": p.k * 0.5}

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.u * p.g + x.s

    def update(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"s": x.s + u.u}

    def derivative(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {"c": u.u}


def mine(method: str, written: Callable[..., Any], **others: Any) -> type[Block]:
    """The class `Mine`, a WellMeant block of the user's with one method written otherwise."""
    return type("Mine", (WellMeant,), {method: written, **others, "__module__": "users"})


def line_of(written: Callable[..., Any]) -> str:
    """The file and line at which a mistake of a method is expected: the one marked `# here`, or its first."""
    rows, first = inspect.getsourcelines(written)
    marked = [i for i, row in enumerate(rows) if HERE in row]
    return f"{inspect.getsourcefile(written)}:{first + (marked[0] if marked else 0)}"
