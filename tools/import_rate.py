"""How many public Simulink models `twodof slx import` takes: imported, compiled and run for 1,000 steps.

`python -m tools.import_rate REPOSITORY...` takes folders with models, one a repository, and looks for libraries in all
folders of the repository, those that share more of the model's own path first. Names that no callback of a model gives
are looked for in the repository's scripts, those of the model's folder first; what none gives is 1, or a structure
whose fields are 1, and is counted. A model with the same bytes counts once, a library not at all. A part is missing
where a library, a model, a block of another vendor or the class of an enumeration is not in the repository. Data are
missing where no script, .mat file or dictionary of the repository assigns a name that the model takes. The rates
without such models are shown apart; a name that a script assigns, and that we do not compute, is not missing.
`--why` counts the reasons of refusals, in models without missing parts, and how often one is a model's only one.
"""

import argparse
import hashlib
import multiprocessing
import os
import re
import subprocess
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from twodof.compile import build
from twodof.errors import TwodofError
from twodof.slx.blocks import RULES
from twodof.slx.importer import import_system
from twodof.slx.inspection import OWN_LIBRARIES, inspect, library_file
from twodof.slx.matlab.parser import assigned_names
from twodof.slx.matlab.script import read_workspace
from twodof.slx.matlab.values import Value
from twodof.slx.model import CODED, Model, read_model, source_file

MISSING = re.compile(r"is not found|cannot be found|is an enumeration")
STEPS = 1000
PERIOD = 0.01
"""Where a model says no period [s]."""


@dataclass
class Tried:
    """A model that was tried: whether it, or what it refers to, has a chart part; what it is refused for."""

    path: Path
    chart: bool = False
    blocks: int = 0
    invented: int = 0
    """How many names got no value from the repository."""
    absent: int = 0
    """How many of these nothing in the repository assigns."""
    reasons: dict[str, str] = field(default_factory=dict)
    """The first block of each reason."""

    @property
    def missing(self) -> bool:
        """True if a part of it is not in the repository."""
        return any(map(MISSING.search, self.reasons))


def tried(path: Path, folders: list[Path]) -> Tried | None:
    """Import, compile and run a model. None for a library and for other files."""
    try:
        model = read_model(path)
    except TwodofError as reason:
        return Tried(path, reasons={f"not read: {reason}": ""})
    if model.kind != "model":
        return None
    found = Tried(path, bool(model.charts), sum(1 for _ in model.blocks()))
    near = {one: len(os.path.commonpath([path.parent, one])) for one in folders}
    folders = [path.parent, *sorted(folders, key=lambda one: -near[one])]
    wanted = set(inspect(model, folders).names)
    names = _workspace(wanted, folders, path.stem)
    missing = wanted - names.keys()
    found.invented = len(missing)
    found.absent = len(missing.difference(*map(_given, _files(tuple(folders), "m"))))
    names |= dict.fromkeys(missing, _ONE)
    try:
        another = True
        while another:
            imported = import_system(model, "", names, folders, otherwise=PERIOD)
            found.chart |= any(line.kind in CODED for line in imported.report)
            another = _with_fields(names, missing, [line.why for line in imported.refused])
        if imported.diagram is None and not imported.refused:
            raise TwodofError("no block is refused, but the diagram is missing", str(path), "mend the importer")
        for line in imported.refused:
            found.reasons.setdefault(f"{line.kind}: {line.why}", line.path)
        if imported.diagram is not None:
            machine = build(imported.diagram, dt=imported.dt).machine()
            machine.run(STEPS, dict.fromkeys(imported.diagram.inputs, 0))
    except TwodofError as reason:
        found.reasons[f"{type(reason).__name__}: {reason.what}"] = ""
    except Exception as reason:  # noqa: BLE001  a fault of the importer counts as a refusal, and is shown
        found.reasons[f"FAULT {type(reason).__name__}: {reason}"[:150]] = ""
    if found.reasons:
        found.reasons |= _missing_in_charts(model, folders)
    return found


def _missing_in_charts(model: Model, folders: list[Path]) -> dict[str, str]:
    """Return the libraries that are not found of subsystems in charts, which the importer refuses before it asks."""
    charts = [(path, one.system) for path, one in model.blocks() if one.kind == "Chart" and one.system is not None]
    links = [
        (at, one)
        for path, system in charts
        for at, inner in system.walk(path)
        for one in inner.blocks.values()
        if one.type == "Reference" and one.kind not in RULES
    ]
    return {
        f"{one.kind}: the library {source_file(one)} is not found": at
        for at, one in links
        if source_file(one) not in OWN_LIBRARIES and library_file(source_file(one), folders) is None
    }


_ONE = np.array([[1.0]])


def _with_fields(names: dict[str, Value], invented: set[str], refusals: list[str]) -> bool:
    """Give the `invented` names the fields that refusals miss in them, such as motor.K; return whether any was new."""
    new = False
    for path in {path for why in refusals if "there is no field" in why for path in re.findall(r"\w+(?:\.\w+)+", why)}:
        *outer, last = path.split(".")
        if outer[0] in invented:
            inner = names
            for part in outer:
                kept = inner.get(part)
                inner[part] = inner = kept if isinstance(kept, dict) else {}
            new |= last not in inner
            inner.setdefault(last, _ONE)
    return new


MOST_TURNS = 2
"""How often the scripts run that give what others need."""
_GIVES = re.compile(r"assignin|cellToObject")
"""Functions by which a function's file gives names to the base workspace."""


def _workspace(wanted: set[str], folders: list[Path], model: str) -> dict[str, Value]:
    """Return what the scripts and .mat files of these folders give the names `wanted` of a model.

    Scripts that name the model come first. A name keeps its first value, and a structure takes the further fields that
    other scripts give it. Scripts that need a name of other scripts run again when those gave it, as in a session of
    MATLAB's.
    """
    values: dict[str, Value] = {}
    asked = set(wanted)
    files = sorted(_files(tuple(folders), "m"), key=lambda file: model not in _words(file))
    for _ in range(MOST_TURNS):
        before, needed = len(values), set[str]()
        for file in files:
            full = {name for name, value in values.items() if not isinstance(value, dict)}
            if not _given(file) & asked - full:
                continue
            found = dict(values)
            with suppress(TwodofError):
                why = " ".join(one.why for one in read_workspace(file, found, [file.parent, *folders]))
                needed.update(re.findall(r"(\w+) has no value", why))
            values = _merged(values, found)
        asked |= needed
        if len(values) == before or not asked - values.keys():
            break
    for file in _files(tuple(folders), "mat"):
        if wanted <= values.keys():
            break
        values = _recorded(file) | values
    return {name: value for name, value in values.items() if name in wanted}


def _merged(first: dict[str, Value], then: dict[str, Value]) -> dict[str, Value]:
    """Return the values of both; where both have a structure it has the fields of both, and else the first counts."""
    both = {
        name for name in first.keys() & then.keys() if isinstance(first[name], dict) and isinstance(then[name], dict)
    }
    return {**then, **first, **{name: _merged(first[name], then[name]) for name in both}}


@cache
def _files(folders: tuple[Path, ...], end: str) -> list[Path]:
    return [file for folder in dict.fromkeys(folders) for file in sorted(folder.glob(f"*.{end}"))]


@cache
def _recorded(file: Path) -> dict[str, Value]:
    """Return the values of a .mat file."""
    found: dict[str, Value] = {}
    with suppress(TwodofError):
        read_workspace(file, found)
    return found


@cache
def _words(file: Path) -> frozenset[str]:
    return frozenset(re.findall(r"\w+", file.read_text(errors="replace")))


@cache
def _given(file: Path) -> frozenset[str]:
    """Return the names that a script, or a function which gives names to the base workspace, may assign."""
    text = file.read_text(errors="replace")
    to_base = re.findall(r"\w+", text) if _GIVES.search(text) else []
    function = text.lstrip().startswith(("function", "classdef"))
    return frozenset(to_base if function else [*assigned_names(text), *to_base])


def models(repository: Path) -> list[tuple[Path, list[Path]]]:
    """Return the models of a repository, each content once, with the folders of all its files."""
    files = sorted(one for one in repository.rglob("*.slx") if one.is_file())
    files += sorted(one for one in repository.rglob("*.mdl") if one.is_file())
    files = [one for one in files if not one.name.startswith("._")]  # what macOS keeps beside a file
    beside = [one for end in ("sldd", "m", "mat") for one in repository.rglob(f"*.{end}")]
    # Folders of classes, packages and private functions are on no path of MATLAB's.
    off = re.compile(r"/(?:[@+]|private\b)")
    folders = sorted({one.parent for one in (*files, *beside) if off.search(f"{one.parent}/") is None})
    once = {hashlib.sha256(one.read_bytes()).digest(): one for one in reversed(files)}
    return [(one, folders) for one in sorted(once.values())]


def _short(reason: str) -> str:
    return re.sub(r"(parameter \w+: ).*", r"\1...", re.sub(r"[\d.]{2,}|\d", "N", reason))[:110]


def say(line: str) -> None:
    """Print a line at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main() -> None:
    """Print a row of Markdown for each repository with models, the sums, and reasons if wished."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("repository", nargs="+", type=Path)
    parser.add_argument("--why", action="store_true", help="count the reasons of refusals")
    parser.add_argument("--list", action="store_true", help="print each model with its reasons")
    parser.add_argument("--processes", type=int, default=1)
    asked = parser.parse_args()
    total: list[Tried] = []
    say("| repository | commit | imported | no missing part: plain | with a chart | nor data: plain | with a chart |")
    say("|---|---|---|---|---|---|---|")
    with multiprocessing.Pool(asked.processes) as pool:
        for repository in asked.repository:
            found = [one for one in pool.starmap(tried, models(repository), chunksize=1) if one is not None]
            total += found
            commit = subprocess.run(
                ["git", "-C", str(repository), "rev-parse", "--short", "HEAD"],
                capture_output=True,
                text=True,
                check=False,
            ).stdout.strip()
            say(f"| {repository.name.replace('+', '/')} | {commit or '-'} | {_rates(found)} |")
            for one in found if asked.list else ():
                reasons = "; ".join(f"{why[:90]} ({at})" for why, at in list(one.reasons.items())[:8])
                invented = f" ({one.invented} names invented, {one.absent} absent)" if one.invented else ""
                say(f"  {one.path.relative_to(repository)}{invented}: {reasons or 'runs'}")
    say(f"| all | | {_rates(total)} |")
    if asked.why:
        shorts = [{_short(why) for why in one.reasons} for one in total if not one.missing]
        counts = Counter(why for one in shorts for why in one)
        only = Counter(why for one in shorts if len(one) == 1 for why in one)
        for why, count in counts.most_common(60):
            say(f"{count:5d} {only[why]:4d} {why}")


def _rates(found: list[Tried]) -> str:
    def rate(among: list[Tried]) -> str:
        return f"{sum(not one.reasons for one in among)} of {len(among)}"

    whole = [one for one in found if not one.missing]
    parts = [
        rate([one for one in some if one.chart == chart])
        for some in (whole, [one for one in whole if not one.absent])
        for chart in (False, True)
    ]
    return " | ".join((rate(found), *parts))


if __name__ == "__main__":
    main()
