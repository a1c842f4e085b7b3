"""A design as a whole: it says how far it is, and Ctrl-C ends the command at any moment."""

import json
from pathlib import Path

import pytest

from tests.cli.test_interrupts import interrupted
from twodof.design.designed_controller import design_controller
from twodof.design.pitch_family import PitchFamily
from twodof.design.specification import Specification
from twodof.errors import ParameterError

pytestmark = pytest.mark.slow

FAMILY = PitchFamily.of(
    {"w_n": 3.437, "xi": 0.0836, "mu": 358.5, "tau": 0.02}, {"mu": 10.0, "dead_time": 0.0005}, gust=0.5, q_noise=0.01
)


@pytest.mark.long
@pytest.mark.parametrize("specification", [None, Specification(bandwidth=4.0)], ids=["rule", "specification"])
def test_it_says_how_far_it_is(specification: Specification | None) -> None:
    seen: list[tuple[str, float]] = []
    made = design_controller(FAMILY, specification=specification, members=60, progress=lambda *one: seen.append(one))
    assert made.ready
    assert made.saturation.goal == made.promise.goal
    shares = [share for _, share in seen]
    assert shares == sorted(shares)
    assert {"the worst member", "flying the members", "the motors' limits"} <= {text for text, _ in seen}
    assert len(seen) > 20


@pytest.mark.long
@pytest.mark.parametrize("after_s", [0.5, 2.5])
def test_ctrl_c_ends_a_design_in_a_line(after_s: float, tmp_path: Path) -> None:
    (tmp_path / "model.json").write_text(json.dumps({"model": dict(FAMILY.values)}))
    (tmp_path / "spec.toml").write_text("[pitch]\nbandwidth = 4.0\n", encoding="utf-8-sig")
    (folder := tmp_path / "empty").mkdir()
    command = ["design", "controller", str(tmp_path / "model.json"), "--spec", str(tmp_path / "spec.toml")]
    # 20,000 members take many seconds: it is at work when the signal comes
    assert interrupted(after_s, folder, *command, "--members", "20000", "--out", "mine.json") == ""


def test_refuses_what_does_not_go_together() -> None:
    for bad in ({"method": "magic"}, {"method": "lqg", "anti_windup": "clamping"}, {"crossover": -1.0}):
        with pytest.raises(ParameterError) as caught:
            design_controller(FAMILY, **bad)  # type: ignore[arg-type]
        assert caught.value.remedy
