"""Writes the tables in docs (PAGES) from the code: `python tools/tables.py`.

A table stands between `<!-- made: NAME -->` and `<!-- end -->`; the text around it is written by hand. A test compares
the pages with what this gives.
"""

import ast
import csv
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree

from twodof.fcu.onboard_log.log_topics import COLUMNS, PX4_TOPICS
from twodof.fcu.parameters.table import VehicleParameter, vehicle_rows
from twodof.flight.failsafe.causes_and_actions import ACTIONS, CAUSES, NONE
from twodof.flight.gains import NAMED
from twodof.flight.starters import STARTERS, starter
from twodof.flight.templates import TEMPLATES, kind_of
from twodof.flightlog.mcap_stream import stream_of
from twodof.flightlog.ulog_file import PX4_SOURCES
from twodof.gcs.recording import SAFETY
from twodof.link.mavlink import dialect
from twodof.link.mavlink.dialect import FILES, GROUND, ONBOARD
from twodof.parameters import TUNABLES
from twodof.rig.parameters import CONDITIONS, NAMES, TABLE, load_rig, origins
from twodof.rig.rig import PARTS, model_parameters, rig_params, rotor_moment
from twodof.signals import HOVER, TOPICS

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = tuple(sorted(page for page in DOCS.rglob("*.md") if "<!-- made: " in page.read_text(encoding="utf-8")))
SOURCE = DOCS.parent / "src" / "twodof"
LAYERS = DOCS.parent / "tests" / "test_layers.py"
FMEA = DOCS.parent / "tests" / "fmea" / "measured.csv"
AT_A_STOP = 300  # as tests.fmea.fly has it [ms]
PULSE = 0.1


def render(text: str) -> str:
    """The page's text with all its tables made afresh. Raises KeyError for a table that is not known."""
    tables = {
        "parameters": _parameters,
        "conditions": _conditions,
        "models": _models,
        "gains": _gains,
        "templates": _templates,
        "starters": _starters,
        "channels": _channels,
        "causes": _causes,
        "safety": _safety,
        "vehicle": _vehicle,
        "wire": _wire,
        "onboard": _onboard,
        "steps": _steps,
        "streams": _streams,
        "fmea": _fmea,
        "fmea_short": _fmea_short,
        "rooms": _rooms,
    }

    def made(match: re.Match[str]) -> str:
        lines = [f"<!-- made: {match[1]} -->", *tables[match[1]](), "<!-- end -->"]
        return "\n".join(lines)

    return re.sub(r"<!-- made: (\w+) -->\n.*?<!-- end -->", made, text, flags=re.DOTALL)


def models(rig: Mapping[str, float]) -> dict[str, tuple[float, str, str]]:
    """Value, unit and equation of the rig's parameters as in the paper's models; docs/explanation/physics.md, 8."""
    known = model_parameters(rig)
    pulse = rotor_moment(rig, PULSE, 0.0) / (PULSE * rig["inertia"])
    return {
        "w_n, rotors at rest": (known["w_n"], "rad/s", "(31)"),
        "w_n, rotors running": (known["w_n_run"], "rad/s", "(31)"),
        "xi, rotors at rest": (known["xi"], "", "(32)"),
        "xi, rotors running": (known["xi_run"], "", "(32)"),
        f"mu at T = 0, M = {PULSE}": (pulse, "rad/s2", "(34)"),
        f"mu at T = {HOVER}": (known["mu"], "rad/s2", "(33)"),
        "tau": (known["tau"], "s", "(35)"),
        f"k_v at T = {HOVER}": (known["k_v"], "m/s2", "(36)"),
        "p_v": (known["p_v"], "1/s", "(36)"),
        "bearing's dry friction, rotors at rest": (known["coulomb"], "rad/s2", "(15)"),
        "bearing's dry friction, rotors running": (known["coulomb_run"], "rad/s2", "(15)"),
        "rail's dry friction": (known["rail_coulomb"], "m/s2", "(15)"),
        "hardening k_3 / J, rotors at rest": (known["hardening"], "rad/s2 per rad3", "(2)"),
    }


def _rooms() -> Iterator[str]:
    yield "| row | room | is |"
    yield "|---|---|---|"
    for number, row in enumerate(_layers(), 1):
        for room in sorted(row):
            base = SOURCE / room
            if base.is_dir():
                parts = sorted(part.parent.name for part in base.glob("*/__init__.py"))
                below = f" ({', '.join(parts)})" if parts else ""
                yield f"| {number} | `{room}/`{below} | {_first_line(base / '__init__.py')} |"
            elif base.with_suffix(".py").is_file():
                yield f"| {number} | `{room}.py` | {_first_line(base.with_suffix('.py'))} |"


def _layers() -> list[set[str]]:
    """The rows of rooms, as the test of their order states them."""
    tree = ast.parse(LAYERS.read_text(encoding="utf-8"))
    (rows,) = [node.value for node in tree.body if isinstance(node, ast.Assign) and "ROWS" in ast.dump(node.targets[0])]
    return ast.literal_eval(rows)


def _first_line(file: Path) -> str:
    return (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").split("\n")[0]


def _models() -> Iterator[str]:
    found = {name: models(load_rig(name).snapshot()) for name in NAMES}
    yield f"| | equation | unit | {' | '.join(f'`{name}`' for name in NAMES)} |"
    yield "|---|---|---|" + "---|" * len(NAMES)
    for key, (_, unit, equation) in found[NAMES[0]].items():
        values = " | ".join(f"{found[name][key][0]:.4g}" for name in NAMES)
        yield f"| {key} | {equation} | {unit} | {values} |"


def _gains() -> Iterator[str]:
    sets = {name: gains.parameters() for name, gains in NAMED.items()}
    yield f"| parameter | unit | {' | '.join(sets)} |"
    yield "|---|---|" + "---|" * len(sets)
    for path in next(iter(sets.values())):
        unit = TUNABLES[f"cascade.{path}"].unit
        yield f"| `cascade.{path}` | {unit} | {' | '.join(f'{values[path]:g}' for values in sets.values())} |"


def _templates() -> Iterator[str]:
    for template in TEMPLATES.values():
        yield from ("", f"**`{template.name}`**: {template.text}", "")
        yield "| | port | type | unit | is |"
        yield "|---|---|---|---|---|"
        for direction, ports in (("in", template.inputs), ("out", template.outputs)):
            for port in ports:
                yield f"| {direction} | `{port.name}` | {port.kind} | {port.unit} | {port.text} |"
    yield ""


def _starters() -> Iterator[str]:
    yield "| name | template | is |"
    yield "|---|---|---|"
    for name in STARTERS:
        diagram = starter(name)
        yield f"| `{name}` | {kind_of(diagram)} | {diagram.text} |"


def _channels() -> Iterator[str]:
    yield "| topic | channel | fields | unit | rate, Hz | MCAP topic | from PX4's |"
    yield "|---|---|---|---|---|---|---|"
    for row in TOPICS:
        rate = f"{row.rate_hz:g}" if row.rate_hz else "on events"
        sources = (*PX4_SOURCES.get(row.mat, ()), *[("vehicle_control_mode", ())] * (row.mat == "mode"))
        px4 = " or ".join(f"`{topic}`" for topic, _ in sources)
        fields = ", ".join(row.fields)
        yield f"| `{row.name}` | `{row.mat}` | {fields} | {row.unit} | {rate} | `{stream_of(row).topic}` | {px4} |"
    fields = ", ".join(SAFETY.fields)
    yield f"| | `{SAFETY.mat}` | {fields} | - | 1, and at each change | `{SAFETY.topic}` | |"


def _causes() -> Iterator[str]:
    yield "| bit | cause | is | asks for |"
    yield "|---|---|---|---|"
    for bit, cause in enumerate(CAUSES):
        action = ACTIONS[cause.action] if cause.action != NONE else "no arming"
        yield f"| {bit} | `{cause.name}` | {cause.text} | {action} |"


def _safety() -> Iterator[str]:
    yield "| parameter | over MAVLink | unit | default | from | to | is |"
    yield "|---|---|---|---|---|---|---|"
    for path, row in TUNABLES.items():
        if path.startswith("failsafe."):
            flag = isinstance(row.default, bool)
            value, bounds = (row.default, " | ") if flag else (f"{row.default:g}", f"{row.low:g} | {row.high:g}")
            path = path.removeprefix("failsafe.")
            yield f"| `{path}` | `{row.name}` | {row.unit} | {value} | {bounds} | {row.text} |"


def _flown() -> list[dict[str, str]]:
    with FMEA.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _fmea_short() -> Iterator[str]:
    faults: dict[tuple[str, str], list[dict[str, str]]] = {}
    for line in _flown():
        if line["component"] != "no fault":
            faults.setdefault((line["component"], line["fault"]), []).append(line)
    on = {fault: max(int(line["on_after_ms"]) for line in lines) for fault, lines in faults.items()}
    strongest = [max((line["most"] for line in lines), key=ACTIONS.index) for lines in faults.values()]
    late = sorted((fault for fault in faults if on[fault] > AT_A_STOP), key=lambda fault: -on[fault])
    pairs, flights = sum(component == "two at once" for component, _ in faults), sum(map(len, faults.values()))
    yield ""
    yield f"- {len(faults)} faults were flown, {pairs} of them pairs, in {flights} flights on both rigs."
    none, off = strongest.count("none"), strongest.count("off")
    yield f"- {none} of them need no action, {off} may end with motors off, the others level or brake."
    yield f"- {len(late)} leave motors on for more than {AT_A_STOP / 1e3:g} s after the drone first met an end stop:"
    yield from ("", "| fault | motors on, s | why |", "|---|---|---|")
    for fault in late:
        yield f"| {': '.join(fault)} | {on[fault] / 1e3:.2f} | {faults[fault][0]['why']} |"
    yield ""


def _fmea() -> Iterator[str]:
    lines = _flown()
    for component in dict.fromkeys(line["component"] for line in lines):
        mine = [line for line in lines if line["component"] == component]
        flown = ", ".join(dict.fromkeys(line["flown"] for line in mine))
        yield from ("", f"**{component[0].upper()}{component[1:]}** (flown: {flown})", "")
        yield "| fault | first seen as | after, s | ends in | after, s | pitch, rad | place, m | impact | on, s |"
        yield "|---|---|---|---|---|---|---|---|---|"
        for fault in dict.fromkeys(line["fault"] for line in mine):
            yield _fault(fault, [line for line in mine if line["fault"] == fault])
    yield ""


def _fault(fault: str, lines: list[dict[str, str]]) -> str:
    """A row of the hazard analysis: the worst of its flights."""

    def most(column: str, of: Iterable[dict[str, str]] = lines) -> float:
        return max((float(line[column]) for line in of if line[column]), default=0.0)

    def after(column: str, of: Iterable[dict[str, str]] = lines) -> str:
        return f"{most(column, of) / 1e3:.2f}" if strongest != "none" else ""

    least = min((line["least"] for line in lines), key=ACTIONS.index)
    strongest = max((line["most"] for line in lines), key=ACTIONS.index)
    ends = strongest if least == strongest else f"{least} to {strongest}"
    last = [line for line in lines if line["most"] == strongest]
    first = {name for line in lines for name in line["first"].split()}
    causes = ", ".join(f"`{cause.name}`" for cause in CAUSES if cause.name in first)
    impacts = ((most("impact_q"), "rad/s"), (most("impact_v"), "m/s"))
    impact = ", ".join(f"{speed:g} {unit}" for speed, unit in impacts if speed)
    on = f"{most('on_after_ms') / 1e3:.2f}" if most("on_after_ms") else ""
    if most("on_after_ms") > AT_A_STOP:
        on = f"**{on}**"
    if lines[0]["why"]:
        fault = f"{fault}. *{lines[0]['why']}*"
    worst = f"{most('theta'):.2f} | {most('x'):.3f} | {impact} | {on}"
    return f"| {fault} | {causes} | {after('first_ms')} | {ends} | {after('most_ms', last)} | {worst} |"


def _vehicle() -> Iterator[str]:
    rows = vehicle_rows(1)
    for group in dict.fromkeys(row.group for row in rows):
        yield from ("", f"**{group}**", "")
        yield "| name | the drone's name | type | unit | default | from | to | changed | is |"
        yield "|---|---|---|---|---|---|---|---|---|"
        for row in sorted((row for row in rows if row.group == group), key=lambda row: row.name):
            other = f"`{row.drone}`" if row.drone else ""
            bounds = f"{_number(row, row.low)} | {_number(row, row.high)}"
            yield (
                f"| `{row.name}` | {other} | {row.kind} | {row.unit} | {_number(row, row.default)} | {bounds} "
                f"| {_changed(row)} | {row.text} |"
            )
    yield ""


def _number(row: VehicleParameter, value: float) -> str:
    return str(int(value)) if row.kind == "int32" else f"{value:g}"


def _changed(row: VehicleParameter) -> str:
    when = "never" if row.fixed else "disarmed" if row.disarmed else "any time"
    return f"{when}, by anyone" if row.tuning else when


def _wire() -> Iterator[str]:
    yield "| topic | fields | unit | rate, Hz | MAVLink | ROS | `.mat` | is |"
    yield "|---|---|---|---|---|---|---|---|"
    for row in TOPICS:
        rate = f"{row.rate_hz:g}" if row.rate_hz else "on events"
        fields = ", ".join(row.fields)
        places = f"`{row.mavlink}` | `{row.ros}` | `{row.mat}`"
        yield f"| `{row.name}` | {fields} | {row.unit} | {rate} | {places} | {row.text} |"


def _onboard() -> Iterator[str]:
    yield "| topic | fields | is |"
    yield "|---|---|---|"
    for topic in PX4_TOPICS:
        fields = ", ".join(f"`{field}`" for field in topic.fields.split(";"))
        yield f"| `{topic.name}` | {fields} | {topic.text} |"


def _steps() -> Iterator[str]:
    kinds = {float: "double", bool: "bool", int: "int32_t"}
    yield "| field | type |"
    yield "|---|---|"
    for name, kind in COLUMNS:
        yield f"| `{name}` | {kinds[kind]} |"


def _streams() -> Iterator[str]:
    texts = {
        int(row.attrib["id"]): (row.attrib["name"], row.findtext("description", ""))
        for file in FILES
        for row in ElementTree.parse(Path(dialect.__file__).with_name(file)).iter("message")
    }
    yield "| message | id | rate, Hz | `ground` | is |"
    yield "|---|---|---|---|---|"
    for number in sorted({*ONBOARD, *GROUND}):
        name, text = texts[number]
        rates = " | ".join(_rate(profile.get(number)) for profile in (ONBOARD, GROUND))
        yield f"| `{name}` | {number} | {rates} | {text} |"


def _rate(rate: float | None) -> str:
    """As shown: none if it comes on request only, 0 if with each news."""
    return "" if rate is None else f"{rate:g}" if rate > 0.0 else "with each news"


def _parameters() -> Iterator[str]:
    rigs = {name: load_rig(name).snapshot() for name in NAMES}
    rows = {row.name: row for row in TABLE}
    for part, block, _ in PARTS:
        own = [param.name for param in block.params if param.name in rows]
        if not own:
            continue
        yield from ("", f"**{part.replace('_', ' ').capitalize()}**", "")
        yield "| parameter | unit | `paper` | `lab` | is | from |"
        yield "|---|---|---|---|---|---|"
        for name in own:
            values = " | ".join(f"{rigs[rig][name]:.4g}" for rig in NAMES)
            yield f"| `{name}` | {rows[name].unit} | {values} | {rows.pop(name).text} | {_origin(name)} |"
    yield ""


def _origin(name: str) -> str:
    """Where the numbers of both sets come from; once, if from the same place."""
    texts = {rig: origins(rig)[name] for rig in NAMES}
    if len(set(texts.values())) == 1:
        return texts[NAMES[0]]
    return "; ".join(f"*{rig}*: {text}" for rig, text in texts.items())


def _conditions() -> Iterator[str]:
    yield "| parameter | unit | default | |"
    yield "|---|---|---|---|"
    for name, param in rig_params().items():
        if name in CONDITIONS:
            value = f"{param.value:.4g}" if isinstance(param.value, float) else f"{param.value}"
            yield f"| `{name}` | {param.unit} | {value} | {param.text or name.replace('_', ' ')} |"


if __name__ == "__main__":
    for page in PAGES:
        page.write_text(render(page.read_text(encoding="utf-8")), encoding="utf-8")
        sys.stdout.write(f"{page} written\n")
