"""Names inside PX4: of the module, topic and class, of parameters and of message fields.

Each name depends on other names as little as possible, so that a new part of a diagram does not rename the others.
"""

import functools
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from string import Template
from zlib import crc32

from twodof.errors import DiagramError

LONGEST_PARAMETER = 16  # what MAVLink carries
LONGEST_PREFIX = 5
LONGEST_STEM = 24
LONGEST_FIELD = 48
PREFIX = re.compile(r"[A-Z][A-Z0-9]{0,4}")
_DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"


def digest(text: str, length: int = 4) -> str:
    """Return `length` letters or digits as a digest of `text`."""
    number, made = crc32(text.encode()), ""
    for _ in range(length):
        number, digit = divmod(number, 36)
        made += _DIGITS[digit]
    return made


@dataclass(frozen=True)
class ModuleNames:
    """Names of one diagram's module: `twodof_pitch` in the shell and as topic, `TwodofPitch` in C++."""

    stem: str
    prefix: str

    @property
    def module(self) -> str:
        """Name of the module, of its command and topic; it also begins the C names."""
        return f"twodof_{self.stem}"

    @property
    def class_name(self) -> str:
        """Name of the class and of the message."""
        return "Twodof" + "".join(word.capitalize() for word in self.stem.split("_"))


def module_names(diagram: str, prefix: str = "") -> ModuleNames:
    """Return the names of the module of a diagram called `diagram`; `prefix` begins its parameters' names.

    The stem is the diagram's name in small letters, at most LONGEST_STEM long; a longer one ends with a digest. A word
    of one letter joins the one before it, since PX4 makes a topic's name from the capitals of the message's. The
    default prefix has at most five characters: T, the first letters of the words (or two letters of the only one), and
    the number at the end of the name, which tells variants of a diagram apart. Raises DiagramError for a prefix that is
    not 1 to 5 capitals and digits.
    """
    words: list[str] = []
    for word in re.findall(r"[a-z0-9]+", diagram.lower()):
        if words and (len(word) == 1 or word[0].isdigit()):
            words[-1] += word
        else:
            words.append(word)
    if len(words) > 1 and len(words[0]) == 1:
        words[:2] = [words[0] + words[1]]
    stem = "_".join(words)
    if len(stem) > LONGEST_STEM:
        stem = re.sub(r"_+$", "", stem[: LONGEST_STEM - 4]) + digest(diagram).lower()
    if not prefix:
        prefix = _prefix(words)
    if not PREFIX.fullmatch(prefix):
        raise DiagramError(
            f"{prefix!r:.40} is not a prefix", "prefix", "use 1 to 5 capitals or digits, a capital first"
        )
    return ModuleNames(stem, prefix)


def _prefix(words: Sequence[str]) -> str:
    number = re.sub(r"^.*?([0-9]{0,2})$", r"\1", words[-1])
    letters = "".join(word[0] for word in words) if len(words) > 1 else words[0].rstrip("0123456789")[:2]
    return "T" + (letters[: LONGEST_PREFIX - 1 - len(number)] + number).upper()


def parameter_names(
    prefix: str,
    paths: Sequence[tuple[str, int | None]],
    taken: Iterable[str] = (),
    elsewhere: Iterable[str] = (),
    part: str = "",
) -> list[str]:
    """Return names of at most 16 characters for the parameters at `paths` (with the index of an array's element).

    A name is PREFIX_PART_NAME(_INDEX). One that is too long loses the last letter of its longest word until it fits.
    Names that would be equal, or equal to one of `taken`, are cut and end with a digest of their paths. If the diagram
    is the `part` of a vehicle, `elsewhere` names the vehicle's other parameters; a name equal to one of them ends with
    a digest of the part's name and its path. Raises DiagramError if two names are equal even so.
    """
    reserved, others = set(taken), set(elsewhere)
    made = [_shortened(prefix, path, index) for path, index in paths]
    count = Counter(made)
    final = []
    for name, (path, index) in zip(made, paths, strict=True):
        own = name if count[name] == 1 and name not in reserved else _told_apart(name, f"{path}[{index}]")
        final.append(_told_apart(name, f"{part}.{path}[{index}]") if own in others else own)
    seen = dict.fromkeys(reserved | others, "the vehicle" if part else "the module")
    for name, (path, _) in zip(final, paths, strict=True):
        if name in seen:
            raise DiagramError(f"its PX4 name {name} is also that of {seen[name]!r:.80}", path, "rename one of them")
        seen[name] = path
    return final


def _told_apart(name: str, text: str) -> str:
    return f"{name[:11].rstrip('_')}_{digest(text)}"


def _shortened(prefix: str, path: str, index: int | None) -> str:
    words = [w for w in re.split(r"[._]", path.upper()) if w]
    tail = "" if index is None else f"_{index}"
    room = LONGEST_PARAMETER - len(prefix) - len(tail)
    while 2 * len(words) > room:  # a letter for each is too much already
        words[:2] = [words[0][:1] + words[1][:1]]
    while sum(len(w) + 1 for w in words) > room:
        longest = max(range(len(words)), key=lambda i: len(words[i]))
        words[longest] = words[longest][:-1]
    return "_".join([prefix, *words]) + tail


def field_names(prefix: str, paths: Sequence[str]) -> list[str]:
    """Return the message's field names for the signals at `paths`: `prefix`_path in small letters, all different."""
    made: list[str] = []
    for path in paths:
        stem = re.sub(r"[^a-z0-9]+", "_", path.lower()).strip("_") or "signal"
        name = f"{prefix}_{stem}"
        if len(name) > LONGEST_FIELD:
            name = f"{name[: LONGEST_FIELD - 5].rstrip('_')}_{digest(path).lower()}"
        base, number = name, 2
        while name in made:
            name = f"{base}_{number}"
            number += 1
        made.append(name)
    return made


def harmless(text: str, longest: int) -> str:
    """Return a user's text without characters that have a meaning in comments, YAML or descriptions.

    Letters, digits, spaces and a few signs of ASCII stay; each run of other characters becomes a question mark.
    """
    plain = re.sub(r"[^A-Za-z0-9 .,:;()\[\]+\-/=<>_^%|~!'*]+", "?", " ".join(text.split()))
    plain = re.sub(r"/(?=[/*])|\*(?=/)", r"\g<0> ", plain)
    return plain if len(plain) <= longest else plain[: longest - 3].rstrip() + "..."


def fill(template: str, names: ModuleNames, **fields: object) -> str:
    """Return a file of `templates/` with `${module}`, the other names and `fields` filled in.

    Raises KeyError for a field of the template without a value.
    """
    own = {"module": names.module, "MODULE": names.module.upper(), "class_name": names.class_name}
    return _template(template).substitute(own, prefix=names.prefix, **fields)


@functools.cache
def _template(name: str) -> Template:
    return Template(resources.files(__package__).joinpath("templates", name).read_text(encoding="utf-8"))
