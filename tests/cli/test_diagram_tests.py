"""`twodof diagram test`, as a user meets it."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from tests.cli.program import Shell

TESTS = """
[[test]]
name = "gains"
duration = 0.1
inputs.theta_0 = { step = 0.1, at = 0.04 }
inputs.FLAG_ATTITUDE_ENABLED = true
checks = ["M never above {limit}", "M rises to 0.1 before 0.05"]
"""


@pytest.fixture
def tests(tmp_path: Path) -> list[str]:
    """Return a file with tests that pass, and a file with an assertion that does not hold."""
    files = []
    for name, limit in (("fine.toml", "0.2"), ("wrong.toml", "0.1")):
        (tmp_path / name).write_text(TESTS.replace("{limit}", limit), encoding="utf-8")
        files.append(str(tmp_path / name))
    return files


def test_the_status_says_whether_the_tests_pass(tests: list[str], shell: Shell) -> None:
    fine, wrong = tests
    out = shell(["diagram", "test", "pid-attitude", fine, "--target", "reference"]).out
    assert "  ok     gains: M rises to 0.1 before 0.05: at 0.04 s" in out
    assert out.endswith("1 of 1 tests passed\n")
    out = shell(["diagram", "test", "pid-attitude", fine, wrong, "--target", "reference"], 1).out
    assert re.search(r"FAILED gains: M never above 0\.1: 0\.\d+ at 0\.04 s is above 0\.1 by 0\.0\d+; ", out)
    assert out.endswith("1 of 2 tests passed\n")
    assert "cannot be read" in shell(["diagram", "test", "pid-attitude", "nowhere.toml"], 2).err


def test_machines_get_json_junit_and_a_page(tests: list[str], tmp_path: Path, shell: Shell) -> None:
    junit, page = tmp_path / "junit.xml", tmp_path / "failed.html"
    arguments = ["diagram", "test", "pid-attitude", *tests, "--target", "reference", "--precision", "float32"]
    found = shell([*arguments, "--json", "--junit", str(junit), "--html", str(page)], 1).json
    assert found["passed"] is False
    fine, wrong = found["files"].values()
    assert fine[0]["passed"] is True
    check = wrong[0]["checks"][0]
    assert (check["passed"], check["tick"], check["time"], check["limit"]) == (False, 10, 0.04, 0.1)
    assert check["by"] == pytest.approx(check["value"] - 0.1)
    suites = ElementTree.parse(junit).getroot()
    assert [suite.get("failures") for suite in suites] == ["0", "1"]
    text = page.read_text(encoding="utf-8")
    assert text.count("<svg") == 1
    assert "1 of 2 tests failed" in text
    assert not re.search(
        r"(src|href)\s*=|https?:|url\(|@import", re.sub(r"xmlns[^ >]*|url\(#\w+\)|href=\"#\w+\"", "", text)
    )
    assert "there already" in shell([*arguments, "--junit", str(junit)], 2).err


TABLE = """
[[test]]
name = 'a <b> & "c"'
[test.table]
columns = ["tick", "M"]
rows = [[0, 0.0], [5, 0.5], [9, 0.0]]
between = "interpolate"
absolute = 0.01
at = "ticks"
"""


def test_a_page_draws_what_a_table_expects(tmp_path: Path, shell: Shell) -> None:
    file, page = tmp_path / "table.toml", tmp_path / "failed.html"
    file.write_text(TABLE, encoding="utf-8")
    assert (
        "M as in table, within 0.01: 0 at 0.004 s is below 0.09 by 0.09; 8 ticks"
        in shell(["diagram", "test", "empty-attitude", str(file), "--target", "reference", "--html", str(page)], 1).out
    )
    text = page.read_text(encoding="utf-8")
    assert "<figcaption><b>a &lt;b&gt; &amp; &quot;c&quot;: M as in table" in text
    drawn = text[text.index("<svg") : text.index("</svg>") + 6]
    ElementTree.fromstring(drawn.replace("<svg ", '<svg xmlns:xlink="x" ', 1))
    assert drawn.count("stroke: var(--set-point)") == 1
    assert drawn.count("stroke: var(--measured)") == 1


def test_coverage_lists_missing_sides_and_can_fail(tests: list[str], shell: Shell) -> None:
    arguments = ["diagram", "test", "pid-attitude", tests[0], "--target", "reference"]
    out = shell([*arguments, "--coverage"]).out
    counts = re.search(r"coverage: (\d+) of the (\d+) sides of \d+ decisions were taken, ([\d.]+) %", out)
    assert counts
    number, sides, percent = int(counts[1]), int(counts[2]), float(counts[3])
    assert percent == pytest.approx(100.0 * number / sides, abs=0.05)
    assert len(out.partition("never taken:\n")[2].splitlines()) == 1 + sides - number  # with the head of the table
    assert re.search(r"^pid +output M +u\.clear +true", out, re.MULTILINE)
    assert "FAILED coverage: below 100 %" in shell([*arguments, "--coverage-min", "100"], 1).out
    found = shell([*arguments, "--coverage-min", str(percent - 1.0), "--json"]).json["coverage"]
    assert found["sides"] == sides
    assert sum(len(row["taken"]) for row in found["decisions"]) == number
