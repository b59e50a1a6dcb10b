"""Fields that only a newer version knows, kept when a file is read and written again."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any


def with_unknown(written: Any, read: Any) -> Any:
    """Return what is to be written, with every field of what was read that the writer does not know.

    Parameters
    ----------
    written : JSON value
        Made of classes, which have lost what they do not know.
    read : JSON value
        The file as it was.

    Returns
    -------
    JSON value
        An object keeps its unknown fields. An object in a list keeps them as long as nothing else of it has changed:
        what was said of another number does not go with this one.

    Examples
    --------
    >>> with_unknown({"a": 2}, {"a": 1, "b": 3})
    {'a': 2, 'b': 3}
    >>> with_unknown([{"name": "x", "a": 1}, {"name": "y", "a": 2}], [{"name": "y", "a": 2, "b": 3}])
    [{'name': 'x', 'a': 1}, {'name': 'y', 'a': 2, 'b': 3}]
    """
    if isinstance(written, Mapping) and isinstance(read, Mapping):
        known = {key: with_unknown(value, read.get(key)) for key, value in written.items()}
        return known | {key: value for key, value in read.items() if key not in written}
    if not (isinstance(written, list | tuple) and isinstance(read, list)):
        return written
    before: defaultdict[str, list[Any]] = defaultdict(list)
    for each in read:
        if isinstance(each, Mapping):
            before[str(each.get("name"))].append(each)
    return [
        next((old for old in before[str(each.get("name"))] if _says_as_much(old, each)), each)
        if isinstance(each, Mapping) else each for each in written
    ]  # fmt: skip


def _says_as_much(old: Any, new: Any) -> bool:
    """Say whether all of `new` stands in `old`, which may say more."""
    if isinstance(new, Mapping):
        return isinstance(old, Mapping) and all(key in old and _says_as_much(old[key], new[key]) for key in new)
    if isinstance(new, list | tuple):
        return isinstance(old, list) and len(old) == len(new) and all(map(_says_as_much, old, new))
    return bool(old == new)
