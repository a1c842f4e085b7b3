"""The catalogue: what an editor offers for the arguments of a block."""

from twodof.blocks.schema.json_form import catalogue


def test_an_argument_that_may_be_a_word_offers_its_words_whatever_its_default_is() -> None:
    choices = {entry["type"]: entry["choices"] for entry in catalogue()}
    assert choices["discrete_integrator"]["reset"] == ["none", "level", "rising", "falling", "either"]  # False
    assert choices["convert"]["overflow"] == ["wrap", "saturate"]  # None
    assert "clamping" in choices["pid"]["anti_windup"]  # "none"
    assert choices["pid"].keys().isdisjoint({"limits", "unit", "Kp"})
    assert "signs" not in choices["sum"], "any signs may be typed"
