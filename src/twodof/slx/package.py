"""Files of Simulink as trees of XML: .slx (a zip of parts) and both kinds of .mdl (the same parts as text; braces).

A part is one file of the package, named by its path: `simulink/blockdiagram.xml`. The older .mdl has no parts: its text
`Key value` and `Block {...}` becomes the XML that the first .slx had, so that the rest reads one format. Nothing is
unpacked to the disk. This runs behind the fence of `twodof.flightlog.fence`.
"""

import io
import re
import zipfile
from collections.abc import Iterator, Mapping
from xml.etree import ElementTree

from twodof.errors import LogError

Element = ElementTree.Element
MOST_PART = 64 << 20  # bytes of one part: the largest public one has 9 MB
REMEDY = "open it in Simulink and save it again"
DIAGRAM = "simulink/blockdiagram.xml"
_TEXT_PACKAGE = b"# MathWorks OPC Text Package"
_PART = re.compile(r"^__MWOPC_PART_BEGIN__ /(\S+)(?: (\w+))?[ \r]*$", re.MULTILINE)
_END = "__MWOPC_PACKAGE_END__"


class Package:
    """Parts of a model's file, each read when it is asked for."""

    def __init__(self, data: bytes, where: str) -> None:
        self.where = where
        self._zip: zipfile.ZipFile | None = None
        self._texts: dict[str, str] = {}
        self._braces: Element | None = None
        if data[:4] == b"PK\x03\x04":
            try:
                self._zip = zipfile.ZipFile(io.BytesIO(data))
            except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as reason:
                raise LogError(f"its archive is damaged: {reason}", where, REMEDY) from reason
        elif data.startswith(_TEXT_PACKAGE):
            self._texts = dict(_text_parts(_decoded(data)))
        elif re.match(rb"(?:\s|#[^\n]*\n)*(Model|Library|Subsystem)\s*\{", data):
            self._braces = from_braces(_decoded(data), where)
        else:
            raise LogError("is neither .slx nor .mdl", where, "give a model, library or subsystem file of Simulink")

    @property
    def names(self) -> list[str]:
        """Names of the parts, sorted."""
        return sorted(self._zip.namelist() if self._zip is not None else self._texts)

    def text(self, part: str) -> bytes:
        """Return the bytes of a part; empty if there is none. Raises LogError for one that is damaged or too large."""
        if self._zip is None:
            return self._texts.get(part, "").encode()
        try:
            information = self._zip.getinfo(part)
        except KeyError:
            return b""
        if information.file_size > MOST_PART:
            raise LogError(f"its part {part} has {information.file_size} bytes", self.where, REMEDY)
        try:
            with self._zip.open(information) as stream:
                return stream.read(MOST_PART)
        except (zipfile.BadZipFile, OSError, EOFError, RuntimeError, NotImplementedError, ValueError) as reason:
            raise LogError(f"its part {part} is damaged: {reason}", self.where, REMEDY) from reason
        except Exception as reason:  # zlib.error has no common base
            raise LogError(f"its part {part} cannot be unpacked: {reason}", self.where, REMEDY) from reason

    def tree(self, part: str) -> Element | None:
        """Return a part's XML; None if there is no such part. Raises LogError for XML that is damaged."""
        text = self.text(part)
        return _tree(text, f"{self.where}: {part}") if text else None

    def diagram(self) -> Element:
        """Return the element of the model, library or subsystem. Raises LogError where there is none."""
        if self._braces is not None:
            return self._braces
        root = self.tree(DIAGRAM)
        if root is None:
            raise LogError(f"has no part {DIAGRAM}", self.where, REMEDY)
        for kind in ("Model", "Library", "Subsystem"):
            found = root if root.tag == kind else root.find(kind)
            if found is not None:
                return found
        raise LogError("holds no model, library or subsystem", self.where, REMEDY)


def _tree(text: bytes, where: str) -> Element:
    if b"<!DOCTYPE" in text[:4096] or b"<!ENTITY" in text:
        raise LogError("its XML defines entities, which no file of Simulink does", where, REMEDY)
    try:
        return ElementTree.fromstring(text)  # behind the fence, and without entities
    except (ElementTree.ParseError, ValueError, LookupError) as reason:
        raise LogError(f"its XML is damaged: {reason}", where, REMEDY) from reason


def _decoded(data: bytes) -> str:
    """Return the text of a .mdl, in the encoding that it names."""
    named = re.search(rb'SavedCharacterEncoding\s+"([\w-]{1,40})"', data[:4096])
    for encoding in (named.group(1).decode() if named else "utf-8", "utf-8"):
        try:
            return data.decode(encoding)
        except (UnicodeDecodeError, LookupError):
            continue
    return data.decode("latin-1")


def _text_parts(text: str) -> Iterator[tuple[str, str]]:
    """Yield name and text of each part of a text package but the binary ones, which nothing here reads."""
    found = list(_PART.finditer(text))
    for this, following in zip(found, [*found[1:], None], strict=True):
        if this[2] is None:
            content = text[this.end() : following.start() if following else len(text)]
            yield this[1], content.partition(_END)[0].strip()


# --- the older .mdl

_LINE = re.compile(r'\s*(?:(\})|([\w.$]+)\s*(\{)|([\w.$]+)\s+(.*?)|("(?:[^"\\]|\\.)*"))\s*$')
_QUOTED = re.compile(r'"((?:[^"\\]|\\.)*)"')
_ESCAPE = re.compile(r"\\(.)")
_ESCAPES = {"n": "\n", "t": "\t", "r": "\r"}


def from_braces(text: str, where: str) -> Element:
    """Return the tree of a .mdl of braces in the form that .slx has. Raises LogError where a brace is missing.

    A chart's part hangs below the model as `chart` and `state`, as it does in older .slx.
    """
    top = Element("file")
    open_: list[Element] = [top]
    last: Element | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        found = _LINE.match(line)
        if found is None:
            if not line.strip() or line.lstrip().startswith("#"):
                continue
            if last is not None:  # a matrix over several lines
                last.text = f"{last.text} {line.strip()}"
                continue
            raise LogError(f"line {number} is not read: {line.strip()[:60]}", where, REMEDY)
        close, section, _, key, value, more = found.groups()
        if close:
            if len(open_) == 1:
                raise LogError(f"line {number} closes a section that was not opened", where, REMEDY)
            _finish(open_.pop())
            last = None
        elif section:
            child = ElementTree.SubElement(open_[-1], section)
            open_.append(child)
            last = None
        elif key:
            last = ElementTree.SubElement(open_[-1], "P", {"Name": key})
            last.text = _plain(value)
        elif last is not None:
            last.text = f"{last.text or ''}{_plain(more)}"
    if len(open_) > 1:
        raise LogError("ends before its braces are closed", where, REMEDY)
    model = next((child for child in top if child.tag in ("Model", "Library", "Subsystem")), None)
    if model is None:
        raise LogError("holds no model, library or subsystem", where, REMEDY)
    model.extend(child for child in top if child.tag == "Stateflow")
    return model


def _plain(value: str) -> str:
    """Return a value without quotes and escapes."""
    if not value.startswith('"'):
        return value
    return "".join(_ESCAPE.sub(lambda e: _ESCAPES.get(e[1], e[1]), part) for part in _QUOTED.findall(value))


def _finish(element: Element) -> None:
    """Give a section that has ended the attributes that the XML has."""
    values = {p.get("Name", ""): p for p in element if p.tag == "P"}
    if element.tag == "Block":
        _to_attributes(element, values, ("BlockType", "Name", "SID"))
    elif element.tag == "System":
        ids = {name: b.get("SID") or f"name {name}" for b in element.iterfind("Block") if (name := b.get("Name"))}
        for block in element.iterfind("Block"):
            block.set("SID", ids.get(block.get("Name", ""), ""))
        for line in (one for top in element.iterfind("Line") for one in top.iter() if one.tag in ("Line", "Branch")):
            _to_pins(line, ids)
    elif element.tag in ("Object", "Array", "List"):
        for name, attribute in (("$PropName", "PropName"), ("PropName", "PropName"), ("$ClassName", "ClassName")):
            if name in values:
                element.set(attribute, values[name].text or "")
        if element.tag == "List" and "ListType" in values:
            _to_attributes(element, values, ("ListType",))


def _to_attributes(element: Element, values: dict[str, Element], names: tuple[str, ...]) -> None:
    for name in names:
        if name in values:
            element.set(name, values[name].text or "")
            element.remove(values[name])


def _to_pins(line: Element, ids: Mapping[str, str]) -> None:
    """Name the ends of a line as .slx does: `12#out:1`."""
    values = {p.get("Name"): p for p in line.iterfind("P")}
    for end, pin in (("Src", "out"), ("Dst", "in")):
        block, port = values.get(f"{end}Block"), values.get(f"{end}Port")
        if block is None or port is None or values.get(end) is not None:
            continue
        text = port.text or "1"
        physical = re.fullmatch(r"([LR])Conn(\d+)", text)
        suffix = f"{physical[1].lower()}conn:{physical[2]}" if physical else f"{pin}:{text}" if text.isdigit() else text
        made = ElementTree.SubElement(line, "P", {"Name": end})
        made.text = f"{ids.get(block.text or '', block.text)}#{suffix}"
