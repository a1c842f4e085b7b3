"""Plain values of a Simulink file: found behind the fence; `model` makes objects of it."""

import re
from collections.abc import Iterator, Mapping
from itertools import zip_longest
from typing import Any

from twodof.errors import LogError
from twodof.flightlog.fence import Answer
from twodof.slx.package import REMEDY, Element, Package

DEEPEST = 100  # systems inside each other; the deepest public model has 13
MOST_BLOCKS = 100_000
SOLVER = ("SolverName", "Solver", "SolverType", "FixedStep", "StartTime", "StopTime")
CALLBACKS = ("PreLoadFcn", "PostLoadFcn", "InitFcn", "StartFcn", "StopFcn", "CloseFcn", "PreSaveFcn", "PostSaveFcn")
_NOT_KEPT = {"UserData", "UserDataPersistent", "Ports", "DialogControls", "DialogControlsArgs"}


def plain_model(data: bytes, where: str) -> Answer:
    """Return the model of a file's bytes as JSON values. Raises LogError for a file that is damaged or no model."""
    package = Package(data, where)
    top = package.diagram()
    content = PackageReader(package)
    root = top.find("System")
    if root is None:
        raise LogError("has no diagram", where, REMEDY)
    settings = [part for part in map(package.tree, content.settings()) if part is not None] or [top]
    model = {
        "kind": top.tag.lower(),
        "release": content.release(top),
        "version": _nested(top, "ComputedModelVersion") or content.property("revision"),
        "solver": {name: found for name in SOLVER for s in settings[:1] if (found := _nested(s, name))},
        "callbacks": {name: found for name in CALLBACKS if (found := _value(top, name).strip())},
        "dictionary": _value(top, "DataDictionary"),
        "defaults": content.defaults(top),
        "root": content.system(root, 0),
        "charts": list(content.charts(top)),
    }
    return model, []


class PackageReader:
    """Reader of one package: how many blocks it has seen, and which systems."""

    def __init__(self, package: Package) -> None:
        self.package = package
        self.blocks = 0
        self.seen: set[str] = set()

    def settings(self) -> Iterator[str]:
        """Yield the parts that hold solver settings."""
        return (name for name in self.package.names if re.fullmatch(r"simulink/configSet\d+\.xml", name))

    def release(self, top: Element) -> str:
        """Return the release that saved the file, such as R2024a; "" where it does not say."""
        modern = self.package.tree("metadata/mwcoreProperties.xml")
        said = "" if modern is None else _text(modern, "matlabRelease")
        if said:
            return said
        version = self.property("version") or _value(top, "Version") or _nested(top, "SimulinkVersion")
        return RELEASES.get(version.split("_")[0], version)

    def property(self, name: str) -> str:
        """Return a property of the package, whatever its name space; "" without it."""
        properties = self.package.tree("metadata/coreProperties.xml")
        return "" if properties is None else _text(properties, name)

    def defaults(self, top: Element) -> dict[str, dict[str, str]]:
        """Return the parameters that the file gives to all blocks of a type. Since R2022a it gives none."""
        found = top.find("BlockParameterDefaults")
        if found is None and (part := self.package.tree("simulink/bddefaults.xml")) is not None:
            found = part.find(".//BlockParameterDefaults")
        if found is None:
            return {name: dict(values) for name, values in DEFAULTS.items()}
        return {b.get("BlockType", ""): _values(b) for b in found.iterfind("Block")}

    def system(self, element: Element, depth: int) -> dict[str, Any]:
        """Return a system and all that is in it, from this element or the part that it names."""
        where = self.package.where
        reference = element.get("Ref")
        if reference is not None:
            if reference in self.seen or not re.fullmatch(r"[\w:.-]+", reference):
                raise LogError(f"its system {reference} holds itself or stands twice", where, REMEDY)
            self.seen.add(reference)
            part = self.package.tree(f"simulink/systems/{reference.replace(':', '_')}.xml")
            if part is None:
                raise LogError(f"has no part for its system {reference}", where, REMEDY)
            element = part
        if depth > DEEPEST:
            raise LogError(f"has systems inside each other deeper than {DEEPEST}", where, REMEDY)
        blocks = [self.block(one, depth) for one in element.iterfind("Block")]
        lines = [
            [_value(one, "Name"), _value(one, "Src"), _wire(one)]
            for one in element.iterfind("Line")
            if _value(one, "LineType") != "Connection" and "conn:" not in _value(one, "Src")
        ]
        return {"blocks": blocks, "lines": lines}

    def block(self, element: Element, depth: int) -> dict[str, Any]:
        """Return a block with its mask and system."""
        self.blocks += 1
        if self.blocks > MOST_BLOCKS:
            raise LogError(f"has more than {MOST_BLOCKS} blocks", self.package.where, REMEDY)
        made: dict[str, Any] = {
            "type": element.get("BlockType", ""),
            "name": element.get("Name") or f"{element.get('BlockType', '')} {element.get('SID', '')}",
            "sid": element.get("SID") or f"name {element.get('Name')}",
            "values": _values(element),
        }
        interface = next((one for one in element.iterfind("List") if one.get("ListType") == "InterfaceData"), None)
        if interface is not None:
            made["values"] |= {f"Interface{name}": text for name, text in _values(interface).items()}
        ports = _ports(element)
        if ports is not None:
            made["ports"] = ports
        instance = element.find("InstanceData")
        if instance is not None:
            made["instance"] = _values(instance)
        signals = {
            port.get("Index") or _value(port, "PortNumber") or "1": name
            for port in (*element.iterfind("Port"), *element.iterfind("PortProperties/Port"))
            if port.get("Type", "out") == "out" and (name := _value(port, "Name"))
        }
        if signals:
            made["signals"] = {number: name for number, name in signals.items() if number.isdigit()}
        mask = _mask(element)
        if mask is not None:
            made["mask"] = mask
        inner = element.find("System")
        if inner is not None:
            made["system"] = self.system(inner, depth + 1)
        return made

    def charts(self, top: Element) -> Iterator[tuple[str, bool, str, dict[str, Any] | None]]:
        """Yield path, whether it is a MATLAB Function, code or labels, and the form of each chart."""
        parts = [name for name in self.package.names if re.fullmatch(r"simulink/stateflow/chart_\w+\.xml", name)]
        older = self.package.tree("simulink/stateflow.xml")
        roots = [one for one in map(self.package.tree, parts) if one is not None]
        roots += [] if older is None else [older]
        roots += list(top.iterfind("Stateflow"))
        for root in roots:
            for chart in root.iter("chart"):
                yield _chart(chart, root)


def _chart(chart: Element, root: Element) -> tuple[str, bool, str, dict[str, Any] | None]:
    # In a .mdl of braces the parts of a chart stand beside it, and name by a number what they are inside.
    beside: dict[str, list[Element]] = {}
    for one in root if _value(chart, "id") else ():
        if (within := re.match(r"\[(\d+)", _value(one, "treeNode") or _value(one, "linkNode"))) is not None:
            beside.setdefault(within[1], []).append(one)
    form = _form(chart, 0, beside)
    texts = [
        (name.rpartition("/")[2], text) for one in (form, *parts_inside(form)) for name, text in one["values"].items()
    ]
    scripts, labels = ([text for name, text in texts if name == kind] for kind in ("script", "labelString"))
    function = _value(chart, "type") == "EML_CHART" or (bool(scripts) and len(labels) <= 1)
    return _value(chart, "name"), function, "\n".join(scripts if function else [*labels, *scripts]), form


def parts_inside(form: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the parts inside a part of a chart."""
    for one in form["inside"]:
        yield from (one, *parts_inside(one))


def _form(part: Element, depth: int, beside: dict[str, list[Element]]) -> dict[str, Any]:
    """Return a part of a chart with its values, those of parts that only hold values by path, and the parts inside."""
    if depth > DEEPEST:
        raise LogError(f"a chart is nested more than {DEEPEST} deep", "stateflow", REMEDY)
    values: dict[str, str] = {}
    stack = [("", part)]
    while stack:
        prefix, at = stack.pop()
        values |= {f"{prefix}{name}": text for name, text in _values(at).items()}
        stack += [(f"{prefix}{one.tag}/", one) for one in at if one.tag not in ("P", "Children") and len(prefix) < 200]
    inside = [one for children in part.iterfind("Children") for one in children]
    return {
        "tag": part.tag,
        "id": part.get("SSID", values.get("id", "")),
        "name": part.get("name", values.get("name", "")),
        "values": values,
        "inside": [_form(one, depth + 1, beside) for one in [*inside, *beside.get(values.get("id", ""), ())]],
    }


def _values(element: Element) -> dict[str, str]:
    """Return the parameters of an element; one that points at a binary part has the part's name."""
    named = ((one.get("Name", ""), one) for one in element.iterfind("P"))
    return {name: one.text or one.get("Ref") or "" for name, one in named if name and name not in _NOT_KEPT}


def _value(element: Element, name: str) -> str:
    return next((one.text or "" for one in element.iterfind("P") if one.get("Name") == name), "")


def _nested(element: Element, name: str) -> str:
    return next((one.text or "" for one in element.iter("P") if one.get("Name") == name), "")


def _text(element: Element, tag: str) -> str:
    return next((one.text or "" for one in element.iter() if one.tag.rpartition("}")[2] == tag), "")


def _ports(element: Element) -> list[int] | None:
    counts = element.find("PortCounts")
    if counts is not None:
        return [int(counts.get(side, "0")) if counts.get(side, "0").isdigit() else 0 for side in ("in", "out")]
    said = next((one for one in element.iterfind("P") if one.get("Name") == "Ports"), None)
    if said is None:
        return None
    numbers = [int(one) for one in re.findall(r"\d{1,6}", said.text or "")]
    return [*numbers, 0, 0][:2]


def _wire(element: Element) -> list[Any]:
    """Return way, sink and branches of a line. A branch may hold branches, as deep as the parser allows."""
    sink = _value(element, "Dst")
    branches = [_wire(one) for one in element.iterfind("Branch")]
    return [_value(element, "Points"), "" if "conn:" in sink else sink, branches]


def _mask(element: Element) -> list[Any] | None:
    """Return kind, parameters and code of a mask, in any of the three forms that files have."""
    modern = element.find("Mask")
    if modern is not None:
        values = {
            one.get("Name", ""): [one.get("Type", "edit"), one.get("Value") or one.findtext("Value") or ""]
            for one in modern.iterfind("MaskParameter")
        }
        return [modern.findtext("Type") or "", values, modern.findtext("Initialization") or ""]
    older = next((one for one in element.iterfind("Object") if one.get("PropName") == "MaskObject"), None)
    if older is not None:
        lists = [one for one in older.iterfind("Array") if one.get("PropName") == "Parameters"]
        single = [one for one in older.iterfind("Object") if one.get("PropName") == "Parameters"]
        # In a .mdl of braces the parameters are sections named by their class.
        entries = [*single, *(entry for one in lists for entry in one if entry.tag != "P")]
        values = {_value(one, "Name"): [_value(one, "Type") or "edit", _value(one, "Value")] for one in entries}
        return [_value(older, "Type"), values, _value(older, "Initialization")]
    names = re.findall(r"(\w+)\s*=\s*[@&]\d+", _value(element, "MaskVariables"))
    if names or _value(element, "MaskType"):
        given = re.split(r"(?<!\\)\|", _value(element, "MaskValueString"))
        kinds = [one.split("(")[0] for one in _value(element, "MaskStyleString").split(",")]
        values = {n: [k or "edit", v] for n, k, v in zip_longest(names, kinds, given, fillvalue="") if n}
        return [_value(element, "MaskType"), values, _value(element, "MaskInitialization")]
    return None


_INTERNAL = {"OutDataTypeStr": "Inherit: Inherit via internal rule", "SaturateOnIntegerOverflow": "off"}
DEFAULTS = {
    "Gain": {**_INTERNAL, "ParamDataTypeStr": "Inherit: Inherit via internal rule"},
    "Product": {**_INTERNAL, "RndMeth": "Floor"},
    "Sum": _INTERNAL,
}
"""What blocks without these parameters mean in a file without defaults: other values stand in such files by name."""
# Simulink's version of each release, for files that do not name the release.
RELEASES = {
    "6.4": "R2006a", "6.5": "R2006b", "6.6": "R2007a", "7.0": "R2007b", "7.1": "R2008a", "7.2": "R2008b",
    "7.3": "R2009a", "7.4": "R2009b", "7.5": "R2010a", "7.6": "R2010b", "7.7": "R2011a", "7.8": "R2011b",
    "7.9": "R2012a",
    "8.0": "R2012b", "8.1": "R2013a", "8.2": "R2013b", "8.3": "R2014a", "8.4": "R2014b", "8.5": "R2015a",
    "8.6": "R2015b", "8.7": "R2016a", "8.8": "R2016b", "8.9": "R2017a", "9.0": "R2017b", "9.1": "R2018a",
    "9.2": "R2018b", "9.3": "R2019a", "10.0": "R2019b", "10.1": "R2020a", "10.2": "R2020b", "10.3": "R2021a",
    "10.4": "R2021b", "10.5": "R2022a", "10.6": "R2022b", "10.7": "R2023a", "23.2": "R2023b", "24.1": "R2024a",
    "24.2": "R2024b", "25.1": "R2025a", "25.2": "R2025b",
}  # fmt: skip
