"""Random diagrams: what is compiled gives the bits of the reference. Docs: language.md; the rules: emitted C's head."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tests.compile.differential import Case, cheap_cases, differences, random_cases, reference_run, sources
from twodof.blocks.expr import Expr
from twodof.compile import cexpr

CHUNKS = 8
STEPS = 20_000
COMPILERS = [c for c in ("gcc", "zig") if c == "zig" or shutil.which(c)]


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """These libraries are used once: they stay out of the user's cache."""
    monkeypatch.setenv("TWODOF_CACHE", str(tmp_path / "cache"))


def check(cases: Sequence[Case], precision: str, integrator: str, levels: Sequence[str] = ("-O0", "-O3")) -> None:
    expected = [reference_run(c, precision, integrator) for c in cases]
    source, lowered = sources(cases, precision, integrator)
    for compiler in COMPILERS:
        for level in levels:
            found = differences(cases, expected, source, lowered, compiler, level)
            assert not found, f"{precision} {compiler} {level}:\n" + "\n".join(found[:20])


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_small_diagrams_run_20000_steps_alike(chunk: int, precision: str) -> None:
    cases = cheap_cases(1000 + 100 * chunk, 13, STEPS)  # 104 in all
    check(cases, precision, "rk4")


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize(("first", "integrator"), [(0, "rk4"), (20, "euler")])
def test_large_diagrams_run_alike(first: int, integrator: str, precision: str) -> None:
    check(random_cases(range(first, first + 20), 200), precision, integrator)


@pytest.mark.soak
@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("chunk", range(100))
def test_thousands_of_diagrams_run_alike(chunk: int, precision: str) -> None:
    seeds = range(10_000 + 20 * chunk, 10_000 + 20 * (chunk + 1))
    check(random_cases(seeds, 500), precision, ("rk4", "euler")[chunk % 2])


def _swapped(op: str, args: Any) -> Any:
    return _ARITHMETIC({"add": "sub", "sub": "add"}.get(op, op), args)


_ARITHMETIC = cexpr._arithmetic
_EXPRESSION = cexpr.Renderer._expression


def _with_fmin(self: cexpr.Renderer, item: Expr, args: Sequence[cexpr.Text]) -> cexpr.Text:
    compared = [id(a) for a in item.args[0].args] if item.args and item.args[0].op == "lt" else []
    if item.op == "where" and item.kind == "real" and compared == [id(a) for a in item.args[1:]]:
        return f"__builtin_fmin({args[1][0]}, {args[2][0]})", cexpr.ATOM
    return _EXPRESSION(self, item, args)


def _with_plain_conversion(self: cexpr.Renderer, item: Expr, args: Sequence[cexpr.Text]) -> cexpr.Text:
    if item.op == "convert" and item.kind == "int32" and item.args[0].kind == "real":
        return f"(int32_t)({args[0][0]})", cexpr.ATOM
    return _EXPRESSION(self, item, args)


@pytest.fixture(scope="module")
def judged() -> tuple[list[Case], list[Any]]:
    """A few large diagrams with what the reference says of them."""
    cases = random_cases(range(230, 248), 150)
    return cases, [reference_run(c, "float64", "rk4") for c in cases]


@pytest.mark.parametrize(
    ("where", "name", "fault"),
    [
        (cexpr, "_arithmetic", _swapped),
        (cexpr.Renderer, "_expression", _with_fmin),
        (cexpr.Renderer, "_expression", _with_plain_conversion),
    ],
    ids=["plus-for-minus", "fmin", "unclamped-conversion"],
)
def test_a_fault_in_the_emitter_is_caught(
    where: Any, name: str, fault: Any, judged: tuple[list[Case], list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    cases, expected = judged
    right, lowered = sources(cases, "float64", "rk4")
    assert not differences(cases, expected, right, lowered, COMPILERS[0], "-O1")
    monkeypatch.setattr(where, name, fault)
    wrong, lowered = sources(cases, "float64", "rk4")
    assert wrong.text != right.text
    assert differences(cases, expected, wrong, lowered, COMPILERS[0], "-O1")


def test_contraction_is_caught(judged: tuple[list[Case], list[Any]]) -> None:
    """a * b + c in one rounding: what compilers do for processors with FMA unless they are told not to."""
    if "fma" not in Path("/proc/cpuinfo").read_text(encoding="utf-8").split():
        pytest.skip("this processor has no FMA")
    cases, expected = judged
    source, lowered = sources(cases, "float64", "rk4")
    loose = re.sub(r"#if defined\(__clang__\)\n.*?#endif\n", "", source.text, count=1, flags=re.DOTALL)
    assert loose != source.text
    contracted = type(source)(loose, source.layouts, source.precision)
    assert differences(cases, expected, contracted, lowered, COMPILERS[0], "-O3", flags=["-ffp-contract=fast"])
