"""Holding: which signals of parts that act at times must be kept between those times.

A part that acts at some ticks only holds its outputs in between. A reader at other ticks sees
that, and so does a log. What is read only at the ticks at which it is computed need not be kept.
"""

from twodof.compile.program.flat_program import FlatProgram, FlatSignal, Node


def passing(program: FlatProgram) -> set[FlatSignal]:
    """The numbers that nobody reads but at the ticks, and after the moment, at which they are computed."""
    readers: dict[FlatSignal, list[Node]] = {}
    seen = {*program.outputs.values(), *program.moving}
    inside = {action.node for group in program.stage for action in group.actions}
    for node in program.nodes:
        for s in node.drivers.values():
            readers.setdefault(s, []).append(node)
        for condition in node.conditions:
            seen.update(condition.signals)
    found = set()
    for group in program.tick:
        if group.guard.always or group.needs:
            continue
        for s in (s for action in group.actions for s in action.signals):
            alike = all(n.guard == group.guard and not n.continuous and n not in inside for n in readers.get(s, ()))
            if alike and s not in seen and s.width is None and s.initial is None and s.disabled is None:
                found.add(s)
    return found
