"""Names inside PX4: legal, unique, stable."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twodof.compile.px4.names import field_names, harmless, module_names, parameter_names
from twodof.errors import DiagramError

LETTERS = "abcKPXYZ"  # few, so that names meet
NAMES = st.builds(str.__add__, st.sampled_from(LETTERS), st.text(LETTERS + "019_", max_size=62))
PATHS = st.lists(NAMES, min_size=1, max_size=5).map(".".join)


def snake_in_cmake(name: str) -> str:
    """A message's topic, as PX4's msg/CMakeLists.txt makes it of the file's name."""
    name = re.sub(r"(.)([A-Z][a-z]+)", r"\1_\2", name)
    return re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", name).lower()


def snake_in_python(name: str) -> str:
    """The same, as PX4's message generator makes it."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


@settings(max_examples=30)
@given(NAMES)
def test_both_of_px4s_ways_to_name_a_topic_agree(name: str) -> None:
    names = module_names(name)
    assert snake_in_cmake(names.class_name) == names.module
    assert snake_in_python(names.class_name) == names.module
    assert re.fullmatch(r"twodof_[a-z0-9]+(_[a-z0-9]+)*", names.module)
    assert len(names.module) <= 31
    assert module_names(name, names.prefix) == names  # the prefix is legal


@pytest.mark.parametrize(
    ("diagram", "module", "class_name", "prefix"),
    [
        ("pitch", "twodof_pitch", "TwodofPitch", "TPI"),
        ("attitude_control", "twodof_attitude_control", "TwodofAttitudeControl", "TAC"),
        ("PID", "twodof_pid", "TwodofPid", "TPI"),
        ("a", "twodof_a", "TwodofA", "TA"),
        ("a_b_controller_2", "twodof_ab_controller2", "TwodofAbController2", "TAC2"),
        ("attitude_v12", "twodof_attitude_v12", "TwodofAttitudeV12", "TAV12"),
        ("my_own_pitch_law_v3", "twodof_my_own_pitch_law_v3", "TwodofMyOwnPitchLawV3", "TMOP3"),
        ("pitch_2024", "twodof_pitch2024", "TwodofPitch2024", "TPI24"),
        ("x2", "twodof_x2", "TwodofX2", "TX2"),
        ("x__y", "twodof_xy", "TwodofXy", "TXY"),
    ],
)
def test_a_diagrams_name_becomes_a_modules(diagram: str, module: str, class_name: str, prefix: str) -> None:
    names = module_names(diagram)
    assert (names.module, names.class_name, names.prefix) == (module, class_name, prefix)


def test_the_variants_of_a_diagram_have_prefixes_of_their_own() -> None:
    variants = [
        f"{name}{end}" for name in ("attitude", "my_attitude") for end in ("", "_2", "_v2", "_v3", "_fast", "10")
    ]
    prefixes = [module_names(name).prefix for name in variants]
    assert len(set(prefixes)) == len(variants)
    assert all(re.fullmatch(r"T[A-Z0-9]{1,4}", prefix) for prefix in prefixes)


@pytest.mark.parametrize("prefix", ["lower", "TOOLONG", "1A", "A B", "Ä", "A\n", "A;"])
def test_a_prefix_that_is_none_is_refused(prefix: str) -> None:
    with pytest.raises(DiagramError, match="not a prefix"):
        module_names("pitch", prefix)


@settings(max_examples=30)
@given(st.lists(st.tuples(PATHS, st.none() | st.integers(0, 31)), unique=True, max_size=20))
def test_parameters_have_legal_names_that_differ(paths: list[tuple[str, int | None]]) -> None:
    made = parameter_names("TPI", paths, ["TPI_LIVE"])
    assert len(set(made)) == len(made) == len(paths)
    for name in made:
        assert re.fullmatch(r"TPI_[0-9A-Z_]+", name)
        assert len(name) <= 16
        assert name != "TPI_LIVE"
    assert made == parameter_names("TPI", paths, ["TPI_LIVE"])


@pytest.mark.parametrize(
    ("path", "index", "name"),
    [
        ("rate.kp", None, "TPI_RATE_KP"),
        ("rate.pid.kp", None, "TPI_RATE_PID_KP"),
        ("velocity.kp", None, "TPI_VELOCITY_KP"),
        ("velocity_loop.kp", None, "TPI_VELO_LOOP_KP"),
        ("gains", 3, "TPI_GAINS_3"),
        ("attitude_gains", 12, "TPI_ATTI_GAIN_12"),
        ("live", None, "TPI_LIVE_6HGE"),
    ],
)
def test_a_parameters_name_is_its_path_cut_to_16(path: str, index: int | None, name: str) -> None:
    assert parameter_names("TPI", [(path, index)], ["TPI_LIVE"]) == [name]


def test_a_new_parameter_renames_others_only_if_they_would_be_alike() -> None:
    before = parameter_names("TPI", [("rate.kp", None), ("velocity_loop.kp", None)])
    after = parameter_names("TPI", [("rate.kp", None), ("rate.ki", None), ("velocity_loop.kp", None)])
    assert [after[0], after[2]] == before
    alike = parameter_names("TPI", [("a.b_c", None), ("a_b.c", None), ("A.B.C", None), ("d", None)])
    assert len(set(alike)) == 4
    assert alike[3] == "TPI_D"
    assert all(name.startswith("TPI_A_B_C_") for name in alike[:3])


@settings(max_examples=30)
@given(st.lists(PATHS, max_size=20))
def test_fields_have_legal_names_that_differ(paths: list[str]) -> None:
    made = field_names("log", paths)
    assert len(set(made)) == len(made) == len(paths)
    for name in made:
        # PX4's generator refuses capitals; ROS 2 also two underscores in a row and one at the end.
        assert re.fullmatch(r"log_[a-z0-9]+(_[a-z0-9]+)*", name)
        assert len(name) <= 60


@settings(max_examples=30)
@given(st.text(max_size=200))
def test_a_users_text_means_nothing_in_any_language(text: str) -> None:
    made = harmless(text, 70)
    assert len(made) <= 70
    assert made.isascii()
    assert made.isprintable()
    for sign in ('"', "\\", "`", "$", "{", "}", "@", "#", "*/", "//", "/*", "??", "\n"):
        assert sign not in made
