"""Pictures of fits: where they may be written. What they show is tested with `twodof identify`."""

from pathlib import Path
from typing import Any

import pytest

from twodof.errors import LogError
from twodof.models import pitch_rate
from twodof.report.plots.identification_plot import write_identification_plot


def test_the_place_is_checked_before_the_fit(tmp_path: Path) -> None:
    no_fit: Any = None
    taken = tmp_path / "fit.svg"
    taken.touch()
    for path, what in ((taken, "is there already"), (tmp_path / "fit.doc", "no picture has the suffix")):
        with pytest.raises(LogError, match=what):
            write_identification_plot(no_fit, pitch_rate(), [], path)
