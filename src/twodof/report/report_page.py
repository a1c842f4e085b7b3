"""Pages without script or network: the report, the failed tests of a diagram, and its C beside its blocks."""

import math
import re
from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from twodof.compile.c_files.c_files import SourceMap
from twodof.compile.diagram_test.assertions import Judgement, element_of
from twodof.compile.diagram_test.scenario import ScenarioResult
from twodof.identify.estimate import Estimate
from twodof.identify.validate import Correlation
from twodof.report.content import (
    Content,
    Figure,
    FigureBand,
    FigureLine,
    FigurePoint,
    Panel,
    ParameterRow,
    ReportTable,
    Subject,
    Uncertain,
)
from twodof.report.plots.canvas import correlation_figure, estimates_figure, page, time_figure
from twodof.report.wording import deviation, fill, plain, say, with_sigma

MAX_FIGURES = 50
"""Most failed tests that are drawn."""

_UNITS = {"velocity": "m"}
"""Unit of an experiment's output, if it is not rad/s."""

_KEY = {
    "measured": "measured",
    "input": "input",
    "set-point": "set-point",
    "simple": "simple method",
    "grey-box": "grey-box model",
}


def to_html(content: Content) -> str:
    """Return the whole page as text; the same content gives the same bytes."""
    sections = [
        ("table-1", "Table 1", "".join(_table_section(content.subjects))),
        *_figure_sections(content.subjects),
        *((table.anchor, table.title, _free_table(table)) for table in content.tables),
        ("residuals", "Residuals: what the models leave unexplained", "".join(_residual_section(content.subjects))),
        ("doubts", "Doubts: what the data could not tell", "".join(_doubt_section(content.subjects))),
        ("errata", "Errata of the paper", "".join(_errata_section(content.errata))),
        ("provenance", "Provenance", _provenance_table(content)),
    ]
    links, body = "", ""
    for anchor, name, inner in sections:
        if inner:
            links += f'<li><a href="#{anchor}">{escape(name.partition(":")[0])}</a></li>'
            body += f'<section id="{anchor}"><h2>{escape(name)}</h2>{inner}</section>'
    findings = "".join(f"<li>{_tied(finding)}</li>" for finding in content.findings)
    main = f'<nav aria-label="Contents"><ul>{links}</ul></nav>\n<main>{body}</main>'
    return page(content.title, content.lead, main, f'<ul class="findings">{findings}</ul>')


def _table_section(subjects: Sequence[Subject]) -> Iterator[str]:
    yield f'<p class="text">{say("table_1")}</p>'
    yield _key(("simple", "grey-box"), "marks")
    yield f'<figure class="wide">{estimates_figure(subjects, "Estimates and paper side by side")}</figure>'
    for subject in subjects:
        yield f'<h3>{escape(subject.name)}</h3><p class="text">{subject.text}</p>'
        yield _parameter_table(subject.rows)


def _parameter_table(rows: Sequence[ParameterRow]) -> str:
    known = any(row.truth is not None for row in rows)
    repeated = any(row.greybox_spread is not None for row in rows)
    heads = ["Parameter", "Unit", "Paper", "Paper, by “greyest”", *(["Truth"] if known else []), "Simple", "Grey-box"]
    heads += ["repeated"] if repeated else []
    lines = []
    for row in rows:
        cells = [_value(row.paper), _value(row.paper_greybox), *([_value(row.truth)] if known else [])]
        cells += [_found(row.simple, row.truth), _found(row.greybox, row.truth, row.greybox_sigma)]
        if repeated:
            cells.append("–" if row.greybox_spread is None else f"± {plain(row.greybox_spread, 2)}")
        symbol = f"<i>{row.symbol}</i> <small>{escape(row.text)}</small>"
        lines.append(_row(symbol, escape(row.unit) or "–", *cells))
    return _table(heads, "".join(lines))


def _table(heads: Sequence[str], body: str, style: str = "") -> str:
    """Return a table with these heads; `style` is its class."""
    head = "".join(f'<th scope="col">{name}</th>' for name in heads)
    named = f' class="{style}"' if style else ""
    return f'<div class="scroll"><table{named}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _row(head: str, *cells: str, left: int = 0) -> str:
    """Return a row of a table; its first `left` cells are text, set to the left."""
    looks = [' class="left"'] * left + [""] * len(cells)
    body = "".join(f"<td{look}>{cell}</td>" for look, cell in zip(looks, cells, strict=False))
    return f'<tr><th scope="row">{head}</th>{body}</tr>'


def _found(estimate: Uncertain | None, truth: float | None, sigma: float = math.nan) -> str:
    """Return an estimate and, below it, its deviation from the truth, also in `sigma` if one is given."""
    if estimate is None:
        return "–"
    below = "" if truth is None else f"<small>{deviation(Uncertain(estimate.value, sigma), truth)}</small>"
    return f"{with_sigma(estimate)}{below}"


def _free_table(table: ReportTable) -> str:
    body = "".join(_row(*map(escape, row)) for row in table.rows)
    return f'<p class="text">{table.text}</p>{_table([escape(name) for name in table.heads], body)}'


def _value(value: float | None) -> str:
    return "–" if value is None else plain(value)


def _figure_sections(subjects: Sequence[Subject]) -> Iterator[tuple[str, str, str]]:
    numbers = sorted({figure.number for subject in subjects for figure in subject.figures})
    for number in numbers:
        shown = [(s, figure) for s in subjects for figure in s.figures if figure.number == number]
        roles = [line.role for _, figure in shown for panel in figure.panels for line in panel.lines]
        cards = "".join(_figure_card(subject, figure) for subject, figure in shown)
        title = f"Figure {number}: {shown[0][1].title}"
        key = _key(tuple(dict.fromkeys(roles)), "lines") if roles else ""
        yield f"figure-{number}", title, f"{key}{_grid(len(shown))}{cards}</div>"


def _grid(columns: int) -> str:
    """Return the opening tag of a grid of cards, in `columns` if there is room for them, else in one column."""
    return f'<div class="grid of-{min(columns, 3)}">'


def _figure_card(subject: Subject, figure: Figure) -> str:
    drawing = figure.picture or time_figure(figure, escape(f"{figure.title}, {subject.name}", quote=True))
    caption = _tied(figure.caption)
    return f"<figure><h3>{escape(subject.name)}</h3>{drawing}<figcaption>{caption}</figcaption></figure>"


def _tied(text: str) -> str:
    """Return the text with numbers tied to their units and deviations, so that no line begins with one."""
    return re.sub(r"(?<=\d) (?=%|°|m?s\b|rad|m/s|1/s|σ|±)|(?<=±) ", "\N{NO-BREAK SPACE}", text)


def _key(roles: Sequence[str], kind: str) -> str:
    items = "".join(f'<li><span class="swatch {role}"></span>{_KEY[role]}</li>' for role in _KEY if role in roles)
    return f'<ul class="key {kind}">{items}</ul>'


def _residual_section(subjects: Sequence[Subject]) -> Iterator[str]:
    fits = [(subject, name, fit) for subject in subjects for name, fit in subject.fits.items()]
    if not fits:
        return
    yield f'<p class="text">{say("residuals")}</p>'
    heads = ("Machine", "Experiment", "Output", "FIT", "VAF", "RMSE", "FIT, validation", "White", "Free of the input")
    lines = []
    for subject, name, estimate in fits:
        fit = estimate.identification[0]
        figures = (f"{fit.fit_percent:.1f} %", f"{fit.vaf:.1f} %", f"{plain(fit.rmse, 3)} {_UNITS.get(name, 'rad/s')}")
        validation = ", ".join(f"{other.fit_percent:.1f} %" for other in estimate.validation) or "–"
        verdicts = _verdict(fit.whiteness), _verdict(*fit.inputs.values())
        cells = (escape(name), escape(fit.output), *figures, validation, *verdicts)
        lines.append(_row(escape(subject.name), *cells, left=1))
    yield _table(heads, _tied("".join(lines)), "break")
    yield _grid(len(subjects))
    for subject, name, estimate in fits:
        yield _residual_card(subject, name, estimate)
    yield "</div>"


def _verdict(*tests: Correlation | None) -> str:
    run = [test for test in tests if test is not None]
    if not run:
        return "<span>too few samples to test</span>"
    outside, lags = sum(test.outside for test in run), sum(test.lags.size for test in run)
    allowed = sum(test.allowed for test in run)
    word = '<b class="good">yes</b>' if all(test.passed for test in run) else '<b class="bad">no</b>'
    return f"{word} <span>{outside} of {lags} outside, {allowed} allowed</span>"


def _residual_card(subject: Subject, name: str, estimate: Estimate) -> str:
    fit = estimate.identification[0]
    title = f"{subject.name}: {name}, {fit.output}"
    tests = {} if fit.whiteness is None else {"residual with itself": fit.whiteness}
    tests |= {f"residual with {name}": test for name, test in fit.inputs.items()}
    if not tests:
        return ""
    drawing = correlation_figure(tests, escape(f"Residuals, {title}", quote=True))
    return f"<figure><h3>{escape(title)}</h3>{drawing}<figcaption>{_note(estimate)}</figcaption></figure>"


def _note(estimate: Estimate) -> str:
    """Return the meaning of the residual tests for the standard deviations."""
    if estimate.white:
        return say("white")
    shared = [label for label in estimate.labels if label not in estimate.local]
    return say("coloured", wider=max(estimate.sigma(label) / estimate.cramer_rao(label) for label in shared))


def _doubt_section(subjects: Sequence[Subject]) -> Iterator[str]:
    for subject in subjects:
        if subject.doubts:
            items = "".join(f"<li>{doubt}</li>" for doubt in subject.doubts)
            yield f'<h3>{escape(subject.name)}</h3><ul class="text">{items}</ul>'


def _errata_section(errata: Sequence[tuple[str, str, str]]) -> Iterator[str]:
    if errata:
        lines = "".join(_row(*row, left=2) for row in errata)
        yield _table(("Where", "Printed", "What this work shows"), lines, "prose")


def _provenance_table(content: Content) -> str:
    lines = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in content.provenance.items())
    return f"<dl>{lines}</dl>" if lines else ""


def failed_tests_page(name: str, results: Sequence[ScenarioResult]) -> str:
    """Return the page of the failed tests of the diagram `name`; the first MAX_FIGURES are drawn.

    A drawing shows the signal, the expected values of a table (dashed), and the violation.
    """
    failed = [(result, judgement) for result in results for judgement in result.failed]
    scenarios = sum(not result.passed for result in results)
    lead = f"{scenarios} of {len(results)} tests failed. Claims that do not hold: {len(failed)}."
    figures = "".join(_failed_figure(number, *one) for number, one in enumerate(failed[:MAX_FIGURES], 1))
    return page(f"Tests of {name}", escape(lead), f"<main>{figures}</main>")


def _failed_figure(number: int, result: ScenarioResult, judgement: Judgement) -> str:
    value = element_of(result.signals, judgement.signal, result.name).astype(np.float64)
    marks: list[FigureBand | FigurePoint] = []
    if judgement.limit is not None and np.isfinite(judgement.limit):
        marks.append(FigureBand(judgement.limit, judgement.limit, ""))
    if judgement.time is not None and judgement.value is not None and np.isfinite(judgement.value):
        marks.append(
            FigurePoint(judgement.time, judgement.value, f"{judgement.time:.4g} s, limit {judgement.limit:.4g}")
        )
    lines = [FigureLine("measured", result.time, value)]
    if judgement.check in result.expected:
        lines.append(FigureLine("set-point", *result.expected[judgement.check]))
    panel = Panel(judgement.signal, lines, marks, 1.3)
    title = escape(f"{result.name}: {judgement.check}")
    drawn = time_figure(Figure(number, title, "", [panel]), title)
    caption = f"<b>{title}</b><br>{escape(judgement.text)}"
    return f'<figure class="wide">{drawn}<figcaption>{caption}</figcaption></figure>'


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
