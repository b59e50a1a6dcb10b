"""Rendering of pages: each is one self-contained file, readable without its script, for all themes and for print."""

from __future__ import annotations

import re
from base64 import b64encode
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from urllib.parse import quote

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from hiltest.text import legible


@dataclass(frozen=True, slots=True)
class Badge:
    """Look of a verdict: a class of the style sheet, and a sign for readers who do not see its colour."""

    tone: str
    sign: str


# "not judged" occurs in older records.
_NO_ANSWER = ("not evaluated", "not judged", "interrupted", "no tests")
_BADGES = {"pass": Badge("good", "✓")} | dict.fromkeys(_NO_ANSWER, Badge("warn", "!"))

_SCRIPT = Path(__file__).with_name("rows.js").read_text(encoding="utf-8")
_SCRIPT_HASH = b64encode(sha256(_SCRIPT.encode()).digest()).decode()
# Spaces as in 12 500 and 1 %, at which a narrow cell must not break.
_KEPT_SPACE = re.compile(r"(?<=\d) (?=\d{3}(?!\d)|%)")


def render(template: str, *, package: str = "hiltest.report", **content: object) -> str:
    """Return a page whose template is in a package.

    All texts are escaped, so that a firmware called ``<script>`` shows as text; invisible characters are named.
    """
    loaders = [PackageLoader(fromkey, ".") for fromkey in dict.fromkeys((package, "hiltest.report"))]
    environment = Environment(
        loader=ChoiceLoader(loaders),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_make_visible,
    )
    environment.globals["script"] = Markup(_SCRIPT)
    environment.globals["script_hash"] = _SCRIPT_HASH
    environment.filters["beside"] = _relative_address
    return environment.get_template(template).render(**content)


def badge_of(outcome: str) -> Badge:
    """Return the look of a verdict by its outcome; an outcome that is neither a pass nor missing is bad."""
    return _BADGES.get(outcome, Badge("bad", "✗"))


def _make_visible(value: object) -> object:
    return _KEPT_SPACE.sub("\N{NO-BREAK SPACE}", legible(value)) if type(value) is str else value


def _relative_address(path: str) -> str:
    """Return the address of a file beside the page, quoted as a path."""
    return f"./{quote(path)}"
