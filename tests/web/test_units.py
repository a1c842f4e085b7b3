"""The unit tests of the browser page's own code, which stand in web/tests and run in Node.js."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.long
@pytest.mark.skipif(
    not (ROOT / "web" / "node_modules" / "installed-lock.json").is_file(),
    reason="the page's packages are not installed: run make web",
)
def test_the_units_of_the_page_pass() -> None:
    done = subprocess.run(
        ["tools/web.sh", sys.executable, "test"], cwd=ROOT, capture_output=True, text=True, timeout=2 * PATIENCE_S
    )
    assert done.returncode == 0, done.stdout + done.stderr
