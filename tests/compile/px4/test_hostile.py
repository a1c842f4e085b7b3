"""Names and texts made of code are harmless in every file of the tree."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.compile.px4.build import compile_module, parse_message
from twodof.blocks import Block, Diagram, Param, Port
from twodof.compile.px4.export import make_module

pytestmark = pytest.mark.slow

# Legal names of the block language that mean something in C, C++, PX4's macros, messages or shells.
NAMES = (
    "int", "class", "new", "this", "template", "operator", "typename", "namespace", "private", "restrict", "while",
    "OK", "ERROR", "NULL", "NAN", "INFINITY", "M_PI", "errno", "stdin", "true", "false", "main", "exit", "real", "bool",
    "timestamp", "timestamp_sample", "tick", "faults", "active", "string", "time", "char", "uint8", "float32", "header",
    "p", "s", "u", "y", "in", "out", "own", "inside", "within", "values", "words", "c", "candidate", "none", "tick_2",
    "param_get", "hrt_absolute_time", "PX4_INFO", "step", "init", "memcpy", "I", "D", "x", "FAULT_STALE", "yes", "no",
)  # fmt: skip
TEXTS = (
    '"; system("rm -rf /"); //',
    "*/ #include </etc/passwd> /*",
    "line\nbreak\r\n#define float double",
    "'): exec('x') #",
    "${PWNED} $(PWNED) `PWNED` @PWNED@ %s%n",
    "\\\n??/ trigraph",
    "a: b\n- c: [d, {e: f}]\n--- !!python/object:os.system",
    "раrаmeter kр (Cyrillic)",
    "\u202egnp.exe \u0000 \ufeff \x1b[31m",
    "# TOPICS actuator_armed",
    "MODULE x) execute_process(COMMAND touch /tmp/pwned) #",
)


class Texts(Block):
    """A block with a parameter for each hostile text, named by hostile names."""

    inputs = tuple(Port(name) for name in NAMES[:8])
    outputs = tuple(Port(name) for name in NAMES)

    def __init__(self) -> None:
        self.params = [Param(name, 1.0, text=TEXTS[i % len(TEXTS)]) for i, name in enumerate(NAMES)]

    def output(self, u: Any, x: Any, p: Any, t: Any) -> Any:
        return {name: u[NAMES[i % 8]] * p[name] for i, name in enumerate(NAMES)}


def hostile(text: str, name: str = "class") -> Diagram:
    """A diagram whose parts, ports and parameters are called as above, and which `text` describes."""
    d = Diagram(name, text)
    d.input("q", unit="rad/s")
    d.add("new", Texts(), inputs=dict.fromkeys(NAMES[:8], "q"))
    d.output("M", "new.OK")
    d.output("OK", "new.OK")
    d.output("int", "new.int")
    d.output("timestamp", "new.int")
    return d


LOG = [f"new.{name}" for name in NAMES if name not in ("OK", "int")][:40]


# What a text of code would leave behind outside of comments, strings and documents.
MARKS = (
    "system(",
    "include </etc",
    "define float",
    "exec",
    "PWNED",
    "os.",
    "trigraph",
    "gnp",
    "Cyrillic",
    "actuator_armed ",
)


def code(path: str, text: str) -> str:
    """A file without its comments and strings."""
    if path.endswith((".c", ".h", ".cpp", ".hpp")):
        return re.sub(r'/\*.*?\*/|//[^\n]*|"(?:[^"\\\n]|\\.)*"', " ", text, flags=re.DOTALL)
    return re.sub(r"#[^\n]*", "", text)


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_of_code_stays_a_text(text: str) -> None:
    module = make_module(hostile(text), LOG)
    for path, made in module.files.items():
        if path.endswith((".json", ".md", ".yaml")):  # documents; JSON escapes, YAML is read below
            continue
        assert made.isascii(), path
        assert not re.search(r"\\$", made, re.MULTILINE), path  # would join the next line
        left = [mark for mark in MARKS if mark in code(path, made)]
        assert left == (["actuator_armed "] if path.endswith("topics.txt") else []), path
        assert not re.search(r"^# TOPICS", made, re.MULTILINE), path
    document = yaml.safe_load(module.files[f"src/modules/{module.names.module}/module.yaml"])
    assert set(document) == {"module_name", "parameters"}
    for row in document["parameters"][0]["definitions"].values():
        for said in row["description"].values():
            assert not re.search(r"[@${}`\"\\\n]|\*/", said)
    cmake = module.files[f"src/modules/{module.names.module}/CMakeLists.txt"]
    assert cmake.count("(") == cmake.count(")") == 1


@pytest.mark.long
def test_names_of_code_compile_under_px4s_flags(tmp_path: Path) -> None:
    module = make_module(hostile(" ".join(TEXTS)), LOG)
    assert len(compile_module(module, tmp_path)) == 2
    rows, constants = parse_message(module.files[f"msg/{module.names.class_name}.msg"])
    names = [name for _, name in rows]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z][a-z0-9_]*", name) for name in names)
    assert all(re.fullmatch(r"[A-Z][A-Z0-9_]*", name) for name in constants)


@pytest.mark.parametrize("name", ["param", "hrt", "uorb", "main", "printf", "while", "PX4", "orb", "M"])
def test_a_diagrams_name_takes_no_symbol_of_px4s(name: str) -> None:
    module = make_module(hostile("", name), LOG[:3])
    c = module.files[f"src/modules/{module.names.module}/{module.names.module}.c"]
    functions = re.findall(r"^(?:void|int|bool|int32_t|uint32_t) (\w+)\(", c, re.MULTILINE)
    assert functions
    assert all(f.startswith("twodof_") for f in functions)
