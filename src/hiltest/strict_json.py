"""Strict parser of JSON from any source, with bounds for size, depth, numbers and keys."""

from __future__ import annotations

import json
import math
import stat
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from hiltest.errors import ConfigError

LARGEST_BYTES = 32 * 1024 * 1024
"""Largest size of a record or a baseline; the record of the full set has a hundredth of it."""

DEEPEST = 32
"""Largest number of nested lists and objects; a record has six."""

_LONGEST_INTEGER = 19  # digits; no count needs 64 bits


@dataclass(frozen=True, slots=True)
class JsonFile:
    """Content of a JSON file, the schema that it names if any, and the SHA-256 of the file."""

    path: Path
    content: Any
    schema: object
    sha256: str


def read_json(path: Path, *, otherwise: str, largest_bytes: int = LARGEST_BYTES) -> JsonFile:
    """Read and parse one JSON file.

    Parameters
    ----------
    otherwise
        Remedy if it is refused; it ends the message.
    largest_bytes
        A larger file is refused before it is read.

    Raises
    ------
    ConfigError
        If it cannot be read or is not JSON in the sense of `parse_json`.
    """
    text = read_bounded(path, largest_bytes=largest_bytes, otherwise=otherwise)
    try:
        content = parse_json(text)
    except ValueError as error:
        raise ConfigError(f"{path}: not JSON: {error}; {otherwise}") from error
    schema = content.get("schema") if isinstance(content, dict) else None
    return JsonFile(path, content, schema, sha256(text).hexdigest())


def read_bounded(path: Path, *, largest_bytes: int, otherwise: str) -> bytes:
    """Return the bytes of a regular file.

    Raises
    ------
    ConfigError
        If it cannot be read, is larger, or is a pipe or a device, which may never end.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            kind = "a folder" if stat.S_ISDIR(status.st_mode) else "not a regular file"
            raise ConfigError(f"{path}: {kind}; {otherwise}")
        with path.open("rb") as file:  # a file that is still written may have grown meanwhile
            content = b"" if status.st_size > largest_bytes else file.read(largest_bytes + 1)
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        raise ConfigError(f"{path}: {getattr(error, 'strerror', None) or error}; {otherwise}") from error
    if max(len(content), status.st_size) > largest_bytes:
        raise ConfigError(f"{path}: larger than {largest_bytes} bytes; {otherwise}")
    return content


def parse_json(text: str | bytes) -> Any:
    """Parse JSON according to RFC 8259, in UTF-8.

    Raises
    ------
    ValueError
        If it is not JSON, is nested too deeply, holds a NaN or a number that is too large for a float or for 64 bits,
        or has a key twice in one object.
    """
    decoded = text.decode("utf-8") if isinstance(text, bytes) else text
    try:
        parsed = json.loads(
            decoded,
            object_pairs_hook=_refuse_duplicates,
            parse_constant=_refuse_constant,
            parse_float=_parse_finite,
            parse_int=_parse_short_integer,
        )
    except RecursionError as error:
        raise ValueError(f"nested more than {DEEPEST} levels deep") from error
    if _is_deeper_than(parsed, DEEPEST):
        raise ValueError(f"nested more than {DEEPEST} levels deep")
    return parsed


def _refuse_duplicates(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"key {shown(twice)} stands twice in one object")
    return content


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number")


def _parse_finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"{shown(text)} is too large for a number")
    return number


def _parse_short_integer(text: str) -> int:
    if len(text.lstrip("-")) >= _LONGEST_INTEGER:
        raise ValueError(f"{shown(text)} is too large for a whole number")
    return int(text)


def _is_deeper_than(value: Any, levels: int) -> bool:
    """Return whether a list or object is nested in more than `levels` others, without recursion."""
    level = [value]
    for _ in range(levels + 1):
        level = [item for item in level if isinstance(item, list | dict)]
        if not level:
            return False
        level = [inner for item in level for inner in (item.values() if isinstance(item, dict) else item)]
    return True


def shown(value: object) -> str:
    """Return a value of a file for a message, shortened."""
    text = json.dumps(value, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."
