"""module.yaml: valid by PX4's own rules, restated here, and true to the diagram."""

import math
import re
from typing import Any

import numpy as np
import pytest
import yaml

from tests.compile.px4.modules import PITCH_LOG, pitch, rail
from twodof.blocks import Block, Diagram, Param, Port
from twodof.blocks.library import Convert
from twodof.compile.px4.export import Px4Module, make_module
from twodof.compile.px4.parameters import MOST, number
from twodof.errors import DiagramError
from twodof.flight.starters import STARTERS, starter

KEYS = {"description", "type", "decimal", "min", "max", "unit", "reboot_required", "default"}
# The units that PX4 v1.14.4, v1.15.4, v1.16.1 and v1.17.0-alpha1 all allow, as far as they are of use here.
ALLOWED = {"%", "Hz", "1/s", "rad", "rad/s", "rad/s^2", "deg", "deg/s", "kg", "kg m^2", "m", "m/s", "m^2", "m/s^2"}
ALLOWED |= {"m/s^3", "V", "A", "us", "ms", "s", "Nm", "N"}


def definitions(module: Px4Module) -> dict[str, Any]:
    """The parameters in module.yaml, checked against PX4's schema and its parser's rules."""
    text = module.files[f"src/modules/{module.names.module}/module.yaml"]
    document = yaml.safe_load(text)
    assert set(document) == {"module_name", "parameters"}
    (group,) = document["parameters"]
    assert set(group) == {"group", "definitions"}
    for name, row in group["definitions"].items():
        assert re.fullmatch("[0-9A-Z_]+", name)
        assert len(name) <= 16
        assert set(row) <= KEYS
        assert set(row["description"]) == {"short", "long"}
        assert 0 < len(row["description"]["short"]) <= 70
        for said in row["description"].values():
            assert not re.search(r"[@\n]|\*/|\$\{", said)  # would end or extend the comment PX4 makes of it
        assert row["type"] in ("int32", "float", "boolean")
        kind = {"int32": int, "float": float, "boolean": bool}[row["type"]]
        for key in ("default", "min", "max"):
            if key in row:
                assert type(row[key]) is kind, (name, key, row[key])
                # what PX4's parser of the C that it makes of this accepts as a number
                assert re.fullmatch(r"[^ ,)]+", f"{row[key]}")
        if "unit" in row:
            assert row["unit"] in ALLOWED
            assert row["type"] != "boolean"
        assert row.get("min", -math.inf) <= row["default"] <= row.get("max", math.inf)
        assert ("decimal" in row) == (row["type"] == "float")
    assert [row.name for row in module.parameters] == list(group["definitions"])
    return dict(group["definitions"])


@pytest.mark.parametrize("name", STARTERS)
def test_the_starters_parameters_are_valid(name: str) -> None:
    definitions(make_module(starter(name)))


def test_parameters_of_all_types() -> None:
    rows = definitions(make_module(pitch(), PITCH_LOG))
    assert rows["TPI_DAMP_GAINS_1"] == {
        "description": {
            "short": "damper.gains[1]: of pitch and pitch rate",
            "long": "damper.gains[1]: of pitch and pitch rate. 0.0 to 4.0; another value is put back to the one "
            "that flies. A change acts at the next step.",
        },
        "type": "float",
        "decimal": 5,
        "min": 0.0,
        "max": 4.0,
        "default": 0.08,
    }
    assert rows["TPI_DAMPER_SHARE"]["type"] == "int32"
    assert rows["TPI_DAMPER_SHARE"]["min"] == 1
    assert rows["TPI_DAMPE_INTEGR"]["type"] == "boolean"
    assert rows["TPI_DAMPE_INTEGR"]["default"] is True
    assert rows["TPI_DAMPER_SUM_0"]["reboot_required"] is True
    assert "reboot_required" not in rows["TPI_DAMPER_KI"]
    assert rows["TPI_DAMPER_KI"]["description"]["short"] == "damper.ki: integral [1/rad]"
    assert rows["TPI_LIVE"]["default"] is True
    assert rows["TPI_TORQUE"]["default"] == pytest.approx(math.sqrt(2), rel=1e-7)
    assert definitions(make_module(rail()))["TRA_KP"]["unit"] == "1/s"


class Many(Block):
    """A block with the parameters it is given."""

    inputs = (Port("u"),)
    outputs = (Port("y"),)

    def __init__(self, params: Any) -> None:
        self.params = params

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return u.u


def with_params(*params: Param) -> Px4Module:
    """The module of a diagram with these parameters."""
    d = Diagram("many")
    d.input("q")
    d.add("b", Many(params), u="q")
    d.output("M", "b")
    return make_module(d)


def test_what_px4_cannot_hold_stays_at_its_default_and_is_listed() -> None:
    module = with_params(
        Param("limit", math.inf),
        Param("huge", 1e39),
        Param("mask", 2**31, "uint32"),
        Param("small_mask", 2**31 - 1, "uint32"),
        Param("table", [0.0] * 33, width=33),
        Param("row", [0.0] * 32, width=32),
    )
    assert {k.path for k in module.kept} == {"b.limit", "b.huge", "b.mask", "b.table"}
    rows = definitions(module)
    assert rows["TMA_B_SMALL_MASK"]["default"] == 2**31 - 1
    assert rows["TMA_B_SMALL_MASK"]["min"] == 0
    assert "TMA_B_ROW_31" in rows
    readme = module.files["README.md"]
    for kept in module.kept:
        assert f"`{kept.path}`: {kept.reason}" in readme


def test_the_kinds_beside_real() -> None:
    """Doubles are more than PX4 holds; short integers keep their range, and are assigned by a cast."""
    module = with_params(
        Param("exact", 0.1, "float64"), Param("single", 0.1, "float32"), Param("short", -5, "int8", high=100)
    )
    assert {k.path: k.reason for k in module.kept} == {"b.exact": "a float64; PX4's parameters are float32 and int32"}
    rows = definitions(module)
    assert (rows["TMA_B_SHORT"]["type"], rows["TMA_B_SHORT"]["min"], rows["TMA_B_SHORT"]["max"]) == ("int32", -128, 100)
    assert rows["TMA_B_SINGLE"]["type"] == "float"
    source = module.files[f"src/modules/{module.names.module}/{module.names.module}.c"]
    assert re.search(r"candidate\.b_short = \(int8_t\)values\[\d\]\.integer;", source)


def test_signals_of_the_kinds_beside_real_are_refused() -> None:
    d = Diagram("many")
    d.input("q")
    d.add("b", Many(()), u="q")
    d.add("wide", Convert("real", "float64"), u="q")
    d.output("M", "b")
    with pytest.raises(DiagramError, match=r"its signal 'wide\.y' is float64 \(convert it to one of real, int32"):
        make_module(d, ["wide.y"])


def test_too_many_parameters_are_refused() -> None:
    with pytest.raises(DiagramError, match="parameters for PX4"):
        with_params(*(Param(f"p{i}") for i in range(MOST + 1)))


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, 0.1, 1e-7, 123456.79, 3.4e38, 1e-42, -2.5e-5, 16777216.0])
def test_a_number_in_yaml_is_read_back_as_the_same_float32(value: float) -> None:
    text = number(float(np.float32(value)), "real")
    read = yaml.safe_load(text)
    assert type(read) is float
    # PX4 prints it with Python's str into C, whose compiler rounds the double to a float
    assert np.float32(float(str(read))).tobytes() == np.float32(value).tobytes()
