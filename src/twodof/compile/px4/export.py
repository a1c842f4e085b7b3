"""Export of a diagram as a complete external module for PX4."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from zlib import crc32

from twodof.blocks.diagram import Diagram
from twodof.blocks.schema.json_form import to_json
from twodof.compile.px4.controller import (
    EXACT,
    FAULTS,
    HEAD,
    MessageFields,
    controller,
    fields,
    header,
    message,
    source,
)
from twodof.compile.px4.names import ModuleNames, fill, harmless, module_names
from twodof.compile.px4.parameters import UNITS, ExportedParameter, KeptParameter, exported, module_yaml, number
from twodof.compile.px4.tree import COMPILED, MANIFEST, TESTED, manifest, write_tree
from twodof.compile.px4.work_item import INPUTS, OUTPUTS, ModuleRole, role, work_item, work_item_header

FIRST_ID, IDS = 22000, 1000  # PX4 reserves these for custom models


@dataclass(frozen=True)
class Px4Module:
    """A diagram as a module for PX4. `files` is the whole tree: texts by relative path."""

    names: ModuleNames
    role: ModuleRole
    fields: MessageFields
    parameters: tuple[ExportedParameter, ...]
    kept: tuple[KeptParameter, ...]
    files: Mapping[str, str]

    def write(self, folder: str | Path, force: bool = False) -> None:
        """Write the tree as `folder`, wholly or not at all; see `twodof.compile.px4.tree.write_tree`."""
        write_tree(Path(folder), self.files, force)


def export(
    diagram: Diagram, folder: str | Path, log: Iterable[str] = (), prefix: str = "", force: bool = False
) -> Px4Module:
    """Write the module of `diagram` as `folder`; for arguments and errors see `make_module` and `Px4Module.write`."""
    module = make_module(diagram, log, prefix)
    module.write(folder, force)
    return module


def make_module(diagram: Diagram, log: Iterable[str] = (), prefix: str = "") -> Px4Module:
    """Make the module of `diagram`, which also logs the signals at the paths `log`. Equal arguments give equal text.

    `prefix`, 1 to 5 capitals or digits, begins the parameters' names; by default it is made from the diagram's name.
    Raises DiagramError for a diagram that is faulty, has ports for which PX4 has no signal, or is too large for PX4.
    """
    names = module_names(diagram.name, prefix)
    made = controller(diagram, names, tuple(log))
    part = role(made.program)
    rows, kept = exported(made.program, names, part.commands == "torque")
    found = fields(made.program, len(made.program.own))
    where, frame = f"src/modules/{names.module}", airframe_file(names)
    about = f" {harmless(diagram.text, 100)}".rstrip()
    # With PX4's own loops beside the diagram the drone's gains too. The allocator moves the motors of a symmetric X by
    # .7071 of the torque, so that the gains are the larger by sqrt(2).
    loops = "" if part.commands == "torque" else fill(f"loops_{part.commands}.sh", names)
    settings = fill("settings.sh", names) + loops
    # PX4 runs it after its own modules have started.
    stops = "\n".join(f"    {module} stop" for module in part.stops)
    takeover = fill("takeover.sh", names, replaced=" and ".join(part.stops), stops=stops)
    logged = logger_topics(names, part)
    files = {
        "README.md": readme(names, part, found, rows, kept, diagram.text),
        "diagram.json": to_json(diagram),
        "src/CMakeLists.txt": fill("sources.cmake", names),
        f"{where}/CMakeLists.txt": fill(
            "module.cmake", names, stack=made.stack, flags="\n".join(f"        {f}" for f in EXACT)
        ),
        f"{where}/module.yaml": module_yaml(names, rows),
        f"{where}/{names.module}.h": header(names, found, rows, made),
        f"{where}/{names.module}.c": source(names, found, rows, made),
        f"{where}/{names.class_name}.hpp": work_item_header(names, part),
        f"{where}/{names.class_name}.cpp": work_item(names, part, found),
        "msg/CMakeLists.txt": fill("messages.cmake", names),
        f"msg/{names.class_name}.msg": message(names, found),
        f"etc/init.d-posix/airframes/{frame}": fill("airframe.sh", names, about=about, settings=settings),
        f"etc/init.d-posix/airframes/{frame}.post": takeover,
        "etc/logging/logger_topics.txt": logged,
        "sdcard/etc/config.txt": fill("config.txt", names, settings=settings),  # run after the airframe, on a board
        "sdcard/etc/extras.txt": takeover,
        "sdcard/etc/logging/logger_topics.txt": logged,
    }
    facts = {
        "module": names.module,
        "message": names.class_name,
        "airframe": airframe_id(names),
        "parameters": [row.name for row in rows],
        "units": sorted({UNITS[row.unit] for row in rows if row.unit in UNITS}),
        "description": found.description + len(names.module) + 1,
        "reads": [*part.reads, *part.asides],
        "writes": list(part.writes),
        "stops": list(part.stops),
        "log": list(log),
    }
    files[MANIFEST] = manifest(files, facts)
    return Px4Module(names, part, found, tuple(rows), tuple(kept), MappingProxyType(files))


def airframe_id(names: ModuleNames) -> int:
    """Return SYS_AUTOSTART of the module's airframe, which depends on the module's name only."""
    return FIRST_ID + crc32(names.module.encode()) % IDS


def airframe_file(names: ModuleNames) -> str:
    """Return the airframe's file name, which PX4_SIM_MODEL may name too."""
    return f"{airframe_id(names)}_{names.module}"


def logger_topics(names: ModuleNames, role: ModuleRole) -> str:
    """Return etc/logging/logger_topics.txt: names, and intervals in ms (0: every message)."""
    slow = {"vehicle_local_position": 20, "vehicle_attitude": 10, "sensor_combined": 0}
    others = {"vehicle_status": 200, "vehicle_land_detected": 200, "failsafe_flags": 200, "battery_status": 500}
    rows = [(names.module, 0)]
    rows += [(topic, slow.get(topic, 0)) for topic in sorted({*role.reads, *role.writes})]
    rows += sorted(others.items())
    if "actuator_motors" not in role.writes:
        rows.append(("actuator_motors", 0))
    return "".join(f"{topic} {interval}\n" for topic, interval in rows)


def readme(
    names: ModuleNames,
    role: ModuleRole,
    found: MessageFields,
    rows: Sequence[ExportedParameter],
    kept: Sequence[KeptParameter],
    text: str,
) -> str:
    """Return the README: use of the tree, signals, parameters, and behaviour on faults."""
    inputs = [
        (f"`{f.path}`", f.unit or "-", _cell(", ".join(INPUTS[f.path].topics)), _cell(INPUTS[f.path].text))
        for f in found.inputs
    ]
    signals = (*found.inputs, *found.outputs)
    fields = [(f"`{name}`", _cell(text)) for _, name, text in HEAD]
    fields += [(f"`{f.name}`", _cell(f.described)) for f in signals]
    faults = [(str(bit), name, _cell(text)) for bit, name, text in FAULTS]
    return fill(
        "readme.md",
        names,
        about=f"{_cell(text)}\n\n" if text else "",
        airframe=airframe_file(names),
        airframe_id=airframe_id(names),
        stops=", ".join(f"`{s}`" for s in role.stops),
        safe=role.commanding["safe"],
        inputs=_table(("input", "unit", "topic", "what"), inputs),
        outputs=_table(("output", "where"), [(f"`{name}`", _cell(OUTPUTS[name])) for name in role.outputs]),
        writes=", ".join(f"`{t}`" for t in role.writes),
        commanded=role.commanding["when"],
        fields=_table(("field", "what"), fields),
        parameters=_parameters(rows),
        kept=_kept(kept),
        faults=_table(("bit", "fault", "what"), faults),
        input_words=sum(f.words for f in found.inputs),
        output_words=sum(f.words for f in found.outputs),
        tested=TESTED,
        compiled=", ".join(COMPILED),
    )


def _cell(text: str) -> str:
    return harmless(text, 300).replace("|", "/").replace("<", "(").replace("_", "\\_")


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [" | ".join(head), " | ".join("---" for _ in head), *(" | ".join(row) for row in rows)]
    return "".join(f"| {line} |\n" for line in lines)


def _parameters(rows: Sequence[ExportedParameter]) -> str:
    table = [
        (
            str(i),
            f"`{r.name}`",
            f"`{r.place}`" if r.place else "-",
            number(r.default, r.kind),
            r.bounds,
            _cell(r.unit) or "-",
            _cell(r.text) + (" (read at the start)" if r.fixed else ""),
        )
        for i, r in enumerate(rows)
    ]
    return _table(("place", "PX4", "diagram", "default", "bounds", "unit", "what"), table)


def _kept(kept: Sequence[KeptParameter]) -> str:
    if not kept:
        return ""
    rows = "".join(f"- `{k.path}`: {k.reason}\n" for k in kept)
    return f"\nThese are not parameters of PX4 and keep the diagram's defaults:\n\n{rows}"
