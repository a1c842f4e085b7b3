"""The how-to pages that change the source leave out nothing: their steps work on a copy of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.how_to import PROJECT, carry_out, copied

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_flight_parameter_is_its_row_and_equation(tmp_path: Path) -> None:
    root = copied(tmp_path)
    before = (root / "docs" / "reference" / "parameters.md").read_text(encoding="utf-8")
    assert carry_out("add-a-parameter.md", root) == {
        "src/twodof/parameters.py",
        "src/twodof/flight/cascade.py",
        "bench/computing/hand/loop.h",
        "bench/computing/hand/flight.h",
    }
    after = (root / "docs" / "reference" / "parameters.md").read_text(encoding="utf-8")
    assert "ATT_Q_MAX" not in before
    assert "ATT_Q_MAX" in after
    page = Path("docs/how-to/check-a-diagram.md")
    assert (root / page).read_text(encoding="utf-8") != (PROJECT / page).read_text(encoding="utf-8"), "its lines move"


@pytest.mark.long
def test_a_telemetry_signal_is_five_files(tmp_path: Path) -> None:
    root = copied(tmp_path)
    assert len(carry_out("add-a-signal.md", root)) == 5
    assert "estimate.bias" in (root / "docs" / "reference" / "topics.md").read_text(encoding="utf-8")


@pytest.mark.long
def test_a_sensor_with_its_own_rate_is_six_files(tmp_path: Path) -> None:
    root = copied(tmp_path)
    assert len(carry_out("add-a-sensor.md", root)) == 6
    assert "camera.flow" in (root / "docs" / "reference" / "topics.md").read_text(encoding="utf-8")


def test_an_excitation_is_two_files(tmp_path: Path) -> None:
    changed = carry_out("add-an-excitation.md", copied(tmp_path))
    assert changed == {"src/twodof/blocks/library/sources.py", "src/twodof/excitation.py"}


def test_a_stick_mode_is_three_files(tmp_path: Path) -> None:
    assert carry_out("add-a-stick-mode.md", copied(tmp_path)) == {
        "src/twodof/link/mavlink/modes.py",
        "src/twodof/fcu/command/setpoints.py",
        "docs/reference/protocol.md",
    }


@pytest.mark.long
def test_a_block_is_its_file_and_its_test(tmp_path: Path) -> None:
    root = copied(tmp_path)
    (root / "tests" / "blocks" / "library").mkdir(parents=True)
    files = {"src/twodof/blocks/library/math.py", "tests/blocks/library/test_signed_root.py"}
    assert carry_out("add-a-block.md", root) == files
    assert "### SignedRoot" in (root / "docs" / "reference" / "blocks.md").read_text(encoding="utf-8")
