"""The report's pages and pictures with fields to fill in: `templates/` holds them as they are read."""

import functools
import tomllib
from importlib import resources
from string import Template
from typing import Any


def fill(template: str, **fields: object) -> str:
    """Return the filled text of a file in `templates/`. Raises KeyError for a field of it that is not given."""
    return Template(text(template)).substitute(**fields)


def say(key: str, **fields: object) -> str:
    """Return a text of `words.toml` with its fields filled in."""
    words: str = table("words.toml")[key]
    return words.format(**fields)


@functools.cache
def table(name: str) -> dict[str, Any]:
    """Return the tables of a TOML file in `templates/`."""
    return tomllib.loads(text(name))


@functools.cache
def text(name: str) -> str:
    """Return the text of a file in `templates/` as it is."""
    return resources.files(__package__).joinpath("templates", name).read_text(encoding="utf-8")
