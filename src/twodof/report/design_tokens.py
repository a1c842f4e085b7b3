"""The design's colours: those of templates/tokens.css, which the page in the browser has too, light and dark."""

import functools
import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from twodof.report.template_texts import text

_BOTH = re.compile(r"--([\w-]+): light-dark\((#\w+), (#\w+)\);")
_ONE = re.compile(r"--([\w-]+): (#\w+);")


class Shades(NamedTuple):
    """A colour on a light page, and on a dark one."""

    light: str
    dark: str


@functools.cache
def colours() -> Mapping[str, Shades]:
    """Every colour by its name."""
    tokens = text("tokens.css")
    found = {name: Shades(light, dark) for name, light, dark in _BOTH.findall(tokens)}
    return MappingProxyType(found | {name: Shades(one, one) for name, one in _ONE.findall(tokens)})


@functools.cache
def style() -> str:
    """Return the colours as CSS without `light-dark()`, which tokens.css has and older browsers lack."""

    def rows(dark: bool) -> str:
        return " ".join(f"--{name}: {shades[dark]};" for name, shades in colours().items())

    light = f":root {{ color-scheme: light dark; {rows(dark=False)} }}\n"
    return light + f"@media (prefers-color-scheme: dark) {{ :root {{ {rows(dark=True)} }} }}\n"
