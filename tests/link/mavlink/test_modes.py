"""Modes and set-points: PX4's numbers, and what goes out comes back."""

import pytest

from twodof.errors import LinkError
from twodof.link.mavlink import modes


def test_custom_modes_are_those_that_px4_publishes() -> None:
    """As PX4 v1.16 in software-in-the-loop sends them in HEARTBEAT (custom_mode of px4_custom_mode.h)."""
    published = {"manual": 65536, "rate": 327680, "attitude": 458752, "position": 196608, "hold": 50593792}
    assert {mode.name: mode.custom_mode for mode in modes.MODES} == published | {"offboard": 393216}


def test_the_base_mode_has_the_flags_of_the_mode() -> None:
    """MAV_MODE_FLAG: custom 1, auto 4, guided 8, stabilised 16, manual input 64, armed 128."""
    flags = {"manual": 65, "rate": 65, "attitude": 81, "position": 81, "hold": 29, "offboard": 17}
    assert {mode.name: modes.base_mode(mode.custom_mode, False) for mode in modes.MODES} == flags
    assert {modes.base_mode(one.custom_mode, True) - flags[one.name] for one in modes.MODES} == {128}


def test_names_and_numbers_go_both_ways() -> None:
    for mode in modes.MODES:
        assert modes.custom_mode(mode.name) == mode.custom_mode
        assert modes.mode_name(mode.custom_mode) == mode.name
    assert modes.mode_name(4 << 16 | 6 << 24) == "main 4, sub 6"
    with pytest.raises(LinkError, match="offboard"):
        modes.custom_mode("warp")
