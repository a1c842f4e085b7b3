"""What is written in a chart: the actions of a state, the label of a transition, C as MATLAB's language."""

import re
from itertools import pairwise

from twodof.blocks.expressions.numbers import INTEGER_TYPES
from twodof.slx.model import collapsed
from twodof.slx.translation import NotTranslated

COMMENT = re.compile(r"%[^\n]*|//[^\n]*|/\*.*?\*/", re.DOTALL)
_CONTINUED = re.compile(r"\.\.\.[^\n]*\n")
_ACTIONS = {"en": "entry", "entry": "entry", "du": "during", "during": "during", "ex": "exit", "exit": "exit"}
_KEYWORD = re.compile(
    r"(?:(?<=\s)|(?<=;)|^)((?:(?:entry|en|during|du|exit|ex|bind|on\s+[^:\n]+)\s*,?\s*)+):", re.MULTILINE
)
AFTER = re.compile(r"\bafter\s*\(([^(),]+),\s*(tick|sec|msec|usec)\s*\)")
SEND = re.compile(r"\bsend\s*\(\s*(\w+)\s*(?:,\s*([\w.]+)\s*)?\)\s*;?")
_EVENTS = re.compile(r"(?:[A-Za-z]\w*(?:\s*\|\s*[A-Za-z]\w*)*)?")
_C = re.compile(
    r"(?P<space>\s+|\.\.\.\s*)|(?P<name>[A-Za-z_]\w*)|(?P<number>\d+\.?\d*(?:[eE][+-]?\d+)?(?!\w)|\.\d+)"
    r"|(?P<operator>\+\+|--|[-+*/]=|==|!=|~=|<=|>=|>>|&&|\|\||[-+*/!<>=();,\[\].])"
)
_PLACE_OF = r"([\w.]+(?:\([^()]*(?:\(\d+\)[^()]*)*\))?){}"
"""A name, perhaps with an index, and what stands behind it."""
_SAME_IN_C = {"after", "hasChanged", "hasChangedFrom", "hasChangedTo", "abs", "true", "false", *INTEGER_TYPES}
"""Functions that mean the same in C and in MATLAB's language."""
_PLAIN_NUMBERS = {"after", "hasChanged", "hasChangedFrom", "hasChangedTo"}
"""Calls whose literals keep their form."""


def matlab_of(text: str, functions: set[str], exact: bool, owner: str) -> str:
    """Return an action or a condition of C in MATLAB's language; `functions` are those of the chart.

    Unless `exact`, numbers may be whole: then a literal without a point is one of int32, as in C, and the program that
    carries it out computes as C does. Raises NotTranslated where the two languages differ otherwise.
    """
    tokens, at = list[str](), 0
    while at < len(text):
        found = _C.match(text, at)
        if found is None:
            raise NotTranslated(f"{owner}: {text[at : at + 12]!r} in C is not translated")
        tokens.append(found[0])
        at = found.end()
    exact = exact and INTEGER_TYPES.keys().isdisjoint(tokens)
    solid = [k for k, one in enumerate(tokens) if one.strip(" .\t\n") or one == "."]
    words = [tokens[k] for k in solid]
    calls = list[str]()
    for k, (one, after) in enumerate(pairwise([*words, ""])):
        before = words[k - 1] if k else ""
        if after == "(" and one.isidentifier() and one not in functions | _SAME_IN_C and before != ".":
            raise NotTranslated(f"{owner}: {one} is a function in C, or one that the chart does not have")
        if one in ("++", "--") and not before.isidentifier() and before != "]":
            raise NotTranslated(f"{owner}: {one} before a name in C is not translated")
        if one in ("if", "for", "while", "return", "ml") or (after == "(" and before == "." and one.isidentifier()):
            raise NotTranslated(f"{owner}: {one} in C is not translated")
        if exact and one == "/" and before.isdigit() and after.isdigit():
            raise NotTranslated(f"{owner}: the quotient of {before} and {after} is whole in C")
        # All but these bind before a shift.
        alone = {*words[max(k - 2, 0) : k - 1], *words[k + 2 : k + 3]} <= {"=", "(", ")", ",", ";", "&&", "||"}
        shift = one == ">>" and not (alone and before.isidentifier() and after.isdigit())
        if one in ("/=", "*=") or (one == "[" and before == "]") or shift:
            raise NotTranslated(f"{owner}: {one!r} in C is not translated")
        calls += [before] if one == "(" else []
        calls = calls[:-1] if one == ")" else calls
        if one.isdigit() and not exact and not {*calls} & _PLAIN_NUMBERS:
            tokens[solid[k]] = f"int32({one})"
    if re.search(r"[=!]=[^&|()]*[<>]|[<>][^&|()]*[=!]=", text):
        raise NotTranslated(f"{owner}: == beside < in C is not translated")
    step = "1" if exact else "int32(1)"
    forms = {"!": "~", "!=": "~=", "[": "(", "]": f" + {step})"}  # an index is from 0 on
    made = "".join(forms.get(one, one) for one in tokens)
    made = re.sub(r"(\w+)\s*>>\s*int32\((\d+)\)", r"bitshift(\1, -\2)", made)
    made = re.sub(_PLACE_OF.format(r"\s*(\+\+|--)"), lambda m: f"{m[1]} = {m[1]} {m[2][0]} {step}", made)
    return re.sub(_PLACE_OF.format(r"\s*([-+])=\s*([^;,\n]*)"), r"\1 = \1 \2 (\3)", made)


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
