"""The demo: the table, the report, and that the methods find what is true.

Its flights are simulated here, which gives the samples of those over MAVLink (tests/experiment/test_fly.py). In the
soak it flies as a user's does.
"""

import json
from collections.abc import Iterable, Iterator
from typing import Any

import pytest

from twodof.cli.app import run
from twodof.experiment.flight import Laboratory
from twodof.experiment.fly import SeriesFlight

pytestmark = pytest.mark.slow

KEYS = ["w_n", "xi", "mu", "tau", "k_v", "p_v"]


def simulated(rigs: Iterable[str], names: list[str], seeds: Iterable[int]) -> Iterator[SeriesFlight]:
    """Yield the flights of `fly_series` from the simulator."""
    for rig in rigs:
        laboratory = Laboratory(rig)
        for seed in seeds:
            yield from ((rig, name, seed, laboratory.fly(name, seed)) for name in names)


@pytest.fixture(scope="module", params=["simulated", pytest.param("flown", marks=pytest.mark.soak)])
def demo(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], str]:
    """The JSON document and the report's text; the real logs are left out, other tests are about them."""
    folder = tmp_path_factory.mktemp("demo")
    report = folder / "report.html"
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "simulated":
            patch.setattr("twodof.cli.demo.fly_series", simulated)
        patch.setenv("TWODOF_FLIGHT_DATA", str(folder))
        patch.setenv("XDG_CACHE_HOME", str(folder))
        written: list[str] = []
        patch.setattr("sys.stdout", Collector(written))
        assert run(["demo", "--json", "--repetitions", "3", "--out", str(report)]) == 0
    return json.loads("".join(written)), report.read_text()


class Collector:
    """A stdout that keeps what is written (capfd cannot be used by a fixture of a module)."""

    def __init__(self, kept: list[str]) -> None:
        self.kept = kept

    def write(self, text: str) -> None:
        self.kept.append(text)

    def flush(self) -> None:
        """Keep the interface of a file."""

    def isatty(self) -> bool:
        return False


@pytest.mark.long
def test_the_table_compares_the_six_parameters(demo: tuple[dict[str, Any], str]) -> None:
    machines = demo[0]["machines"]
    assert [machine["name"] for machine in machines] == ["virtual rig “paper”", "virtual rig “lab”"]
    for machine in machines:
        assert list(machine["parameters"])[:6] == KEYS
        for key in KEYS:
            row = machine["parameters"][key]
            assert all(row[column] is not None for column in ("paper", "simple", "greybox", "greybox_sigma"))


@pytest.mark.long
def test_the_simple_method_is_accurate_enough(demo: tuple[dict[str, Any], str]) -> None:
    """w_n 2 %, xi 15 %, mu 7 %, tau one sample of 4 ms."""
    rows = demo[0]["machines"][0]["parameters"]
    for key, share in (("w_n", 0.02), ("xi", 0.15), ("mu", 0.07)):
        assert rows[key]["simple"] == pytest.approx(rows[key]["truth"], rel=share), key
    assert rows["tau"]["simple"] == pytest.approx(rows["tau"]["truth"], abs=4.0)


@pytest.mark.long
def test_the_grey_box_holds_the_truth(demo: tuple[dict[str, Any], str]) -> None:
    for key, row in demo[0]["machines"][0]["parameters"].items():
        assert abs(row["greybox"] - row["truth"]) < 3.0 * row["greybox_sigma"], key


@pytest.mark.long
def test_the_report_is_whole(demo: tuple[dict[str, Any], str]) -> None:
    page = demo[1]
    assert page.startswith("<!doctype html>")
    assert page.endswith("</html>\n")
    for number in (3, 4, 5, 7, 8):
        assert f'id="figure-{number}"' in page
    assert "twodof log fetch" in page
