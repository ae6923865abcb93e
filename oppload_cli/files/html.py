"""HTML pages that need no other file, made from the templates beside this module."""

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
        File name in the folder ``templates`` of the package, e.g. ``reproduction.html``. It
        extends ``page.html`` of ``oppload_cli/files``, which holds the style that all pages share.
    package : str
        Where the template is.
    **values
        Values and functions that the template uses; one that is missing is an error. Text is
        escaped, unless it is a ``markupsafe.Markup``.
    """
    return _environment(package).get_template(template).render(values)


def embedded(picture: bytes, kind: str = "png") -> str:
    """Return a picture, the content of a file, as the ``data:`` address of an ``<img>``.

    The kind is ``png`` or ``jpeg``.
    """
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode('ascii')}"
