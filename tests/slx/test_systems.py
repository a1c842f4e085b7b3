"""Conditional subsystems of Simulink as diagrams: when they act, their outputs while they do not, and new starts.

The wanted values follow Simulink's definitions step by step in numpy.
"""

import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.slx.files import Blocks, Lines, model, model_of, slx
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import build
from twodof.slx.importer import Imported, import_system
from twodof.slx.model import read_model

pytestmark = pytest.mark.slow
DT = 0.01
STEPS = 300
DRAWN = np.random.default_rng(4).normal(0.0, 1.0, (4, STEPS)).round(1)
REAL = {"OutDataTypeStr": "double"}
COUNT: Blocks = [
    ("Inport", "in", {}),
    ("Sum", "sum", {"Ports": "[2, 1]"}),
    ("UnitDelay", "z", {"InitialCondition": "1"}),
]
COUNTED: Lines = [("in", "sum:1"), ("z", "sum:2"), ("sum", "z"), ("sum", "out")]


def imported(tmp_path: Path, blocks: Blocks, lines: Lines) -> Imported:
    return import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")), dt=DT)


def flown(found: Imported, **inputs: np.ndarray) -> dict[str, np.ndarray]:
    """What the imported diagram gives, after a round trip through JSON."""
    assert found.diagram is not None, found.refused
    steps = len(next(iter(inputs.values())))
    return build(from_json(to_json(found.diagram)), dt=found.dt).machine().run(steps, inputs)


def conditional(tmp_path: Path, port: str, pin: str, values: dict[str, str], out: dict[str, str]) -> Imported:
    """Import a model of one subsystem that sums its input from 1 on while `control` makes it act."""
    inside = ([*COUNT, ("Outport", "out", out), (port, "control", values)], COUNTED)
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("Inport", "control", {"Port": "2", **REAL}),
        ("SubSystem", "counts", {"Ports": "[1, 1]"}, inside),
        ("Outport", "y", {}),
    ]
    return imported(tmp_path, blocks, [("u", "counts"), ("control", f"counts#{pin}"), ("counts", "y")])


def summed(acts: np.ndarray, restarts: np.ndarray, initial: float, held: bool = True) -> np.ndarray:
    """The sum's output: from 1, anew at `restarts`, held or `initial` while it does not act."""
    y, state, found = initial, 1.0, []
    for u, on, again in zip(DRAWN[0], acts, restarts, strict=True):
        state = 1.0 if again else state
        if on:
            state = y = u + state
        elif not held:
            y = initial
        found.append(y)
    return np.array(found)


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("held", [False, True])
def test_an_enabled_subsystem_holds_or_resets_states_and_outputs(tmp_path: Path, restart: bool, held: bool) -> None:
    port = {"StatesWhenEnabling": "reset" if restart else "held"}
    out = {"InitialOutput": "7", "OutputWhenDisabled": "held" if held else "reset"}
    found = flown(conditional(tmp_path, "EnablePort", "enable", port, out), u=DRAWN[0], control=DRAWN[1])
    acts = DRAWN[1] > 0.0
    again = acts & ~np.r_[True, acts[:-1]] & restart
    assert np.array_equal(found["y"], summed(acts, again, 7.0, held))


def crossings(u: np.ndarray, edge: str) -> np.ndarray:
    """Return where a trigger fires, as Simulink's table of signs says; a zero in passing counts once."""
    found, before, last = [], None, ""
    for v in np.sign(u):
        event = {(-1, 0): "NZ", (-1, 1): "NP", (0, 1): "ZP", (1, 0): "PZ", (1, -1): "PN", (0, -1): "ZN"}.get(
            (before, v), ""
        )
        event = "" if (last, event) in (("NZ", "ZP"), ("PZ", "ZN")) else event
        up, down = event in ("NZ", "NP", "ZP"), event in ("PZ", "PN", "ZN")
        found.append({"rising": up, "falling": down, "either": up or down}[edge])
        before, last = v, event
    return np.array(found)


@pytest.mark.parametrize("edge", ["rising", "falling", "either"])
def test_a_triggered_subsystem_acts_at_edges_through_zero_once(tmp_path: Path, edge: str) -> None:
    control = np.random.default_rng(5).integers(-1, 2, STEPS).astype(float)
    found = flown(
        conditional(tmp_path, "TriggerPort", "trigger", {"TriggerType": edge}, {}), u=DRAWN[0], control=control
    )
    acts = crossings(control, edge)
    assert 40 < acts.sum() < 250
    assert np.array_equal(found["y"], summed(acts, np.zeros(STEPS, bool), 0.0))


def test_a_resettable_subsystem_is_initial_while_its_level_lasts(tmp_path: Path) -> None:
    control = (DRAWN[1] > 0.8).astype(float)
    port = {"ResetTriggerType": "level hold"}
    found = flown(conditional(tmp_path, "ResetPort", "Reset", port, {}), u=DRAWN[0], control=control)
    assert np.array_equal(found["y"], summed(np.ones(STEPS, bool), control > 0.0, 0.0))


def actions(
    tmp_path: Path, choice: tuple[str, dict[str, str]], labels: list[str], state: str, apart: bool = False
) -> Imported:
    """Import a model of action subsystems with sums, merged; `apart` in another subsystem, to which buses lead."""
    parts: Blocks = []
    lines: Lines = [("pick", "choice:1")]
    count = len(labels)
    merge = ("Merge", "merge", {"Ports": f"[{count}, 1]", "InitialOutput": "-3"})
    inner: Blocks = [merge, ("Outport", "out", {})]
    inner_lines: Lines = [("merge", "out")]
    for k, label in enumerate(labels, start=1):
        port = ("ActionPort", "act", {"InitializeStates": state})
        inside = ([*COUNT, ("Outport", "out", {}), port], COUNTED)
        parts += [
            ("SubSystem", label, {"Ports": "[1, 1]"}, inside),
            ("Gain", f"k{k}", {"Gain": str(k)}),
        ]
        lines += [("u", f"k{k}"), (f"k{k}", label), (f"choice:{k}", f"{label}#ifaction")]
        lines += [(label, f"bus{k}"), (f"bus{k}", f"merging:{k}")] if apart else [(label, f"merge:{k}")]
        parts += [("BusCreator", f"bus{k}", {"Inputs": "1", "Ports": "[1, 1]"})] if apart else []
        inner.append(("Inport", f"in{k}", {"Port": str(k)}))
        inner.append(("BusSelector", f"take{k}", {"OutputSignals": "signal1", "Ports": "[1, 1]"}))
        inner_lines += [(f"in{k}", f"take{k}"), (f"take{k}", f"merge:{k}")]
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("Inport", "pick", {"Port": "2", **REAL}),
        (choice[0], "choice", {"Ports": f"[1, {count}]", **choice[1]}),
        *parts,
        ("SubSystem", "merging", {"Ports": f"[{count}, 1]"}, (inner, inner_lines)) if apart else merge,
        ("Outport", "y", {}),
    ]
    return imported(tmp_path, blocks, [*lines, ("merging" if apart else "merge", "y")])


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("state", ["held", "reset"])
@pytest.mark.parametrize("kind", ["If", "SwitchCase"])
def test_the_action_that_is_chosen_acts_and_is_merged(tmp_path: Path, kind: str, state: str, apart: bool) -> None:
    if kind == "If":
        values = {"IfExpression": "u1 > .5 & ~(u1 >= 2*one)", "ElseIfExpressions": "u1 == 0 | u1 == -1, u1 < -1"}
        pick = DRAWN[1].round(0)
        chosen = np.select([(pick > 0.5) & ~(pick >= 2.0), (pick == 0.0) | (pick == -1.0), pick < -1.0], [0, 1, 2], 3)
        labels = ["first", "second", "third", "last"]
    else:
        values, pick = {"CaseConditions": "{1, [2 -1]}", "ShowDefaultCase": "off"}, 2.0 * DRAWN[1]
        whole = np.trunc(pick)
        chosen = np.select([whole == 1, (whole == 2) | (whole == -1)], [0, 1], -1)
        labels = ["first", "second"]
    if kind == "If":
        values["IfExpression"] = values["IfExpression"].replace("one", "1")
    found = flown(actions(tmp_path, (kind, values), labels, state, apart), u=DRAWN[0], pick=pick)
    states, y, wanted, last = [1.0] * len(labels), -3.0, [], -1
    for k, (u, at) in enumerate(zip(DRAWN[0], chosen, strict=True)):
        if at >= 0:
            again = state == "reset" and k > 0 and at != last
            states[at] = y = (at + 1) * u + (1.0 if again else states[at])
        wanted.append(y)
        last = at
    assert np.array_equal(found["y"], wanted)


def test_a_function_call_input_acts_in_the_steps_of_its_calls(tmp_path: Path) -> None:
    port = ("TriggerPort", "call", {"TriggerType": "function-call"})
    blocks: Blocks = [
        ("Inport", "run", {"OutputFunctionCall": "on"}),
        ("Inport", "u", {"Port": "2", **REAL}),
        ("SubSystem", "task", {"Ports": "[1, 1]"}, ([*COUNT, ("Outport", "out", {}), port], COUNTED)),
        ("Outport", "y", {}),
    ]
    found = imported(tmp_path, blocks, [("run", "task#trigger"), ("u", "task"), ("task", "y")])
    acts = DRAWN[1] > 0.0
    assert np.array_equal(flown(found, run=acts, u=DRAWN[0])["y"], summed(acts, np.zeros(STEPS, bool), 0.0))


def test_a_subsystem_of_an_event_is_left_out_unless_it_initialises(tmp_path: Path) -> None:
    inside: Blocks = [("Constant", "c", {}), ("Outport", "out", {})]
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("SubSystem", "empty", {}, ([("EventListener", "e", {})], [])),
        ("SubSystem", "stop", {}, ([*inside, ("EventListener", "e", {"EventType": "Terminate"})], [("c", "out")])),
        ("Outport", "y", {}),
    ]
    found = imported(tmp_path, blocks, [("u", "y")])
    assert np.array_equal(flown(found, u=DRAWN[0])["y"], DRAWN[0])
    assert [note.partition(" ")[0] for note in found.notes] == ["empty", "stop"]
    start = ("SubSystem", "start", {}, ([*inside, ("EventListener", "e", {})], [("c", "out")]))
    assert imported(tmp_path, [*blocks, start], [("u", "y")]).refused[0].path == "start/e"


def test_conditions_without_an_equivalent_are_refused_by_path(tmp_path: Path) -> None:
    inside: tuple[Blocks, Lines] = (
        [*COUNT, ("Outport", "out", {}), ("TriggerPort", "e", {"ShowOutputPort": "on"})],
        COUNTED,
    )
    each: tuple[Blocks, Lines] = ([*COUNT, ("Outport", "out", {}), ("ForEach", "each", {})], COUNTED)
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("SubSystem", "shown", {"Ports": "[1, 1]"}, inside),
        ("SubSystem", "all", {"Ports": "[1, 1]"}, each),
        ("Merge", "merge", {"Ports": "[2, 1]"}),
        ("Outport", "y", {}),
    ]
    lines = [
        ("u", "shown#enable"),
        ("u", "shown"),
        ("u", "all"),
        ("all", "merge:1"),
        ("shown", "merge:2"),
        ("merge", "y"),
    ]
    found = imported(tmp_path, blocks, lines)
    assert {(line.path, line.why) for line in found.refused} == {
        ("shown", "ShowOutputPort of its TriggerPort is not translated"),
        ("all", "a For Each with SpecifiedNumIters = -1 is not translated"),
    }


def test_an_enable_port_shows_what_enables_its_subsystem(tmp_path: Path) -> None:
    """Inside, an output holds the last enabling value."""
    shown: Blocks = [("EnablePort", "e", {"ShowOutputPort": "on"}), ("Outport", "seen", {"Port": "2"})]
    inside: tuple[Blocks, Lines] = ([*COUNT, ("Outport", "out", {}), *shown], [*COUNTED, ("e", "seen")])
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("Inport", "control", {"Port": "2", **REAL}),
        ("SubSystem", "counts", {"Ports": "[1, 2, 1]"}, inside),
        ("Outport", "y", {}),
        ("Outport", "z", {"Port": "2"}),
    ]
    lines: Lines = [("u", "counts"), ("control", "counts#enable"), ("counts:1", "y"), ("counts:2", "z")]
    found = flown(imported(tmp_path, blocks, lines), u=DRAWN[0], control=DRAWN[1])
    last, wanted = 0.0, []
    for value in DRAWN[1]:
        last = value if value > 0.0 else last
        wanted.append(last)
    assert np.array_equal(found["z"], wanted)


def test_blocks_of_several_sample_times_run_at_their_own_ticks(tmp_path: Path) -> None:
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("ZeroOrderHold", "slow", {"SampleTime": "0.04"}),
        ("Sum", "sum", {"Ports": "[2, 1]"}),
        ("UnitDelay", "z", {}),
        ("RateTransition", "up", {"OutPortSampleTime": "0.01", "InitialCondition": "5"}),
        ("UnitDelay", "late", {"SampleTime": "[0.06 0.02]"}),
        ("Sum", "both", {"Ports": "[2, 1]"}),
        ("Outport", "direct", {}),
        ("Outport", "passed", {"Port": "2"}),
        ("Outport", "sixth", {"Port": "3"}),
    ]
    lines = [("u", "slow"), ("slow", "sum:1"), ("z", "sum:2"), ("sum", "z"), ("sum", "up"), ("sum", "both:1")]
    lines += [("u", "both:2"), ("both", "direct"), ("up", "passed"), ("u", "late"), ("late", "sixth")]
    found = import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")))
    assert found.dt == 0.01
    got = flown(found, u=DRAWN[0])
    slow = np.cumsum(DRAWN[0][::4])
    ticks = np.arange(STEPS)
    # A block reads a slower signal as it is held; a Rate Transition to a faster one is late by a slow sample.
    assert np.array_equal(got["direct"], slow[ticks // 4] + DRAWN[0])
    assert np.array_equal(got["passed"], np.r_[5.0, slow][ticks // 4])
    sixth = DRAWN[0][2::6]
    last = (ticks - 2) // 6
    assert np.array_equal(got["sixth"], np.where(last < 1, 0.0, sixth[np.maximum(last - 1, 0)]))


@pytest.mark.parametrize("deterministic", [True, False])
def test_a_rate_transition_samples_a_slow_input_at_its_own_ticks(tmp_path: Path, deterministic: bool) -> None:
    """As in multitasking C: a buffer that the slower task fills after the faster one has read it."""
    kept = {"OutPortSampleTime": "0.02", "InitialCondition": "5", "Deterministic": "on" if deterministic else "off"}
    blocks: Blocks = [
        ("Inport", "u", REAL | {"SampleTime": "0.06" if deterministic else "0.03"}),
        ("RateTransition", "up", kept),
        ("UnitDelay", "base", {"SampleTime": "0.01"}),
        ("Outport", "y", {}),
        ("Outport", "z", {"Port": "2"}),
    ]
    lines = [("u", "up"), ("up", "y"), ("u", "base"), ("base", "z")]
    got = flown(import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx"))), u=DRAWN[0])
    buffer, out, wanted = 5.0, 5.0, []
    for k, u in enumerate(DRAWN[0]):
        if k % 2 == 0 and (k % 6 == 0 or not deterministic):
            out = buffer
        if k % (6 if deterministic else 3) == 0:
            buffer = u
        wanted.append(out)
    assert np.array_equal(got["y"], wanted)


def test_sample_times_without_a_common_period_are_refused(tmp_path: Path) -> None:
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("UnitDelay", "a", {"SampleTime": "pi/100"}),
        ("UnitDelay", "b", {"SampleTime": "exp(1)/100"}),
        ("Outport", "y", {}),
    ]
    path = model_of(blocks, [("u", "a"), ("a", "b"), ("b", "y")], tmp_path / "m.slx")
    refused = [line.why for line in import_system(read_model(path)).refused]
    assert refused == ["these periods have no common one: 0.0271828 s (b), 0.0314159 s (a)"]
    given = {"a": {"SampleTime": "0.02"}, "b": {"SampleTime": "0.03"}}
    blocks = [(kind, name, given.get(name, values)) for kind, name, values in blocks]
    path = model_of(blocks, [("u", "a"), ("a", "b"), ("b", "y")], tmp_path / "n.slx")
    assert import_system(read_model(path)).dt == 0.01


def test_goto_leads_across_levels_as_far_as_its_tag_is_seen(tmp_path: Path) -> None:
    inner: tuple[Blocks, Lines] = (
        [
            ("Inport", "in", {}),
            ("Gain", "twice", {"Gain": "2"}),
            ("Goto", "up", {"GotoTag": "g", "TagVisibility": "global"}),
            ("Goto", "port", {"GotoTag": "p", "TagVisibility": "scoped"}),
            ("From", "s", {"GotoTag": "s"}),
            ("Outport", "out", {}),
        ],
        [("in", "twice"), ("twice", "up"), ("in", "port"), ("s", "out")],
    )
    middle: tuple[Blocks, Lines] = (
        [("Inport", "in", {}), ("SubSystem", "inner", {"Ports": "[1, 1]"}, inner), ("Outport", "out", {})],
        [("in", "inner"), ("inner", "out")],
    )
    other: tuple[Blocks, Lines] = (
        [
            ("Sum", "sum", {"Inputs": "++-", "Ports": "[3, 1]"}),
            ("From", "g", {"GotoTag": "g"}),
            ("From", "p", {"GotoTag": "p"}),
            ("From", "s", {"GotoTag": "s"}),
            ("Outport", "out", {}),
        ],
        [("g", "sum:1"), ("p", "sum:2"), ("s", "sum:3"), ("sum", "out")],
    )
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("Inport", "v", {"Port": "2", **REAL}),
        ("GotoTagVisibility", "seen", {"GotoTag": "s"}),
        ("GotoTagVisibility", "also", {"GotoTag": "p"}),
        ("Goto", "scoped", {"GotoTag": "s", "TagVisibility": "scoped"}),
        ("SubSystem", "first", {"Ports": "[0, 1]"}, other),
        ("SubSystem", "middle", {"Ports": "[1, 1]"}, middle),
        ("Outport", "y", {}),
        ("Outport", "z", {"Port": "2"}),
    ]
    lines = [("v", "scoped"), ("u", "middle"), ("first", "y"), ("middle", "z")]
    got = flown(imported(tmp_path, blocks, lines), u=DRAWN[0], v=DRAWN[1])
    assert np.array_equal(got["y"], 2.0 * DRAWN[0] + DRAWN[0] - DRAWN[1])
    assert np.array_equal(got["z"], DRAWN[1])
    local = [(kind, name, {**values, "TagVisibility": "local"} if name == "scoped" else values, *inside)
             for kind, name, values, *inside in blocks]  # fmt: skip
    refused = {line.why for line in imported(tmp_path, local, lines).refused}
    assert refused == {"0 Goto blocks with the tag s are seen from this system"}


def test_a_model_block_is_the_model_that_it_refers_to(tmp_path: Path) -> None:
    inside: Blocks = [
        ("Inport", "in", {}),
        ("Gain", "gain", {"Gain": "k * base"}),
        ("UnitDelay", "z", {}),
        ("Outport", "out", {}),
    ]
    model_of(inside, [("in", "gain"), ("gain", "z"), ("z", "out")], tmp_path / "inner.slx")
    given = {"ParameterArgumentNames": "k", "ParameterArgumentValues": "3", "Ports": "[1, 1]"}
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("ModelReference", "model", {"ModelNameDialog": "inner.slx", **given}),
        ("Outport", "y", {}),
    ]
    read = read_model(model_of(blocks, [("u", "model"), ("model", "y")], tmp_path / "m.slx"))
    found = import_system(read, "", {"base": np.array([[2.0]])}, [tmp_path], DT)
    assert np.array_equal(flown(found, u=DRAWN[0])["y"], np.r_[0.0, 6.0 * DRAWN[0][:-1]])
    (refused,) = import_system(read, dt=DT).refused
    assert (refused.path, refused.why) == ("model", "the model inner is not found: name its folder with --path")


def test_recorded_data_of_a_referenced_model_become_inputs(tmp_path: Path) -> None:
    inside: Blocks = [("FromWorkspace", "data", {"VariableName": "seen"}), ("Outport", "out", {})]
    model_of(inside, [("data", "out")], tmp_path / "inner.slx")
    ports = {"ModelNameDialog": "inner.slx", "Ports": "[0, 1]"}
    blocks: Blocks = [
        ("ModelReference", "one", ports),
        ("ModelReference", "two", ports),
        ("Sum", "sum", {"Inputs": "+-", "Ports": "[2, 1]"}),
        ("Outport", "y", {}),
    ]
    lines: Lines = [("one", "sum:1"), ("two", "sum:2"), ("sum", "y")]
    found = import_system(read_model(model_of(blocks, lines, tmp_path / "m.slx")), "", {}, [tmp_path], DT)
    assert found.diagram is not None, found.refused
    first, second = found.diagram.inputs
    y = flown(found, **{first: DRAWN[0], second: DRAWN[1]})["y"]
    assert np.array_equal(y, DRAWN[0] - DRAWN[1])


def element(number: int, port: str, path: str) -> dict[str, str]:
    values = {"PortNumber": str(number), "PortName": port, "Element": path, "IsComposite": "1"}
    return {"Port": str(number), **{f"Interface{key}": value for key, value in values.items()}}


def test_ports_of_bus_elements_are_one_port(tmp_path: Path) -> None:
    gives: tuple[Blocks, Lines] = (
        [
            ("Inport", "u", {}),
            ("Inport", "v", {"Port": "2"}),
            ("Gain", "twice", {"Gain": "2"}),
            ("Outport", "out p", element(1, "state", "rates.p")),
            ("Outport", "out q", element(1, "state", "rates.q")),
            ("Outport", "out v", element(1, "state", "v")),
            ("Outport", "more", {"Port": "2"}),
        ],
        [("u", "twice"), ("twice", "out p"), ("u", "out q"), ("v", "out v"), ("v", "more")],
    )
    takes: tuple[Blocks, Lines] = (
        [
            ("Inport", "first", {}),
            ("Inport", "in v", element(2, "state", "v")),
            ("Inport", "in q", element(2, "state", "rates.q")),
            ("Inport", "in p", element(2, "state", "rates.p")),
            ("Sum", "sum", {"Inputs": "+--+", "Ports": "[4, 1]"}),
            ("Outport", "out", {}),
        ],
        [("in v", "sum:1"), ("in q", "sum:2"), ("in p", "sum:3"), ("first", "sum:4"), ("sum", "out")],
    )
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("Inport", "v", {"Port": "2", **REAL}),
        ("SubSystem", "gives", {"Ports": "[2, 2]"}, gives),
        ("SubSystem", "takes", {"Ports": "[2, 1]"}, takes),
        ("Outport", "y", {}),
    ]
    lines = [("u", "gives:1"), ("v", "gives:2"), ("gives:1", "takes:2"), ("gives:2", "takes:1"), ("takes", "y")]
    u, v = DRAWN[:2]
    got = flown(imported(tmp_path, blocks, lines), u=u, v=v)
    assert np.array_equal(got["y"], ((v - u) - 2.0 * u) + v)


@pytest.mark.parametrize("gain", ["2", "[2; 3]"])
def test_an_element_of_a_bus_may_hang_on_another_one(tmp_path: Path, gain: str) -> None:
    names = "Derivative,state"
    blocks: Blocks = [
        ("BusSelector", "state out", {"OutputSignals": "state"}),
        ("Inport", "u", REAL),
        ("Sum", "sum", {"Inputs": "+-", "Ports": "[2, 1]"}),
        ("Gain", "Derivative", {"Gain": gain}),
        ("UnitDelay", "state", {"InitialCondition": "1"}),
        ("BusCreator", "bus", {"Inputs": names, "Ports": "[2, 1]"}),
        ("BusSelector", "rate out", {"OutputSignals": "Derivative"}),
        ("Outport", "y", {}),
    ]
    lines: Lines = [
        *[("u", "sum:1"), ("state out", "sum:2"), ("sum", "Derivative"), ("sum", "state")],
        *[("Derivative", "bus:1"), ("state", "bus:2"), ("bus", "state out"), ("bus", "rate out"), ("rate out", "y")],
    ]
    u, state, want = DRAWN[0], 1.0, []
    for one in u:
        state = one - state
        want.append(state)
    got = flown(imported(tmp_path, blocks, lines), u=u)["y"]
    assert np.array_equal(got, np.multiply.outer(want, [2.0, 3.0]) if ";" in gain else 2.0 * np.array(want))


@pytest.mark.parametrize(("start", "notes"), [("0.0", 0), ("0.001", 1)])
def test_a_start_time_is_said_not_to_be_taken(tmp_path: Path, start: str, notes: int) -> None:
    parts = model([("Inport", "u", REAL), ("Outport", "y", {})], [("u", "y")])
    page, said = "simulink/blockdiagram.xml", f'<ConfigSet><Object><P Name="StartTime">{start}</P></Object></ConfigSet>'
    parts[page] = parts[page].replace("<Model>", f"<Model>{said}")
    found = import_system(read_model(slx(parts, tmp_path / "m.slx")), dt=DT)
    assert sum("StartTime" in note for note in found.notes) == notes


def test_units_are_converted_between_what_is_said_beside(tmp_path: Path) -> None:
    """1 mph is .44704 m/s exactly, and a mile in an hour is the same (NIST Special Publication 811, appendix B.8)."""
    conversion: Blocks = [
        ("Inport", "u", {**REAL, "Unit": "m/s"}),
        ("UnitConversion", "convert", {}),
        ("SignalSpecification", "say", {}),
        ("Outport", "y", {}),
    ]
    lines: Lines = [("u", "convert"), ("convert", "say"), ("say", "y")]
    u = DRAWN[0]
    for unit, size in (("mph", 0.44704), ("mile/hr", 0.44704), ("km/min", 1000.0 / 60.0)):
        conversion[2] = ("SignalSpecification", "say", {"Unit": unit})
        assert np.array_equal(flown(imported(tmp_path, conversion, lines), u=u)["y"], u * (1.0 / size))
    for unit, why in (("inherit", "right beside"), ("kg", "cannot be converted"), ("furlong", "furlong is not")):
        conversion[2] = ("SignalSpecification", "say", {"Unit": unit})
        (line,) = [one for one in imported(tmp_path, conversion, lines).report if one.status == "refused"]
        assert why in line.why


def test_what_a_file_leaves_out_is_simulinks_own_default(tmp_path: Path) -> None:
    """A Unit Delay runs every second, a Math block is exp, unless the file says another value."""
    blocks: Blocks = [
        ("Inport", "u", {"SampleTime": "0.5", **REAL}),
        ("UnitDelay", "z", {}),
        ("Math", "exp", {}),
        ("Outport", "y", {}),
        ("Outport", "e", {"Port": "2"}),
    ]
    path = model_of(blocks, [("u", "z"), ("z", "y"), ("u", "exp"), ("exp", "e")], tmp_path / "m.slx")
    with zipfile.ZipFile(path) as package:
        text = package.read("simulink/blockdiagram.xml").decode().replace('<P Name="SampleTime">-1</P>', "")
    found = import_system(read_model(slx({"simulink/blockdiagram.xml": text}, path)))
    assert found.dt == 0.5
    got = flown(found, u=DRAWN[0])
    assert np.array_equal(got["y"], np.r_[0.0, 0.0, np.repeat(DRAWN[0][::2], 2)][:STEPS])
    assert np.allclose(got["e"], np.exp(DRAWN[0]), rtol=1e-15)


def test_a_data_store_is_read_as_it_stood_before_the_step(tmp_path: Path) -> None:
    writes: tuple[Blocks, Lines] = (
        [
            ("Inport", "in", {}),
            ("Sum", "sum", {"Ports": "[2, 1]"}),
            ("DataStoreRead", "old", {"DataStoreName": "total"}),
            ("DataStoreWrite", "new", {"DataStoreName": "total"}),
            ("EnablePort", "on", {}),
        ],
        [("in", "sum:1"), ("old", "sum:2"), ("sum", "new")],
    )
    blocks: Blocks = [
        ("Inport", "u", REAL),
        ("Inport", "on", {"Port": "2", **REAL}),
        ("DataStoreMemory", "memory", {"DataStoreName": "total", "InitialValue": "4"}),
        ("DataStoreMemory", "fixed", {"DataStoreName": "k", "InitialValue": "[1 2]"}),
        ("SubSystem", "total", {"Ports": "[1, 0]"}, writes),
        ("DataStoreRead", "read", {"DataStoreName": "total"}),
        ("DataStoreRead", "constant", {"DataStoreName": "k"}),
        ("Outport", "y", {}),
        ("Outport", "k", {"Port": "2"}),
    ]
    lines = [("u", "total"), ("on", "total#enable"), ("read", "y"), ("constant", "k")]
    found = imported(tmp_path, blocks, lines)
    got = flown(found, u=DRAWN[0], on=DRAWN[1])
    wanted, stored = [], 4.0
    for u, on in zip(DRAWN[0], DRAWN[1], strict=True):
        wanted.append(stored)
        stored = u + stored if on > 0 else stored
    assert np.array_equal(got["y"], wanted)
    assert np.array_equal(got["k"], np.tile([1.0, 2.0], (STEPS, 1)))
    assert "a store is read as it stood before the step" in [line.why for line in found.report]
    second: Blocks = [*blocks, ("DataStoreWrite", "again", {"DataStoreName": "total"})]
    (refused,) = imported(tmp_path, second, [*lines, ("u", "again")]).refused
    assert (refused.path, refused.why) == ("memory", "2 blocks write it, and a store has one writer")


def test_recorded_data_of_a_subsystem_become_inputs(tmp_path: Path) -> None:
    """A Signal Builder holds its data in a From Workspace: here they are given, as wide as what splits them."""
    inside = (
        [
            ("FromWorkspace", "FromWs", {"VariableName": "tuvar"}),
            ("Demux", "split", {"Outputs": "2", "Ports": "[1, 2]"}),
            ("Outport", "first", {}),
            ("Outport", "second", {"Port": "2"}),
        ],
        [("FromWs", "split"), ("split:1", "first"), ("split:2", "second")],
    )
    blocks: Blocks = [
        ("SubSystem", "Signal Builder", {"Ports": "[0, 2]"}, inside),
        ("FromFile", "log", {"FileName": "log.mat"}),
        ("Sum", "sum", {"Inputs": "+-+", "Ports": "[3, 1]"}),
        ("Goto", "unused", {"GotoTag": "a", "Commented": "on"}),
        ("Goto", "goto", {"GotoTag": "a"}),
        ("From", "from", {"GotoTag": "a"}),
        ("Outport", "y", {}),
    ]
    lines = [("Signal Builder:1", "sum:1"), ("Signal Builder:2", "sum:2"), ("log", "sum:3"), ("sum", "goto")]
    found = imported(tmp_path, blocks, [*lines, ("sum", "unused"), ("from", "y")])
    assert found.notes == [
        "FromFile log: its data are not read; they are the input log",
        "FromWorkspace FromWs: its data are not read; they are the input tuvar",
    ]
    y = flown(found, tuvar=DRAWN[:2].T.copy(), log=DRAWN[2])["y"]
    assert np.array_equal(y, (DRAWN[0] - DRAWN[1]) + DRAWN[2])


@pytest.mark.parametrize("values", [{"SpecifiedNumIters": "2"}, {}])
def test_a_for_each_acts_once_for_each_part(tmp_path: Path, values: dict[str, str]) -> None:
    """Each part has states of its own, and what is not taken apart goes to all of them; a port says their number."""
    inside: Blocks = [
        ("ForEach", "each", values),
        ("Inport", "part", {"Partition": "on", "PartitionDimension": "1", "PartitionWidth": "2"}),
        ("Inport", "whole", {"Port": "2"}),
        ("Sum", "sum", {"Ports": "[3, 1]", "Inputs": "+++"}),
        ("UnitDelay", "z", {"InitialCondition": "1"}),
        ("Outport", "out", {"ConcatenationDimension": "1"}),
    ]
    lines: Lines = [("part", "sum:1"), ("z", "sum:2"), ("whole", "sum:3"), ("sum", "z"), ("sum", "out")]
    blocks: Blocks = [
        ("Inport", "u", {**REAL, "PortDimensions": "4"}),
        ("Inport", "v", {"Port": "2", **REAL, "PortDimensions": "2"}),
        ("SubSystem", "parts", {"Ports": "[2, 1]"}, (inside, lines)),
        ("Outport", "y", {}),
    ]
    found = imported(tmp_path, blocks, [("u", "parts:1"), ("v", "parts:2"), ("parts", "y")])
    got = flown(found, u=DRAWN.T, v=DRAWN[:2].T)["y"]
    wanted = 1.0 + np.cumsum(DRAWN.T + np.tile(DRAWN[:2].T, 2), axis=0)
    assert np.allclose(got, wanted, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("size", "values", "why"),
    [
        (
            "4",
            {"SpecifiedNumIters": "2", "PartitionWidth": "2", "PartitionOffset": "-1"},
            "parts 2 wide with a gap of -1",
        ),
        ("5", {"PartitionWidth": "2"}, "do not divide into the same number of parts"),
        ("4", {"PartitionWidth": "0"}, "parts 0 wide"),
        ("4", {"PartitionWidth": "2", "PartitionOffset": "1"}, "parts 2 wide with a gap of 1"),
    ],
)
def test_parts_of_a_for_each_that_do_not_lie_side_by_side_are_refused(
    tmp_path: Path, size: str, values: dict[str, str], why: str
) -> None:
    inside: Blocks = [
        ("ForEach", "each", {name: one for name, one in values.items() if name == "SpecifiedNumIters"}),
        ("Inport", "part", {"Partition": "on", "PartitionDimension": "1", **values}),
        ("Outport", "out", {"ConcatenationDimension": "1"}),
    ]
    blocks: Blocks = [
        ("Inport", "u", {**REAL, "PortDimensions": size}),
        ("SubSystem", "parts", {"Ports": "[1, 1]"}, (inside, [("part", "out")])),
        ("Outport", "y", {}),
    ]
    (line,) = imported(tmp_path, blocks, [("u", "parts"), ("parts", "y")]).refused
    assert why in line.why


@pytest.mark.parametrize("reset", [False, True])
def test_a_for_iterator_acts_as_often_as_its_input_says(tmp_path: Path, reset: bool) -> None:
    """Simulink's documentation: states go from turn to turn, and are reset at each step or held; outputs stay."""
    states = {"ResetStates": "reset"} if reset else {}
    inside: Blocks = [
        ("Inport", "n", {}),
        ("ForIterator", "for", {"Ports": "[1, 1]", "IterationSource": "external", **states,
                                "IterationVariableDataType": "int8"}),
        ("DataTypeConversion", "k", {"OutDataTypeStr": "double"}),
        ("Sum", "sum", {"Ports": "[2, 1]"}),
        ("UnitDelay", "z", {"InitialCondition": "1", "SampleTime": "-1"}),
        ("Outport", "out", {}),
    ]  # fmt: skip
    lines: Lines = [("n", "for"), ("for", "k"), ("k", "sum:1"), ("z", "sum:2"), ("sum", "z"), ("sum", "out")]
    blocks: Blocks = [("Inport", "u", REAL), ("SubSystem", "s", {"Ports": "[1, 1]"}, (inside, lines)),
                      ("Outport", "y", {})]  # fmt: skip
    found = imported(tmp_path, blocks, [("u", "s"), ("s", "y")])
    turns, wanted, state, y = np.array([0.0, 3.0, 200.0, 0.0, 2.7, -1.0]), [], 1.0, 0.0
    for count in np.clip(np.trunc(turns), 0, 127):
        state = 1.0 if reset else state
        for k in range(1, int(count) + 1):
            y = state = state + k
        wanted.append(y)
    assert np.array_equal(flown(found, u=turns)["y"], wanted)
    assert [line.why for line in found.report if line.path == "s/turn"] == ["it is iterated 127 times at most"]
    inside[1] = ("ForIterator", "for", {"Ports": "[0, 1]", "IterationLimit": "2000"})
    cut = imported(
        tmp_path, [("SubSystem", "s", {"Ports": "[0, 1]"}, (inside[1:], lines[1:])), blocks[2]], [("s", "y")]
    )
    assert "2000 turns of a ForIterator are more than 1000" in cut.refused[0].why


@pytest.mark.parametrize("kind", ["while", "do-while"])
def test_a_while_iterator_acts_until_its_condition_fails(tmp_path: Path, kind: str) -> None:
    """The documentation's example: add the number of the turn until a sum is reached."""
    values = {"WhileBlockType": kind, "MaxIters": "6", "ResetStates": "reset", "ShowIterationPort": "on"}
    inside: Blocks = [
        ("Inport", "most", {}),
        ("Inport", "first", {"Port": "2"}),
        ("WhileIterator", "while", {"Ports": "[2, 1]" if kind == "while" else "[1, 1]", **values}),
        ("DataTypeConversion", "k", {"OutDataTypeStr": "double"}),
        ("Sum", "sum", {"Ports": "[2, 1]"}),
        ("Memory", "z", {}),
        ("RelationalOperator", "goes", {"Operator": "<"}),
        ("Outport", "out", {}),
    ]
    lines: Lines = [("while", "k"), ("k", "sum:1"), ("z", "sum:2"), ("sum", "z"), ("sum", "out"), ("sum", "goes:1"),
                    ("most", "goes:2"), ("goes", "while:1")]  # fmt: skip
    lines += [("first", "while:2")] if kind == "while" else []
    blocks: Blocks = [("Inport", "u", REAL), ("Inport", "v", {"Port": "2", **REAL}),
                      ("SubSystem", "s", {"Ports": "[2, 1]"}, (inside, lines)), ("Outport", "y", {})]  # fmt: skip
    found = imported(tmp_path, blocks, [("u", "s:1"), ("v", "s:2"), ("s", "y")])
    most, first = np.array([3.0, 7.0, 9.0, 100.0, -1.0]), np.array([1.0, 1.0, 0.0, 1.0, 1.0])
    wanted, y = [], 0.0
    for bound, begins in zip(most, first, strict=True):
        total, turn, goes = 0.0, 1, kind == "do-while" or begins != 0.0
        while goes and turn <= 6:
            y = total = total + turn
            goes, turn = total < bound, turn + 1
        wanted.append(y)
    assert np.array_equal(flown(found, u=most, v=first)["y"], wanted)


def loop_model(tmp_path: Path, function: Blocks) -> Imported:
    """Import y = u - f(y), where `f` is a block, and the integral of y."""
    blocks: Blocks = [("Inport", "u", REAL), ("Sum", "sum", {"Ports": "[2, 1]", "Inputs": "+-"}), *function,
                      ("Integrator", "x", {}), ("Outport", "y", {}), ("Outport", "z", {"Port": "2"})]  # fmt: skip
    lines: Lines = [("u", "sum:1"), ("sum", "f"), ("f", "sum:2"), ("sum", "x"), ("sum", "y"), ("x", "z")]
    return imported(tmp_path, blocks, lines)


def test_a_linear_algebraic_loop_is_solved(tmp_path: Path) -> None:
    inside: tuple[Blocks, Lines] = (
        [("Inport", "in", {}), ("Gain", "g", {"Gain": "3"}), ("Outport", "out", {})], [("in", "g"), ("g", "out")]
    )  # fmt: skip
    for number, f in enumerate([("Gain", "f", {"Gain": "3"}), ("SubSystem", "f", {"Ports": "[1, 1]"}, inside)]):
        (tmp_path / str(number)).mkdir()
        found = loop_model(tmp_path / str(number), [f])
        assert any("is solved by 20 steps of Newton's method" in note for note in found.notes)
        got = flown(found, u=DRAWN[0])
        assert np.allclose(got["y"], DRAWN[0] / 4.0, rtol=0.0, atol=1e-12)
        wanted = np.r_[0.0, np.cumsum(DRAWN[0] / 4.0 * DT)[:-1]]  # the input is held within a step
        assert np.allclose(got["z"], wanted, rtol=0.0, atol=1e-12)


def test_two_algebraic_loops_through_one_subsystem_are_solved(tmp_path: Path) -> None:
    """The one inside, 2 w = 1, hangs on nothing of the other, y = u - 3 y, which goes through the same subsystem."""
    inside: tuple[Blocks, Lines] = (
        [("Inport", "in", {}), ("Gain", "g", {"Gain": "3"}), ("Outport", "out", {}), ("Constant", "one", {}),
         ("Sum", "w", {"Ports": "[2, 1]", "Inputs": "+-"}), ("Gain", "h", {}), ("Outport", "two", {"Port": "2"})],
        [("in", "g"), ("g", "out"), ("one", "w:1"), ("w", "h"), ("h", "w:2"), ("w", "two")],
    )  # fmt: skip
    found = loop_model(tmp_path, [("SubSystem", "f", {"Ports": "[1, 2]"}, inside)])
    assert sum("is solved by 20 steps" in note for note in found.notes) == 2, found.notes
    assert np.allclose(flown(found, u=DRAWN[0])["y"], DRAWN[0] / 4.0, rtol=0.0, atol=1e-12)


def test_an_algebraic_loop_is_solved_or_is_nan(tmp_path: Path) -> None:
    """y = u - exp(y) has one solution, y = u - y^2 has none for u below -1/4, where Simulink ends the simulation."""
    found = loop_model(tmp_path, [("Math", "f", {"Operator": "exp"})])
    y = flown(found, u=3.0 * DRAWN[0])["y"]
    assert np.allclose(y + np.exp(y), 3.0 * DRAWN[0], rtol=0.0, atol=1e-9)
    (tmp_path / "square").mkdir()
    found = loop_model(tmp_path / "square", [("Math", "f", {"Operator": "square"})])
    assert np.isnan(flown(found, u=np.array([0.5, -1.0]))["y"]).tolist() == [False, True]


def test_an_algebraic_loop_through_a_state_space_keeps_its_state(tmp_path: Path) -> None:
    """A loop over (s + 2)/(s + 1): y = u - (y + x), x' = y - x, so y = (u - x)/2 and x' = (u - 3 x)/2."""
    transfer = {"Numerator": "[1 2]", "Denominator": "[1 1]"}
    found = loop_model(tmp_path, [("TransferFcn", "f", transfer)])
    y, x, wanted = flown(found, u=np.ones(STEPS))["y"], 0.0, []
    for _ in range(STEPS):
        wanted.append((1.0 - x) / 2.0)
        x = 1.0 / 3.0 + (x - 1.0 / 3.0) * np.exp(-1.5 * DT)
    assert np.allclose(y, wanted, rtol=0.0, atol=1e-9)
