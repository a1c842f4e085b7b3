"""The tests of a diagram that failed, each with a plot of its signal, as a page without script or network."""

from collections.abc import Sequence
from html import escape

import numpy as np

from twodof.compile.diagram_test.assertions import Judgement, element_of
from twodof.compile.diagram_test.scenario import ScenarioResult
from twodof.report.content import Figure, FigureBand, FigureLine, FigurePoint, Panel
from twodof.report.plots.canvas import page
from twodof.report.plots.time_figures import time_figure

MAX_FIGURES = 50


def failed_tests_page(name: str, results: Sequence[ScenarioResult]) -> str:
    """The page of the diagram `name`: for each assertion that does not hold its signal, what a table expects of it
    (dashed), and the violation.

    The first 50 are drawn.
    """
    failed = [(result, judgement) for result in results for judgement in result.failed]
    scenarios = sum(not result.passed for result in results)
    lead = f"{scenarios} of {len(results)} tests failed. Claims that do not hold: {len(failed)}."
    figures = "".join(_figure(number, *one) for number, one in enumerate(failed[:MAX_FIGURES], 1))
    return page(f"Tests of {name}", escape(lead), f"<main>{figures}</main>")


def _figure(number: int, result: ScenarioResult, judgement: Judgement) -> str:
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
