"""A diagram saved by the page has the bytes that Python gives it: the page's writer against `to_json`."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from tests.patience import PATIENCE_S
from tests.web.written_diagrams import texts

pytestmark = pytest.mark.slow

WEB = Path(__file__).resolve().parents[2] / "web"
VITEST = WEB / "node_modules" / "vitest" / "vitest.mjs"


@pytest.mark.skipif(not VITEST.is_file(), reason="the page's packages are not installed: run make web")
def test_the_page_writes_the_bytes_that_python_writes(tmp_path: Path) -> None:
    file = tmp_path / "texts.json"
    file.write_text(json.dumps(texts()), encoding="utf-8")
    done = subprocess.run(
        ["node", str(VITEST), "run", "tests/diagram/written_by_python.test.ts"],
        cwd=WEB,
        env=os.environ | {"VITE_TWODOF_TEXTS": str(file), "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"Tests  {len(texts())} passed" in done.stdout, done.stdout
