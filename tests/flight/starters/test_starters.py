"""Every starter diagram: fits its template, is data with the same bits, carries its layout and bounded parameters."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from twodof.blocks import Diagram
from twodof.blocks.block import REGISTRY, Block
from twodof.blocks.schema.json_form import from_json, to_json
from twodof.compile import build
from twodof.errors import DiagramError, LogError
from twodof.flight.starters import STARTERS, load_diagram, new_diagram, save_diagram, starter
from twodof.flight.templates import TEMPLATES, check_template
from twodof.signals import PERIOD

pytestmark = pytest.mark.slow

STEPS = 400


def inputs_of(diagram: Diagram, steps: int = STEPS, seed: int = 3) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        name: rng.random(steps) < (0.1 if "RESET" in name else 0.7)
        if port.kind == "bool"
        else 0.3 * rng.standard_normal(steps)
        for name, port in diagram.inputs.items()
    }


@pytest.mark.parametrize("name", STARTERS)
def test_a_starter_fits_the_template_that_its_name_says(name: str) -> None:
    kind = name.rpartition("-")[2]
    assert check_template(starter(name)).name == f"{kind}_control"
    assert starter(name).name == name.replace("-", "_")


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", STARTERS)
def test_from_json_it_computes_the_same_bits(name: str, precision: str, tmp_path: Path) -> None:
    diagram = starter(name)
    file = tmp_path / "controller.json"
    save_diagram(diagram, file)
    loaded = load_diagram(file)
    assert to_json(loaded) == to_json(diagram) == file.read_text()
    inputs = inputs_of(diagram)
    ours, theirs = (build(d, PERIOD, precision).machine().run(STEPS, inputs) for d in (diagram, loaded))
    for output in diagram.outputs:
        assert ours[output].tobytes() == theirs[output].tobytes()
        assert np.isfinite(ours[output]).all()


@pytest.mark.parametrize("name", STARTERS)
def test_it_can_be_drawn_and_tuned(name: str) -> None:
    diagram = starter(name)
    assert diagram.text
    places = [part.position for part in diagram.parts.values()]
    assert None not in places
    assert len(set(places)) == len(places)
    for param in diagram.params.values():
        assert param.text
        assert math.isfinite(param.low)
        assert math.isfinite(param.high)


def test_only_the_stock_loops_are_no_library_blocks() -> None:
    own = {
        name: {type(part.item).__name__ for part in starter(name).parts.values() if _custom(part.item)}
        for name in STARTERS
    }
    assert {name: kinds for name, kinds in own.items() if kinds} == {
        "stock-attitude": {"AttitudeLoop", "RateLoop"},
        "stock-position": {"PositionLoop", "VelocityLoop", "Projection"},
    }


def _custom(item: Block | Diagram) -> bool:
    return isinstance(item, Block) and type(item).type_name not in REGISTRY


@pytest.mark.parametrize("kind", ["attitude", "position", "motor"])
def test_the_empty_one_asks_for_no_moment(kind: str) -> None:
    diagram = starter(f"empty-{kind}")
    out = build(diagram, PERIOD).machine().run(STEPS, inputs_of(diagram))
    if kind == "attitude":
        assert np.all(out["M"] == 0.0)
    elif kind == "position":
        assert np.all(out["thrust"] == 0.4)
        assert np.all(out["theta_0"] == 0.0)
    else:
        thrust = inputs_of(diagram)["thrust_0"]
        assert all(np.array_equal(out[port.name], thrust) for port in TEMPLATES["motor_control"].outputs)


def test_a_name_that_is_none_is_answered_with_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(DiagramError, match=r"no starter diagram called 'pid'.*there are: stock-attitude"):
        starter("pid")
    with pytest.raises(
        DiagramError, match=r"neither a file nor a starter diagram.*name a JSON file or one of stock-att"
    ):
        load_diagram(str(tmp_path / "nothing.json"))
    with pytest.raises(DiagramError, match="this is not a file"):
        load_diagram(tmp_path)
    with pytest.raises(DiagramError, match="cannot be read"):
        load_diagram("a" * 5000)


def test_a_file_is_bounded_and_only_data(tmp_path: Path) -> None:
    big = tmp_path / "big.json"
    with big.open("wb") as file:
        file.truncate(2**34)  # sparse: a reader that takes it whole would need 16 GiB
    with pytest.raises(DiagramError, match="bytes of diagram"):
        load_diagram(big)
    text = tmp_path / "text.json"
    text.write_text("import os")
    with pytest.raises(DiagramError, match=f"{text}: file: this is no JSON"):
        load_diagram(text)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(DiagramError, match="this is not a file"):
        load_diagram(pipe)


def test_a_new_diagram_overwrites_nothing(tmp_path: Path) -> None:
    file = tmp_path / "mine.json"
    new_diagram("lqr-attitude", file)
    written = file.read_bytes()
    assert to_json(from_json(written)).encode() == written
    with pytest.raises(LogError, match="there already"):
        new_diagram("empty-attitude", file)
    assert file.read_bytes() == written
    new_diagram("empty-attitude", file, overwrite=True)
    assert load_diagram(file).name == "empty_attitude"
    with pytest.raises(LogError, match="cannot be written"):
        new_diagram("empty-attitude", tmp_path / "no" / "folder.json")
