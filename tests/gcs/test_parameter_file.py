"""Parameter files: what QGroundControl writes is read, what is written reads back to the same float32."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twodof.errors import ParameterError
from twodof.gcs.parameter_file import ParameterFile
from twodof.gcs.parameters import INT32, REAL32, ParameterEntry

# As QGroundControl 4 writes it, with 18 digits; the layout is that of its developer guide.
FROM_QGC = """# Onboard parameters for Vehicle 1
#
# Stack: PX4 Pro
# Vehicle: Multi-Rotor
# Version: 1.16.0
# Git Revision: 6ea3539157f3cd70
#
# Vehicle-Id Component-Id Name Value Type
1\t1\tRATE_KP\t0.085400000214576721\t9
1\t1\tSAFE_WATCH_BITS\t1\t6
1\t100\tCAM_MODE\t2\t6
"""


def entry(name: str, value: float, kind: int = REAL32) -> ParameterEntry:
    return ParameterEntry(name, value, kind, 0)


def test_a_file_of_qgroundcontrol_is_read() -> None:
    file = ParameterFile.read(FROM_QGC)
    assert file.values == {"RATE_KP": 0.085400000214576721, "SAFE_WATCH_BITS": 1.0}
    assert (file.system, file.component, file.about["Version"]) == (1, 1, "1.16.0")
    assert ParameterFile.read(FROM_QGC, component=100).values == {"CAM_MODE": 2.0}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    "rows",
    [
        "#NOTE: by Mission Planner\nRATE_KP,0.0813\r\nMODE,2\r\n",
        "RATE_KP  0.0813 # by MAVProxy\n # x\n\nMODE\t2\n",
        "# PX4's airframe\nparam set-default RATE_KP 0.0813\nparam set MODE 2\n",
    ],
)
def test_files_of_names_and_values_are_read(rows: str, encoding: str) -> None:
    file = ParameterFile.read(rows.encode(encoding))
    assert (file.values, file.system) == ({"RATE_KP": 0.0813, "MODE": 2.0}, 0)


def test_a_byte_order_mark_is_no_parameter() -> None:
    assert ParameterFile.read(FROM_QGC.encode("utf-8-sig")) == ParameterFile.read(FROM_QGC)


def test_a_file_of_the_drones_values_changes_nothing() -> None:
    """QGroundControl's 18 digits and our shortest ones are one float32."""
    known = {"RATE_KP": entry("RATE_KP", 0.0854), "SAFE_WATCH_BITS": entry("SAFE_WATCH_BITS", 0.0, INT32)}
    assert ParameterFile.read(FROM_QGC).against(known) == ({"SAFE_WATCH_BITS": 1.0}, ())
    assert ParameterFile.read(FROM_QGC).against({}) == ({}, ("RATE_KP", "SAFE_WATCH_BITS"))


@given(
    st.dictionaries(
        st.text("ABCXYZ_09", min_size=1, max_size=16),
        st.floats(width=32, allow_nan=False, allow_infinity=False),
        min_size=1,
        max_size=20,
    )
)
def test_every_float32_survives(values: dict[str, float]) -> None:
    # A drone's entry holds the shortest decimal of its float32.
    rows = [entry(name, float(str(np.float32(value)))) for name, value in values.items()]
    back = ParameterFile.read(ParameterFile.of(rows, 7, about={"Version": "0.1"}).text())
    assert {name: np.float32(v) for name, v in back.values.items()} == {
        name: np.float32(v) for name, v in values.items()
    }
    assert (back.system, back.about["Version"]) == (7, "0.1")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file has no parameter"),
        ("1\t1\tRATE_KP\tnan\t9\n", "line 1"),
        ("1\t1\tRATE_KP\t0.1\n", "line 1"),
        ("RATE_KP,0,1\n", "'RATE_KP,0,1' is not a parameter"),
        ("\x1a\0\0\0\x01RATE_KP\0", "is not text .*`param save` of PX4 writes a binary file"),
        ("# x\n1\t1\tRATE_KP\t0.1\t9\n1\t1\tRATE_KP\t0.2\t9\n", "line 3"),
        ("1\t999\tRATE_KP\t0.1\t9\n", "out of range"),
        ("1\t1\tA_NAME_THAT_IS_TOO_LONG\t0.1\t9\n", "16 ASCII characters"),
        ("x" * (1 << 21), "KiB"),
    ],
)
def test_a_file_that_is_none_says_the_line(text: str, says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        ParameterFile.read(text)
