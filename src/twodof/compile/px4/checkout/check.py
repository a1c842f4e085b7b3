"""check: tells before a build what of an exported module does not fit a checkout of PX4."""

import dataclasses
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import get_origin, get_type_hints

from twodof.compile.px4.checkout.source_tree import SourceTree
from twodof.compile.px4.checkout.versions import FIRST, LAST, TESTED, Px4Version
from twodof.compile.px4.topics import FIELDS
from twodof.compile.px4.tree import absent, read_manifest, strangers
from twodof.errors import CompileError

ERROR, WARNING = "error", "warning"

# What any PX4 has, and then what the module is built with.
_LANDMARKS = ("CMakeLists.txt", "Makefile", "src/modules", "msg", "platforms/common", "cmake", "ROMFS")
NEEDED = (
    "cmake/px4_add_module.cmake",
    "platforms/common/include/px4_platform_common/atomic.h",
    "platforms/common/include/px4_platform_common/log.h",
    "platforms/common/include/px4_platform_common/px4_work_queue/ScheduledWorkItem.hpp",
    "platforms/common/include/px4_platform_common/px4_work_queue/WorkQueueManager.hpp",
    "platforms/common/uORB/Publication.hpp",
    "platforms/common/uORB/Subscription.hpp",
    "platforms/common/uORB/SubscriptionCallback.hpp",
    "src/drivers/drv_hrt.h",
    "src/lib/parameters/param.h",
    "msg/CMakeLists.txt",
)
_SUBMODULES = ("src/modules/mavlink/mavlink", "src/lib/events/libevents", "src/lib/heatshrink/heatshrink")
_BOARD_SUBMODULES = ("platforms/nuttx/NuttX/nuttx", "platforms/nuttx/NuttX/apps")
_FETCH = "run git submodule update --init --recursive in it"


@dataclass(frozen=True)
class CheckoutFinding:
    """Something that does not fit (`level` "error": the build or the flight fails) or may not ("warning")."""

    level: str
    what: str
    where: str
    remedy: str


@dataclass(frozen=True)
class CheckoutFindings:
    """What was found about the module `module` and a PX4 of `version` ("unknown" with the reason, if it is)."""

    module: str
    version: str
    rows: tuple[CheckoutFinding, ...]

    @property
    def fits(self) -> bool:
        """Whether nothing is an error."""
        return not any(row.level == ERROR for row in self.rows)


def _error(what: str, where: object, remedy: str) -> CheckoutFinding:
    return CheckoutFinding(ERROR, what, str(where), remedy)


def _warning(what: str, where: object, remedy: str) -> CheckoutFinding:
    return CheckoutFinding(WARNING, what, str(where), remedy)


@dataclass(frozen=True)
class _Facts:
    """What a manifest says of the module. Raises TypeError for what is not of these types."""

    module: str
    message: str
    airframe: int
    parameters: list[str]
    units: list[str]
    reads: list[str]
    writes: list[str]
    stops: list[str]
    description: int

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(_Facts).items():
            value = getattr(self, name)
            if not isinstance(value, get_origin(kind) or kind):
                raise TypeError
            if isinstance(value, list) and not all(isinstance(one, str) for one in value):
                raise TypeError


def check(px4: str | Path, folder: str | Path) -> CheckoutFindings:
    """Whether the export in `folder` fits the checkout `px4`. Nothing is written, built or run but `git describe`.

    Raises CompileError if `folder` holds no export; everything wrong with `px4` is a finding.
    """
    export, tree = Path(folder), SourceTree(Path(px4).resolve())
    facts = _facts(export)
    rows = [*_export(export)]
    if not tree.root.is_dir():
        rows.append(_error("is no folder", px4, "name a checkout of PX4"))
        return CheckoutFindings(facts.module, "unknown", tuple(rows))
    missing = [p for p in _LANDMARKS if not tree.has(p)]
    if "px4" not in tree.text("CMakeLists.txt").lower() or len(missing) > len(_LANDMARKS) // 2:
        rows.append(_error("is not a source tree of PX4", px4, "name the folder that git clone made of PX4"))
        return CheckoutFindings(facts.module, "unknown", tuple(rows))
    version, reason = tree.version
    rows += [*_checked_out(tree, missing), *_version(tree, version, reason), *_interfaces(tree, facts)]
    rows += [*_topics(tree, facts), *_clashes(tree, facts), *_neighbours(tree, facts, export.resolve())]
    return CheckoutFindings(facts.module, str(version) if version else f"unknown ({reason})", tuple(rows))


def _facts(folder: Path) -> _Facts:
    data = read_manifest(folder)
    if data is None:
        raise CompileError(
            "holds no exported module", str(folder), "name the folder that twodof px4 export DIAGRAM FOLDER wrote"
        )
    try:
        return _Facts(**{field.name: data[field.name] for field in dataclasses.fields(_Facts)})
    except (KeyError, TypeError) as error:
        raise CompileError("its manifest is damaged", str(folder), "export the diagram again") from error


def _export(folder: Path) -> Iterator[CheckoutFinding]:
    missing = absent(folder)
    if missing:
        yield _error(f"has lost files of the export: {_some(missing)}", folder, "export the diagram again")
    changed = strangers(folder)
    if changed:
        yield _warning(f"was changed since the export: {_some(changed)}", folder, "export the diagram again")


def _some(paths: list[str]) -> str:
    return ", ".join(paths[:5]) + (f" and {len(paths) - 5} more" if len(paths) > 5 else "")


def _checked_out(tree: SourceTree, missing: list[str]) -> Iterator[CheckoutFinding]:
    root = tree.root
    missing = missing + [path for path in NEEDED if not tree.has(path)]
    if missing:
        yield _error(f"is half checked out: {', '.join(missing)} missing", root, "run git checkout -f in it")
    listed = tree.submodules
    empty = [path for path in _SUBMODULES if path in listed and tree.empty(path)]
    if empty:
        yield _error(f"is half checked out: {', '.join(empty)} empty", root, _FETCH)
    boards = [path for path in _BOARD_SUBMODULES if path in listed and tree.empty(path)]
    if boards:
        yield _warning(f"builds for the simulator only: {', '.join(boards)} empty", root, _FETCH)
    build = tree.root / "build"
    if not os.access(build if build.is_dir() else tree.root, os.W_OK):
        yield _error("is read-only, and PX4 builds inside it", root, "copy it, or change its permissions")


def _version(tree: SourceTree, version: Px4Version | None, reason: str) -> Iterator[CheckoutFinding]:
    root = tree.root
    first, last = (f"v{major}.{minor}" for major, minor in (FIRST, LAST))
    if version is None:
        what = f"its version is unknown ({reason}); only what the module uses was compared"
        yield _warning(what, root, f"use a git clone with tags; modules are for {first} to {last}")
    elif not version.supported:
        yield _error(f"is PX4 {version}; the module is for {first} to {last}", root, f"run git checkout {TESTED} in it")
    elif not version.tested:
        what = f"is PX4 {version}: what the module uses is there, but it was flown with {TESTED} only"
        yield _warning(what, root, "try it in the simulator first")


def _interfaces(tree: SourceTree, facts: _Facts) -> Iterator[CheckoutFinding]:
    another = "use a PX4 that has it"
    for path, wanted, what in (
        ("CMakeLists.txt", "EXTERNAL_MODULES_LOCATION", "external modules"),
        ("msg/CMakeLists.txt", "config_msg_list_external", "messages of external modules"),
        ("cmake/px4_add_module.cmake", "MODULE_CONFIG", "parameters from module.yaml"),
        ("platforms/common/include/px4_platform_common/px4_work_queue/WorkQueueManager.hpp", "rate_ctrl", "rate_ctrl"),
    ):
        text = tree.text(path)
        if text and wanted not in text:
            yield _error(f"knows no {what}", tree.root / path, another)
    limit = re.search(r"\bchar\s+format\[(\d+)\]", tree.text("src/modules/logger/messages.h"))
    if limit and int(limit[1]) < facts.description:
        what = f"its logger has room for {limit[1]} characters of a message's description, not {facts.description}"
        yield _error(what, tree.root, "log fewer signals")
    units = re.search(
        r"allowedUnits = set ?\(\[(.*?)\]\)", tree.text("src/lib/parameters/px4params/srcparser.py"), re.DOTALL
    )
    unknown = [u for u in facts.units if units and f"'{u}'" not in units[1]]
    if unknown:
        yield _error(f"knows no parameters in {', '.join(unknown)}", tree.root, another)
    absent = [name for name in facts.stops if name not in tree.commands]
    if absent:
        what = f"has no {', '.join(absent)}, whose place the module takes"
        yield _warning(what, tree.root, "see that nobody else commands; the .post stops it in vain")


def _topics(tree: SourceTree, facts: _Facts) -> Iterator[CheckoutFinding]:
    for topic in sorted({*facts.reads, *facts.writes}):
        fields = tree.messages.get(topic)
        if fields is None:
            yield _error(f"has no topic {topic}", tree.root / "msg", "use another version of PX4")
            continue
        for name, kind in FIELDS.get(topic, {}).items():
            if fields.get(name) not in kind.split(" or "):
                has = f"is {fields[name]}" if name in fields else "is missing"
                what = f"{topic}.{name} {has}, where {kind} is used"
                yield _error(what, tree.root / "msg", "use another version of PX4")


def _clashes(tree: SourceTree, facts: _Facts, own: bool = False) -> Iterator[CheckoutFinding]:
    """What in `tree` has a name of the module. Where the module is the tree's `own`, it is not meant itself."""
    mine = (tree.root / "src" / "modules" / facts.module, tree.root / "msg" / f"{facts.message}.msg")

    def others(paths: list[Path]) -> list[Path]:
        return [path for path in paths if not own or not any(path.is_relative_to(place) for place in mine)]

    rename = "rename the diagram and export again"
    for path in others(tree.commands.get(facts.module, [])):
        yield _error(f"has a module {facts.module} already", path, rename)
    messages = others(tree.message_files(facts.message))
    for path in messages:
        yield _error(f"has a message {facts.message} already", path, rename)
    if not messages and facts.module in tree.messages and not own:
        yield _error(f"has a topic {facts.module} already", tree.root / "msg", rename)
    defined: dict[Path, list[str]] = {}
    for name in facts.parameters:
        for path in others(tree.parameters(name)):
            defined.setdefault(path, []).append(name)
    for path, names in defined.items():
        what = f"has {'a parameter' if len(names) == 1 else 'parameters'} {_some(names)} already"
        yield _error(what, path, "export one of the two again with another --prefix")
    for other in tree.airframes(facts.airframe):
        if other.name != f"{facts.airframe}_{facts.module}":
            what = f"has an airframe {facts.airframe} already"
            yield _warning(what, other, "give the exported airframe's file another number")


def _neighbours(tree: SourceTree, facts: _Facts, folder: Path) -> Iterator[CheckoutFinding]:
    """Clashes with the modules beside this one: in its folder, or in those that builds of this PX4 have used."""
    yield from _clashes(SourceTree(folder), facts, own=True)
    seen = {folder}
    for place, cache in tree.external_modules:
        if place in seen:
            continue
        seen.add(place)
        for row in _clashes(SourceTree(place), facts, own=True):
            what = f"{row.what}; {cache.parent.name} was built with it, and in one folder the two do not build"
            yield _warning(what, row.where, row.remedy)
