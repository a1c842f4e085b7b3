"""export: from a diagram to a complete external module for PX4."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from twodof.blocks.diagram import Diagram
from twodof.blocks.schema.json_form import to_json
from twodof.compile.px4.airframe import airframe, airframe_file, airframe_id, board_settings, logger_topics, takeover
from twodof.compile.px4.controller import EXACT, controller, header, source
from twodof.compile.px4.message import MessageFields, fields, message
from twodof.compile.px4.names import ModuleNames, module_names
from twodof.compile.px4.parameters import UNITS, ExportedParameter, KeptParameter, exported, module_yaml
from twodof.compile.px4.readme import readme
from twodof.compile.px4.template_files import fill
from twodof.compile.px4.topics import ModuleRole, role
from twodof.compile.px4.tree import MANIFEST, manifest, write_tree
from twodof.compile.px4.work_item import work_item, work_item_header


@dataclass(frozen=True)
class Px4Module:
    """A diagram as a module for PX4. `files` is the whole tree: relative path -> text."""

    names: ModuleNames
    role: ModuleRole
    fields: MessageFields
    parameters: tuple[ExportedParameter, ...]
    kept: tuple[KeptParameter, ...]
    files: Mapping[str, str]

    def write(self, folder: str | Path, force: bool = False) -> None:
        """Writes the tree as `folder`, wholly or not at all; see `twodof.compile.px4.tree.write_tree`."""
        write_tree(Path(folder), self.files, force)


def export(
    diagram: Diagram, folder: str | Path, log: Iterable[str] = (), prefix: str = "", force: bool = False
) -> Px4Module:
    """Writes the module of `diagram` as `folder`; `make_module` and `Px4Module.write` say how, and what is raised."""
    module = make_module(diagram, log, prefix)
    module.write(folder, force)
    return module


def make_module(diagram: Diagram, log: Iterable[str] = (), prefix: str = "") -> Px4Module:
    """The module of `diagram`, which logs also the signals at the paths `log`. The same arguments give the same text.

    `prefix` begins the parameters' names, 1 to 5 capitals or digits; without it the diagram's name decides. Raises
    DiagramError for a diagram that is faulty, whose ports are nothing in PX4, or that is too large for it.
    """
    names = module_names(diagram.name, prefix)
    made = controller(diagram, names, tuple(log))
    part = role(made.program)
    rows, kept = exported(made.program, names, part.commands == "torque")
    found = fields(made.program, len(made.program.own))
    where, frame = f"src/modules/{names.module}", airframe_file(names)
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
        f"etc/init.d-posix/airframes/{frame}": airframe(names, part, diagram.text),
        f"etc/init.d-posix/airframes/{frame}.post": takeover(names, part),
        "etc/logging/logger_topics.txt": logger_topics(names, part),
        "sdcard/etc/config.txt": board_settings(names, part),
        "sdcard/etc/extras.txt": takeover(names, part),
        "sdcard/etc/logging/logger_topics.txt": logger_topics(names, part),
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
