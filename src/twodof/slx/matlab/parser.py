"""MATLAB's language as trees: expressions with MATLAB's precedence, statements, functions.

Nothing is computed here, and a statement that is not read is a tree of its own, `refused`, which says why where it is
carried out: what no run reaches does no harm.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from twodof.slx.matlab.values import NotComputed, String

DEEPEST = 30  # each takes fifteen calls of Python, of a thousand
DEEPEST_BLOCKS = 60
_TOKEN = re.compile(
    r"""(?P<space>(?:[ \t]|\.\.\.[^\n]*\n)+)|(?P<comment>[%\#][^\n]*)
      |(?P<whole>0[xX][0-9a-fA-F]{1,16})|(?P<number>(?:\d+(?:\.(?![*/\\^'])\d*)?|\.\d+)(?:[eEdD][+-]?\d+)?)
      |(?P<name>[A-Za-z]\w*)|(?P<operator>\.\^|\.\*|\./|\.\\|\.'|==|~=|!=|<=|>=|&&|\|\||[-+*/\\^'<>=&|~!:;,()\[\]{}.@])
      |(?P<text>"(?:[^"\n]|"")*")|(?P<line>\r?\n)""",
    re.VERBOSE,
)
_QUOTED = re.compile(r"'((?:[^'\n]|'')*)'")
BLOCK_COMMENT = re.compile(r"^[ \t]*%\{[ \t]*$.*?^[ \t]*%\}[ \t]*$", re.MULTILINE | re.DOTALL)
_BINARY = (("||",), ("&&",), ("|",), ("&",), ("<", "<=", ">", ">=", "==", "~=", "!="), (":",), ("+", "-"),
           ("*", "/", "\\", ".*", "./", ".\\"))  # fmt: skip
OPENING = {"if", "for", "parfor", "while", "switch", "try"}
"""Words that begin a statement with blocks in it."""
_CLAUSES = ("elseif", "else", "case", "otherwise", "catch")
_WORDS = {*OPENING, *_CLAUSES, "function", "end"}
SILENT = {"clear", "clc", "close", "format", "warning", "clearvars", "disp", "fprintf", "tic", "toc", "figure", "hold",
          "plot", "subplot", "xlabel", "ylabel", "title", "legend", "grid"}  # fmt: skip
"""Statements that change no value: skipped without a word."""
_SILENT = {"assert", "error", "pause", "drawnow", "eml.extrinsic", "eml.inline"} | {
    f"coder.{name}" for name in ("inline", "extrinsic", "allowpcode", "varsize", "unroll", "cstructname", "cinclude")
}


class Unreadable(NotComputed):
    """Reason why a whole text is not read."""


@dataclass(frozen=True, slots=True)
class Token:
    """A word, number, text, operator or line end of a script."""

    kind: str
    text: str
    line: int
    spaced: bool
    """Whether white space stands before it."""


@dataclass(frozen=True, slots=True)
class Tree:
    """An expression, a step of one, or a statement: its kind, a word of it, and the trees inside.

    A `chain` is its first operand and a tree for each operator behind it; an `access` is a name, a literal or what is
    in brackets, and the steps `(`, `{` and `.` to an element.
    """

    kind: str
    text: str = ""
    parts: tuple["Tree", ...] = ()
    value: Any = None
    """Of a literal."""
    line: int = 0
    start: int = 0
    stop: int = 0
    """Of a statement the places of its first token, and of the one after the last."""
    excess: str = ""
    """Why what stands behind a statement is not read; "" if nothing does."""


@dataclass(frozen=True)
class FunctionDefinition:
    """A function of a program: arguments and results by name, its body, and the places of that one's tokens."""

    name: str
    arguments: list[str]
    results: list[str]
    body: Tree
    start: int
    stop: int


def tokens_of(text: str) -> list[Token]:
    """Return the tokens of a script. Raises NotComputed for a character that none begins with."""
    found: list[Token] = []
    at, line, spaced = 0, 1, False
    while at < len(text):
        before = found[-1] if found else None
        operand = before is not None and (
            before.kind in ("name", "number", "text") or before.text in (")", "]", "}", "'", ".'")
        )
        quoted = _QUOTED.match(text, at)
        if quoted is not None and not (operand and not spaced):
            found.append(Token("text", quoted[1].replace("''", "'"), line, spaced))
            at, spaced = quoted.end(), False
            continue
        match = _TOKEN.match(text, at)
        if match is None:
            raise NotComputed(f"line {line}: the character {text[at]!r} is not read")
        kind, said = match.lastgroup or "", match[0]
        at = match.end()
        if kind in ("space", "comment"):
            spaced = spaced or kind == "space"
            line += said.count("\n")
            continue
        if kind == "text":
            said = String(said[1:-1].replace('""', '"'))
        found.append(Token(kind, said, line, spaced))
        line += kind == "line"
        spaced = False
    return [*found, Token("end", "the end", line, False)]


def assigned_by(tokens: Sequence[Token]) -> set[str]:
    """Return the names that statements give a value: those left of each `=`, in `[a, b] = ...` several."""
    names: set[str] = set()
    start = depth = 0
    for at, token in enumerate(tokens):
        depth += nesting(token)
        if depth == 0 and (token.kind == "line" or token.text in (";", ",") or token.text in _WORDS):
            start = at + 1
        elif depth == 0 and token.text == "=":
            target = tokens[start:at]
            pairs = zip(target, [None, *target], strict=False)
            found = [t.text for t, b in pairs if t.kind == "name" and (not b or b.text != ".")]
            names.update(found if target and target[0].text == "[" else found[:1])
    return names


def names_in(text: str) -> list[str]:
    """Return the names in an expression, of `p.gains.Kp` the first; none where it cannot be read."""
    try:
        tokens = tokens_of(text)
    except NotComputed:
        return []
    pairs = zip(tokens, [None, *tokens], strict=False)
    return [t.text for t, before in pairs if t.kind == "name" and (before is None or before.text != ".")]


def assigned_names(code: str) -> set[str]:
    """Return the names that a script gives a value; none where it cannot be read."""
    try:
        return assigned_by(tokens_of(code))
    except NotComputed:
        return set()


def nesting(token: Token) -> int:
    """Return 1 for a bracket that opens, and -1 for one that closes."""
    return (token.text in ("(", "[", "{")) - (token.text in (")", "]", "}")) if token.kind == "operator" else 0


@lru_cache(4096)
def expression_of(text: str) -> tuple[Tree, str]:
    """Return the tree of an expression, and the token behind it; "" where it ends."""
    parser = MatlabParser(tokens_of(text))
    tree = parser.expression()
    parser.skip(";", "line")
    return tree, "" if parser.here.kind == "end" else parser.here.text


class MatlabParser:
    """Reader of tokens. A `script` may have a block without an end, or an `end` too many."""

    def __init__(self, tokens: list[Token], script: bool = False) -> None:
        self.tokens, self.script = tokens, script
        self.at = self.depth = self.blocks = 0
        self.matrix = self.unclosed = False

    @property
    def here(self) -> Token:
        """The next token."""
        return self.tokens[self.at]

    @property
    def word(self) -> str:
        """The next token if it is a name, else ""."""
        return self.here.text if self.here.kind == "name" else ""

    def skip(self, *texts: str) -> bool:
        """Pass one of these operators, or a line's end; return whether one stood here."""
        token = self.here
        found = (token.kind == "operator" and token.text in texts) or (token.kind == "line" and "line" in texts)
        self.at += found
        return found

    def need(self, text: str) -> None:
        """Pass an operator. Raises NotComputed where another token stands."""
        if not self.skip(text):
            raise NotComputed(f"'{text}' is missing before '{self.here.text}'")

    def taken(self) -> str:
        """Pass a token and return its text."""
        self.at += 1
        return self.tokens[self.at - 1].text

    # --- expressions

    def expression(self) -> Tree:
        """Read an expression."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise NotComputed("is nested too deep")
        made = self._binary(0)
        self.depth -= 1
        return made

    def _binary(self, level: int) -> Tree:
        """Read operations of this level of precedence, and of those above it; a range has two at most."""
        if level == len(_BINARY):
            return self._unary()
        parts, operators = [self._binary(level + 1)], _BINARY[level]
        if operators == (":",):
            if self.here.text == ":" and self.tokens[self.at + 1].text not in (")", "}", ","):
                while len(parts) < 3 and self.skip(":"):
                    parts.append(self._binary(level + 1))
            return parts[0] if len(parts) == 1 else Tree("range", parts=tuple(parts))
        while self.here.kind == "operator" and self.here.text in operators and not self._separated():
            parts.append(Tree(self.taken(), "matrix" if self.matrix else "", (self._binary(level + 1),)))
        return _chain(parts)

    def _separated(self) -> bool:
        """Return True if the sign here begins the next element of a matrix, as in `[1 -2]`."""
        following = self.tokens[self.at + 1]
        return self.matrix and self.here.spaced and not following.spaced and self.here.text in ("+", "-")

    def _unary(self) -> Tree:
        signs = ""
        while self.here.kind == "operator" and self.here.text in ("+", "-", "~", "!"):
            signs += self.taken()
        made = self._power()
        return Tree("signs", signs, (made,)) if signs else made

    def _power(self) -> Tree:
        parts = [self._postfix()]
        while self.here.kind == "operator" and self.here.text in ("^", ".^", "'", ".'"):
            if self.here.text in ("'", ".'"):
                if self.here.spaced and self.matrix:
                    break
                parts.append(Tree(self.taken()))
                continue
            operator, signs = self.taken(), ""
            while self.here.text in ("+", "-") and self.here.kind == "operator":
                signs += self.taken()
            exponent = self._postfix()
            negative = signs.count("-") % 2 == 1
            parts.append(Tree(operator, parts=(Tree("signs", "-", (exponent,)) if negative else exponent,)))
        return _chain(parts)

    def _postfix(self) -> Tree:
        parts = [self._primary()]
        while self.here.kind == "operator":
            apart = self.matrix and self.here.spaced
            if self.here.text in ("(", "{") and not apart:
                parts.append(Tree(self.here.text, parts=self._arguments(")" if self.here.text == "(" else "}")))
            elif self.here.text == "." and self.tokens[self.at + 1].kind == "name":
                self.at += 1
                parts.append(Tree(".", self.taken()))
            else:
                break
        return Tree("access", parts=tuple(parts))

    def _primary(self) -> Tree:
        """Read a literal, a name, a bracket, a matrix or the handle of a function."""
        token = self.here
        self.at += 1
        if token.kind == "number":
            return Tree("literal", value=np.array([[float(token.text.lower().replace("d", "e"))]]))
        if token.kind == "whole":  # of the smallest type that has as many digits
            bits = next(bits for bits in (8, 16, 32, 64) if 4 * (len(token.text) - 2) <= bits)
            return Tree("literal", value=np.array([[int(token.text, 16)]], dtype=f"uint{bits}"))
        if token.kind in ("text", "name"):
            return Tree("literal" if token.kind == "text" else "name", token.text, value=token.text)
        if token.text in ("(", "[", "{", "@") and token.kind == "operator":
            matrix, self.matrix = self.matrix, token.text in ("[", "{")
            if token.text == "(":
                made = self.expression()
                self.need(")")
            else:
                made = self._handle() if token.text == "@" else self._rows(token.text)
            self.matrix = matrix
            return made
        raise NotComputed(f"'{token.text}' is not computed" if token.kind != "end" else "ends too early")

    def _rows(self, bracket: str) -> Tree:
        """Read the rows of a matrix, or of a cell array."""
        close = "]" if bracket == "[" else "}"
        rows: list[list[Tree]] = [[]]
        while not self.skip(close):
            if self.here.kind == "end":
                raise NotComputed(f"'{close}' is missing")
            if self.skip(";", "line"):
                rows.append([])
            elif not self.skip(","):
                rows[-1].append(self.expression())
        return Tree("rows", bracket, tuple(Tree("row", parts=tuple(row)) for row in rows))

    def _arguments(self, close: str = ")") -> tuple[Tree, ...]:
        """Read the arguments in brackets; ":" alone is a literal."""
        self.at += 1
        matrix, self.matrix = self.matrix, False
        found = list[Tree]()
        while not self.skip(close):
            alone = self.here.text == ":" and self.tokens[self.at + 1].text in (",", close)
            found.append(Tree("literal", value=self.taken()) if alone else self.expression())
            if self.here.text != close:
                self.need(",")
        self.matrix = matrix
        return tuple(found)

    def _handle(self) -> Tree:
        """Read `@name`, or `@(a, b) expression`."""
        if not self.skip("("):
            return Tree("handle", self.taken())
        names = list[Tree]()
        while not self.skip(")"):
            names.append(Tree("name", self.taken()))
            self.skip(",")
        return Tree("handle", "", (self.expression(), *names))

    # --- statements

    def block(self, *ends: str) -> Tree:
        """Read the statements up to one of these words."""
        found = list[Tree]()
        while self.here.kind != "end" and self.word not in ends:
            if not self.skip(";", ",", "line"):
                found.append(self._statement())
        return Tree("block", parts=tuple(found))

    def _statement(self) -> Tree:
        start, line, excess = self.at, self.here.line, ""
        made = self._guarded(self._read)
        self.at = max(self.at, start + 1)
        if self.here.text not in (";", ",") and self.here.kind not in ("line", "end") and self.word not in _WORDS:
            excess = f"'{self.here.text}' is not expected"
            self._pass_over()
        return replace(made, line=line, start=start, stop=self.at, excess=excess)

    def _guarded(self, read: Callable[[], Tree]) -> Tree:
        """Return what `read` reads; where it fails pass over the statement, and return why."""
        start = self.at
        try:
            return read()
        except Unreadable:
            raise
        except NotComputed as reason:
            self.at, self.depth, self.matrix = start, 0, False
            self._pass_over()
            return Tree("refused", str(reason))

    def _pass_over(self) -> None:
        """Pass over tokens up to the end of the statement, or of the block around it."""
        depth = 0
        while self.here.kind != "end":
            ends = self.here.kind == "line" or self.here.text in (";", ",") or self.word in ("end", *_CLAUSES)
            if depth <= 0 and ends:
                return
            depth = 0 if self.here.kind == "line" else depth + nesting(self.here)
            self.at += 1

    def _read(self) -> Tree:
        word, start = self.word, self.at
        dotted = "".join(one.text for one in self.tokens[start : start + 3])
        if word in OPENING:
            return self._structure()
        if word in ("return", "break", "continue"):
            return Tree("leave", self.taken())
        if word in ("global", "function"):
            raise NotComputed(f"'{word}' is not translated")
        if word == "persistent":
            return Tree("persistent", parts=self._names())
        if (word in SILENT or word in _SILENT or dotted in _SILENT) and self.tokens[start + 1].text != "=":
            names = self._names() if word.startswith("clear") else ()
            self._pass_over()
            return Tree("silent", word, names)
        if self.here.text == "[" and (close := self._several()) is not None:
            return self._assign_several(close)
        made = self.expression()
        if not (self.here.text == "=" and self.here.kind == "operator"):
            return Tree("expression", parts=(made,))
        self.at += 1
        return Tree("assign", parts=(_target(made), self.expression()))

    def _names(self) -> tuple[Tree, ...]:
        """Read the names behind a word."""
        self.at += 1
        found = list[Tree]()
        while self.word and self.word not in _WORDS:
            found.append(Tree("name", self.taken()))
            self.skip(",")
        return tuple(found)

    def _several(self) -> int | None:
        """Return the place of the `]` of `[a, b] = ...`; None for a matrix."""
        at = depth = 0
        for at in range(self.at, len(self.tokens) - 1):
            depth += nesting(self.tokens[at])
            if depth == 0 or self.tokens[at].kind == "line":
                break
        return at if depth == 0 and self.tokens[at + 1].text == "=" else None

    def _assign_several(self, close: int) -> Tree:
        targets = list[Tree]()
        self.at, self.matrix = self.at + 1, True
        while self.at < close:
            if self.skip("~", "!"):
                targets.append(Tree("nothing"))
            elif not self.skip(","):
                targets.append(_target(self._postfix()))
        self.at, self.matrix = close + 2, False
        kind = "assign" if len(targets) == 1 and targets[0].parts else "several"
        parts = (self.expression(), *targets)
        return Tree(kind, parts=parts if kind == "several" else parts[::-1])

    def _structure(self) -> Tree:
        """Read a statement with blocks in it: a clause is a tree of its condition and its block."""
        word, line = self.taken(), self.tokens[self.at - 1].line
        self.blocks += 1
        if self.blocks > DEEPEST_BLOCKS:
            raise Unreadable(f"line {line}: blocks stand in each other too deep")
        parts = list[Tree]()
        name = ""
        if word in ("for", "parfor"):
            header = self._guarded(self._header)
            name, parts = header.text, [*(header.parts or (header,)), self.block("end")]
        elif word == "while":
            parts = [self._guarded(self.expression), self.block("end")]
        else:
            if word == "switch":
                parts.append(self._guarded(self.expression))
                self.block(*_CLAUSES, "end")
            clause = word if word != "switch" else self._clause()
            while clause:
                asked = [self._guarded(self.expression)] if clause in ("if", "elseif", "case") else []
                parts.append(Tree(clause, parts=(*asked, self.block(*_CLAUSES, "end"))))
                clause = self._clause()
        self.blocks -= 1
        if self.word == "end":
            self.at += 1
            return Tree("for" if word == "parfor" else word, name, tuple(parts))
        if not self.script:
            raise Unreadable(f"line {line}: a block has no end")
        self.unclosed = True
        return Tree("refused", f"this {word} has no end")

    def _clause(self) -> str:
        """Pass the word of a clause and return it; "" where none begins."""
        return self.taken() if self.word in _CLAUSES else ""

    def _header(self) -> Tree:
        """Read `k = values` of a `for`, perhaps in brackets."""
        bracket, name = self.skip("("), self.taken()
        self.need("=")
        values = self.expression()
        if bracket:
            self.need(")")
        return Tree("header", name, (values,))

    def functions(self) -> list[FunctionDefinition]:
        """Read the functions from here on. They all end with `end`, and may hold others, or none does."""
        found, around, behind = list[FunctionDefinition](), list[FunctionDefinition](), False
        while self.word == "function":
            name, arguments, results = self._head()
            start, body = self.at, self.block("end", "function")
            found.append(FunctionDefinition(name, arguments, results, body, start, self.at))
            around.append(found[-1])
            while self.word == "end":
                if not around:
                    raise NotComputed(f"line {self.here.line}: this end ends nothing")
                ended = around.pop()
                for one in found[found.index(ended) + 1 :]:
                    self._check_apart(one, ended, behind)
                self.at += 1
                behind = bool(self.block("end", "function").parts)
        return found

    def _check_apart(self, inner: FunctionDefinition, outer: FunctionDefinition, behind: bool) -> None:
        """Raise NotComputed for a function in another one that shares a variable with it: both would see its changes.

        Arguments and results are the own ones of each.
        """
        bodies = [self.tokens[one.start : one.stop] for one in (inner, outer)]
        used, used_around = ({token.text for token in body if token.kind == "name"} for body in bodies)
        variables = {*outer.arguments, *outer.results, *assigned_by(bodies[0]), *assigned_by(bodies[1])}
        shared = (used & used_around & variables) - {*inner.arguments, *inner.results}
        if shared or behind:
            what = f"shares {min(shared)} with it" if shared else "stands before statements of it"
            raise NotComputed(f"the function {inner.name} in {outer.name} {what}: not translated")

    def _head(self) -> tuple[str, list[str], list[str]]:
        """Read `function [a, b] = name(c, d)`, of which only the name must be there."""
        names: list[list[str]] = [[]]
        self.at += 1
        assigned = False
        while self.here.kind != "end":
            token = self.here
            assigned = assigned or token.text == "="
            if token.text in ("=", "("):
                names.append([])
            elif token.kind == "name":
                names[-1].append(token.text)
            elif token.text == "~":
                names[-1].append(f"#{self.at}")
            self.at += 1
            if token.text == ")" or token.kind == "line" or token.text == ";":
                break
        results = names.pop(0) if assigned else []
        (name, *_), *arguments = names if names and names[0] else [["?"]]
        return name, arguments[0] if arguments else [], results


def _chain(parts: Sequence[Tree]) -> Tree:
    return parts[0] if len(parts) == 1 else Tree("chain", parts=tuple(parts))


def _target(made: Tree) -> Tree:
    """Return a tree as what is assigned, `s.a(2)`. Raises NotComputed for anything else."""
    if made.kind != "access" or made.parts[0].kind != "name":
        raise NotComputed("'=' is not expected")
    return made
