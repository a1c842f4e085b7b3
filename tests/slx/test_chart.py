"""Stateflow charts: sequences derived by hand from Stateflow's rules, each action written into a log of digits."""

import itertools
import math
import random
import subprocess
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape

import numpy as np
import pytest

from tests import toolchains
from tests.slx.files import Blocks, Lines, model, slx
from twodof.blocks.schema import from_json, to_json
from twodof.compile import build
from twodof.slx.importer import Imported, import_system
from twodof.slx.model import read_model

DT = 0.01
REAL = {"OutDataTypeStr": "double", "PortDimensions": "1"}


def said(digit: int) -> str:
    """The action that writes a digit."""
    return f"log = mod(log*10 + {digit}, 1e12);"


def state(number: int, label: str, inside: str = "", kind: str = "OR_STATE", order: int = 0, **values: str) -> str:
    """A state's XML."""
    given = {"labelString": label, "type": kind, **({"executionOrder": str(order)} if order else {}), **values}
    text = "".join(f'<P Name="{name}">{escape(value)}</P>' for name, value in given.items())
    return f'<state SSID="{number}">{text}<Children>{inside}</Children></state>'


def way(number: int, source: int | None, target: int, label: str = "", order: int = 1) -> str:
    """A transition's XML; a default transition has no source."""
    begin = "<src/>" if source is None else f'<src><P Name="SSID">{source}</P></src>'
    return (
        f'<transition SSID="{number}"><P Name="labelString">{escape(label)}</P>{begin}'
        f'<dst><P Name="SSID">{target}</P></dst><P Name="executionOrder">{order}</P></transition>'
    )


def junction(number: int) -> str:
    """A junction's XML."""
    return f'<junction SSID="{number}"><P Name="type">CONNECTIVE_JUNCTION</P></junction>'


def data(name: str, scope: str, kind: str = "double", initial: str = "", size: str = "1") -> str:
    """The XML of a chart's data."""
    props = f'<props><array><P Name="size">{size}</P></array><P Name="initialValue">{initial}</P></props>'
    typed = f'<P Name="scope">{scope}_DATA</P><P Name="dataType">{kind}</P>'
    return f'<data SSID="9{len(name)}" name="{name}">{typed}{props}</data>'


def chart(
    folder: Path, parts: str, *extra: str, settings: str = "", outputs: tuple[str, ...] = ("log",), braces: bool = False
) -> Imported:
    """Import a model with a chart of the inputs u and v and these outputs. `braces`: as in a .mdl of braces."""
    names = ["u", "v"]
    inner: Blocks = [("Inport", name, {"Port": str(k)}) for k, name in enumerate(names, start=1)]
    inner += [("Outport", name, {"Port": str(k)}) for k, name in enumerate(outputs, start=1)]
    blocks: Blocks = [("Inport", name, {"Port": str(k), **REAL}) for k, name in enumerate(names, start=1)]
    blocks += [
        ("SubSystem", "chart", {"SFBlockType": "Chart", "Ports": f"[2, {len(outputs)}]"}, (inner, [])),
        *(("Outport", f"y_{name}", {"Port": str(k)}) for k, name in enumerate(outputs, start=1)),
    ]
    lines: Lines = [("u", "chart:1"), ("v", "chart:2")]
    lines += [(f"chart:{k}", f"y_{name}") for k, name in enumerate(outputs, start=1)]
    held = [data("u", "INPUT"), data("v", "INPUT"), *([data("log", "OUTPUT")] if "log" in outputs else []), *extra]
    head = '<P Name="name">chart</P><P Name="actionLanguage">2</P>' if "actionLanguage" not in settings else ""
    if "saturate" not in settings:
        head += '<P Name="saturateOnIntegerOverflow">1</P>'
    body = f'<chart id="9">{head}{settings}<Children>{parts}{"".join(held)}</Children></chart>'
    part = {"simulink/stateflow.xml": beside(body)} if braces else {"simulink/stateflow/chart_9.xml": body}
    files = {**model(blocks, lines), **part}
    return import_system(read_model(slx(files, folder / "m.slx")), dt=DT)


def beside(body: str) -> str:
    """The parts of a chart beside each other, as in a .mdl of braces: each has the number of what it is inside."""
    made, parts, count = "", [(ElementTree.fromstring(body), "0")], itertools.count(100)
    for part, within in parts:
        number = str(next(count)) if part.tag in ("chart", "data") else part.attrib["SSID"]
        for held in part.findall("Children"):
            parts += [(one, number) for one in held]
            part.remove(held)
        for end in (*part.iterfind("src/P"), *part.iterfind("dst/P")):
            end.set("Name", "id")
        for name, text in {"id": number, "linkNode": f"[{within} 0 0]", "name": part.get("name", "chart")}.items():
            ElementTree.SubElement(part, "P", Name=name).text = text
        part.attrib.clear()
        made += ElementTree.tostring(part, "unicode")
    return f"<Stateflow>{made}</Stateflow>"


def flown(found: Imported, u: list[float], v: list[float] | None = None) -> dict[str, np.ndarray]:
    """What the imported diagram gives, after a round trip through JSON."""
    assert found.diagram is not None, found.refused
    machine = build(from_json(to_json(found.diagram)), dt=found.dt).machine()
    return machine.run(len(u), {"u": np.array(u), "v": np.array(v or [0.0] * len(u))})


def assert_log(found: Imported, ticks: list[tuple[float, float, str]]) -> None:
    """Compare the log after each tick: u, v and the digits of the actions of the tick."""
    got = flown(found, [u for u, _, _ in ticks], [v for _, v, _ in ticks])["y_log"]
    written = ""
    for k, (_, _, digits) in enumerate(ticks):
        written += digits
        assert got[k] == float(written[-12:] or "0"), (k, digits, got[k])


AT_START = '<P Name="executeAtInitialization">1</P>'
NESTED = [
    state(1, f"A\nentry: {said(1)}\nduring: {said(2)}\nexit: {said(3)}"),
    state(
        2,
        f"B\nen: {said(4)} du: {said(5)}\nex: {said(6)}",
        state(3, f"B1\n{said(7)}\nduring: {said(8)}; exit: {said(9)}")
        + state(4, f"B2\nen, du: {said(1)}")
        + way(11, None, 3)
        + way(12, 3, 4, "after(2, tick)"),
    ),
    way(13, None, 1),
    way(14, 1, 2, f"[u > 0]{{{said(8)}}}/{said(9)}"),
    way(15, 2, 1, "[u < 0]"),
]


@pytest.mark.parametrize("braces", [False, True])
def test_nested_states_act_in_stateflows_order(tmp_path: Path, braces: bool) -> None:
    ticks = [
        (1.0, 0.0, "1"),  # the default transition only, though u > 0 and A has a during action
        (0.0, 0.0, "2"),
        (1.0, 0.0, "83947"),  # condition action, exit A, transition action, entry B, entry B1; no during
        (0.0, 0.0, "58"),  # one tick in B1
        (0.0, 0.0, "591"),  # during B before the transition inside it; exit B1, entry B2
        (0.0, 0.0, "51"),
        (-1.0, 0.0, "61"),  # B2 has no exit: exit B, entry A; nothing inside B acts
        (1.0, 0.0, "83947"),
        (-1.0, 0.0, "961"),  # from the inside out
    ]
    assert_log(chart(tmp_path, "".join(NESTED), braces=braces), ticks)


def test_a_call_of_a_subsystem_is_true_in_its_tick(tmp_path: Path) -> None:
    parts = [state(1, "A\nduring: call;"), state(2, "B"), way(11, None, 1), way(12, 1, 2, "[u > 0]{send(call)}")]
    parts += [way(13, 2, 1, "[u < 0]")]
    call = '<event SSID="5" name="call">' + "".join(
        f'<P Name="{name}">{value}</P>'
        for name, value in (("scope", "OUTPUT_EVENT"), ("trigger", "FUNCTION_CALL_EVENT"))
    )
    found = chart(tmp_path, "".join(parts), f"{call}</event>", outputs=("call()",))
    (called,) = flown(found, [0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0]).values()
    assert called.tolist() == [False, True, True, False, False, True, True]
    assert any("acts once in a tick, after the chart" in line.why for line in found.report)


def event(number: int, name: str) -> str:
    """A local event's XML."""
    typed = f'<P Name="name">{name}</P><P Name="scope">LOCAL_EVENT</P><P Name="trigger">FUNCTION_CALL_EVENT</P>'
    return f'<event SSID="{number}">{typed}</event>'


def test_an_event_that_is_an_edge_turns_its_output_once_a_tick(tmp_path: Path) -> None:
    """Those that are sent beside it wait for the ticks after it, as in MathWorks' code."""
    event = '<event name="E"><P Name="scope">OUTPUT_EVENT</P><P Name="trigger">EITHER_EDGE_EVENT</P></event>'
    parts = state(1, "A") + way(11, None, 1) + way(12, 1, 1, "[u > 0]{send(E);}/if v > 0, send(E); end") + event
    got = flown(chart(tmp_path, parts, outputs=("E",)), [1.0, 1, 0, 1, 1, 0, 0, 0], [0.0, 0, 0, 1, 1, 0, 0, 0])
    assert got["y_E"].tolist() == [False, True, True, False, True, False, True, True]


def test_a_state_acts_at_once_on_an_event_sent_to_it(tmp_path: Path) -> None:
    sender = [
        state(11, f"Idle\nentry: {said(1)} send(E, Other);"),
        state(12, f"Sent\nentry: {said(3)}"),
        way(21, None, 11),
        way(22, 11, 12, f"[u > 0]{{{said(2)} send(E, Other);}}"),
        way(23, 12, 11, "[u < 0]"),
    ]
    receiver = [
        state(13, f"Waits\nduring: {said(4)}"),
        state(14, f"Acts\nentry: {said(5)}"),
        way(24, None, 13),
        way(25, 13, 14, "F | E"),
        way(26, 14, 13, "E[u < 0]"),
    ]
    parts = [
        state(1, "Sender", "".join(sender), "AND_STATE", 1),
        state(2, "Other", "".join(receiver), "AND_STATE", 2),
        event(31, "E"),
        event(32, "F"),
    ]
    found = chart(tmp_path, "".join(parts), settings='<P Name="decomposition">SET_CHART</P>')
    got = flown(found, [0.0, 0, 1, 0, -1, 0])["y_log"].tolist()
    assert got == [1, 14, 14253, 14253, 1425314, 14253144]


@pytest.mark.parametrize("sent", ["send(E);", "send(E, One);", "send(E, Inner);"])
def test_an_event_to_a_state_that_is_not_beside_the_sender_is_refused(tmp_path: Path, sent: str) -> None:
    inner = state(3, f"Inner\nentry: {sent}") + way(4, None, 3)
    parts = state(1, "One", inner, "AND_STATE", 1) + state(2, "Two", "", "AND_STATE", 2) + event(5, "E")
    (refused, *_) = chart(tmp_path, parts, settings='<P Name="decomposition">SET_CHART</P>').refused
    assert f"entry of Inner: {sent} is not an event to a parallel state beside it" in refused.why


def test_a_change_is_one_since_the_tick_before(tmp_path: Path) -> None:
    """Of the only state, which needs no default transition; a condition goes on behind three dots."""
    inner = [
        state(3, f"B\nentry: {said(2)}"),
        state(4, f"C\nentry: {said(3)}"),
        way(11, None, 3),
        way(12, 3, 4, "[hasChanged(u) ...\n && hasChangedTo(v, 1)]"),
        way(13, 4, 3, "[hasChangedFrom(u, 2)]"),
    ]
    ticks = [(1.0, 1.0, "12"), (1.0, 1.0, ""), (2.0, 1.0, ""), (3.0, 0.0, ""), (2.0, 1.0, "3"), (2.0, 1.0, ""),
             (3.0, 1.0, "2")]  # fmt: skip
    assert_log(chart(tmp_path, state(1, f"A\nentry: {said(1)}", "".join(inner))), ticks)


def test_conditions_at_junctions_lead_back_and_their_actions_stay(tmp_path: Path) -> None:
    parts = [
        state(1, f"A\nduring: {said(1)}"),
        state(2, f"B\nentry: {said(2)}"),
        state(3, f"C\nentry: {said(3)}"),
        junction(4),
        way(11, None, 1),
        way(12, 1, 4, f"[u > 0]{{{said(4)}}}", 1),
        way(13, 4, 2, f"[v > 0]{{{said(5)}}}/{said(6)}", 1),
        way(14, 4, 3, "[v < -1]", 2),
        way(15, 1, 3, f"[u > 5]{{{said(7)}}}", 2),
        way(16, 2, 1, f"/{said(8)}"),
        way(17, 3, 1),
    ]
    ticks = [
        (1.0, 1.0, ""),
        (1.0, 0.0, "41"),  # no way on from the junction: A stays, and its during action acts
        (1.0, 1.0, "4562"),
        (0.0, 0.0, "8"),  # B is left at once; A has no entry action
        (9.0, 0.0, "473"),  # back from the junction to the second transition
        (0.0, 0.0, ""),
        (1.0, -2.0, "43"),
    ]
    assert_log(chart(tmp_path, "".join(parts)), ticks)


def test_inner_and_self_transitions_enter_what_they_left(tmp_path: Path) -> None:
    inside = [
        state(2, f"P1\nentry: {said(1)}\nduring: {said(2)}\nexit: {said(3)}"),
        state(3, f"P2\nentry: {said(4)}\nexit: {said(5)}"),
        way(11, None, 2),
        way(12, 1, 3, "[u > 1]"),  # drawn inside P: an inner transition
    ]
    parts = [
        state(1, f"P\nentry: {said(6)}\nduring: {said(7)}\nexit: {said(8)}", "".join(inside)),
        way(13, None, 1),
        way(14, 1, 1, "[u < -1]"),
    ]
    ticks = [
        (2.0, 0.0, "61"),
        (0.0, 0.0, "72"),
        (2.0, 0.0, "734"),  # during P, then the inner transition: P1 to P2, P is not left
        (2.0, 0.0, "754"),
        (-2.0, 0.0, "5861"),  # P itself: left and entered, with its default
    ]
    assert_log(chart(tmp_path, "".join(parts)), ticks)


def test_a_chart_entered_at_initialization_acts_in_the_first_tick(tmp_path: Path) -> None:
    found = chart(tmp_path, "".join(NESTED).replace("after(2, tick)", "[v &gt; 0]"), settings=AT_START)
    assert_log(found, [(0.0, 0.0, "12"), (1.0, 0.0, "83947"), (0.0, 1.0, "591")])


def test_parallel_states_act_in_their_order(tmp_path: Path) -> None:
    def one(number: int, name: str, order: int, digit: int) -> str:
        inside = (
            state(number + 1, f"{name}off\nduring: {said(digit)}")
            + state(number + 2, f"{name}on\nentry: {said(digit + 1)}")
            + way(number + 3, None, number + 1)
            + way(number + 4, number + 1, number + 2, "[u > 0]")
            + way(number + 5, number + 2, number + 1, "[v > 0]")
        )
        return state(number, f"{name}\nentry: {said(9)}", inside, "AND_STATE", order)

    parts = one(20, "late", 2, 3) + one(10, "early", 1, 1)
    found = chart(tmp_path, parts, settings='<P Name="decomposition">SET_CHART</P>')
    assert_log(found, [(1.0, 0.0, "99"), (0.0, 0.0, "13"), (1.0, 0.0, "24"), (0.0, 1.0, ""), (0.0, 0.0, "13")])


def test_seconds_types_constants_and_functions(tmp_path: Path) -> None:
    script = "function r = twice(a)\nr = 2*a;\nend"
    label = '<P Name="labelString">r = twice(a)</P><P Name="type">FUNC_STATE</P>'
    function = f'<state SSID="3">{label}<eml><P Name="script">{script}</P></eml></state>'
    parts = [
        state(1, "Wait\nduring: n = n + 100; x = twice(x) + STEP;"),
        state(2, "Done\nentry: x(1) = -1; flag = true;"),
        function,
        way(11, None, 1, "{x = u;}"),
        way(12, 1, 2, "[after(25, msec) && u > 0]"),
        way(13, 2, 1, "after(0.02, sec)/n = 7;"),
    ]
    extra = [data("n", "OUTPUT", "uint8", "3"), data("x", "OUTPUT"), data("flag", "OUTPUT", "boolean")]
    found = chart(
        tmp_path, "".join(parts), *extra, data("STEP", "CONSTANT", "double", "0.5"), outputs=("n", "x", "flag")
    )
    got = flown(found, [1.0, 1, 1, 1, 1, 1, 1])
    # 25 ms are 2.5 ticks: the third tick after the entry leaves; 20 ms are two.
    assert got["y_n"].tolist() == [3, 103, 203, 203, 203, 7, 107]
    assert got["y_n"].dtype == np.uint8
    assert got["y_x"].tolist() == [1.0, 2.5, 5.5, -1.0, -1.0, -1.0, -1.5]
    assert got["y_flag"].tolist() == [0, 0, 0, 1, 1, 1, 1]


BUMP = [  # r = a + n where a > 1, and n counts how often
    state(
        5,
        "r = bump(a)",
        way(51, None, 52)
        + junction(52)
        + junction(53)
        + way(54, 52, 53, "[a > 1]{r = a + n; n = n + 1;}")
        + data("a", "FUNCTION_INPUT")
        + data("r", "FUNCTION_OUTPUT", "uint8"),
        kind="FUNC_STATE",
    ),
    data("n", "OUTPUT"),
]


STRINGS = data("mode", "LOCAL", "string", '"low"'), data("last", "LOCAL", "string")


@pytest.mark.parametrize("language", [1, 2])
def test_strings_of_a_chart_are_compared_and_assigned(tmp_path: Path, language: int) -> None:
    script = f'function f()\n% "twice" is no string\nif mode == "high" && last ~= "mid"\n {said(5)}\nend'
    function = (
        f'<state SSID="6"><P Name="labelString">f</P><P Name="type">FUNC_STATE</P><eml><P Name="isEML">1</P>'
        f'<P Name="script">{escape(script)}</P></eml><Children/></state>'
    )
    parts = [
        state(1, f'A\nen: {said(1) if language == 2 else "log = 1;"} du: last = mode; mode = "high"; f(); // "a"'),
        state(2, 'B\nen: mode = ""; du: last = "mid"; f();'),
        way(3, None, 1, '[mode == "low"]'),
        way(4, 1, 2, '[last == "high" && u > 0]'),
        way(5, 2, 1, '[last != "" && mode == "" && u < 0]' if language == 1 else '[last ~= "" && mode == "" && u < 0]'),
    ]
    settings = f'<P Name="name">chart</P><P Name="actionLanguage">{language}</P>'
    found = chart(tmp_path, "".join([*parts, function]), *STRINGS, settings=settings)
    assert list(flown(found, [0.0, 0.0, 1.0, 1.0, 0.0, -1.0])["y_log"]) == [
        1,
        15,
        155,
        155,
        155,
        [1551, 1][language == 1],
    ]


@pytest.mark.parametrize("action", ['mode = last + "a";', "u1 = strlength(mode);", 'mode = strcat(last, "a");'])
def test_a_string_that_is_computed_is_refused(tmp_path: Path, action: str) -> None:
    found = chart(tmp_path, state(1, f"A\nen: {action}") + way(3, None, 1), *STRINGS)
    assert "is neither compared nor assigned alone" in found.refused[0].why


def test_graphical_functions_change_the_charts_data(tmp_path: Path) -> None:
    parts = [state(1, "A\nduring: y = bump(u);"), way(11, None, 1), *BUMP]
    got = flown(chart(tmp_path, "".join(parts), data("y", "OUTPUT"), outputs=("n", "y")), [9.0, 2, 1, 2, 299])
    assert got["y_y"].tolist() == [0, 2, 0, 3, 255]  # 0 where no way gives a result; of the result's type
    assert got["y_n"].tolist() == [0, 1, 1, 2, 3]


@pytest.mark.parametrize(("operator", "counted"), [("&&", [0, 0, 1, 1]), ("||", [0, 1, 1, 1])])
def test_a_function_behind_a_decided_condition_is_not_called(
    tmp_path: Path, operator: str, counted: list[float]
) -> None:
    parts = [state(1, "A"), state(2, "B"), way(11, None, 1), way(12, 1, 2, f"[v > 0 {operator} bump(u) > 99]"), *BUMP]
    got = flown(chart(tmp_path, "".join(parts), outputs=("n",)), [2.0, 2, 2, 2], [0.0, 0, 1, 0])
    assert got["y_n"].tolist() == counted


IN_C = '<P Name="name">chart</P><P Name="actionLanguage">1</P>'  # & and | are of bits


def test_actions_in_c_count_and_compare(tmp_path: Path) -> None:
    parts = [
        state(1, "A\nduring:\nn++; // twice u\ny += 2*u;"),
        state(2, "B"),
        way(11, None, 1),
        way(12, 1, 2, "[!(u > 1) && v != 0]{n = 0;}/y = -1;"),
    ]
    held = [data("n", "OUTPUT"), data("y", "OUTPUT")]
    found = chart(tmp_path, "".join(parts), *held, settings=IN_C, outputs=("n", "y"))
    got = flown(found, [5.0, 2, 0.5, 0.5], [0.0, 0, 0, 1])
    assert got["y_n"].tolist() == [0, 1, 2, 0]
    assert got["y_y"].tolist() == [0, 4, 5, -1]


@pytest.mark.parametrize(
    ("label", "why"),
    [
        ("{log = u ? 1 : 2;}", "'? 1 : 2;' in C is not translated"),
        ("{log = f(u);}", "f is a function in C"),
        ("{log = 1/2;}", "the quotient of 1 and 2 is whole in C"),
        ("{log = 1 + log++;}", "in C is not translated"),
        ("{k = 6/k;}", "a quotient of whole numbers in C by another number than a literal"),
        ("[log = 1]", "an assignment in a condition"),
        ("{log = ~u;}", "'~' in C is not translated"),
        (f"{{log = {'(' * 1000}u{')' * 1000};}}", "an expression so deep in C is not translated"),
        (f"{{log = {'-+' * 1000}u;}}", "an expression so deep in C is not translated"),
        ("{k = u;}", "real in uint8 has other rules in C"),
    ],
)
def test_c_that_means_something_else_in_matlab_is_refused(tmp_path: Path, label: str, why: str) -> None:
    extra = [data("k", "LOCAL", "uint8")] if "k" in label else []
    parts = way(1, None, 2) + state(2, "A") + way(3, 2, 2, label)
    (refused, *_) = chart(tmp_path, parts, *extra, settings=IN_C).refused
    assert why in refused.why


def test_whole_numbers_in_c_take_literals(tmp_path: Path) -> None:
    parts = (
        state(1, "A\nentry: k = 3;")
        + state(2, "B")
        + way(11, None, 1)
        + way(12, 1, 2, "[k == 3 && u > 0]{k = uint8(200);}")
    )
    found = chart(tmp_path, parts, data("k", "OUTPUT", "uint8"), settings=IN_C, outputs=("k",))
    assert flown(found, [0.0, 0, 1, 0])["y_k"].tolist() == [3, 3, 200, 200]


@pytest.mark.parametrize(
    ("saturates", "counted", "left"), [("1", [100, 200, 255, 255], 0), ("0", [100, 200, 44, 144], 255)]
)
def test_whole_numbers_in_c_are_computed_in_32_bits(
    tmp_path: Path, saturates: str, counted: list[int], left: int
) -> None:
    label = "A\nentry: k = 100;\nduring: k += 100; left = -k / 300 - 1; log = (k + 200) * 2 / 3 + u / 2;"
    settings = f'{IN_C}<P Name="saturateOnIntegerOverflow">{saturates}</P>'
    held = [data("k", "OUTPUT", "uint8"), data("left", "OUTPUT", "uint8")]
    found = chart(tmp_path, state(1, label) + way(11, None, 1), *held, settings=settings, outputs=("k", "left", "log"))
    got = flown(found, [1.0] * 4)
    assert got["y_k"].tolist() == counted
    assert got["y_left"].tolist() == [0, *[left] * 3]
    assert got["y_log"].tolist() == [0, *((k + 200) * 2 // 3 + 0.5 for k in counted[1:])]


WHOLE = {"a": "uint8", "b": "int8", "c": "uint16", "d": "int16", "e": "int32"}


def drawn_c(draw: random.Random, depth: int = 3) -> str:
    """A random expression of C: whole numbers, casts, bits, comparisons, and quotients by literals."""
    names, inner = [*WHOLE], lambda: drawn_c(draw, depth - 1)
    operators = ("+", "-", "*", "&", "|", "==", "!=", "<", ">=", "&&", "||")
    if depth == 0 or draw.random() < 0.2:
        return draw.choice([*names, str(draw.randrange(400)), f"0x{draw.randrange(400):X}"])
    return draw.choice([
        lambda: f"{inner()} {draw.choice(operators)} {inner()}", lambda: f"({inner()} {draw.choice('+-')} {inner()})",
        lambda: f"({inner()}) / {draw.randrange(1, 90)}", lambda: f"{draw.choice([*WHOLE.values()])}({inner()})",
        lambda: f"-({inner()})", lambda: f"!{draw.choice(names)}", lambda: f"({inner()} >> {draw.randrange(9)})",
        lambda: f"({draw.randrange(9)} << ({draw.choice(names)} & 7))",
    ])()  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_whole_numbers_in_c_are_those_of_a_compiler(tmp_path: Path, seed: int) -> None:
    """What GCC gives where numbers wrap around: 30 ticks of ten random assignments."""
    toolchains.need("gcc")
    draw = random.Random(seed)
    lines = (f"{draw.choice([*WHOLE])} {draw.choice(('=', '=', '+=', '-=', '*='))} {drawn_c(draw)};" for _ in range(10))
    text = "\n".join([*lines, "a++; --b;"])
    settings = f'{IN_C}<P Name="saturateOnIntegerOverflow">0</P>'
    held = [data(name, "OUTPUT", kind, str(7 + 5 * k)) for k, (name, kind) in enumerate(WHOLE.items())]
    parts = state(1, f"A\nduring:\n{text}") + way(11, None, 1)
    got = flown(chart(tmp_path, parts, *held, settings=settings, outputs=(*WHOLE,)), [0.0] * 30)
    declared = "".join(f"{kind}_t {name} = {7 + 5 * k};" for k, (name, kind) in enumerate(WHOLE.items()))
    casts = "".join(f"#define {kind}(x) (({kind}_t)(x))\n" for kind in WHOLE.values())
    shown = f'printf("{"%d " * len(WHOLE)}", {", ".join(WHOLE)});'
    source = f"#include <stdint.h>\n#include <stdio.h>\n{casts}int main(void) {{ {declared} {shown}"
    (tmp_path / "c.c").write_text(f"{source} for (int k = 1; k < 30; k++) {{ {text} {shown} }} }}", encoding="utf-8")
    subprocess.run(["gcc", "-fwrapv", "-w", str(tmp_path / "c.c"), "-o", str(tmp_path / "c")], check=True)
    wanted = subprocess.run([str(tmp_path / "c")], stdout=subprocess.PIPE, check=True).stdout.split()
    assert np.array_equal(np.array(wanted, int).reshape(30, -1), np.array([got[f"y_{name}"] for name in WHOLE]).T)


def test_an_index_in_c_begins_at_0(tmp_path: Path) -> None:
    label = "A\nentry: a[0] = 5;\nduring: a[k]++; a[k + 1] += a[0]; k = 1;"
    held = [data("a", "OUTPUT", "int16", size="3"), data("k", "LOCAL", "uint8")]
    found = chart(tmp_path, state(1, label) + way(11, None, 1), *held, settings=IN_C, outputs=("a",))
    assert flown(found, [0.0] * 3)["y_a"].tolist() == [[5, 0, 0], [6, 6, 0], [6, 7, 6]]


def test_a_flow_chart_in_a_state_acts_at_its_entry(tmp_path: Path) -> None:
    """So MathWorks' code has it: behind the entry action, and not while the state stays active."""
    flow = [
        way(21, None, 31),
        way(22, 31, 32, f"[u > 0]{{{said(2)}}}"),
        way(23, 31, 32, f"{{{said(3)}}}", 2),
        way(24, 32, 33, f"{{{said(4)}}}"),
    ]
    inside = "".join([*flow, *map(junction, (31, 32, 33))])
    parts = [state(1, f"A\nentry: {said(1)}", inside), state(2, "B"), way(11, None, 1), way(12, 1, 2, "[v > 0]")]
    parts += [way(13, 2, 1)]
    got = flown(chart(tmp_path, "".join(parts)), [0.0, 0, 0, 1, 1], [0.0, 0, 1, 0, 0])["y_log"].tolist()
    assert got == [134, 134, 134, 134124, 134124]


def test_an_output_of_a_chart_names_its_line_in_a_bus(tmp_path: Path) -> None:
    inner: Blocks = [("Outport", "a", {"Port": "1"}), ("Outport", "b", {"Port": "2"})]
    blocks: Blocks = [
        ("SubSystem", "chart", {"SFBlockType": "Chart", "Ports": "[0, 2]"}, (inner, [])),
        ("BusCreator", "bus", {"Inputs": "2", "Ports": "[2, 1]"}),
        ("BusSelector", "pick", {"OutputSignals": "b", "Ports": "[1, 1]"}),
        ("Outport", "y", {"Port": "1"}),
    ]
    lines: Lines = [("chart:1", "bus:1"), ("chart:2", "bus:2"), ("bus", "pick"), ("pick", "y")]
    parts = state(1, "A\nentry: a = 2; b = 3;") + way(2, None, 1) + data("a", "OUTPUT") + data("b", "OUTPUT")
    body = f'<chart id="9"><P Name="name">chart</P><P Name="actionLanguage">2</P><Children>{parts}</Children></chart>'
    files = {**model(blocks, lines), "simulink/stateflow/chart_9.xml": body}
    found = import_system(read_model(slx(files, tmp_path / "m.slx")), dt=DT)
    assert found.diagram is not None, found.refused
    assert build(found.diagram, dt=found.dt).machine().run(2, {})["y"].tolist() == [3.0, 3.0]


def test_an_input_that_says_no_type_has_that_of_the_charts_data(tmp_path: Path) -> None:
    """Whether a port drives it or nothing does; and states may hold one constant each, if they are alike."""
    ports = [data("u", "INPUT", "uint8"), data("v", "INPUT", "uint16", size="3"), data("w", "INPUT", "int16")]
    inner: Blocks = [*(("Inport", name, {"Port": str(k)}) for k, name in enumerate("uvw", start=1))]
    inner += [("Outport", "y", {"Port": "1"})]
    blocks: Blocks = [("Inport", "a", {"Port": "1"}), ("Inport", "b", {"Port": "2"}), ("Outport", "out", {"Port": "1"})]
    blocks += [("SubSystem", "chart", {"SFBlockType": "Chart", "Ports": "[3, 1]"}, (inner, []))]
    alike = data("n", "CONSTANT", "int16", "4")
    parts = way(1, None, 2) + state(2, "A\nduring: y = u + v[2] + w + n;", alike) + state(3, "B", alike)
    text = "".join([parts, *ports, data("y", "OUTPUT", "int32")])
    body = f'<chart id="9">{IN_C}<P Name="saturateOnIntegerOverflow">1</P><Children>{text}</Children></chart>'
    lines: Lines = [("a", "chart:1"), ("b", "chart:2"), ("chart:1", "out")]
    files = {**model(blocks, lines), "simulink/stateflow/chart_9.xml": body}
    found = import_system(read_model(slx(files, tmp_path / "m.slx")), dt=DT)
    assert found.diagram is not None, found.refused
    machine = build(found.diagram, dt=found.dt).machine()
    assert [(one.kind, one.width) for one in machine.inputs.values()] == [("uint8", None), ("uint16", 3)]
    assert machine.run(2, {"a": [200, 200], "b": [[1, 2, 65535]] * 2})["out"].tolist() == [0, 65739]


def test_a_discrete_chart_acts_at_its_own_times(tmp_path: Path) -> None:
    settings = '<P Name="updateMethod">DISCRETE</P><P Name="sampleTime">0.02</P>'
    found = chart(tmp_path, state(1, f"A\nduring: {said(1)}") + way(11, None, 1), settings=settings)
    assert flown(found, [0.0] * 5)["y_log"].tolist() == [0, 0, 1, 1, 11]


def test_outputs_begin_anew_at_each_tick(tmp_path: Path) -> None:
    parts = state(1, "A") + way(11, None, 1) + way(12, 1, 1, "[u > 0]{log = 5;}")
    found = chart(tmp_path, parts, settings='<P Name="initializeOutput">1</P>')
    assert flown(found, [1.0, 1, 0, 2])["y_log"].tolist() == [0, 5, 0, 5]


def test_a_chart_without_states_takes_its_ways_at_each_tick(tmp_path: Path) -> None:
    parts = [
        junction(1),
        junction(2),
        way(11, None, 1, f"{{{said(1)}}}"),
        way(12, 1, 2, f"[u > 0]{{{said(2)}}}", 1),
        way(13, 1, 2, f"{{{said(3)}}}", 2),
    ]
    assert_log(chart(tmp_path, "".join(parts)), [(1.0, 0.0, "12"), (0.0, 0.0, "13"), (1.0, 0.0, "12")])


def test_a_circle_of_junctions_turns_as_often_as_its_condition_holds(tmp_path: Path) -> None:
    """A factorial that saturates, as MathWorks' C of two public models has it; it ends at 255 turns."""
    inside = (
        way(1, None, 5, "{y = uint32(1); n = uint8(u);}") + "".join(map(junction, (5, 6, 7, 8)))
        + way(2, 5, 6, "[n > 1]") + way(3, 6, 7, "{y = y * uint32(n);}") + way(4, 7, 5, "{n = n - 1;}")
        + way(9, 5, 8, order=2)
    )  # fmt: skip
    held = data("y", "OUTPUT", "uint32"), data("n", "LOCAL", "uint8")
    u = [0.0, 1.0, 2.0, 5.0, 12.0, 13.0, 40.0, 255.0]
    found = flown(chart(tmp_path, inside, *held, outputs=("y",)), u)
    wanted = [min(math.factorial(int(n)), 2**32 - 1) for n in u]
    assert np.array_equal(found["y_y"], np.array(wanted, dtype=np.uint32))


@pytest.mark.parametrize(
    ("parts", "settings", "why"),
    [
        (way(1, None, 2) + state(2, "A\non tick: log = 1;"), "", "the action 'on tick' of A"),
        (way(1, None, 2) + state(2, "A\nduring: log = svd(u);"), "", "during of A: svd is not computed"),
        (way(1, None, 2) + state(2, "A") + way(3, 2, 2, "E[u > 0]"), "", "the event E is not translated"),
        (way(1, None, 2) + state(2, "A") + way(3, 2, 2, "[in(A)]"), "", "the transition [in(A)]: A has no value"),
        (way(1, None, 2) + state(2, "A") + way(3, 2, 4) + junction(4), "", "it ends at a junction"),
        (state(2, "A") + state(3, "B"), "", "the chart: it has no default transition"),
        (way(1, None, 2) + state(2, "A") + '<event name="E"/>', "", "the event E is not translated"),
        (
            way(1, None, 2)
            + state(2, "A")
            + state(3, "f(x)", kind="FUNC_STATE", simulink="1").replace(
                '<P Name="simulink">1</P>', '<simulink><P Name="isSimulinkFcn">1</P></simulink>'
            ),
            "",
            "the Simulink function f(x)",
        ),
        *(
            (
                way(1, None, 2)
                + state(2, "A", simulink="1").replace(
                    '<P Name="simulink">1</P>', f'<simulink><P Name="{kind}">1</P></simulink>'
                ),
                "",
                "the state A is a Simulink subsystem or an atomic subchart",
            )
            for kind in ("isActionSubsystem", "isComponent")
        ),
        (way(1, None, 2) + state(2, "A", data("log", "LOCAL")), "", "the name log stands for two things"),
        (way(1, None, 2) + state(2, "A\nentry: log = Gear.Park;"), "", "name the folder of its class with --path"),
        (way(1, None, 2) + state(2, "A") + data("ms", "LOCAL", "uint64"), "", "ms of type uint64 is not translated"),
        (way(1, None, 2) + state(2, "A") + way(3, 2, 2, "[u > 0]") + way(4, 2, 2), "", "the order of the transitions"),
        (
            way(1, None, 2) + state(2, "A\nentry: log = double(int8(u) + 1);"),
            '<P Name="saturateOnIntegerOverflow">0</P>',
            "its integers wrap around",
        ),
        (
            way(1, None, 2, "{log = u;}") + state(2, "A"),
            '<P Name="executeAtInitialization">1</P>',
            "executes at initialization",
        ),
        (
            way(1, None, 2)
            + state(2, "A")
            + "".join(junction(k) + way(k + 40, k, k + 1) for k in range(10, 31))
            + junction(31)
            + way(3, 2, 10)
            + way(4, 31, 2),
            "",
            "junctions lead on more than 20 times",
        ),
        (
            way(1, None, 5)
            + junction(5)
            + junction(6)
            + way(7, 5, 6, "[u > log]{log = log + 1; call;}")
            + way(8, 6, 5)
            + '<event name="call"><P Name="scope">OUTPUT_EVENT</P><P Name="trigger">FUNCTION_CALL_EVENT</P></event>',
            "",
            "a circle of junctions calls a subsystem",
        ),
    ],
)
def test_a_chart_beyond_that_is_refused_by_its_part(tmp_path: Path, parts: str, settings: str, why: str) -> None:
    (refused, *_) = chart(tmp_path, parts, settings=settings).refused
    assert refused.path == "chart"
    assert why in refused.why
