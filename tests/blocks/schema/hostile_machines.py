"""State machines of a stranger: small files whose ways are endless to follow, and files that are not machines."""

from typing import Any

from tests.blocks.schema.hostile import file

Form = dict[str, Any]


def machine(**changes: Any) -> bytes:
    """A diagram of one machine with two modes; `changes` are to the block."""
    block = {
        "type": "state_machine",
        "name": "Lamp",
        "inputs": [{"name": "b", "kind": "bool"}, {"name": "u"}],
        "outputs": [{"name": "y"}],
        "variables": [{"name": "x", "initial": 0.0}],
        "nodes": [["input", [], "b"], ["input", [], "u"], ["state", [], "x"], ["add", [1, 2]], ["not", [0]]],
        "modes": [{"name": "off", "during": {"y": 2}}, {"name": "on", "during": {"y": 1}, "entry": {"x": 3}}],
        "transitions": [{"from": "off", "to": "on", "when": 0}, {"from": "on", "to": "off", "when": 4}],
        **changes,
    }
    parts = [{"name": "lamp", "block": block}]
    inputs = [{"name": "b", "kind": "bool"}, {"name": "u"}]
    return file(inputs=inputs, parts=parts, connections=[["b", "lamp.b"], ["u", "lamp.u"]], outputs=[["y", "lamp.y"]])


def _sums(count: int) -> list[Any]:
    """Nodes of a guard that is `count` sums long; the last one is the guard."""
    nodes: list[Any] = [["input", [], "u"], ["input", [], "b"]]
    nodes.extend(["add", [k + 1 if k else 0, 0]] for k in range(count))
    return [*nodes, ["const", [], "real", "0x1.0p+0"], ["lt", [count + 2, count + 1]]]


def _doubled(count: int) -> list[Any]:
    """b & b, `count` times over: as a tree 2^count operands."""
    nodes: list[Any] = [["input", [], "b"], ["input", [], "u"], ["state", [], "x"]]
    return [*nodes, ["and", [0, 0]], *(["and", [k + 3, k + 3]] for k in range(count))]


def _guards(count: int) -> list[Any]:
    """Return nodes of `count` guards, two nodes each from the third on; no guard hides another."""
    nodes: list[Any] = [["input", [], "u"], ["state", [], "x"]]
    for k in range(count):
        nodes += [["const", [], "real", float(k).hex()], ["lt", [0, 2 + 2 * k]]]
    return nodes


def _many(leaves: int, ways: int, nodes: list[Any], guards: list[int]) -> bytes:
    """Return a machine with `leaves` modes inside one, which has `ways` transitions to itself with these guards."""
    inner = [{"name": f"m{k}", "during": {"y": 0}, "entry": {"x": 0}} for k in range(leaves)]
    out = [{"from": "all", "to": f"m{k % leaves}", "when": guards[k % len(guards)]} for k in range(ways)]
    variables = [{"name": name, "initial": 0.0} for name in ("x", "w")]
    return machine(
        nodes=nodes, modes=[{"name": "all", "history": True, "inner": inner}], transitions=out, variables=variables
    )


def _guarded(leaves: int, ways: int) -> bytes:
    """Return the same with as many guards as ways, of which none hides another."""
    return _many(leaves, ways, _guards(ways), [3 + 2 * k for k in range(ways)])


def hostile_machines() -> dict[str, tuple[bytes, str]]:
    """Files, and the pattern of the error that each must give."""
    deep: Form = {"name": "m", "during": {"y": 1}}
    for k in range(200):
        deep = {"name": f"m{k}", "inner": [deep]}
    two = [{"from": "off", "to": "on", "when": 0}, {"from": "on", "to": "off", "when": 1}]
    return {
        "300 modes": (machine(modes=[{"name": f"m{k}"} for k in range(300)]), "300 modes"),
        "200 times 200 modes": (
            machine(
                modes=[{"name": f"m{k}", "inner": [{"name": f"m{k}_{i}"} for i in range(200)]} for k in range(200)]
            ),
            "more than",
        ),
        "2,000 transitions": (machine(transitions=two * 1000), "2000 transitions"),
        "modes 200 deep": (machine(modes=[deep]), "nested more than two levels"),
        "ways out of each of 200 modes": (_guarded(199, 90), "more than 100 ways"),
        "200 ways out of one mode": (_guarded(1, 200), "more than 100 ways"),
        "a long guard in many ways": (_many(90, 20, _sums(9000), [9003]), "more than 50000 operations"),
        "a loop's variable as a guard": (
            machine(
                nodes=[["bound", [], "bool", 0, 1], ["input", [], "u"]],
                modes=[{"name": "off", "during": {"y": 1}}],
                transitions=[{"from": "off", "to": "off", "when": 0}],
            ),
            "stands outside its loop",
        ),
        "an unknown key": (machine(code="import os"), "unknown key 'code'"),
        "an unknown key of a mode": (machine(modes=[{"name": "off", "code": "x"}]), "unknown key 'code'"),
        "a mode that is a number": (machine(modes=[1]), "1 is not a mode"),
        "a name of C": (machine(modes=[{"name": "*/ x"}]), "is not a name"),
        "a target that is a list": (machine(transitions=[{"from": "off", "to": ["on"], "when": 0}]), "'to' is missing"),
        "an unknown target": (machine(transitions=[{"from": "off", "to": "out", "when": 0}]), "names no mode"),
        "a guard that is not there": (machine(transitions=[{"from": "off", "to": "on", "when": 99}]), "node 99"),
        "a guard that is a real": (machine(transitions=two), "the guard gives a real"),
        "an action that is a list": (
            machine(modes=[{"name": "off", "during": [1]}]),
            "'during' is missing or of the wrong kind",
        ),
        "a history that is a text": (machine(modes=[{"name": "off", "history": "yes"}]), "'history' is missing"),
        "a variable that is the mode": (
            machine(variables=[{"name": "mode"}, {"name": "x"}]),
            "two states are named 'mode'",
        ),
        "a state that nobody declares": (machine(nodes=[["state", [], "y"]]), "not well formed"),
    }


def large_machines() -> dict[str, bytes]:
    """Files of machines that are as large as they may be, or look larger than they are."""
    stays = [{"from": "off", "to": "on", "when": 202}, {"from": "on", "to": "off", "when": 0}]
    modes = [{"name": "off", "during": {"y": 2}}, {"name": "on", "during": {"y": 1}}]
    return {
        "100 ways out of one mode": _guarded(1, 100),
        "1,900 ways": _guarded(19, 100),
        "a guard that is 2^200 operands as a tree": machine(nodes=_doubled(200), transitions=stays, modes=modes),
    }
