"""The page of Simulink's blocks is what its generator makes of the table that the import uses."""

from tools.simulink_docs import PAGE, render


def test_the_reference_of_simulinks_blocks_is_current() -> None:
    assert PAGE.read_text(encoding="utf-8") == render(), "run `python tools/simulink_docs.py`"
