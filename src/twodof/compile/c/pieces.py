"""Division of long functions into pieces, since compile time grows with the square of a function's length.

Variables that one piece declares and another one reads are members of a struct that is passed to all pieces.
"""

from collections.abc import Iterable

from twodof.compile.c.functions import Function
from twodof.compile.c.statements import Assign, Call, Copy, IfStatement, Statement, every, without_unread, written

LONGEST = 1200  # statements of a function that stays whole, if it runs at every tick
LONGEST_SETUP = 300  # the same for one that runs at the start, or when a parameter changes
PIECE = 100  # statements of a piece, about
APART = """/* Not put in place, so that a compiler sees less at once. */
#if defined(__GNUC__)
#define td_apart static __attribute__((noinline))
#else
#define td_apart static
#endif
"""
WORK = frozenset(("work",))


def in_pieces(function: Function, every_tick: bool) -> tuple[str, list[Function], int]:
    """Return the struct's C ("" without), the pieces and last the function that calls them, and the struct's elements.

    A function is divided if it is long; one that runs at `every_tick` may be longer.
    """
    if _length(function.body) <= (LONGEST if every_tick else LONGEST_SETUP):
        return "", [function], 0
    without_unread(function.body)
    return _Pieces(function).made()


def _length(statements: Iterable[Statement]) -> int:
    return sum(1 for _ in every(statements))


def _names(statements: Iterable[Statement]) -> set[str]:
    return {name for s in every(statements) for name in (*s.reads, written(s))}


class _Pieces:
    """The pieces of one function."""

    def __init__(self, function: Function) -> None:
        self.function = function
        self.kind = f"{function.name}_Work"
        self.bodies: list[list[Statement]] = []
        self.main: list[Statement] = []
        self._divide(function.body, self.main)
        self.local = {
            s.target: (k, s) for k, body in enumerate(self.bodies) for s in body if isinstance(s, Assign) and s.declared
        }
        elsewhere = {name for s in every(self.main) for name in s.reads}
        for k, body in enumerate(self.bodies):
            elsewhere |= {name for name in _names(body) if name in self.local and self.local[name][0] != k}
        stack = sorted(elsewhere & self.local.keys(), reverse=True)
        self.handed: dict[str, Assign] = {}
        while stack:
            name = stack.pop()
            self.handed[name] = declaration = self.local[name][1]
            if declaration.declared.endswith("*const"):  # with the arrays that it points to
                stack += sorted(declaration.reads & self.local.keys() - self.handed.keys())

    def _divide(self, body: list[Statement], calls: list[Statement]) -> None:
        """Cut a body; a long guarded part is cut too, and stays under its condition.

        The integration stays in one piece, or its copies of the continuous states would be handed on.
        """
        piece: list[Statement] = []
        length = 0

        def end() -> None:
            nonlocal piece, length
            if piece:
                self.bodies.append(piece)
                calls.append(Call(f"{self.function.name}_{len(self.bodies)}", role="pieces"))
            piece, length = [], 0

        for statement in body:
            size = _length([statement])
            if isinstance(statement, IfStatement) and statement.role == "condition" and size > PIECE:
                end()
                inner: list[Statement] = []
                self._divide(statement.then, inner)
                calls.append(IfStatement(statement.test, inner, role="condition", reads=statement.reads))
                continue
            piece.append(statement)
            length += size
            if length >= PIECE and statement.role != "integration":
                end()
        end()

    def made(self) -> tuple[str, list[Function], int]:
        """Return what `in_pieces` does."""
        f = self.function
        struct, parameters, arguments = "", f.parameters, f.arguments()
        main: list[Statement] = []
        if self.handed:
            members = "".join(f"    {_member(s)}\n" for s in self.handed.values())
            struct = f"typedef struct {{ /* what the pieces of {f.name} hand on */\n{members}}} {self.kind};\n\n"
            parameters, arguments = (*parameters, f"{self.kind} *restrict work"), [*arguments, "&work"]
            main.append(Call(f"{self.kind} work;", role="pieces"))
        made = [
            Function("td_apart void", f"{f.name}_{k + 1}", parameters, self._piece(k, body), f.part)
            for k, body in enumerate(self.bodies)
        ]
        loaded: set[str] = set()
        for statement in self.main:
            for name in sorted(statement.reads):
                if name in self.handed and name not in loaded:
                    loaded.add(name)
                    declared = self.handed[name].declared
                    main.append(
                        Assign(name, f"work.{name}", f"const {declared.removeprefix('const ')}", role="handed on")
                    )
            for inner in every([statement]):
                inner.reads |= frozenset(f.arguments())
                if isinstance(inner, Call):
                    inner.line += f"({', '.join(arguments)});"
            main.append(statement)
        made.append(Function(f.result, f.name, f.parameters, main, f.part))
        return struct, made, sum(s.size or 1 for s in self.handed.values())

    def _piece(self, k: int, body: list[Statement]) -> list[Statement]:
        """Return a piece that loads its inputs from the struct, and stores there the values that other pieces read."""
        seen, wrote = _names(body), {written(s) for s in every(body)}
        before: list[Statement] = []
        after: list[Statement] = []
        own: dict[Statement, list[Statement]] = {}
        for name, s in self.handed.items():
            if name not in seen:
                continue
            here = self.local[name][0] == k
            if s.size is not None:
                pointer = f"{s.declared.removeprefix('const ')} *const"
                point = Assign(name, f"work->{name}", pointer, reads=WORK)
                if not here or not s.value:
                    before.append(point)
                    own[s] = []
                else:
                    values = f"{name}_values"
                    while values in seen:
                        values += "_"
                    kind = s.declared.removeprefix("const ")
                    fill = Assign(values, s.value, s.declared, s.size, owner=s.owner, reads=s.reads)
                    copy = Copy(name, values, s.size, kind, owner=s.owner, reads=frozenset((values, name)))
                    before.append(point)
                    own[s] = [fill, copy]
                continue
            if not here:
                before.append(Assign(name, f"work->{name}", s.declared, reads=WORK))
            if here or name in wrote:
                after.append(Assign(f"work->{name}", name, reads=frozenset((name, "work"))))
        for handed in (*before, *after):
            handed.role = "handed on"
        middle = [new for statement in body for new in own.get(statement, [statement])]
        for statement in every(middle):
            if (name := written(statement)) in self.handed and self.handed[name].size is not None:
                statement.reads |= {name}  # by another piece
        return [*before, *middle, *after]


def _member(s: Assign) -> str:
    """Return a handed variable's line in the struct."""
    if s.declared.endswith("*const"):
        return f"{s.declared.removesuffix('const')}{s.target};"
    size = "" if s.size is None else f"[{s.size}]"
    return f"{s.declared.removeprefix('const ')} {s.target}{size};"
