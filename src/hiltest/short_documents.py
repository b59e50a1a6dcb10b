"""Documents of `--json`, shortened for readers who pay by length, as language models do."""

from __future__ import annotations

import json
from collections import Counter
from typing import Any

from hiltest.errors import ConfigError

_SCALARS = 64  # vectors, matrices and most lists of numbers stay whole
_NESTED = 32  # of a table within a list, no column is left out, only rows
_KEYS = 40  # no document has an object with so many fields: more are a table by name
_UNREMARKABLE = {"unchanged", "pass", "passed", "information", "not offered"}


def shorten(document: dict[str, Any], most_bytes: int) -> dict[str, Any]:
    """Return a document of at most so many bytes that fits the same schema.

    Long lists and tables end early, after their remarkable entries; a reason for which many tests were skipped stands
    once, with their number. The key ``left_out`` has the number of missing entries by place, a JSON Pointer (RFC 6901)
    without escapes.

    Raises
    ------
    ConfigError
        If the document is longer even with empty lists.
    """
    for longest in (*(1 << power for power in range(16, -1, -1)), 0):
        left_out: dict[str, int] = {}
        shortened: dict[str, Any] = _cut(document, longest, 0, "", left_out) | (
            {"left_out": left_out} if left_out else {}
        )
        if len(compact(shortened).encode()) <= most_bytes:
            return shortened
    raise ConfigError(f"{document.get('schema')}: more than {most_bytes} bytes even with empty lists")


def compact(value: Any) -> str:
    """Return a value as JSON without spaces."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def _cut(value: Any, longest: int, least: int, place: str, left_out: dict[str, int]) -> Any:
    """Return a value whose lists have at most `longest` entries, but `least` are not cut."""
    if isinstance(value, dict):
        names = list(value)[: longest if len(value) > _KEYS else None]
        shortened: Any = {name: _cut(value[name], longest, least, f"{place}/{name}", left_out) for name in names}
    elif isinstance(value, list):
        is_plain = not any(isinstance(item, dict | list) for item in value)
        most = max(longest, least, _SCALARS if is_plain else 0)
        items = value if is_plain else _drop_repeated_reasons(value)
        items = items if len(items) <= most else sorted(items, key=_is_unremarkable)[:most]
        shortened = [_cut(item, longest, _NESTED, f"{place}/{number}", left_out) for number, item in enumerate(items)]
    else:
        return value
    if len(shortened) < len(value):
        left_out[place] = len(value) - len(shortened)
    return shortened


def _drop_repeated_reasons(rows: list[Any]) -> list[Any]:
    """Return rows; of the tests that were skipped for one reason only the first, with the number of the others."""
    reasons = [row.get("reason") if isinstance(row, dict) and row.get("outcome") == "skipped" else None for row in rows]
    counts, rest = Counter(filter(None, reasons)), []
    for row, reason in zip(rows, reasons, strict=True):
        number = counts.pop(reason, 0) if reason else 1
        if number:
            rest.append(row if number == 1 else row | {"reason": f"{reason} (also of {number - 1} other tests)"})
    return rest


def _is_unremarkable(item: Any) -> bool:
    return isinstance(item, dict) and (item.get("change") or item.get("outcome")) in _UNREMARKABLE
