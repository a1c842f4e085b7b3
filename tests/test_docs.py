"""Documentation that fails when it is missing or wrong: docstrings, links, examples, README's code."""

import ast
import json
import os
import re
import runpy
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

import twodof
from tests.patience import PATIENCE_S

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).resolve().parents[1]
SOURCE = PROJECT / "src" / "twodof"
PAGES = sorted([*PROJECT.glob("*.md"), *(PROJECT / "docs").rglob("*.md")])
EXAMPLES = sorted((PROJECT / "examples").glob("*.py"))
EXAMPLE_LINES = 60
LONG = ("fly_experiment", "s1_identify", "s3_attitude")
"""Examples for the soak: a tutorial and the page on tuning fly the same, or the like with shorter flights."""


def undocumented(name: str, tree: ast.Module) -> Iterator[str]:
    """Public modules, functions and classes without a docstring, and the methods a class does not inherit."""
    if not ast.get_docstring(tree):
        yield name
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        if node.name.startswith("_"):
            continue
        if not ast.get_docstring(node):
            yield f"{name}:{node.lineno} {node.name}"
        if isinstance(node, ast.ClassDef) and not node.bases:
            for method in node.body:
                public = isinstance(method, ast.FunctionDef) and not method.name.startswith("_")
                if public and not ast.get_docstring(method):
                    yield f"{name}:{method.lineno} {node.name}.{method.name}"


@pytest.mark.long
def test_everything_public_has_a_docstring() -> None:
    missing = [
        line
        for path in sorted(SOURCE.rglob("*.py"))
        for line in undocumented(str(path.relative_to(SOURCE)), ast.parse(path.read_text()))
    ]
    assert missing == []


def test_a_missing_docstring_is_found() -> None:
    tree = ast.parse('"""M."""\ndef f(): ...\nclass A:\n    """A."""\n    def g(self): ...\ndef _h(): ...\n')
    assert list(undocumented("m.py", tree)) == ["m.py:2 f", "m.py:5 A.g"]


def anchors(text: str) -> set[str]:
    """The anchors a page's headings make, by the rule common Markdown hosts use."""
    headings = re.findall(r"^#+\s+(.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def broken_links(page: Path) -> Iterator[str]:
    """Relative links and pictures of a Markdown page that lead nowhere; the network is not asked."""
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(), flags=re.DOTALL)
    for label, target in re.findall(r"(?<=\[)([^\[\]]*)\]\(([^)\s]+)[^)]*\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        if re.fullmatch(r"[\w./]+\.\w+", label) and not target.endswith(label):
            yield f"{page.name}: {label} leads to {target}"
        path, _, anchor = target.partition("#")
        file = (page.parent / path) if path else page
        if not file.exists():
            yield f"{page.name}: {target}"
        elif anchor and file.suffix == ".md" and anchor not in anchors(file.read_text()):
            yield f"{page.name}: {target} (no such heading)"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(PROJECT)))
def test_no_link_is_broken(page: Path) -> None:
    assert list(broken_links(page)) == []


def test_a_broken_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A b\n[ok](#a-b) [ok](page.md#a-b) [x](nowhere.md) ![y](#c) `[z](code.md)` [w](https://a.b) [b.md](page.md)\n"
    )
    assert list(broken_links(page)) == [
        "page.md: nowhere.md",
        "page.md: #c (no such heading)",
        "page.md: b.md leads to page.md",
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(PROJECT)))
def test_every_file_that_a_page_names_is_there(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    named = set(re.findall(r"(?<![\w/.*$])((?:\w+/)+\w+\.(?:py|c|xml|mjs))\b", text))
    places = (PROJECT, SOURCE, PROJECT / "tests", PROJECT / "tests" / "fcu")
    assert sorted(name for name in named if not any((place / name).is_file() for place in places)) == []


def run(code: Path, folder: Path) -> None:
    """Run a Python file as a program in an empty folder, warnings being errors.

    It runs in this process, which has loaded the package: loading it again would take longer than most of them.
    """
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        patch.chdir(folder)
        patch.setattr("sys.argv", [str(code)])
        patch.setenv("MPLBACKEND", "Agg")
        warnings.simplefilter("error")
        try:
            runpy.run_path(str(code), run_name="__main__")
        except SystemExit as end:
            if end.code:
                raise


@pytest.mark.long
@pytest.mark.parametrize(
    "example",
    [pytest.param(path, id=path.name, marks=[pytest.mark.soak] if path.stem in LONG else []) for path in EXAMPLES],
)
def test_an_example_is_short_and_runs(example: Path, tmp_path: Path) -> None:
    assert len(example.read_text().splitlines()) <= EXAMPLE_LINES
    run(example, tmp_path)


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_a_first_page_leads_to_the_browser(page: str) -> None:
    text = (PROJECT / page).read_text()
    assert "pictures/ground-station-fly.png" in text
    assert "tutorials/ground-station.md" in text


def test_readme_stays_a_screen_and_a_half() -> None:
    assert len((PROJECT / "README.md").read_text().splitlines()) <= 80


@pytest.mark.long
def test_readme_code_prints_what_it_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (PROJECT / "README.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    assert blocks, "README shows no example of the API"
    script = tmp_path / "readme.py"
    script.write_text("\n".join(blocks))
    run(script, tmp_path)
    assert capsys.readouterr().out == "".join(re.findall(r"```text\n(.*?)```", page, flags=re.DOTALL))


@pytest.mark.long
def test_readme_shell_block_can_be_pasted(tmp_path: Path) -> None:
    """In an empty folder; the page says the mu that the fit with what is known of the rig gives there."""
    page = (PROJECT / "README.md").read_text()
    (block,) = (text for text in re.findall(r"```sh\n(.*?)```", page, flags=re.DOTALL) if "twodof fly" in text)
    pasted = block.replace(". .venv/bin/activate\n", "set -e\n")
    programs = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": programs, "PYTHONPATH": str(PROJECT / "src")}
    done = subprocess.run(
        ["sh", "-c", pasted], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=10 * PATIENCE_S
    )
    assert done.returncode == 0, done.stderr
    (printed,) = re.findall(r"^mu +([\d.]+)", done.stdout, flags=re.MULTILINE)
    assert f"mu {float(printed):.0f} rad/s2" in page


@pytest.mark.long
def test_a_notebook_runs(tmp_path: Path) -> None:
    cells = json.loads((PROJECT / "examples" / "first_flight.ipynb").read_text())["cells"]
    script = tmp_path / "notebook.py"
    script.write_text("\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"))
    run(script, tmp_path)


def test_the_versions_agree() -> None:
    places = {
        "pyproject.toml": r'^version = "(.+)"',
        "CITATION.cff": r"^version: (.+)",
        "README.md": r"twodof-(.+)-py3",
    }
    found = {re.findall(text, (PROJECT / name).read_text(), flags=re.MULTILINE)[0] for name, text in places.items()}
    assert found == {twodof.__version__}


@pytest.mark.parametrize(
    "name",
    [
        "how-to/fit-your-own-data",
        "how-to/test-a-diagram",
        "how-to/come-from-simulink",
        "how-to/write-a-state-machine",
        "explanation/language",
    ],
)
def test_the_code_of_a_page_on_design_runs(name: str, tmp_path: Path) -> None:
    page = PROJECT / "docs" / f"{name}.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)
    assert blocks
    script = tmp_path / "page.py"
    script.write_text("\n".join(blocks))
    run(script, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", ["recipes", "check-a-diagram", "bring-your-own-rig"])
def test_each_recipe_prints_what_the_page_says(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (PROJECT / "docs" / "how-to" / f"{name}.md").read_text()
    script = tmp_path / "recipes.py"
    script.write_text("\n".join(re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)))
    run(script, tmp_path)
    assert capsys.readouterr().out == "".join(re.findall(r"```text\n(.*?)```", page, flags=re.DOTALL))


@pytest.mark.long
def test_the_code_of_the_pages_on_tuning_and_recording_runs(tmp_path: Path) -> None:
    pages = [PROJECT / "docs" / "how-to" / name for name in ("tune-in-flight.md", "record-and-convert.md")]
    blocks = [re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL) for page in pages]
    assert all(blocks)
    script = tmp_path / "pages.py"
    script.write_text("\n".join(block for page in blocks for block in page))
    run(script, tmp_path)


def test_no_file_names_a_package_index() -> None:
    host = re.compile(r"https?://[a-z.]*(" + "|".join(["py" + "pi", "npm" + "js", "python" + "hosted"]) + ")")
    listed = subprocess.run(["git", "ls-files"], cwd=PROJECT, capture_output=True, text=True, check=False)
    names = listed.stdout.splitlines() or [str(path.relative_to(PROJECT)) for path in SOURCE.rglob("*.py")]
    texts = [PROJECT / name for name in names if not name.endswith((".png", ".svg"))]
    assert [path.name for path in texts if path.is_file() and host.search(path.read_text())] == []
