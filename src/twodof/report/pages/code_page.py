"""The generated C beside the blocks it came from, as one self-contained page: point at one to see the other."""

from __future__ import annotations

from html import escape

from twodof.compile.c.source_map import SourceMap

_STYLE = """
* { box-sizing: border-box; }
body { margin: 0; color: #16202e; background: #fff; height: 100vh; display: flex; flex-direction: column; }
body { font: 14px/1.5 system-ui, "Segoe UI", "Liberation Sans", sans-serif; }
header { padding: .7rem 1rem; border-bottom: 1px solid #d5dae2; } h1 { font-size: 1.1rem; margin: 0; }
header p { margin: .15rem 0 0; color: #556072; }
main { display: grid; grid-template-columns: minmax(15rem, 26rem) 1fr; flex: 1; min-height: 0; }
nav, pre { overflow: auto; margin: 0; padding: .6rem 0; } nav { border-right: 1px solid #d5dae2; }
ul { list-style: none; margin: 0; padding-left: 1rem; } nav > ul { padding-left: .6rem; }
nav button { all: unset; cursor: pointer; padding: .05rem .4rem; border-radius: 4px; }
nav button:focus-visible { outline: 2px solid #1d4a8f; } nav small { color: #556072; }
nav .out { color: #8a93a1; } nav .out button { cursor: default; }
pre { font: 12.5px/1.45 "DejaVu Sans Mono", Menlo, Consolas, monospace; tab-size: 4; counter-reset: line; }
pre span { display: block; padding: 0 1rem 0 4.5rem; min-height: 1.45em; position: relative; white-space: pre; }
pre span::before { counter-increment: line; content: counter(line); position: absolute; left: 0; width: 3.6rem;
  text-align: right; color: #9aa3b0; }
[data-b] { cursor: pointer; } .near { background: #e9f0fb; } .chosen { background: #cfe0fa; }
button.near, button.chosen { font-weight: 600; }
"""

_SCRIPT = """
const all = document.querySelectorAll('[data-b]');
const mark = (b, style) => all.forEach(e => e.classList.toggle(style, b !== null && e.dataset.b === b));
let chosen = null;
document.querySelector('[data-part="step"]')?.scrollIntoView({block: 'center'});
all.forEach(e => {
  e.addEventListener('mouseenter', () => mark(e.dataset.b, 'near'));
  e.addEventListener('mouseleave', () => mark(null, 'near'));
  e.addEventListener('click', () => {
    chosen = chosen === e.dataset.b ? null : e.dataset.b;
    mark(chosen, 'chosen');
    if (chosen === null) return;
    const other = e.tagName === 'SPAN' ? 'nav' : 'pre';
    const found = document.querySelectorAll(other + ' [data-b="' + chosen + '"]');
    const step = [...found].find(f => f.dataset.part === 'step') || found[0];
    if (step) step.scrollIntoView({block: 'center'});
  });
});
"""


def code_page(name: str, text: str, found: SourceMap) -> str:
    """The page of a diagram `name` that says `text` about itself; the same arguments give the same bytes."""
    number = {path: i for i, path in enumerate(sorted(found.blocks))}
    about = f"{len(found.blocks)} blocks, {len(found.lines)} lines of C. Point at a block or a line; click to keep it."
    rows = []
    for line in found.lines:
        mark = f' data-b="{number[line.block]}" data-part="{escape(line.part)}"' if line.block in number else ""
        title = line.block or line.role
        hint = f' title="{escape(title)}"' if title else ""
        rows.append(f"<span{mark}{hint}>{escape(line.text)}</span>")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(name)}: blocks and C</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f"<header><h1>{escape(name)}</h1><p>{escape(text + '. ' if text else '')}{about}</p></header>\n"
        f"<main>\n<nav>{_tree(found, number)}</nav>\n<pre>{''.join(rows)}</pre>\n</main>\n"
        f"<script>{_SCRIPT}</script>\n</body>\n</html>\n"
    )


def _tree(found: SourceMap, number: dict[str, int]) -> str:
    """The blocks as nested lists, by their paths."""
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
