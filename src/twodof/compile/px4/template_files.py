"""The text files of a module with fields to fill in: `templates/` holds them as they are exported."""

import functools
from importlib import resources
from string import Template

from twodof.compile.px4.names import ModuleNames


def fill(template: str, names: ModuleNames, **fields: object) -> str:
    """The text of a file in `templates/`: `${module}` and the other names, and `fields`, stand where it names them.

    Raises KeyError for a field of the template that is not given.
    """
    own = {"module": names.module, "MODULE": names.module.upper(), "class_name": names.class_name}
    return _template(template).substitute(own, prefix=names.prefix, **fields)


@functools.cache
def _template(name: str) -> Template:
    return Template(resources.files(__package__).joinpath("templates", name).read_text(encoding="utf-8"))
