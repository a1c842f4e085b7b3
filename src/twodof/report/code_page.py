"""Page of the generated C beside its blocks: point at one to see the other."""

from html import escape

from twodof.compile.c_files.c_files import SourceMap
from twodof.report.wording import fill


def code_page(name: str, text: str, found: SourceMap) -> str:
    """Return the page of a diagram `name` described by `text`; the same arguments give the same bytes."""
    number = {path: i for i, path in enumerate(sorted(found.blocks))}
    about = f"{len(found.blocks)} blocks, {len(found.lines)} lines of C. Point at a block or a line; click to keep it."
    rows = []
    for line in found.lines:
        mark = f' data-b="{number[line.block]}" data-part="{escape(line.part)}"' if line.block in number else ""
        title = line.block or line.role
        hint = f' title="{escape(title)}"' if title else ""
        rows.append(f"<span{mark}{hint}>{escape(line.text)}</span>")
    return fill(
        "code_page.html",
        name=escape(name),
        text=escape(f"{text}. " if text else ""),
        about=about,
        tree=_tree(found, number),
        code="".join(rows),
    )


def _tree(found: SourceMap, number: dict[str, int]) -> str:
    """Return the blocks as nested lists, by their paths."""
    lines = ["<ul>"]
    open_: list[str] = []
    left_out = set(found.left_out)
    for path in sorted(found.blocks, key=lambda p: p.split(".")):
        *levels, name = path.split(".")
        while open_ and open_ != levels[: len(open_)]:
            open_.pop()
            lines.append("</ul></li>")
        for level in levels[len(open_) :]:
            open_.append(level)
            lines.append(f"<li>{escape(level)}<ul>")
        kind = found.blocks[path]
        if path in left_out:
            lines.append(
                f'<li class="out"><button>{escape(name)}</button> <small>{escape(kind)}, left out</small></li>'
            )
            continue
        lines.append(f'<li><button data-b="{number[path]}">{escape(name)}</button> <small>{escape(kind)}</small></li>')
    lines += ["</ul></li>"] * len(open_)
    return "".join([*lines, "</ul>"])
