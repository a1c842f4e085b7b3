"""Shared objects in this process."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.patience import PATIENCE_S

SOURCE = "int twodof_answer(void) { return 42; }\n"


def test_a_process_that_flushes_subnormals_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    code = (
        "import ctypes, sys\n"
        "from twodof.compile.native import load\n"
        "from twodof.compile.toolchain.compilers import find_compiler\n"
        "from twodof.errors import CompileError\n"
        "flush = load('#include <xmmintrin.h>\\nvoid flush(void) { _mm_setcsr(_mm_getcsr() | 0x8040); }',\n"
        "                    find_compiler())\n"
        "flush.flush()\n"
        "try:\n"
        f"    load({SOURCE!r}, find_compiler())\n"
        "except CompileError as error:\n"
        "    print(error.what)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    if "xmmintrin.h" in done.stderr:
        pytest.skip("not an x86 processor")
    assert "subnormal" in done.stdout, done.stderr
