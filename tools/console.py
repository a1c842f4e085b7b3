"""Runs the commands that the documentation shows and brings the shown output up to date: `tools/console.py [PAGE...]`.

In a ```console block a line `$ twodof ...` or `$ python ...` is a command, and what follows are lines of its output,
not necessarily all. A block ```python title="FILE" (or toml) is a file that the reader saves first.
`$LOGS` is the folder of the real drone's logs. Without it the commands that name it are skipped, and so are those
that read their files.
"""

import contextlib
import io
import itertools
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in `twodof`; before numpy is loaded

from twodof.cli import app
from twodof.flightlog.public_data import cache_folder

PROJECT = Path(__file__).resolve().parents[1]
PAGES = [page for page in sorted((PROJECT / "docs").rglob("*.md")) if "```console" in page.read_text(encoding="utf-8")]
# A command compiles once and flies or fits for a second; on a loaded machine several times that.
DEADLINE_S = 120


@dataclass(frozen=True)
class Command:
    """A command line and the lines of its output that the page shows."""

    line: str
    shown: list[str]

    @property
    def refused(self) -> bool:
        """True if the page shows an error, or a flight that failed."""
        return any(line.startswith(("error:", "  FAILED")) for line in self.shown)


def commands(text: str) -> list[Command]:
    """The commands of a page's console blocks."""
    found: list[Command] = []
    for block in re.findall(r"```console\n(.*?)```", text, flags=re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append(Command(line[2:], []))
            elif line.strip():
                found[-1].shown.append(line)
    return found


def files(text: str) -> dict[str, str]:
    """The files that a page has its reader save: name and text."""
    return dict(re.findall(r"```(?:python|toml) title=\"([\w.]+)\"\n(.*?)```", text, flags=re.DOTALL))


def save_files(text: str, folder: Path) -> None:
    """Save a page's files in `folder`, as its reader does."""
    for name, content in files(text).items():
        (folder / name).write_text(content, encoding="utf-8")


def run_page(text: str, folder: Path, logs: Path | None) -> Iterator[tuple[Command, int, str]]:
    """Run a page's commands in `folder`, with the page's files; yield each with its exit status and output.

    `logs` is the folder of the real flight logs; without it the commands that need them are left out.
    """
    save_files(text, folder)
    missing = {"$LOGS"} if logs is None else set()
    for command in commands(text):
        named = set(re.findall(r"\$LOGS|[\w-]+\.[a-z]\w+", command.line))
        if named & missing:
            missing |= named
        else:
            yield command, *run(command, folder, logs)


def run(command: Command, folder: Path, logs: Path | None) -> tuple[int, str]:
    """Return exit status and output of a command run in `folder`."""
    program, *arguments = shlex.split(command.line.replace("$LOGS", str(logs)))
    if program == "twodof":
        return _in_this_process(arguments, folder)
    done = subprocess.run(
        [str(Path(sys.executable).with_name(program)), *arguments],
        cwd=folder,
        env={**os.environ, "COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


def _in_this_process(arguments: list[str], folder: Path) -> tuple[int, str]:
    """A command of ours without the second that a process takes to begin."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = app.run(arguments)
    return status, out.getvalue() + err.getvalue()


def paired(shown: list[str], output: str) -> Iterator[tuple[str, str | None]]:
    """Each shown line with the next line of output that has the same words, numbers apart; None where none has."""
    lines = iter(output.splitlines())
    for line in shown:
        yield line, next((other for other in lines if words(other) == words(line)), None)


def words(line: str) -> list[str]:
    """Return the words of a line without numbers, which depend on the noise of a flight."""
    return [word for word in line.split() if not re.search(r"\d", word)]


NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
SAME = 0.02
"""Share by which a shown number may differ from the printed one. A seed gives the same flight to the bit, but a fit on
another computer's linear algebra ends elsewhere in its last digits: figures move by a hundredth of a sigma."""


def agree(shown: str, printed: str) -> bool:
    """Return True if the numbers of two lines are the same, to `SAME` or to a unit of the last digit shown."""
    pairs = [*itertools.zip_longest(NUMBER.findall(shown), NUMBER.findall(printed), fillvalue="nan")]
    return all(abs(float(a) - float(b)) <= max(SAME * abs(float(b)), 1.001 * _last_digit(a)) for a, b in pairs)


def _last_digit(number: str) -> float:
    mantissa, _, exponent = number.partition("e")
    return float(10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])))


def not_printed(text: str, commands: Iterable[Command]) -> list[str]:
    """Return the estimates of the prose, such as "359.6 ± .6", that no line of the commands' output has."""
    shown = " ".join(line for command in commands for line in command.shown)
    found = [float(number) for number in NUMBER.findall(shown)]
    stated = re.findall(r"(\d+(?:\.\d+)?) ± (\d*\.?\d+)", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    return [value for pair in stated for value in pair if not any(_rounds(number, value) for number in found)]


def _rounds(number: float, value: str) -> bool:
    return abs(number - float(value)) <= 0.5001 * _last_digit(value)


def refreshed(text: str) -> str:
    """A page's text with the numbers that its commands print now."""
    logs = Path(os.environ.get("TWODOF_FLIGHT_DATA") or cache_folder()).resolve()
    with tempfile.TemporaryDirectory() as folder:
        for command, _, output in run_page(text, Path(folder), logs if logs.is_dir() else None):
            if command.shown:
                now = [(other or line).rstrip() for line, other in paired(command.shown, output)]
                text = text.replace(
                    "\n".join([f"$ {command.line}", *command.shown]), "\n".join([f"$ {command.line}", *now])
                )
    return text


if __name__ == "__main__":
    for page in map(Path, sys.argv[1:]) if sys.argv[1:] else PAGES:
        page.write_text(refreshed(page.read_text(encoding="utf-8")), encoding="utf-8")
        sys.stdout.write(f"{page} written\n")
