"""What is written in a chart: the actions of a state, the label of a transition, C as MATLAB's language."""

import re
from collections.abc import Callable, Mapping, Set
from typing import Any

from twodof.blocks.expressions.numbers import INTEGER_TYPES
from twodof.slx.model import collapsed
from twodof.slx.translation import NotTranslated

COMMENT = re.compile(r"%[^\n]*|//[^\n]*|/\*.*?\*/", re.DOTALL)
_COMMENT_OR_STRING = re.compile(r'("(?:[^"\n]|"")*")|' + COMMENT.pattern, re.DOTALL)
_CONTINUED = re.compile(r"\.\.\.[^\n]*\n")
_ACTIONS = {"en": "entry", "entry": "entry", "du": "during", "during": "during", "ex": "exit", "exit": "exit"}
_KEYWORD = re.compile(
    r"(?:(?<=\s)|(?<=;)|^)((?:(?:entry|en|during|du|exit|ex|bind|on\s+[^:\n]+)\s*,?\s*)+):", re.MULTILINE
)
AFTER = re.compile(r"\bafter\s*\(([^(),]+),\s*(tick|sec|msec|usec)\s*\)")
SEND = re.compile(r"\bsend\s*\(\s*(\w+)\s*(?:,\s*([\w.]+)\s*)?\)\s*;?")
_EVENTS = re.compile(r"(?:[A-Za-z]\w*(?:\s*\|\s*[A-Za-z]\w*)*)?")
_C = re.compile(
    r"(?:\s|\.\.\.)*(?:(?P<name>[A-Za-z_]\w*)|(?P<number>0[xX][0-9a-fA-F]+(?!\w)|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[fF]?(?!\w))"
    r"|(?P<operator>\+\+|--|<<|>>|[-+*/=!<>~]=|&&|\|\||[-+*/!<>=~&|();,\[\].])|(?P<unknown>\S.*))",
    re.DOTALL,
)
_BINARY = (("||",), ("&&",), ("|",), ("&",), ("==", "!=", "~="), ("<", "<=", ">", ">="), ("<<", ">>"), ("+", "-"),
           ("*", "/"))  # fmt: skip
"""Operators of C from those that bind last to those that bind first."""
_SAME_IN_C = {"abs", "true", "false", "single", "double", "boolean", *INTEGER_TYPES}
"""Functions that mean the same in C and in MATLAB's language."""
DEEPEST = 40  # of signs and brackets within one another
_PLAIN = {"after", "hasChanged", "hasChangedFrom", "hasChangedTo", "send"}
"""Calls whose arguments keep their form."""


def matlab_of(text: str, functions: Set[str], exact: bool, bits: bool, owner: str) -> str:
    """Return an action or a condition of C in MATLAB's language; `functions` are those of the chart.

    Unless `exact`, numbers may be whole: then a literal without a point is one of int32, as in C, and the program that
    carries it out computes as C does. With `bits`, & and | are of bits. Raises NotTranslated for what is not read.
    """
    return _Translation(text, functions, exact, bits, owner).statements()


class _Translation:
    """Reader of C that writes MATLAB's language."""

    def __init__(self, text: str, functions: Set[str], exact: bool, bits: bool, owner: str) -> None:
        self.functions, self.bits, self.owner, self.at, self.depth = functions, bits, owner, 0, 0
        self.tokens = [found[found.lastgroup or 0] for found in _C.finditer(text)]
        self.exact = exact and INTEGER_TYPES.keys().isdisjoint(self.tokens)
        self.one = "1" if self.exact else "int32(1)"

    @property
    def here(self) -> str:
        """The next token, "" at the end."""
        return self.tokens[self.at] if self.at < len(self.tokens) else ""

    def taken(self, *texts: str) -> str:
        """Pass one of these tokens and return it; "" where another one stands."""
        found = self.here if self.here in texts else ""
        self.at += found != ""
        return found

    def refused(self, said: str) -> NotTranslated:
        return NotTranslated(f"{self.owner}: {said} in C is not translated")

    def statements(self) -> str:
        found = list[str]()
        while self.here:
            if not self.taken(";", ","):
                found.append(self._statement())
        return ";\n".join(found)

    def _statement(self) -> str:
        before, start = self.taken("++", "--"), self.at
        if self.here.isidentifier():
            self.at += 1
            place = self._place(self.tokens[start])
            if step := self.taken("++", "--") or before:
                return f"{place} = {place} {step[0]} {self.one}"
            if operator := self.taken("=", "+=", "-=", "*=", "/="):
                value = self._binary(0)
                return f"{place} = {value}" if operator == "=" else f"{place} = {place} {operator[0]} ({value})"
        self.at = start
        return self._binary(0)

    def _binary(self, level: int) -> str:
        """Read operations of this level, and of those that bind before it."""
        if level == len(_BINARY):
            self.depth += 1
            if self.depth > DEEPEST:
                raise self.refused("an expression so deep")
            made = self._unary()
            self.depth -= 1
            return made
        left = self._binary(level + 1)
        while operator := self.taken(*_BINARY[level]):
            right = self._binary(level + 1)
            if operator == "/" and self.exact and left.isdigit() and right.isdigit():
                raise NotTranslated(f"{self.owner}: the quotient of {left} and {right} is whole in C")
            if operator in ("<<", ">>"):
                left = f"bitshift({left}, {'-' * (operator == '>>')}{right})"
            elif operator in ("&", "|") and self.bits:
                left = f"bit{'and' if operator == '&' else 'or'}({left}, {right})"
            else:
                left = f"({left} {({'!=': '~=', '&': '&&', '|': '||'}).get(operator, operator)} {right})"
        return left

    def _unary(self) -> str:
        if sign := self.taken("-", "+", "!", "~"):
            if sign == "~" and self.bits:
                raise self.refused("'~'")
            return f"{'~' if sign == '!' else sign}{self._binary(len(_BINARY))}"
        if self.taken("("):
            made = self._binary(0)
            if not self.taken(")"):
                raise self.refused(repr(self.here[:12]))
            return f"({made})"
        found, token = _C.fullmatch(self.here), self.here
        self.at += 1
        if found is None or found["operator"] or found["unknown"]:
            raise self.refused(repr(token[:12]))
        if found["number"]:
            whole = token.isdigit() or token[:2] in ("0x", "0X")
            number = str(int(token, 0 if token[1:2] in ("x", "X") else 10)) if whole else token.rstrip("fF")
            return f"int32({number})" if whole and not self.exact else number
        return self._place(token)

    def _place(self, name: str) -> str:
        """Read what stands behind a name: a call's arguments, or indices, from 0 on, and fields."""
        if self.here == "(" and name in _PLAIN:
            at, self.at = self.at, self.tokens.index(")", self.at) + 1
            return f"{name}{''.join(self.tokens[at : self.at])}"
        if self.here == "(" and name not in self.functions | _SAME_IN_C:
            raise NotTranslated(f"{self.owner}: {name} is a function in C, or one that the chart does not have")
        made = name
        while step := self.taken("(", "[", "."):
            inside = list[str]()
            if step == ".":
                made = f"{made}.{self.here}"
                self.at += 1
                if self.here == "(":
                    raise self.refused(made)
                continue
            while not self.taken(")", "]"):
                inside.append(self._binary(0) if step == "(" else f"{self._binary(0)} + {self.one}")
                if not self.taken(",") and self.here not in (")", "]"):
                    raise self.refused(repr(self.here[:12]))
                if step == "[" and self.tokens[self.at : self.at + 2] == ["]", "["]:
                    self.at += 2
            made = f"{made}({', '.join(inside)})"
        return made


def without_strings(data: list[Mapping[str, Any]]) -> tuple[list[Mapping[str, Any]], Callable[[str, str], str]]:
    """Return a chart's data with its own strings as whole numbers, and what writes its texts so.

    A string is the number of its literal, and an empty one 0. The writer takes a text and its owner, and raises
    NotTranslated for strings that are neither compared nor assigned alone.
    """
    own = [one["name"] for one in data if one["values"].get("dataType") == "string"]
    if not own or any(one["values"].get("scope") != "LOCAL_DATA" for one in data if one["name"] in own):
        return data, lambda text, owner: text
    numbers = {'""': 0}
    term = rf'(?:"(?:[^"\n]|"")*"|(?<![\w.])(?:{"|".join(own)})(?!\s*[\w.(]))'
    pair = re.compile(rf"(?<![-+*/<>])({term})(\s*(?:[=~!]?=)\s*)({term})(?!\s*[-+*/=<>.(\[{{])")

    def number(text: str) -> str:
        return f"int32({numbers.setdefault(text, len(numbers))})" if text.startswith('"') else text

    def written(text: str, owner: str) -> str:
        bare = _COMMENT_OR_STRING.sub(lambda found: found[1] or "", text)
        if left := re.search(term, pair.sub(" ", bare)):
            raise NotTranslated(f"{owner}: the string {left[0]} is neither compared nor assigned alone")
        return pair.sub(lambda found: f"{number(found[1])}{found[2]}{number(found[3])}", bare)

    made = list[Mapping[str, Any]]()
    for one in data:
        start = one["values"].get("props/initialValue") or '""'
        counted = {"dataType": "int32", "props/initialValue": number(start) if start.startswith('"') else start}
        made.append({**one, "values": {**one["values"], **counted}} if one["name"] in own else one)
    return made, written


def actions_of(text: str, state: str) -> dict[str, str]:
    """Return the actions of a state's label, behind its name."""
    found: dict[str, str] = {}
    bare = COMMENT.sub("", text).lstrip("/ \t")
    parts = _KEYWORD.split(bare)
    if parts[0].strip():
        found["entry"] = parts[0].strip()
    for keywords, action in zip(parts[1::2], parts[2::2], strict=True):
        for keyword in re.split(r"[,\s]+", keywords.strip().strip(",")):
            if keyword not in _ACTIONS:
                raise NotTranslated(f"the action '{keywords.strip()}' of {state} is not translated")
            name = _ACTIONS[keyword]
            found[name] = f"{found.get(name, '')}\n{action.strip()}".strip()
    return found


def label_of(label: str) -> tuple[str, str, str, frozenset[str]]:
    """Return condition, action when it holds, action when it is taken, and events of a transition's label.

    It is read as `event | event [condition] {action} / action`; `after` is a condition.
    """
    text = _CONTINUED.sub(" ", COMMENT.sub("", label)).strip().removesuffix("?")
    event = re.match(r"[^\[{/]*", text)
    assert event is not None
    text = text[event.end() :]
    condition, action, at_end = "", "", ""
    if text.startswith("["):
        condition, text = _bracket(text, "[", "]")
        condition = collapsed(condition)
    if text.startswith("{"):
        action, text = _bracket(text, "{", "}")
    if text.startswith("/"):
        at_end, text = text[1:].strip().removeprefix("{").removesuffix("}"), ""
    said = event[0].strip()
    timed = AFTER.fullmatch(said) is not None
    if text or not (timed or _EVENTS.fullmatch(said)):
        raise NotTranslated(f"the transition {label.strip()[:60]!r}: it is not read")
    if timed:
        condition = f"{said} && ({condition})" if condition else said
    return condition, action, at_end, frozenset(() if timed else re.findall(r"\w+", said))


def _bracket(text: str, opening: str, closing: str) -> tuple[str, str]:
    """Return what is inside the bracket that begins a text, and what follows it."""
    depth = 0
    for at, letter in enumerate(text):
        depth += (letter == opening) - (letter == closing)
        if depth == 0:
            return text[1:at].strip(), text[at + 1 :].strip()
    raise NotTranslated(f"{text[:60]!r} has no {closing}")
