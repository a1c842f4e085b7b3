"""Builds the documentation's site in out/docs: `python tools/site.py`, which `make docs` runs.

First it gathers the pages of docs/, the API's pages and mkdocs.yml in one folder; then Zensical builds them, and a
broken link ends the build. The API's pages list what the examples, README and the pages import, so that a reader finds
each name of a program in them. A link to a file of the repository that is not a page becomes the file's name. The site
stands alone: nothing in it is fetched from elsewhere.
"""

import ast
import posixpath
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
DOCS = PROJECT / "docs"
SOURCE = PROJECT / "src"
CONFIGURATION = PROJECT / "mkdocs.yml"
PLAY = PROJECT / "out" / "play"
API = "reference/api"
# docs/reference/blocks.md is its page.
ELSEWHERE = {"twodof.blocks.library"}


def imported() -> list[str]:
    """The modules that examples and pages import from, sorted."""
    pages = [PROJECT / "README.md", *DOCS.rglob("*.md"), *(PROJECT / "examples").glob("*.py")]
    found = set[str]()
    for page in pages:
        text = page.read_text(encoding="utf-8")
        found |= set(re.findall(r"^ *from (twodof\.[\w.]+) import ", text, flags=re.MULTILINE))
    return sorted(found - ELSEWHERE)


def public_names(module: str) -> list[str]:
    """The public names of a module, in the order of its text; those that a package imports are its own."""
    base = SOURCE.joinpath(*module.split("."))
    package = base.is_dir()
    tree = ast.parse((base / "__init__.py" if package else base.with_suffix(".py")).read_text(encoding="utf-8"))
    listed: list[str] = []
    names: list[str] = []
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.ImportFrom) and package:
            names += [alias.asname or alias.name for alias in node.names]
        elif isinstance(node, ast.Assign) and isinstance(target := node.targets[0], ast.Name):
            if target.id == "__all__":
                listed = ast.literal_eval(node.value)
            else:
                names.append(target.id)
    return [name for name in listed or names if not name.startswith("_")]


def api_pages() -> Iterator[tuple[str, str]]:
    """(address, text) of each page: an index, and one for each room of the package, with its modules."""
    modules = imported()
    rooms = sorted({module.split(".")[1] for module in modules})
    intro = "Made from the docstrings of everything that the examples and these pages import."
    links = [f"- [`twodof.{room}`]({room}.md)" for room in rooms]
    yield f"{API}/index.md", "\n".join(["# The Python interface", "", intro, "", *links, ""])
    for room in rooms:
        lines = [f"# twodof.{room}", ""]
        for module in (module for module in modules if module.split(".")[1] == room):
            if module != f"twodof.{room}":
                lines += [f"## {module}", ""]
            lines += [f"::: {module}", "    options:", f"      members: {public_names(module)}", ""]
        yield f"{API}/{room}.md", "\n".join(lines)


def standing_alone(text: str, address: str) -> str:
    """A page's text, in which links to files of the repository outside of docs are the files' names."""

    def named(match: re.Match[str]) -> str:
        words, target = match[1], match[2]
        path = posixpath.normpath(posixpath.join("docs", posixpath.dirname(address), target.partition("#")[0]))
        if ":" in target or target.startswith("#") or path.startswith("docs/"):
            return match[0]
        return f"`{path}`" if words.strip("`/") in path else f"{words} (`{path}`)"

    return re.sub(r"(?<!!)\[([^\]]*)\]\(([^)\s]+)\)", named, text)


def not_listed(configuration: str) -> list[str]:
    """The pages of docs that the list of pages in mkdocs.yml leaves out."""
    listed = set(re.findall(r"^ +- (?:[^:\n]+: )?(\S+\.md)$", configuration, flags=re.MULTILINE))
    return sorted({str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")} - listed)


def gather(folder: Path) -> None:
    """Write everything that the site is built from into `folder`, which is emptied first."""
    configuration = CONFIGURATION.read_text(encoding="utf-8")
    if missing := not_listed(configuration):
        raise SystemExit(f"error: no place in the list of pages: {', '.join(missing)}; add them to nav in mkdocs.yml")
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS, folder / "docs")
    for page in (folder / "docs").rglob("*.md"):
        address = str(page.relative_to(folder / "docs"))
        page.write_text(standing_alone(page.read_text(encoding="utf-8"), address), encoding="utf-8")
    entries = []
    for address, text in api_pages():
        page = folder / "docs" / address
        page.parent.mkdir(exist_ok=True)
        page.write_text(text, encoding="utf-8")
        entries.append(f"          - {address}\n")
    configuration = configuration.replace(f"          - {API}/index.md\n", "".join(entries))
    configuration = configuration.replace("paths: [src]", f"paths: [{SOURCE}]")
    (folder / "mkdocs.yml").write_text(configuration, encoding="utf-8")


def build(folder: Path) -> Path:
    """Gather and build in `folder`; returns the site's own folder. Raises SystemExit with Zensical's words."""
    gather(folder)
    command = [sys.executable, "-m", "zensical", "build", "--strict"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"error: the site was not built\n{done.stdout}{done.stderr}")
    return folder / "site"


def fetched_from_elsewhere(site: Path) -> list[str]:
    """Return page and address of each file that a page loads from another host; links do not count."""
    loaded = r"<(?:script|img|iframe|source|object|embed|link)\b[^>]*\b(?:src|href|data)=[\"']((?:https?:)?//[^\"']+)"
    styled = r"(?:url\(|@import )[\"']?((?:https?:)?//[^\"')]+)"
    return [
        f"{path.relative_to(site)}: {address}"
        for suffix, pattern in (("*.html", loaded), ("*.css", styled), ("*.html", styled))
        for path in sorted(site.rglob(suffix))
        for address in re.findall(pattern, path.read_text(encoding="utf-8"))
    ]


def main() -> None:
    """Build the site and put it in out/docs."""
    out = PROJECT / "out"
    site = build(out / "site")
    if elsewhere := fetched_from_elsewhere(site):
        raise SystemExit("error: the site would fetch\n" + "\n".join(elsewhere))
    shutil.rmtree(out / "docs", ignore_errors=True)
    site.rename(out / "docs")
    if PLAY.is_dir():
        shutil.copytree(PLAY, out / "docs" / "play")
    shutil.rmtree(out / "site")
    sys.stdout.write("written: out/docs; read it with: python3 -m http.server --directory out/docs\n")


if __name__ == "__main__":
    main()
