"""Charts of block characters: what is where, with nothing but the characters to go by."""

import numpy as np
from rich.console import Console

from twodof.cli.watch.block_chart import Columns, bound, chart


def line_of(values: list[float]) -> Columns:
    return np.array(values), np.array(values)


def text(measured: Columns, wanted: Columns | None, height: int, limit: float) -> list[str]:
    return [line.plain for line in chart(measured, wanted, height, limit)]


def test_a_step_and_its_set_point() -> None:
    """The set-point is a thin rule, the response a line of blocks that covers it where it follows."""
    measured = line_of([-0.5] * 6 + [0.5] * 6)
    wanted = line_of([-0.5] * 2 + [0.5] * 10)
    assert text(measured, wanted, 3, 0.75) == [
        " ▁▁▄▄▄",
        "┈┊┈▌┈┈",
        "▄▄▄▌  ",
    ]


def test_it_reads_without_colour() -> None:
    drawn = chart(line_of([0.0, 1.0, -1.0, 0.0]), line_of([1.0] * 4), 3, 1.0)
    console = Console(no_color=True, color_system=None, width=20, force_terminal=True)
    with console.capture() as got:
        for line in drawn:
            console.print(line, end="\n")
    assert "\x1b[3" not in got.get()
    assert got.get().split() == "\n".join(line.plain for line in drawn).split()


def test_every_value_of_a_line_is_on_its_level() -> None:
    """Upside down and back: from the characters the value comes to within half a level."""
    quarters = " ▘▝▀▖▌▞▛▗▚▐▜▄▙▟█"
    values = 0.9 * np.sin(np.linspace(0.0, 6.0, 60))
    height = 20
    drawn = text(line_of(list(values)), None, height, 1.0)
    for k, value in enumerate(values):
        bit = (1 if k % 2 == 0 else 2, 4 if k % 2 == 0 else 8)
        rows = [
            2 * row + lower
            for row in range(height)
            for lower in (0, 1)
            if drawn[row][k // 2] in quarters and quarters.index(drawn[row][k // 2]) & bit[lower]
        ]
        level = (1.0 - value) / 2.0 * 2 * height
        assert min(abs(row + 0.5 - level) for row in rows) <= 0.5 + 1e-9


def test_what_is_not_known_is_not_drawn() -> None:
    gap = line_of([0.5, 0.5, np.nan, np.nan, 0.5, 0.5])
    assert [line[1] for line in text(gap, None, 3, 1.0)] == [" ", "┈", " "]
    assert text(line_of([np.nan] * 4), None, 1, 1.0) == ["  "]


def test_what_is_beyond_is_at_the_edge() -> None:
    assert text(line_of([9.0] * 2), None, 3, 1.0) == ["▀", "┈", " "]
    assert text(line_of([-9.0] * 2), None, 3, 1.0) == [" ", "┈", "▄"]


def test_one_line_is_a_row_of_heights() -> None:
    assert text(line_of(list(np.linspace(-1.0, 1.0, 16))), None, 1, 1.0) == ["▁▂▃▄▅▆▇█"]


def test_limits_come_from_the_ladder() -> None:
    ladder = (1.0, 2.0, 5.0)
    assert bound([np.array([0.1, np.nan])], ladder) == 1.0
    assert bound([np.array([0.1]), np.array([-1.5])], ladder) == 2.0
    assert bound([np.array([70.0])], ladder) == 5.0
    assert bound([np.array([np.nan])], ladder) == 1.0
