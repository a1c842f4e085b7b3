"""A checkout of PX4, read without building or running anything of it."""

import os
import re
import subprocess
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from pathlib import Path

from twodof.compile.px4.checkout.versions import Px4Version, parse_version

DEADLINE = 20.0  # [s], of git
LARGEST = 4_000_000  # bytes read of a file
MOST = 50_000  # files looked at
FAR = 2000  # commits between two minor releases of PX4: that far from a tag its numbers say nothing
_CAPITAL = re.compile(r"(?<!^)(?=[A-Z])")
_FIELD = re.compile(r"^\s*([a-z]+[0-9]*(?:\[\d+\])?)\s+([a-z][a-z0-9_]*)\s*(?:#.*)?$", re.MULTILINE)
_TOPICS = re.compile(r"^# TOPICS (.+)$", re.MULTILINE)


class SourceTree:
    """The folder `root` as PX4's source. A file that is not there, or no text, reads as ""."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def text(self, path: str | Path) -> str:
        """The beginning of a file, at most LARGEST bytes."""
        place = self.root / path
        try:
            if not place.is_file():  # a pipe would never end
                return ""
            with place.open("rb") as file:
                return file.read(LARGEST).decode("utf-8", "replace")
        except OSError:
            return ""

    def has(self, path: str) -> bool:
        """Whether there is such a file or folder."""
        return (self.root / path).exists()

    def files(self, under: str, name: str) -> Iterator[Path]:
        """The files below `under` whose names match the pattern `name`, in order. Links to folders are not followed."""
        pattern, seen = re.compile(name), 0
        for folder, folders, names in os.walk(self.root / under):
            folders[:] = sorted(f for f in folders if f != ".git")
            for file in sorted(names):
                seen += 1
                if seen > MOST:
                    return
                if pattern.fullmatch(file) and Path(folder, file).is_file():
                    yield Path(folder, file)

    def empty(self, path: str) -> bool:
        """Whether a folder is missing or has nothing in it, as that of a submodule that was not fetched."""
        folder = self.root / path
        try:
            return next(folder.iterdir(), None) is None
        except OSError:
            return True

    @property
    def submodules(self) -> list[str]:
        """The paths of the submodules there should be."""
        return re.findall(r"^\s*path\s*=\s*(\S+)\s*$", self.text(".gitmodules"), re.MULTILINE)

    @cached_property
    def version(self) -> tuple[Px4Version | None, str]:
        """The version, and how it is known or why it is not."""
        if not self.has(".git"):
            return None, "there is no .git folder"
        command = ["git", "-C", str(self.root), "describe", "--tags", "--exclude", "ext/*"]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=DEADLINE, env=os.environ | {"GIT_OPTIONAL_LOCKS": "0"}
            )
        except FileNotFoundError:
            return None, "git is not installed"
        except (OSError, subprocess.TimeoutExpired) as reason:
            return None, f"git does not answer: {reason!s:.120}"
        if done.returncode:
            return None, f"git describe says: {' '.join(done.stderr.split())[:160]}"
        found = parse_version(done.stdout)
        if found and found.commits > FAR:
            return None, f"{found.commits} commits after the tag before it, {found}"
        return found, f"git describe says {done.stdout.strip()[:80]}"

    @cached_property
    def messages(self) -> dict[str, dict[str, str]]:
        """Topic -> field -> type, of all messages."""
        found: dict[str, dict[str, str]] = {}
        for path in self.files("msg", r".*\.msg"):
            text = self.text(path)
            fields = {name: kind for kind, name in _FIELD.findall(text)}
            topics = [t for line in _TOPICS.findall(text) for t in line.split()] or [path.stem]
            for topic in topics:
                found.setdefault(_CAPITAL.sub("_", topic).lower(), fields)
        return found

    def _places(self, under: str, file: str, names: Callable[[Path], Iterable[str]]) -> dict[str, list[Path]]:
        """Name -> files, for the `names` of each file below `under`."""
        found: dict[str, list[Path]] = {}
        for path in self.files(under, file):
            for name in names(path):
                found.setdefault(name, []).append(path)
        return found

    def message_files(self, name: str) -> list[Path]:
        """The files of the messages with this name, in whatever letters."""
        return list(self.files("msg", rf"(?i:{re.escape(name)})\.msg"))

    @cached_property
    def commands(self) -> dict[str, list[Path]]:
        """Name of a module's command -> its CMakeLists.txt; more than one where modules clash."""
        return self._places(
            "src", r"CMakeLists\.txt", lambda path: re.findall(r"\bMAIN\s+(\w+)", self.text(path), re.ASCII)
        )

    def parameters(self, name: str) -> list[Path]:
        """Where a parameter is defined."""
        names, patterns = self._parameters
        return names.get(name, []) + [path for pattern, path in patterns if pattern.fullmatch(name)]

    @cached_property
    def _parameters(self) -> tuple[dict[str, list[Path]], list[tuple[re.Pattern[str], Path]]]:
        """Parameter -> its files; and patterns of those that are defined once for several instances."""
        patterns: list[tuple[re.Pattern[str], Path]] = []
        defined = re.compile(r"\bPARAM_DEFINE_\w+\s*\(\s*([A-Z0-9_]+)")
        names = self._places("src", r".*param.*\.c", lambda path: defined.findall(self.text(path)))
        for path in self.files("src", r".*\.ya?ml"):
            text = self.text(path)
            for name in re.findall(r"^\s+([A-Z0-9_]+(?:\$\{i\}[A-Z0-9_]*)?):\s*$", text, re.MULTILINE):
                if "$" in name:
                    patterns.append((re.compile(name.replace("${i}", r"\d+")), path))
                else:
                    names.setdefault(name, []).append(path)
            # Outputs get parameters by a rule: PWM_MAIN_FUNC1, PWM_MAIN_MIN1, PWM_MAIN_REV and others.
            prefixes = re.findall(r"^[\s-]+param_prefix:\s*([A-Z0-9_]+)\s*$", text, re.MULTILINE)
            patterns += [(re.compile(rf"{prefix}_[A-Z0-9_]+"), path) for prefix in prefixes]
        return names, patterns

    @cached_property
    def external_modules(self) -> list[tuple[Path, Path]]:
        """The folders from which the builds inside take external modules, each with the file that says so."""
        found = []
        for cache in sorted((self.root / "build").glob("*/CMakeCache.txt")):
            place = re.search(r"^EXTERNAL_MODULES_LOCATION:\w+=(.+)$", self.text(cache), re.MULTILINE)
            if place and Path(place[1]).is_dir():
                found.append((Path(place[1]).resolve(), cache))
        return found

    def airframes(self, number: int) -> list[Path]:
        """The files of the airframes with this SYS_AUTOSTART, of PX4 or of exports."""
        folders = ("ROMFS", "etc/init.d-posix/airframes")
        return [path for folder in folders for path in self.files(folder, rf"{number}_[^.]+")]
