"""The public Simulink controller beside its own C: what is measured, and what is missing without a checkout."""

import os

import pytest

from bench.computing.simulink_controller import CHECKOUT, run


@pytest.mark.long
@pytest.mark.skipif(CHECKOUT not in os.environ, reason=f"let {CHECKOUT} name the checkout of the public controller")
def test_both_programs_give_the_same_outputs() -> None:
    figures = run(quick=True)
    assert len(figures) == 5, figures
    assert [figure.remark for figure in figures[:3] if "outputs equal" not in figure.remark] == []


def test_missing_checkout_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(CHECKOUT, raising=False)
    (figure,) = run()
    assert CHECKOUT in figure.remark
