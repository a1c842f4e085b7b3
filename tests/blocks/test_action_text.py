"""Guards and actions as text: they mean what the same functions mean, and a hostile text is refused quickly."""

import time
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.blocks.schema.hostile_machines import machine as machine_file
from twodof.blocks import Diagram, Param, Port, State, maximum, sin, to_real, where
from twodof.blocks.reference import Reference
from twodof.blocks.schema import from_json, to_json
from twodof.blocks.schema.traced_block import nodes_to_json
from twodof.blocks.state_machine import Mode, StateMachine, Transition
from twodof.compile import build
from twodof.compile.builder import emit_program
from twodof.errors import DiagramError

pytestmark = pytest.mark.slow


class Written(StateMachine):
    """A damper with an outer mode, whose guards and actions are functions."""

    inputs = (Port("v", unit="m/s"), Port("on", "bool"))
    outputs = (Port("y"), Port("mode", "int32"))
    params = (Param("least", 0.1),)
    variables = (State("n", 0, "int32"), State("worst"))
    modes: Any = (
        Mode("idle", during={"y": 0.0}),
        Mode(
            "active",
            inner=[
                Mode("push", during=lambda u, x, p: {"y": -2.0 * u.v + to_real(x.n) / 3.0 * p.least}),
                Mode(
                    "hold",
                    during=lambda u, t: {"y": where(t.elapsed_time > 0.05, sin(u.v), 1.0 / 3.0)},
                    exit=lambda x, u: {"worst": maximum(x.worst, abs(u.v))},
                ),
            ],
            entry=lambda x: {"n": x.n + 1, "worst": to_real(x.n + 1) * 0.5},
        ),
    )
    transitions: Any = (
        Transition("active", "idle", lambda u: ~u.on | (u.v < -5.0)),
        Transition("idle", "active", lambda u, p, t: (u.v > p.least) & (t.elapsed >= 3), lambda: {"worst": 0.0}),
        Transition("push", "hold", lambda u, t: (u.v >= 0.2) & (u.v < 2.0) & (t.elapsed_time >= 0.03)),
        Transition("hold", "push", lambda u, x: (x.n % 2 == 0) & ~((u.v > 1.0) | u.on)),
    )


IDLE, ACTIVE = Written.modes
TEXT_MODES = (
    Mode("idle", during="y = 0.0", position=(10.0, 20.5)),
    Mode(
        "active",
        inner=[
            Mode("push", during="y = -2.0 * v + to_real(n) / 3.0 * least"),
            Mode(
                "hold",
                during="y = sin(v) if elapsed_time > 0.05 else 1.0 / 3.0",
                exit="worst = max(worst, abs(v))",
                position=(300.0, -40.0),
            ),
        ],
        entry="n += 1; worst = to_real(n) * 0.5",
    ),
)
TEXT_TRANSITIONS = (
    Transition("active", "idle", "not on or v < -5.0"),
    Transition("idle", "active", "v > least and after(3)", "worst = 0.0"),
    Transition("push", "hold", "0.2 <= v < 2.0 and after(0.03, sec)"),
    Transition("hold", "push", "n % 2 == 0 and not (v > 1.0 or on)"),
)


def written(**changes: Any) -> StateMachine:
    made: StateMachine = type("Written", (Written,), {"__module__": __name__, **changes})()
    return made


def alone(block: StateMachine) -> Diagram:
    d = Diagram("damper")
    d.input("v", unit="m/s")
    d.input("on", "bool")
    d.add("machine", block, v="v", on="on")
    d.output("y", "machine.y")
    d.output("mode", "machine.mode")
    return d


def as_text() -> StateMachine:
    return written(modes=TEXT_MODES, transitions=TEXT_TRANSITIONS)


def test_a_machine_of_texts_gives_the_same_c_and_the_same_bits() -> None:
    functions, texts = alone(written()), from_json(to_json(alone(as_text())))
    source = emit_program(texts, 0.01).source.replace("TracedMachine", "Written")  # a comment has the name of the class
    assert source == emit_program(functions, 0.01).source
    rows = [{"v": 0.37 * k % 3.1 - 0.8, "on": k % 23 > 2} for k in range(120)]
    machines = [Reference(functions, 0.01).machine(), Reference(texts, 0.01).machine(), build(texts, 0.01).machine()]
    found = [[machine.step(row) for row in rows] for machine in machines]
    assert found[0] == found[1] == found[2]
    assert {row["mode"] for row in found[0]} == {0, 1, 2}


def test_texts_and_places_stay_in_the_file() -> None:
    text = to_json(alone(as_text()))
    assert to_json(from_json(text)) == text
    assert '"when": "0.2 <= v < 2.0 and after(0.03, sec)"' in text
    assert '"position": [300.0, -40.0]' in text
    assert '"nodes": []' in text


Pair = tuple[str, str]
"""An expression as a text, and as Python writes it in a function."""


def _joined(pairs: list[Pair], text: str, python: str) -> Pair:
    return "(" + f" {text} ".join(a for a, _ in pairs) + ")", "(" + f" {python} ".join(b for _, b in pairs) + ")"


def _numbers() -> st.SearchStrategy[Pair]:
    literals = st.floats(-1e3, 1e3, allow_nan=False).map(lambda v: (repr(v), repr(v)))
    names = st.sampled_from([("v", "u.v"), ("worst", "x.worst"), ("least", "p.least"), ("elapsed_time",) * 2])
    names = names.map(lambda pair: (pair[0], "t.elapsed_time") if pair[0] == "elapsed_time" else pair)

    def larger(inner: st.SearchStrategy[Pair]) -> st.SearchStrategy[Pair]:
        sums = st.tuples(st.sampled_from("+-*"), inner, inner).map(lambda s: _joined([*s[1:]], s[0], s[0]))
        called = st.tuples(st.sampled_from(["sin", "abs", "-"]), inner)
        return sums | called.map(lambda c: (f"{c[0]}({c[1][0]})", f"{c[0]}({c[1][1]})"))

    return st.recursive(names | literals, larger, max_leaves=6)


def _conditions() -> st.SearchStrategy[Pair]:
    compared = st.tuples(st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), _numbers(), _numbers())
    waited = st.integers(0, 99).map(lambda n: (f"after({n})", f"(t.elapsed >= {n})"))
    leaves = compared.map(lambda c: _joined([*c[1:]], c[0], c[0])) | waited | st.just(("on", "u.on"))

    def larger(inner: st.SearchStrategy[Pair]) -> st.SearchStrategy[Pair]:
        both = st.tuples(st.sampled_from([("and", "&"), ("or", "|")]), inner, inner)
        negated = inner.map(lambda pair: (f"(not {pair[0]})", f"~({pair[1]})"))
        return both.map(lambda b: _joined([*b[1:]], *b[0])) | negated

    return st.recursive(leaves, larger, max_leaves=5)


@settings(max_examples=60, deadline=None)
@given(_conditions(), _numbers())
def test_a_text_records_what_the_same_function_records(condition: Pair, number: Pair) -> None:
    names = {"sin": sin, "abs": abs}
    guard = eval(f"lambda u, x, p, t: ({condition[1]}) | (u.v > 1e9)", names)
    value = eval(f"lambda u, x, p, t: {{'worst': {number[1]} + p.least}}", names)
    outcomes = []
    for when, do in ((guard, value), (f"{condition[0]} or v > 1e9", f"worst = {number[0]} + least")):
        first, *others = TEXT_TRANSITIONS
        changed = [first, Transition("idle", "active", when, do), *others[1:]]
        try:
            graph = written(modes=TEXT_MODES, transitions=changed).graph
        except DiagramError as error:  # such as a guard that is always true
            outcomes.append((error.what, error.remedy))
        else:
            outcomes.append(nodes_to_json([graph.guards[1], *graph.does[1].values()])[0])  # type: ignore[arg-type]
    assert outcomes[0] == outcomes[1]


WRONG_GUARDS: dict[str, str] = {
    "speed > 1.0": "column 1: unknown name 'speed' (there are: ",
    "v > 1.0 and v": "column 13: this is a real, and not true or false (compare it, as in v > 0.0)",
    "v = 1.0": "column 1: a guard is one condition (compare with ==; assign in an action)",
    "on and": "column 7: it cannot be read: invalid syntax",
    "on and (v > 1.0 or y > 2.0)": "column 20: unknown name 'y'",
    "v ** 2 > 1.0": "column 1: 'v ** 2' cannot stand in a text (write x * x, or pow(x, y))",
    "on & on": "column 1: 'on & on' cannot stand in a text (write `and`)",
    "after(0.5)": "column 1: 0.5 ticks (write after(25) for ticks, or after(0.5, sec))",
    "on or sinus(v) > 0.0": "column 7: no function named 'sinus' (there are: sin,",
    "v > 1.0 and 1 / 0 > v": "column 13: division by zero",
    "v.real > 0.0": "column 1: the field 'real' of what is not a bus",
    "v > 1.0 \u2227 on": "column 9: the character '\u2227' (write ASCII characters)",
    "n > 0.5": "column 1: the literal 0.5 meets int32 in one operation",
}


@pytest.mark.parametrize("guard", WRONG_GUARDS)
def test_a_wrong_guard_is_named_with_its_transition_and_column(guard: str) -> None:
    changed = [TEXT_TRANSITIONS[0], Transition("idle", "active", guard), *TEXT_TRANSITIONS[2:]]
    with pytest.raises(DiagramError) as raised:
        to_json(alone(written(modes=TEXT_MODES, transitions=changed)))
    assert f"block Written, when of idle -> active, {WRONG_GUARDS[guard]}" in str(raised.value)


@pytest.mark.parametrize(
    ("action", "complaint"),
    [
        ("y", "during of idle, column 1: an action assigns values (write such as y = 0.0; n = n + 1)"),
        ("y = 0.0; n = v", "during of idle, column 10: 'n': real meets int32 in one operation"),
        ("v = 1.0; y = 0.0", "during of idle gives 'v', which is not declared (it may give: n, worst, y)"),
        ("n = 1", "the output 'y' is not given in idle"),
        ("y = 0.0\nimport os", "during of idle, line 2, column 1: an action assigns values"),
        ("y = y + 1.0", "during of idle, column 5: unknown name 'y'"),
    ],
)
def test_a_wrong_action_is_named_with_its_mode(action: str, complaint: str) -> None:
    with pytest.raises(DiagramError) as raised:
        to_json(alone(written(modes=(Mode("idle", during=action), TEXT_MODES[1]), transitions=TEXT_TRANSITIONS)))
    assert complaint in str(raised.value)


HOSTILE: dict[str, tuple[str, str]] = {
    "an import": ("__import__('os').system('ls') == 0", "column 1: .* cannot stand in a text"),
    "an attribute of a class": ("b.__class__.__base__ == 0", "the field '__class__' of what is not a bus"),
    "a comprehension": ("[u for u in b][0]", "cannot stand in a text"),
    "a lambda": ("(lambda: b)()", "cannot stand in a text"),
    "a walrus": ("(u := 1.0) > 0.0", "cannot stand in a text"),
    "a string": ("u > 'a' * 999999999", "cannot stand in a text"),
    "an argument by name": ("sin(x=u) > 0.0", "cannot stand in a text"),
    "an endless power": ("9 ** 9 ** 9 ** 9 > u", "write x \\* x, or pow"),
    "a shift": ("1 << 999999999 > u", "cannot stand in a text"),
    "a long number": ("9" * 900 + " > u", "this number is too large"),
    "an infinite number": ("1e999 > u", "this number is too large"),
    "brackets": ("(" * 300 + "b" + ")" * 300, "too many nested parentheses"),
    "lists": ("[" * 190 + "b" + "]" * 190, "cannot stand in a text"),
    "signs": ("-" * 900 + "u > 0", "more than 40 operations within one another"),
    "negations": ("not " * 200 + "b", "more than 40 operations within one another"),
    "choices": ("b if b else " * 80 + "b", "more than 40 operations within one another"),
    "a thousand and one characters": ("b" * 1001, "a text of 1001 characters .at most 1000"),
    "a million characters": ("u" * 10**6, "more than 100000 characters of guards and actions"),
    "a zero byte": ("b\0", "null bytes"),
    "a letter that looks like another": ("\u0432 > 0", "the character"),
    "a keyword in a number": ("0x1for u in b", "invalid hexadecimal literal"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_text_is_refused_quickly(name: str) -> None:
    text, complaint = HOSTILE[name]
    modes = [{"name": "off", "during": "y = 0.0"}, {"name": "on", "during": "y = 1.0"}]
    ways = [{"from": "off", "to": "on", "when": text}, {"from": "on", "to": "off", "when": "not b"}]
    data = machine_file(modes=modes, transitions=ways, nodes=[])
    start = time.process_time()
    with pytest.raises(DiagramError, match=complaint) as raised:
        from_json(data)
    # Each takes some ms; a reader that follows a text takes seconds or for ever.
    assert time.process_time() - start < 0.5
    assert len(str(raised.value)) < 500


@pytest.mark.parametrize("part", ["(u > 0.1 and not b)", "0.1 + 0.2 + 0.3 > 1.0"])
def test_many_long_texts_are_judged_within_two_seconds(part: str) -> None:
    """Fifty texts of up to 900 characters; each guard is followed out of 19 modes."""
    long = "x = 1.5; " * 100
    inner = [{"name": f"m{k}", "during": "y = 0.0", "entry": long, "exit": long} for k in range(19)]
    guard = " or ".join([part] * 30)
    ways = [{"from": "all", "to": f"m{k % 19}", "when": f"u < {k}.0 and ({guard})"} for k in range(24)]
    data = machine_file(modes=[{"name": "all", "inner": inner}], transitions=ways, nodes=[])
    start = time.process_time()
    from_json(data)
    # What any file may take (docs/reference/diagram-files.md).
    assert time.process_time() - start < 2.0
