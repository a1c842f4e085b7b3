"""A made-up report: two machines whose curves are textbook second-order responses, for tests of the layout."""

import math

import numpy as np

from twodof.identify.validate import compare
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
    Span,
    Subject,
    Uncertain,
)

HOSTILE = "real drone <script>alert(1)</script> & co"


def subject(name: str, seed: int, truth: bool) -> Subject:
    generator = np.random.default_rng(seed)
    time = np.arange(0.0, 18.0, 0.004)
    pulse = np.where((time > 0.5) & (time < 0.7), 0.1, 0.0)
    ring = np.where(time > 0.6, np.exp(-0.287 * (time - 0.6)) * np.cos(3.437 * (time - 0.6)), 0.0)
    noisy = 2.0 * ring + generator.normal(0.0, 0.02, time.size)
    rows = [
        ParameterRow("w_n", "ω<sub>n</sub>", "natural frequency", "rad/s", 3.437, None, 3.437 if truth else None,
                     Uncertain(3.42, 0.02), Uncertain(3.4372, 0.0009)),
        ParameterRow("xi", "ξ", "damping ratio", "", 0.0836, None, 0.0836 if truth else None,
                     Uncertain(0.079, 0.004), Uncertain(0.08361, 0.00026)),
        ParameterRow("mu", "μ", "gain", "rad/s²", 358.5, None, 358.5 if truth else None,
                     Uncertain(351.0), Uncertain(357.9, 1.3)),
        ParameterRow("tau", "τ", "delay", "ms", 20.0, None, 20.0 if truth else None,
                     Uncertain(20.0, 1.2), Uncertain(20.02, 0.11)),
        ParameterRow("k_v", "k<sub>v</sub>", "gain, pitch to velocity", "m/s²", 4.041, 4.748, 4.748 if truth else None,
                     Uncertain(4.3, 0.2), Uncertain(4.75, 0.04)),
        ParameterRow("p_v", "p<sub>v</sub>", "pole of the velocity", "1/s", 0.7387, 1.168, 1.168 if truth else None,
                     Uncertain(0.9, 0.2), Uncertain(1.16, 0.03)),
    ]  # fmt: skip
    free = Figure(
        3,
        "response to the impulse-like signal",
        "M = 0.1 for 0.2 s, then free. Period 1.83 s gives ω<sub>n</sub>.",
        [
            Panel("M [–]", [FigureLine("input", time, pulse)], height=0.6),
            Panel(
                "q [rad/s]",
                [FigureLine("measured", time, noisy), FigureLine("grey-box", time, 2.0 * ring)],
                [Span(0.6, 0.6 + 1.83, "period 1.83 s"), FigureBand(-0.02, 0.02, "±1 %")],
                height=1.6,
            ),
        ],
    )
    short = time[time < 3.0]
    response = np.where(short > 0.5, np.sin(6.0 * (short - 0.5)) * np.exp(-0.4 * short), 0.0)
    doublet = Figure(
        4,
        "doublet, identification data",
        "Three repetitions; the first identifies.",
        [
            Panel("M [–]", [FigureLine("input", short, 0.03 * np.sign(np.sin(10.5 * short)))], height=0.6),
            Panel(
                "q [rad/s]",
                [
                    FigureLine("measured", short, response + generator.normal(0.0, 0.06, short.size)),
                    FigureLine("simple", short, 0.95 * response),
                    FigureLine("grey-box", short, response),
                ],
                [FigurePoint(0.76, 0.9, "peak 2.40 rad/s")],
                height=1.6,
            ),
        ],
    )
    noise = generator.normal(0.0, 0.06, short.size)
    coloured = noise if truth else np.convolve(noise, np.ones(4) / 2.0, "same")
    moment = generator.normal(0.0, 1.0, short.size)
    identified = compare("doublet 1", "q", short, response + coloured, response, {"M": moment})
    validated = compare("doublet 2", "q", short, response + noise[::-1], response, {"M": moment})
    check = FitCheck("doublet", "rad/s", identified, [validated], "What the noise means for sigma.")
    return Subject(name, "A machine that exists for this test only.", rows, [free, doublet], [check], ["k and c."])


def content() -> Content:
    return Content(
        "The 2DoF Drone, characterised",
        "Made up for a test.",
        ["<b>μ 357.9 ± 1.3</b> where 358.5 is true", "FIT 96 %"],
        [subject("virtual rig, paper", 1, True), subject(HOSTILE, 2, False)],
        [Erratum("Equation 6", "c = 2ξω<sub>n</sub>/J", "c = 2ξω<sub>n</sub>J")],
        [ReportTable("replay", "Replayed", "What was seen.", ["flight", "M"], [["steps <1>", "1e-7"]])],
        {"seed": "1", "sum": str(math.fsum([0.1] * 10))},
    )
