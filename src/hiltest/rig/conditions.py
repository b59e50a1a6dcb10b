"""One digest of all that the numbers of a rig depend on: two runs with the same one can be compared."""

from __future__ import annotations

import json
from dataclasses import asdict
from hashlib import sha256
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hiltest.rig import Rig

# What may be edited without any number coming out otherwise: names, and what numbers are held against.
_TEXTS = ("path", "name", "schema")
_JUDGED_BY = ("limits", "information", "tolerances", "units", "full_only", "cycles")
# What the record of a run keeps beside the digest, because an option of the command line may say otherwise.
_KEPT_APART = ("seed",)
_KEPT_APART_OF = {"procedure": ("poses", "cost_reference"), "board": ("port", "timing")}


def conditions_sha256(rig: Rig) -> str:
    """Return the SHA-256 of what a rig's numbers rest on.

    Comments, limits, information, tolerances, names and the functions that are counted do not enter, nor do seed and
    poses, which are compared by themselves, nor the calibrator that costs are shown against, nor the port that a board
    happens to be on, nor its timing profile: cycles carry that.
    """
    content = asdict(rig)
    for key in (*_TEXTS, *_JUDGED_BY, *_KEPT_APART):
        del content[key]
    for table, keys in _KEPT_APART_OF.items():
        for key in keys:
            del content[table][key]
    return sha256(json.dumps(_without_none(content), sort_keys=True, default=str).encode()).hexdigest()


def _without_none(content: Any) -> Any:
    """Leave out what is not given, so that a key which a later hiltest adds changes no digest."""
    if isinstance(content, dict):
        return {key: _without_none(value) for key, value in content.items() if value is not None}
    return content
