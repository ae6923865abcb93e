"""HTML pages that need no other file, made from the templates of a package."""

from __future__ import annotations

import base64
from functools import cache

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

_HERE = "oppload_cli.files"


@cache
def _environment(package: str) -> Environment:
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader(_HERE)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    return environment


def rendered(template: str, *, package: str = _HERE, **values: object) -> str:
    """Return the HTML of a page.

    Parameters
    ----------
    template : str
        File name in the folder ``templates`` of the package, e.g. ``reproduction.html``. The
        template extends ``page.html`` of ``oppload_cli/files``, with the style of all pages.
    package : str
        Name of the package with the template.
    **values
        Values and functions that the template uses; a missing value is an error. Text is escaped,
        unless it is a ``markupsafe.Markup``.
    """
    return _environment(package).get_template(template).render(values)


def embedded(picture: bytes, kind: str = "png") -> str:
    """Return the content of a ``png`` or ``jpeg`` file as the ``data:`` address of an ``<img>``."""
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode('ascii')}"
