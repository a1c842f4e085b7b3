"""The commands that the documentation shows are run, page by page, and print what the page says."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.console import PAGES, Command, agree, commands, files, not_printed, paired, run_page

pytestmark = pytest.mark.slow

SAME = "fly-an-experiment.md"
"""Its commands are those of the first tutorial, which are run each day."""


@pytest.mark.long
@pytest.mark.parametrize(
    "page", [pytest.param(page, id=page.name, marks=[pytest.mark.soak] if page.name == SAME else []) for page in PAGES]
)
def test_the_commands_of_a_page_do_what_it_says(page: Path, tmp_path: Path, log_folder: Path | None) -> None:
    """Each page, the tutorials among them: from an empty folder, in its order, with the files that it has one save."""
    results = list(run_page(page.read_text(encoding="utf-8"), tmp_path, log_folder))
    assert results
    for command, status, output in results:
        assert (status != 0) == command.refused, output
        wrong = [both for both in paired(command.shown, output) if both[1] is None or not agree(both[0], both[1])]
        assert wrong == [], f"{command.line}: run `python tools/console.py`, or correct the page"


def test_commands_without_their_logs_are_skipped(tmp_path: Path) -> None:
    lines = ["log convert $LOGS/a.mat b.mcap", "log convert b.mcap c.csv", "--version", "log info c.csv"]
    text = "```console\n" + "".join(f"$ twodof {line}\n" for line in lines) + "```\n"
    assert [command.line for command, _, _ in run_page(text, tmp_path, None)] == ["twodof --version"]


def test_a_line_that_is_not_printed_is_found() -> None:
    output = "mu   358.63   0.93  rad/s2\ntau  0.0196   0.0004  s\n"
    assert [other for _, other in paired(["mu   1.0   2.0  rad/s2", "tau  3  4  s"], output)] == output.splitlines()
    assert [other for _, other in paired(["mu   1.0   2.0  rad/s"], output)] == [None]
    assert [other for _, other in paired(["tau  3  4  s", "mu   1  2  rad/s2"], output)] == [
        output.splitlines()[1],
        None,
    ]


@pytest.mark.parametrize(
    ("printed", "same"),
    [
        ("mu 359.6 0.61 rad/s2", True),
        ("mu 353 0.62 rad/s2", True),
        ("mu 129.98 0.61 rad/s2", False),
        ("mu 359.55 nan rad/s2", False),
        ("mu -359.55 0.61 rad/s2", False),
    ],
)
def test_a_stale_number_is_found(printed: str, same: bool) -> None:
    assert agree("mu 359.55 0.61 rad/s2", printed) == same


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_an_estimate_in_the_prose_is_in_the_output(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not_printed(text, commands(text)) == []


def test_an_estimate_that_no_command_printed_is_found() -> None:
    text = "mu is 359.3 ± .6\n```console\n$ twodof a\nmu 359.55 0.61\n```\n"
    assert not_printed(text, commands(text)) == ["359.3"]


def test_a_page_is_read_as_commands_with_output() -> None:
    text = "```console\n$ twodof a\nx 1\n\ny 2\n$ twodof b\nerror: no\n```\n$ not this\n```console\n$ twodof c\n```\n"
    assert commands(text) == [
        Command("twodof a", ["x 1", "y 2"]),
        Command("twodof b", ["error: no"]),
        Command("twodof c", []),
    ]
    assert [command.refused for command in commands(text)] == [False, True, False]


def test_a_flight_that_went_wrong_is_shown_as_one() -> None:
    assert commands("```console\n$ twodof fly a\n  ok     x\n  FAILED y: z\n```\n")[0].refused


def test_a_file_of_a_page_is_saved() -> None:
    text = 'a\n```python title="a.py"\nx = 1\n```\n```python\nnot_this = 1\n```\n'
    assert files(text) == {"a.py": "x = 1\n"}
