"""Models of public repositories beside the C of MathWorks' coder, whose step is called in other ways.

A step reads its inputs by `get_NAME()`, takes them by pointers, or has them in a structure. TWODOF_SLX_REPOS names the
folder of checkouts, OWNER+NAME: wooterpark/test at accdf5d, ShindeNileshR/ERS-MATLAB-PROJECT at ba97c53,
PurdueElectricRacing/SimscapeModel at c52f074, ahmedsherifmekawy/MBD at 965518b, yasmin-samy/MatLab at 5f2d8b1,
Yomna-AlShaboury/MBD at 72dc67b and DERT-2040/SwervePuppy-2.0 at 618871f. A model and its C must have one version.
"""

import ctypes
import os
import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from tests.slx.generated_c import FLAGS, built, drawn, leaves, plain, value
from tests.slx.test_mathworks_code import flat
from twodof.compile import build
from twodof.slx.importer import import_system
from twodof.slx.matlab.script import read_workspace
from twodof.slx.matlab.values import Value
from twodof.slx.model import read_model

REPOS = os.environ.get("TWODOF_SLX_REPOS", "")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not REPOS, reason="let TWODOF_SLX_REPOS name the folder of the public repositories' checkouts"),
]
STEPS = 2000
ROOM = "S1_VCU/TVS_24/C1_EM_NO_FILTER"
WORDS = "#include <stdint.h>\n" + "".join(
    f"typedef {kind} {name};\n"
    for name, kind in {"boolean": "uint8_t", "uint8": "uint8_t", "sint16": "int16_t", "uint16": "uint16_t",
                       "uint32": "uint32_t", "float32": "float"}.items()
)  # fmt: skip
"""Types of the car's software, which its own headers declare."""
WHOLE = {f"{sign}int{n}": f"{sign}int{n}_t" for sign in ("", "u") for n in (8, 16, 32)}
C_TYPES = {"real": "float", "bool": "uint8_t", **WHOLE}


@dataclass(frozen=True)
class Entry:
    """A model, the folder of its C, its version, its step, and the ranges [scale, offset) or [from, to) of inputs."""

    repository: str
    model: str
    code: str
    version: str
    step: str
    style: str
    ranges: dict[str, tuple[int, int]] = field(default_factory=dict)
    single: bool = True
    flags: tuple[str, ...] = ()
    """Inputs without a declared type that are 0 or 1."""
    imported: dict[str, str] = field(default_factory=dict)
    """Global variables of the step, with their types."""

    @property
    def name(self) -> str:
        return Path(self.model).stem


CAR = "FS_PEB/SWC/A_SWC"
ENTRIES = [
    Entry("wooterpark+test", "Model/ADM/SWC_ADM.slx", f"{CAR}/SWC_ADM", "1.285", "SWC_ADM_1ms", "get",
          {"L2Com_HiPrecVolt": (100, 150), "L2Com_BMSVolt": (250, 300)}),
    Entry("wooterpark+test", "Model/FRP/SWC_FRP.slx", f"{CAR}/SWC_FRP", "1.238", "SWC_FRP_1ms", "get",
          flags=("ADM", "TRSP", "TCF", "STM")),
    Entry("ShindeNileshR+ERS-MATLAB-PROJECT", "Eas_Integrated.slx", "slprj/ert/Eas_Integrated", "1.57",
          "Eas_Integrated", "pointers",
          {"Vehicle_Speed": (0, 2), "rpm": (300, 1200), "Nox_Sensor": (0, 1000), "Scr_Temp_Sensor": (0, 600),
           "Adblue_Quality": (20, 30), "Coolant_Temp": (40, 100), "DPF_Temp_Manual": (0, 700),
           "Crank_Angle": (0, 720)}, False,
          imported={"Adblue_Level": "uint8_t", "Adblue_Quality": "double", "Nox_Sensor": "uint16_t",
                    "Scr_Temp_Sensor": "uint16_t"}),
    Entry("PurdueElectricRacing+SimscapeModel", f"{ROOM}/simulink_em/em.slx", f"{ROOM}/code_em", "1.40", "em_step",
          "structure", {"V": (80, 200), "w": (400, 550)}),
]  # fmt: skip


def parameters(text: str) -> dict[str, Value]:
    """Return the parameters that a NAME_data.c lists; tables of 2,782 numbers have 107 rows."""
    noted = re.sub(r"/\*(.*?)\*/", lambda found: "@" + " ".join(found[1].split()) + "@", text, flags=re.DOTALL)
    found: dict[str, Value] = {}
    for name, body in re.findall(r"@[^@]*?(?:Variable|Expression): (\w+)[^@]*@\s*(\{[^}]*\})", noted):
        numbers = np.array([float(one) for one in re.findall(r"[-+]?\d[\d.]*(?:[eE][-+]?\d+)?", body)])
        found[name] = numbers.reshape((107 if numbers.size == 2782 else 1, -1), order="F")
    return found


def wrapper(one: Entry, text: str, headers: str, kinds: dict[str, str]) -> tuple[list[tuple[str, str]], list[str], str]:
    """Return inputs (port, C place), outputs and the C that moves them; declarations come before a line of ----."""
    ports, places, outs, lines, call = {plain(p): p for p in kinds}, [], [], [], f"{one.step}();"
    if one.style == "get":
        for name in sorted(set(re.findall(r"\b[gs]et_(\w+)\(", text))):
            port = ports.get(plain(name))
            kind = "uint8_t" if port is None or one.flags else C_TYPES[kinds[port]]
            lines += [f"static {kind if f'get_{name}(' in text else 'double'} v_{name};",
                      f"static {kind} get_{name}(void) {{ return v_{name}; }}",
                      f"static void set_{name}(double u) {{ v_{name} = u; }}"]  # fmt: skip
            places += [(port, f"v_{name}")] if port is not None else []
            outs += [f"v_{name}"] if f"set_{name}(" in text else []
    elif one.style == "pointers":
        head = re.search(rf"void {one.step}\(([^;{{]*?)\)\s*\{{", text, re.DOTALL)
        assert head is not None
        arguments = [" ".join(each.split()) for each in head[1].split(",")]
        names = []
        for kind, name in (each.removeprefix("const ").split(" *") for each in arguments):
            lines.append(f"static {kind} {name};")
            names.append(f"&{name}")
            port = ports.get(plain(name[4:]))
            places += [(port, name)] if name.startswith("rtu_") and port is not None else []
            outs += [name] if name.startswith("rty_") else []
        places += [(name, name) for name in one.imported]
        lines += [f"{kind} {name};" for name, kind in one.imported.items()]
        call = f"{one.step}({', '.join(names)});"
    else:
        for kind in ("ExtU", "ExtY"):
            body = re.search(
                rf"typedef struct \{{((?:(?!typedef struct).)*?)\}} {kind}_{one.name};", headers, re.DOTALL
            )
            assert body is not None
            for name, size in re.findall(r"\w+ (\w+)(?:\[(\d+)\])?;", body[1]):
                cells = [f"{kind}_.{name}[{n}]" for n in range(int(size))] if size else [f"{kind}_.{name}"]
                places += [(ports[plain(name)], cell) for cell in cells] if kind == "ExtU" else []
                outs += cells if kind == "ExtY" else []
        lines += [f"static ExtU_{one.name} ExtU_; static ExtY_{one.name} ExtY_; static RT_MODEL_{one.name} M_;"]
        call = f"{one.step}(&M_, &ExtU_, &ExtY_);"
    moved = [*(f"{place} = in[{n}];" for n, (_, place) in enumerate(places)), call,
             *(f"out[{n}] = {place};" for n, place in enumerate(outs))]  # fmt: skip
    step = "void moved(const double *in, double *out) { " + " ".join(moved) + " }"
    return places, outs, "\n".join(lines) + "\n----\n" + step


@pytest.mark.parametrize("one", ENTRIES, ids=[one.name for one in ENTRIES])
def test_a_step_called_in_another_way_has_the_bits_of_mathworks_c(tmp_path: Path, one: Entry) -> None:
    """2,000 steps of all outputs."""
    top = Path(REPOS) / one.repository
    model, c = read_model(top / one.model), top / one.code
    text, head = ((c / f"{one.name}.{end}").read_text("utf-8", "replace") for end in "ch")
    assert re.search(rf"Model version\s*: {one.version}$", text, re.MULTILINE)
    assert model.version == one.version
    data = c / f"{one.name}_data.c"
    names = parameters(data.read_text("utf-8", "replace")) if one.style == "structure" else {}
    found = import_system(model, "", names, [(top / one.model).parent])
    assert found.diagram is not None, found.refused
    machine = build(found.diagram, dt=found.dt, precision="float32" if one.single else "float64").machine()
    kinds = {port: each.kind for port, each in machine.inputs.items()}
    places, outs, code = wrapper(one, text, head, kinds)
    declared, _, step = code.partition("----\n")
    (tmp_path / "Std_Types.h").write_text(WORDS, "utf-8")
    (tmp_path / "set_get_data.h").write_text(f"#include <stdint.h>\n{declared}", "utf-8")
    after = step if one.style == "get" else declared + step
    (tmp_path / "moved.c").write_text(f'#include <stdint.h>\n#include "{c / one.name}.c"\n{after}\n', "utf-8")
    parts = [f"-I{c}", f"-I{c.parent / '_sharedutils'}", f"-I{tmp_path}", *([str(data)] if data.exists() else [])]
    subprocess.run(["gcc", *FLAGS, *parts, str(tmp_path / "moved.c"), "-o", str(tmp_path / "m.so"), "-lm"], check=True)
    library, draw = ctypes.CDLL(str(tmp_path / "m.so")), np.random.default_rng(7)
    columns = []
    for port, _ in places:
        kind, (low, high) = kinds[port], one.ranges.get(port, (1, 0))
        real = ctypes.c_float if one.single else ctypes.c_double
        column = drawn(real if kind == "real" else ctypes.c_int32, 1, STEPS,
                       (0, 2) if kind == "bool" else (low, high) if port in one.ranges else (0, 130), draw)  # fmt: skip
        column = column * column.dtype.type(low) + column.dtype.type(high) if kind == "real" else column
        columns.append(column > 0 if kind == "real" and port.startswith(one.flags or ("-",)) else column)
    inputs, result = np.ascontiguousarray(np.hstack(columns), dtype=float), np.zeros(len(outs))
    wanted, given = [], []
    pointer = ctypes.POINTER(ctypes.c_double)
    for row in inputs:
        library.moved(row.ctypes.data_as(pointer), result.ctypes.data_as(pointer))
        wanted.append(result.copy())
        u: dict[str, object] = {port: True for port in kinds if port not in dict(places)}
        for port in dict.fromkeys(port for port, _ in places):
            cells = [float(x) for x, (at, _) in zip(row, places, strict=True) if at == port]
            typed = cells if kinds[port] == "real" else [int(x) for x in cells]
            u[port] = typed if machine.inputs[port].width else typed[0]
        got = {plain(name): each for name, each in flat(machine.step(u)).items()}
        order = dict.fromkeys(re.sub(r"^(v_|rty_|ExtY_\.)|\[\d+\]$", "", place) for place in outs)
        given.append(np.hstack([np.ravel(got[plain(name)]) for name in order]).astype(float))
    assert np.array_equal(given, wanted)
    assert (np.ptp(wanted, axis=0) > 0.0).sum() >= 1


MEKAWY = "ahmedsherifmekawy+MBD"
STRUCTURES = [
    (MEKAWY, "Lab1/Task 1", "ScientificCalculator"),
    (MEKAWY, "Lab1/Task 2", "ProgrammingCalculator"),
    (MEKAWY, "Lab2/Task 2", "CalcSys"),
    (MEKAWY, "Lab2/Task 3", "GradSys"),
    ("Yomna-AlShaboury+MBD", "3_LogicOP", "LogicOP"),
    ("yasmin-samy+MatLab", "MBD/Calculater_subsystem", "Task2_Lec2"),
    ("yasmin-samy+MatLab", "MBD/Calculator_Bit", "Bit_with"),
]


@pytest.mark.parametrize(("repository", "folder", "name"), STRUCTURES, ids=[name for *_, name in STRUCTURES])
def test_a_students_model_has_the_bits_of_mathworks_c(tmp_path: Path, repository: str, folder: str, name: str) -> None:
    """Calculators and marks: whole numbers, shifts, divisions by 0, actions of If and their merge."""
    at = Path(REPOS) / repository / folder
    model, c = read_model(at / f"{name}.slx"), at / f"{name}_ert_rtw"
    assert re.search(rf"Model version\s*: {model.version}$", (c / f"{name}.c").read_text("utf-8"), re.MULTILINE)
    code = built(c, [each.name for each in sorted(c.glob("*.c")) if each.name != "ert_main.c"], tmp_path, single=False)
    inputs, outputs = (code.at(f"Ext{end}_{name}_T", f"{name}_{end}") for end in "UY")
    found = import_system(model, otherwise=0.01)
    assert found.diagram is not None, found.refused
    machine, draw = build(found.diagram, dt=found.dt).machine(), np.random.default_rng(7)
    ports = {plain(port): port for port in machine.inputs}
    columns = {}
    for path, _, _, kind, _ in leaves(inputs):
        column = drawn(kind, 1, STEPS, (0, 2) if kind is ctypes.c_bool else (0, 100), draw)[:, 0]
        columns[path] = 40.0 * column if column.dtype == float else column
    getattr(code.library, f"{name}_initialize")()
    wanted, given = [], []
    for k in range(STEPS):
        for path, column in columns.items():
            setattr(inputs, path, column[k].item())
        getattr(code.library, f"{name}_step")()
        got = machine.step({ports[plain(path)]: column[k].item() for path, column in columns.items()})
        shown = {plain(port).replace("_", ""): each for port, each in flat(got).items()}
        wanted.append([float(value(outputs, path)[0]) for path, *_ in leaves(outputs)])
        given.append([float(shown[path.lower().replace("_", "")]) for path, *_ in leaves(outputs)])
    assert np.array_equal(given, wanted, equal_nan=True)
    assert len(set(map(tuple, wanted))) > 1


CORNERS = ("FrontLeft", "FrontRight", "BackLeft", "BackRight")
SWERVE = {
    "Odometry_sub": (
        ["Gyro_Angle*", *(f"{at}_Drive_Motor_Rev" for at in CORNERS),
         *(f"{at}_Steer_Module_Angle" for at in ("FL", "FR", "BL", "BR")), "Odometry_IC_X=", "Odometry_IC_Y="],
        ["Product6"],
    ),
    "Kalman_Filter_sub": (
        ["Photon_Est_Pose_X", "Photon_Est_Pose_Y", "Photon_Est_Pose_Ambiguity", "Product6"],
        ["KF_Position_X", "KF_Position_Y"],
    ),
    "Swerve_Drive_sub": (
        [*(f"{one}_SPF" for one in ("Steering_Abs_Cmd", "Steering_Rel_Cmd", "Translation_Speed", "Translation_Angle",
                                    "Is_Absolute_Translation", "Is_Absolute_Steering", "Gyro_Angle_Adjustment")),
         "Gyro_Angle*", *(f"{at}_Drive_Motor_Speed" for at in CORNERS),
         *(f"{at}_Steer_Module_Angle" for at in ("FL", "FR", "BL", "BR"))],
        [f"{at}_{what}_DutyCycle" for at in CORNERS
         for what in ("Steer", "Drive")],
    ),
}  # fmt: skip
"""Parts of a robot's controller of 1,000 blocks, and what their ports are in the C; * in degrees, = a parameter."""


@pytest.mark.parametrize("name", SWERVE)
def test_a_part_of_a_robots_controller_follows_mathworks_c(tmp_path: Path, name: str) -> None:
    """Vectors in polar numbers, wrapped angles, PID, a Kalman filter: 2,000 steps within 1e-14 of outputs of about 1.

    A length is a square root in the C and the language's hypot here, and the filter's gains are of another solver.
    """
    top = Path(REPOS) / "DERT-2040+SwervePuppy-2.0"
    c, parts = top / "src/main/Code_Gen_Model_ert_rtw", top / "simulink/Reusable_Models"
    code = built(c, [each.name for each in sorted(c.glob("*.c"))], tmp_path, single=False)
    u, y, b = (code.at(f"{end}_Code_Gen_Model_T", f"Code_Gen_Model_{end[-1]}") for end in ("ExtU", "ExtY", "B"))
    names: dict[str, Value] = {}
    read_workspace(top / "simulink/Data/Code_Gen_Model_data.m", names)
    for variable in re.findall(r"^real_T (\w+) = ", (c / "Code_Gen_Model.c").read_text("utf-8"), re.MULTILINE):
        number = names[variable]  # the C has five digits of it
        assert isinstance(number, np.ndarray)
        ctypes.c_double.in_dll(code.library, variable).value = float(number.flat[0])
    model = read_model(parts / f"Code_Gen_Referenced_Subsystems/{name}.slx")
    for block in model.root.blocks.values():
        if block.type == "Inport":
            block.signals.setdefault(1, block.name)  # the name that the line outside has
    folders = [parts / "Code_Gen_Libraries", parts / "Code_Gen_Referenced_Subsystems"]
    found = import_system(model, "", names, folders, otherwise=0.02)
    assert found.diagram is not None, found.refused
    machine, draw = build(found.diagram, dt=0.02).machine(), np.random.default_rng(7)
    time = 0.02 * np.arange(STEPS)
    scale = {"Gyro": 80.0, "Speed": 4000.0, "Joystick": 1.0, "Ambiguity": 0.4, "GameState": 0.0}
    columns = {}
    for path, _, _, kind, _ in leaves(u):
        most = next((most for word, most in scale.items() if word in path), 2.0)
        wave = most * np.sin(time * draw.uniform(0.2, 2.0) + draw.uniform(0.0, 6.0))
        columns[path] = wave > 0.0 if kind is ctypes.c_bool else wave + 2.0 * (path == "GameState")

    def cells(wanted: str) -> list[float]:
        path = wanted.rstrip("*=")
        if wanted.endswith("="):
            return [float(ctypes.c_double.in_dll(code.library, path).value)]
        found = [float(one) for one in value(next(one for one in (u, y, b) if hasattr(one, path)), path)]
        return [one * np.pi / 180.0 for one in found] if wanted.endswith("*") else found

    code.library.Code_Gen_Model_initialize()
    wanted, given = [], []
    for k in range(STEPS):
        for path, column in columns.items():
            setattr(u, path, column[k].item())
        code.library.Code_Gen_Model_step()
        fed = [one for entry in SWERVE[name][0] for one in cells(entry)]
        ports = machine.inputs.items()
        got = machine.step(
            {port: at > 0.5 if one.kind == "bool" else at for (port, one), at in zip(ports, fed, strict=True)}
        )
        wanted.append([one for entry in SWERVE[name][1] for one in cells(entry)])
        given.append([float(got[port]) for port in list(found.diagram.outputs)[: len(wanted[0])]])  # not what is shown
    assert np.allclose(given, wanted, rtol=0.0, atol=1e-14)
    assert (np.ptp(wanted, axis=0) > 0.0).all()
