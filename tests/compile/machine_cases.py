"""Random state machines in a diagram, with random inputs."""

import random
from typing import Any

from tests.compile.differential import Case
from tests.compile.random_machines import MachineTable, machine_block, random_table
from twodof.blocks import Bus, Diagram, Param, Port, State, fold, sin
from twodof.blocks.library import Bias, Logic
from twodof.blocks.state_machine import Mode, StateMachine, Transition


def random_rows(r: random.Random, steps: int) -> list[dict[str, Any]]:
    """Inputs of each tick."""
    rows: list[dict[str, Any]] = []
    flag = clear = False
    for _ in range(steps):
        flag = flag != (r.random() < 0.3)
        clear = r.random() < 0.04
        rows.append({"u": float(r.randint(-5, 5)), "b": r.randint(-5, 5), "flag": flag, "clear": clear})
    return rows


def machine_case(r: random.Random, name: str, steps: int) -> tuple[Case, MachineTable]:
    """A random machine, one of its inputs unread, in a sub-diagram that is reset now and then, with its inputs."""
    table = random_table(r)
    d = Diagram(name)
    inner = Diagram("inner")
    for diagram in (d, inner):
        diagram.input("u")
        diagram.input("b", "int32")
        diagram.input("flag", "bool")
    asleep = Diagram("asleep")
    asleep.input("u")
    asleep.add("more", Bias(1.0), u="u")
    asleep.output("y", "more")
    inner.add("asleep", asleep, u="u", enable="flag")
    inner.add("machine", machine_block(table, spare=True), u="u", b="b", flag="flag", spare="asleep.y")
    d.input("clear", "bool")
    d.add("inner", inner, u="u", b="b", flag="flag", reset="clear")
    paths = [f"inner.machine.{port}" for port in ("y", "k", "w", "mode", "elapsed")]
    return Case(d, paths, random_rows(r, steps), {}), table


POSE = Bus("Pose", [Port("angle", unit="rad"), Port("at", width=2)])


class Arrays(StateMachine):
    """Vectors, matrices, buses, loops and shared expressions in guards and actions."""

    inputs = (Port("u"), Port("b", "int32"), Port("flag", "bool"))
    outputs = (Port("norm"), Port("v", width=3), Port("A", shape=(2, 2)), Port("elapsed", "uint32"), Port("pose", POSE))
    variables = (
        State("pose", kind=POSE),
        State("v", [1.0, 2.0, 3.0], width=3),
        State("A", [[1, 2], [3, 4]], shape=(2, 2)),
        State("s", 0.25),
    )
    params = (Param("gain", 0.5),)

    modes = (
        Mode(
            "around",
            inner=[
                Mode("a", entry=lambda u, x: {"v": x.v[1] + x.v, "s": x.v[0]}, during={"norm": 1.0}),
                Mode(
                    "b",
                    during=lambda x, p: {"norm": x.s * p.gain + sin(x.s * p.gain), "s": x.s * p.gain + 0.125},
                    exit=lambda x: {"A": x.A.T, "pose": POSE(angle=x.pose.angle + 1.0, at=[x.s, x.pose.at[0]])},
                ),
            ],
            during=lambda u, x, t: {"norm": 0.0, "A": store_first(x.A, u.u + t.elapsed_time)},
            history=True,
        ),
        Mode("last", entry=lambda x: {"v": [x.s, x.v[2], x.v[0]], "s": x.v @ x.v}, during=lambda x: {"norm": x.s}),
    )
    transitions = (
        Transition("around", "last", lambda u, x: (u.u * x.s > 2.0) & (u.u * x.s < 5.0)),
        Transition("a", "b", lambda u, x: (u.u * x.s > 1.0) & (u.u * x.s < u.u + x.s) & (u.u * x.s < u.u - x.s)),
        Transition("a", "last", lambda u, x: fold(3, [0.0], lambda i, s: [s + x.v[i] * u.u])[0] > 20.0),
        Transition("a", "b", lambda u: u.flag, do=lambda x, t: {"s": x.s + 0.5 * x.v[1], "v": x.v * x.s}),
        Transition("b", "around", lambda u, t: (u.b > 2) | (t.elapsed > 4)),
        Transition("last", "around"),
    )


def store_first(matrix: Any, value: Any) -> Any:
    """The matrix with another first element."""
    return [[value, matrix[0, 1]], [matrix[1, 0], matrix[1, 1]]]


def array_case(steps: int) -> Case:
    """A machine of arrays, which is enabled now and then."""
    d, inner = Diagram("arrays"), Diagram("inner")
    for diagram in (d, inner):
        diagram.input("u")
        diagram.input("b", "int32")
        diagram.input("flag", "bool")
    inner.add("machine", Arrays(), u="u", b="b", flag="flag")
    d.input("clear", "bool")
    d.add("on", Logic("not"), a="clear")
    d.add("inner", inner, u="u", b="b", flag="flag", enable="on", disabled="reset")
    return Case(
        d,
        [f"inner.machine.{p.name}" for p in Arrays.outputs if p.shape is None],
        random_rows(random.Random(5), steps),
        {},
    )
