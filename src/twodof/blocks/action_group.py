"""Action groups: sub-diagrams that act one at a time, with merged outputs; and an integrator with a reset."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from twodof.blocks.bus import grouped
from twodof.blocks.declarations import Port, alike, shape, units_clash
from twodof.blocks.diagram import Diagram, carried_fields, not_connected
from twodof.blocks.library.continuous import ResetIntegrator, ResetLatch
from twodof.blocks.library.routing import CaseChoice, FirstTrue, Merge
from twodof.errors import DiagramError, listed, nearest, shown

__all__ = ["action_group", "resettable_integrator"]


def action_group(
    name: str,
    actions: Mapping[str, Diagram],
    otherwise: Diagram | None = None,
    *,
    values: Mapping[str, Sequence[int]] | None = None,
    enabling: str = "keep",
    initial: Mapping[str, Any] | None = None,
) -> Diagram:
    """Return a diagram in which one of `actions` acts, the first whose condition is true, else `otherwise`.

    The conditions are bool inputs "if_" + the action's name, in the order of `actions`. With `values` there is one
    int32 input `case` instead, and an action acts while `case` is one of its values. The other inputs are those of the
    actions, by name. Each output is that of the acting action; while none acts it keeps its value, at first `initial`
    (0). With `enabling="restart"` an action starts from its initial states each time that it begins to act.

    Raises DiagramError for actions with different outputs, and for two inputs of the same name and different types.
    """
    d = Diagram(name)
    parts = dict(actions) if otherwise is None else {**actions, "otherwise": otherwise}
    if not actions or (otherwise is not None and "otherwise" in actions):
        raise DiagramError(
            f"the actions are {listed(actions)}", name, 'give one or more, none of them named "otherwise"'
        )
    if values is None:
        conditions = {letter: d.input(f"if_{action}", "bool") for letter, action in _lettered(actions)}
        d.add("choice", FirstTrue(len(actions)), inputs=conditions)
    else:
        if list(values) != list(actions):
            what = f"there are values for {listed(values)}"
            raise DiagramError(what, name, f"give values for {listed(actions)}, in that order")
        d.input("case", "int32")
        d.add("choice", CaseChoice([list(values[action]) for action in actions]), u="case")
    acts = {action: f"choice.{letter}" for letter, action in _lettered(actions)} | {"otherwise": "choice.otherwise"}
    first = next(iter(parts))
    for action, item in parts.items():
        if list(item.outputs) != list(parts[first].outputs):
            what = f"{action} has the outputs {listed(item.outputs)}, and {first} {listed(parts[first].outputs)}"
            raise DiagramError(what, name, "give all actions the same outputs")
        for port in item.inputs.values():
            _input(d, port)
        inputs = {port.name: port.name for port in grouped(item.inputs.values())}
        d.add(action, item, enable=acts[action], enabling=enabling, inputs=inputs)
    for output in initial or {}:
        if output not in parts[first].outputs:
            there = f"there are: {nearest(output, parts[first].outputs)}"
            raise DiagramError(f"no output named {shown(output)} to start (`initial`)", name, there)
    for output in parts[first].outputs:
        port = _alike(name, output, parts)
        merge = Merge(len(parts), (initial or {}).get(output, 0), port.enum or port.kind, port.width, port.unit)
        fed = {letter: f"{action}.{output}" for letter, action in zip(merge.names, parts, strict=True)}
        told = {f"{letter}_acts": acts[action] for letter, action in zip(merge.names, parts, strict=True)}
        d.output(output, d.add(f"merge_{output}", merge, inputs={**fed, **told}))
    return d


def _lettered(actions: Mapping[str, Diagram]) -> list[tuple[str, str]]:
    """Return the ports of a choice, and the actions that they are for."""
    return list(zip(FirstTrue(len(actions)).names, actions, strict=True))


def _type(port: Port) -> str:
    return shape(port) if port.enum is None else str(port.enum)


def _input(d: Diagram, port: Port) -> None:
    there = d.inputs.get(port.name)
    if there is None:
        d.declare(port)
    elif not alike(there, port) or units_clash(there, port):
        both = f"{shape(there)} [{there.unit}] and {shape(port)} [{port.unit}]"
        raise DiagramError(f"two actions have an input {port.name!r}, of {both}", d.name, "rename one")
    elif port.unit:
        d.inputs[port.name] = replace(there, unit=port.unit)


def _alike(name: str, output: str, parts: Mapping[str, Diagram]) -> Port:
    """Return the port that the output of all actions is."""
    found: dict[str, Port] = {}
    for action, item in parts.items():
        fields = carried_fields(item, output)
        if not fields:
            raise not_connected("output", f"{name}.{action}.{output}")
        named = [replace(port, name=f"{output}.{field}" if field else output) for field, port in fields.items()]
        port = grouped(named)[0]
        text = ", ".join(f"{field} {_type(port)}".strip() for field, port in sorted(fields.items()))
        found[text] = port
    if len(found) > 1:
        raise DiagramError(
            f"the outputs {output!r} of the actions are {listed(found)}", name, "convert them to the same type"
        )
    return next(iter(found.values()))


def resettable_integrator(
    name: str,
    reset: str = "level",
    initial: Any = 0.0,
    limits: Sequence[float] | None = None,
    width: int | None = None,
    unit: str = "",
) -> Diagram:
    """Return a diagram with y' = u, which starts at `initial`, or with initial="input" at the input `x0`.

    It must run at the base rate. With `reset` there is a bool input `clear`, which resets y at each tick at which it is
    true ("level"), or at its edges ("rising", "falling" or "either"; never at the first tick). Then y becomes the
    initial value before the outputs are computed, and is integrated from there. With "none" it lacks the input `clear`.
    The output y depends on `clear` and `x0` in the same tick, so a loop through them needs a delay. Raises DiagramError
    for an unknown `reset` or invalid `limits`.
    """
    d = Diagram(name)
    latch = ResetLatch(reset, initial, width, unit)
    d.input("u", width=width)
    for port in latch.inputs:
        d.input(port.name, port.kind, port.width, port.unit)
    for param in latch.params:
        d.param(param.name, initial, width=width, unit=unit)
    d.add(
        "latch",
        latch,
        params={param.name: param.name for param in latch.params},
        inputs={port.name: port.name for port in latch.inputs},
    )
    d.add("integrator", ResetIntegrator(limits, width, unit), u="u", x0="latch.x0", start="latch.start")
    d.output("y", "integrator")
    return d
