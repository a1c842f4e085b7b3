"""Pages without script or network, for light, dark and print: the report, and the failed tests of a diagram."""

import math
import re
from collections.abc import Iterator, Sequence
from html import escape

import numpy as np

from twodof.compile.diagram_test.assertions import Judgement, element_of
from twodof.compile.diagram_test.scenario import ScenarioResult
from twodof.identify.validate import Correlation
from twodof.report.content import (
    Content,
    Erratum,
    Figure,
    FigureBand,
    FigureLine,
    FigurePoint,
    FitCheck,
    Panel,
    ParameterRow,
    ReportTable,
    Subject,
    Uncertain,
)
from twodof.report.plots.canvas import page
from twodof.report.plots.time_figures import correlation_figure, estimates_figure, time_figure
from twodof.report.wording import deviation, plain, say, with_sigma

MAX_FIGURES = 50
"""Most failed tests that are drawn."""

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
    sections = [section for section in sections if section[2]]
    links = "".join(
        f'<li><a href="#{anchor}">{escape(name.partition(":")[0])}</a></li>' for anchor, name, _ in sections
    )
    findings = "".join(f"<li>{_tied(finding)}</li>" for finding in content.findings)
    body = "".join(
        f'<section id="{anchor}"><h2>{escape(name)}</h2>{inner}</section>' for anchor, name, inner in sections
    )
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
        lines.append(
            f'<tr><th scope="row"><i>{row.symbol}</i> <small>{escape(row.text)}</small></th>'
            f"<td>{escape(row.unit) or '–'}</td>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>"
        )
    return _table(heads, "".join(lines))


def _table(heads: Sequence[str], body: str, style: str = "") -> str:
    """Return a table with these heads; `style` is its class."""
    head = "".join(f'<th scope="col">{name}</th>' for name in heads)
    named = f' class="{style}"' if style else ""
    return f'<div class="scroll"><table{named}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _found(estimate: Uncertain | None, truth: float | None, sigma: float = math.nan) -> str:
    """Return an estimate and, below it, its deviation from the truth, also in `sigma` if one is given."""
    if estimate is None:
        return "–"
    below = "" if truth is None else f"<small>{deviation(Uncertain(estimate.value, sigma), truth)}</small>"
    return f"{with_sigma(estimate)}{below}"


def _free_table(table: ReportTable) -> str:
    body = "".join(
        f'<tr><th scope="row">{escape(row[0])}</th>' + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:]) + "</tr>"
        for row in table.rows
    )
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
    checks = [(subject, check) for subject in subjects for check in subject.checks]
    if not checks:
        return
    yield f'<p class="text">{say("residuals")}</p>'
    heads = ("Machine", "Experiment", "Output", "FIT", "VAF", "RMSE", "FIT, validation", "White", "Free of the input")
    lines = []
    for subject, check in checks:
        fit = check.identification
        validation = ", ".join(f"{other.fit_percent:.1f} %" for other in check.validation) or "–"
        lines.append(
            f'<tr><th scope="row">{escape(subject.name)}</th><td class="left">{escape(check.experiment)}</td>'
            f"<td>{escape(fit.output)}</td><td>{fit.fit_percent:.1f} %</td><td>{fit.vaf:.1f} %</td>"
            f"<td>{plain(fit.rmse, 3)} {escape(check.unit)}</td><td>{validation}</td>"
            f"<td>{_verdict(fit.whiteness)}</td><td>{_verdict(*fit.inputs.values())}</td></tr>"
        )
    yield _table(heads, _tied("".join(lines)), "break")
    yield _grid(len(subjects))
    for subject, check in checks:
        yield _residual_card(subject, check)
    yield "</div>"


def _verdict(*tests: Correlation | None) -> str:
    run = [test for test in tests if test is not None]
    if not run:
        return "<span>too few samples to test</span>"
    outside, lags = sum(test.outside for test in run), sum(test.lags.size for test in run)
    allowed = sum(test.allowed for test in run)
    word = '<b class="good">yes</b>' if all(test.passed for test in run) else '<b class="bad">no</b>'
    return f"{word} <span>{outside} of {lags} outside, {allowed} allowed</span>"


def _residual_card(subject: Subject, check: FitCheck) -> str:
    fit = check.identification
    title = f"{subject.name}: {check.experiment}, {fit.output}"
    tests = {} if fit.whiteness is None else {"residual with itself": fit.whiteness}
    tests |= {f"residual with {name}": test for name, test in fit.inputs.items()}
    if not tests:
        return ""
    drawing = correlation_figure(tests, escape(f"Residuals, {title}", quote=True))
    return f"<figure><h3>{escape(title)}</h3>{drawing}<figcaption>{check.note}</figcaption></figure>"


def _doubt_section(subjects: Sequence[Subject]) -> Iterator[str]:
    for subject in subjects:
        if subject.doubts:
            items = "".join(f"<li>{doubt}</li>" for doubt in subject.doubts)
            yield f'<h3>{escape(subject.name)}</h3><ul class="text">{items}</ul>'


def _errata_section(errata: Sequence[Erratum]) -> Iterator[str]:
    if errata:
        lines = "".join(
            f'<tr><th scope="row">{e.place}</th><td class="left">{e.printed}</td><td class="left">{e.shown}</td></tr>'
            for e in errata
        )
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
