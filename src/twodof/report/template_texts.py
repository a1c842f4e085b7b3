"""The report's pages and pictures with fields to fill in: `templates/` holds them as they are read."""

from __future__ import annotations

import functools
from importlib import resources
from string import Template


def fill(template: str, **fields: object) -> str:
    """The text of a file in `templates/`. Raises KeyError for a field of it that is not given."""
    return Template(text(template)).substitute(**fields)


@functools.cache
def text(name: str) -> str:
    """The text of a file in `templates/` as it is."""
    return resources.files(__package__).joinpath("templates", name).read_text(encoding="utf-8")
