"""Rendering of pages: one self-contained file each, no script, no address, light and dark, screen and paper."""

from __future__ import annotations

import re
from urllib.parse import quote

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from hiltest.text import legible

# The space in 12 500 and in 1 %, which a narrow cell must not break at.
_KEPT_SPACE = re.compile(r"(?<=\d) (?=\d{3}(?!\d)|%)")


def render(template: str, *, package: str = "hiltest.report", **content: object) -> str:
    """Return a page whose template is in a package.

    Every text in it is escaped, so a firmware called ``<script>`` shows as text; what would be unseen is named.
    """
    loaders = [PackageLoader(fromkey, ".") for fromkey in dict.fromkeys((package, "hiltest.report"))]
    environment = Environment(
        loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, finalize=_shown,
    )
    environment.filters["beside"] = _beside
    return environment.get_template(template).render(**content)


def _shown(value: object) -> object:
    return _KEPT_SPACE.sub("\N{NO-BREAK SPACE}", legible(value)) if type(value) is str else value


def _beside(path: str) -> str:
    """Return the address of a file beside the page, quoted as a path."""
    return f"./{quote(path)}"
