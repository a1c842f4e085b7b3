"""Exported tree: written wholly or not at all, and checked against a checkout of PX4 where PX4's build does not."""

import hashlib
import json
import os
import re
import secrets
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twodof.errors import CompileError, LogError, listed
from twodof.flightlog.atomic import atomic_write

MANIFEST = "twodof-px4.json"
FORMAT = 1
FACTS = {"module": str, "airframe": int, "description": int, "stops": list}
"""Types of the facts in a manifest that `check` compares."""


def manifest(files: Mapping[str, str], facts: Mapping[str, object]) -> str:
    """Return the text of the manifest: `facts`, and the SHA-256 of each file."""
    sums = {path: hashlib.sha256(text.encode()).hexdigest() for path, text in sorted(files.items())}
    return json.dumps({"format": FORMAT, **facts, "files": sums}, indent=2) + "\n"


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return the manifest of a folder, or None if it does not have a valid one."""
    try:
        data = json.loads((folder / MANIFEST).read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        return None
    good = all(isinstance(data.get(name), kind) for name, kind in (("files", dict), *FACTS.items()))
    return data if good and all(isinstance(one, str) for one in (*data["files"].values(), *data["stops"])) else None


def absent(folder: Path) -> list[str]:
    """Return the files of the export that are missing in `folder`, by relative path."""
    return [path for path in sorted(_sums(folder)) if not (folder / path).is_file()]


def strangers(folder: Path) -> list[str]:
    """Return the files in `folder` that do not belong to the export or were changed, by relative path."""
    sums = _sums(folder)
    found = []
    for root, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            path = Path(root, name)
            relative = path.relative_to(folder).as_posix()
            if relative == MANIFEST and sums:
                continue
            regular = path.is_file() and not path.is_symlink()
            if not regular or hashlib.sha256(path.read_bytes()).hexdigest() != sums.get(relative):
                found.append(relative)
    return found


def _sums(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file of the export in `folder`, by relative path."""
    known = read_manifest(folder)
    return known["files"] if known else {}


def write_tree(folder: Path, files: Mapping[str, str], force: bool = False) -> None:
    """Write `files`, which include their manifest, as `folder`: wholly or not at all.

    An empty folder and an unchanged export are replaced. An export with other or changed files is replaced only with
    `force`. Raises LogError for any other folder, CompileError if the file system refuses. The new tree is made beside
    `folder` and then renamed.
    """
    target = folder.resolve()
    _check_place(target, folder, force)
    mark = secrets.token_hex(6)
    fresh, old = target.with_name(f".{target.name}.{mark}.new"), target.with_name(f".{target.name}.{mark}.old")
    try:
        fresh.mkdir(parents=True)
        for path, text in files.items():
            place = fresh / path
            place.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(place, "w") as file:
                file.write(text)
        if target.exists():
            target.rename(old)
        try:
            fresh.rename(target)
        except BaseException:
            if old.exists():
                old.rename(target)
            raise
    except OSError as refusal:
        what = f"cannot be written: {refusal.strerror or refusal}"
        raise CompileError(what, str(folder), "nothing was changed; choose another place") from refusal
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        if target.exists():  # otherwise `old` is all there is
            shutil.rmtree(old, ignore_errors=True)


def _check_place(target: Path, folder: Path, force: bool) -> None:
    if not target.exists():
        return
    if not target.is_dir():
        raise LogError("is a file", str(folder), "name a folder")
    if not any(target.iterdir()):
        return
    if read_manifest(target) is None:
        remedy = "name a new or an empty folder, or an earlier export"
        raise LogError("is a folder with something else in it", str(folder), remedy)
    other = strangers(target)
    if other and not force:
        what = f"has files that were added or changed since the export: {listed(other, 5)}"
        raise LogError(what, str(folder), "save them elsewhere, or give --force to lose them")


ERROR, WARNING = "error", "warning"
TESTED = "v1.16.1"
"""Version of PX4 with which modules of the starters were flown."""
COMPILED = ("v1.14.4", "v1.15.4", "v1.17.0-beta1", "main of 2026-06-06 (8ae02ec4)")
FIRST, LAST = (1, 14), (1, 17)
DEADLINE = 20.0  # [s], of git
FAR = 2000  # commits after a tag, from which on the tag's numbers say nothing


@dataclass(frozen=True)
class CheckoutFinding:
    """A mismatch: `level` "error" (the flight fails) or "warning" (the flight may fail)."""

    level: str
    what: str
    where: str
    remedy: str


@dataclass(frozen=True)
class CheckoutFindings:
    """Findings about the module `module` and a PX4 of `version`, "unknown" with the reason if git does not tell it."""

    module: str
    version: str
    rows: tuple[CheckoutFinding, ...]

    @property
    def fits(self) -> bool:
        """True if all findings are warnings."""
        return not any(row.level == ERROR for row in self.rows)


def check(px4: str | Path, folder: str | Path) -> CheckoutFindings:
    """Compare the export in `folder` with the checkout `px4`. Only `git describe` is run, and nothing is written.

    Raises CompileError if `folder` holds no export; all faults of `px4` are findings.
    """
    export, root = Path(folder), Path(px4).resolve()
    facts = read_manifest(export)
    if facts is None:
        remedy = "name the folder that twodof px4 export DIAGRAM FOLDER wrote"
        raise CompileError("holds no exported module", str(folder), remedy)
    found = list(_export(export))
    version = "unknown"
    if "px4" in _text(root / "CMakeLists.txt").lower() and (root / "src" / "modules").is_dir():
        version, *more = _version(root)
        found += [*more, *_flight(root, facts)]
    else:
        found.append((ERROR, "is not a source tree of PX4", px4, "name the folder that git clone made of PX4"))
    rows = (CheckoutFinding(level, what, str(where), remedy) for level, what, where, remedy in found)
    return CheckoutFindings(str(facts["module"]), version, tuple(rows))


_Row = tuple[str, str, str | Path, str]
"""The level, the fact, the place and the remedy."""


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


def _export(folder: Path) -> Iterator[_Row]:
    for level, paths, what in (
        (ERROR, absent(folder), "has lost files of the export"),
        (WARNING, strangers(folder), "was changed since the export"),
    ):
        if paths:
            yield level, f"{what}: {listed(paths, 5)}", folder, "export the diagram again"


def _version(root: Path) -> Iterator[Any]:
    """Yield the version, and what is wrong with it."""
    # Of this folder alone: a source tree without .git may lie in another project's repository.
    command = ["git", f"--git-dir={root / '.git'}", "describe", "--tags", "--exclude", "ext/*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE)
        tag, reason = done.stdout.strip(), " ".join(done.stderr.split())[:160]
    except (OSError, subprocess.TimeoutExpired) as error:
        tag, reason = "", f"{error!s:.160}"
    found = re.fullmatch(r"v?(\d+)\.(\d+)(\.\d+)?(?:-(\d+)-g\w+|-.*-(\d+)-g\w+|-.*)?", tag)
    first, last = (f"v{major}.{minor}" for major, minor in (FIRST, LAST))
    if found is None or int(found[4] or found[5] or 0) > FAR:
        yield f"unknown ({reason or tag})"
        remedy = f"use a git clone with tags; modules are for {first} to {last}"
        yield WARNING, f"its version is unknown (git describe: {reason or tag})", root, remedy
        return
    yield tag
    release = int(found[1]), int(found[2])
    if not FIRST <= release <= LAST:
        remedy = f"run git checkout {TESTED} in it"
        yield ERROR, f"is PX4 {tag}; the module is for {first} to {last}", root, remedy
    elif not TESTED.startswith(f"v{release[0]}.{release[1]}."):
        yield WARNING, f"is PX4 {tag}: modules were flown with {TESTED} only", root, "try it in the simulator first"


def _flight(root: Path, facts: dict[str, Any]) -> Iterator[_Row]:
    """Yield mismatches with which PX4 builds, and which show in the flight or its log."""
    limit = re.search(r"\bchar\s+format\[(\d+)\]", _text(root / "src/modules/logger/messages.h"))
    if limit and int(limit[1]) < facts["description"]:
        what = f"its logger has room for {limit[1]} characters of a message's description, not {facts['description']}"
        yield ERROR, what, root, "log fewer signals"
    missing = [name for name in facts["stops"] if not (root / "src" / "modules" / name).is_dir()]
    if missing:
        what = f"has no {', '.join(missing)}, whose place the module takes"
        yield WARNING, what, root, "check that no other module has its part; its stop in the .post script does nothing"
    number, own = facts["airframe"], f"{facts['airframe']}_{facts['module']}"
    for other in (root / "ROMFS").rglob(f"{number}_*"):
        if other.name != own and "." not in other.name:  # what runs behind an airframe has a suffix
            remedy = "give the exported airframe's file another number"
            yield WARNING, f"has an airframe {number} already", other, remedy
