"""JSON: one strict reader of files from any source, one text of documents; TOML."""

from __future__ import annotations

import json
import math
import re
import stat
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hiltest.budgets import RECORD, Budget, BudgetError, count_separators
from hiltest.errors import ConfigError

if TYPE_CHECKING:
    from pydantic import TypeAdapter
    from pydantic_core import ErrorDetails

# A list of only numbers. No string has a line break after a bracket.
_NUMBERS = re.compile(r"\[\n([^\[\]{}\"]*?)\n\s*\]")
_LONGEST_INTEGER = 19  # digits; no count needs 64 bits
_PIECE_BYTES = 1 << 20
# A key of TOML with many parts, for which the parser takes the square of their number; possessive, hence linear.
_ONE_KEY = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = r"(?<![\w'\"-]){key}(?:[ \t]*+\.[ \t]*+{key}){{{parts}}}"

Document = TypeVar("Document")


@dataclass(frozen=True, slots=True)
class JsonFile:
    """Text of a JSON document, its parsed content, and its file."""

    path: Path
    text: bytes
    content: Any
    sha256: str
    """Digest of the file as it was read."""

    @property
    def schema(self) -> object:
        """The schema that the document names, if any."""
        return self.content.get("schema") if isinstance(self.content, dict) else None

    def has_family(self, schema: str) -> bool:
        """Return whether the document's schema is some version of a schema."""
        return str(self.schema).partition("/")[0] == schema.partition("/")[0]


def read_json(path: Path, *, otherwise: str, budget: Budget = RECORD, in_lines: bool = False) -> JsonFile:
    """Read and parse one JSON file.

    Parameters
    ----------
    in_lines
        True for a file with one object per line, as of `parse_json_lines`.
    otherwise
        Remedy if it is refused; it ends the message.
    budget
        A larger file is refused before it is read.

    Raises
    ------
    ConfigError
        If it cannot be read, is over its budget, or is not JSON in the sense of `parse_json`.
    """
    text = read_bounded(path, budget, otherwise=otherwise)
    try:
        content = parse_json_lines(text, budget) if in_lines else parse_json(text, budget)
        return JsonFile(path, text, content, sha256(text).hexdigest())
    except BudgetError as error:
        raise ConfigError(f"{path}: {error}; {otherwise}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: not JSON: {error}; {otherwise}") from error


def read_as(
    source: Path | JsonFile,
    kind: type[Document],
    schema: str | None = None,
    *,
    otherwise: str,
    budget: Budget = RECORD,
) -> Document:
    """Read a JSON file as a type.

    Nothing is converted: a quoted number is not a number. Unknown keys are ignored, unless the type forbids them.

    Parameters
    ----------
    schema
        Schema of the type, such as ``hiltest.run/1``; None for a file without one.
    otherwise, budget
        See `read_json`.

    Raises
    ------
    ConfigError
        For the reasons of `read_json`, or if the file is of another schema, or a key is missing, unknown or wrong; the
        message has file and place.
    """
    from pydantic import ValidationError

    file = source
    if isinstance(file, Path):
        file = read_json(file, otherwise=otherwise, budget=budget)
    if schema is not None:
        require_schema(file.path, file.schema, schema, otherwise=otherwise)
    try:
        # As JSON, since strict mode accepts a list for a tuple only there.
        document: Document = adapter(kind).validate_json(file.text, strict=True)
    except ValidationError as error:
        raise ConfigError(f"{file.path}: {describe_invalid(error.errors()[0])}; {otherwise}") from error
    return document


def adapter(kind: Any) -> TypeAdapter[Any]:
    """Return pydantic's adapter of a type; pydantic is imported late, since it takes long."""
    from pydantic import TypeAdapter

    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]


_ADAPTERS: dict[Any, TypeAdapter[Any]] = {}


def require_schema(path: Path, schema: object, expected: str, *, otherwise: str) -> None:
    """Refuse a file of another schema, or of another version of it.

    Raises
    ------
    ConfigError
        If the schemas differ; the message has both, and a remedy.
    """
    if schema == expected:
        return
    is_same_family = str(schema).partition("/")[0] == expected.partition("/")[0]
    remedy = f"use the version that wrote it, or {otherwise}" if is_same_family else otherwise
    raise ConfigError(f"{path}: schema is {shown(schema)}, this hiltest reads {shown(expected)}; {remedy}")


def describe_invalid(detail: ErrorDetails) -> str:
    """Return a sentence about the first mistake that pydantic has noticed."""
    place = ".".join(str(step) for step in detail["loc"])
    kind, message = detail["type"], detail["msg"].removeprefix("Value error, ")
    if kind in ("missing", "missing_argument"):
        return f"{place} is missing"
    if kind in ("unexpected_keyword_argument", "extra_forbidden"):
        return f"unknown key {place}: a newer hiltest may have written it"
    if kind == "value_error":
        return f"{place}: {message}" if place else message
    fault = f"{place}: {message[0].lower()}{message[1:]}, not {shown(detail['input'])}"
    return f"{fault}; nothing is converted" if kind == "literal_error" else fault


def json_text(document: object, schema: str | None = None, *, numbers_in_line: bool = False) -> str:
    """Return the text of a document, a dataclass or plain data, without a line break at its end.

    Parameters
    ----------
    schema
        First key of a dataclass that has none.
    numbers_in_line
        Write a list of only numbers on one line.

    Raises
    ------
    ValueError
        If a number is NaN or infinite, which JSON has not.
    """
    content = asdict(document) if is_dataclass(document) and not isinstance(document, type) else document
    if schema is not None and isinstance(content, dict):
        content = {"schema": schema, **content}
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    return _NUMBERS.sub(lambda match: f"[{' '.join(match[1].split())}]", text) if numbers_in_line else text


def json_line(content: object) -> str:
    """Return plain data as JSON in one line."""
    return json.dumps(content, ensure_ascii=False, allow_nan=False)


def read_bounded(path: Path, budget: Budget, *, otherwise: str) -> bytes:
    """Return the bytes of a regular file; the errors are those of `read_pieces`."""
    return b"".join(read_pieces(path, budget, otherwise=otherwise))


def read_pieces(path: Path, budget: Budget, *, otherwise: str) -> Iterator[bytes]:
    """Yield the bytes of a regular file in pieces.

    Raises
    ------
    ConfigError
        If it cannot be read, is larger than its budget, or is a pipe or a device, which may never end.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            kind = "a folder" if stat.S_ISDIR(status.st_mode) else "not a regular file"
            raise ConfigError(f"{path}: {kind}; {otherwise}")
        budget.check(size=status.st_size)
        with path.open("rb") as file:
            size = 0
            while piece := file.read(_PIECE_BYTES):
                size += len(piece)
                budget.check(size=size)  # a file that is still written may have grown meanwhile
                yield piece
    except (OSError, ValueError) as error:  # a name with a NUL is a ValueError
        raise ConfigError(f"{path}: {getattr(error, 'strerror', None) or error}; {otherwise}") from error


def parse_toml(content: bytes, budget: Budget) -> dict[str, Any]:
    """Parse TOML.

    Raises
    ------
    ValueError
        If it is over its budget, or not TOML in UTF-8.
    """
    budget.check(items=count_separators(content))
    text = content.decode("utf-8")
    if re.search(_LONG_KEY.format(key=_ONE_KEY, parts=budget.nesting), text):
        budget.check(nesting=budget.nesting + 1)
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def parse_json(text: str | bytes, budget: Budget = RECORD) -> Any:
    """Parse JSON according to RFC 8259, in UTF-8.

    Raises
    ------
    ValueError
        If it is not JSON, is over its budget, holds a NaN or a number that is too large for a float or for 64 bits,
        or has a key twice in one object.
    """
    encoded = text if isinstance(text, bytes) else text.encode()
    budget.check(items=count_separators(encoded))
    decoded = text if isinstance(text, str) else text.decode("utf-8")
    try:
        parsed = json.loads(
            decoded,
            object_pairs_hook=_refuse_duplicates,
            parse_constant=_refuse_constant,
            parse_float=_parse_finite,
            parse_int=_parse_short_integer,
        )
    except RecursionError:
        budget.check(nesting=budget.nesting + 1)
    if _is_deeper_than(parsed, budget.nesting):
        budget.check(nesting=budget.nesting + 1)
    return parsed


def parse_json_lines(text: bytes, budget: Budget = RECORD) -> list[dict[str, Any]]:
    """Parse a file with one JSON object per line; a last line without its end is ignored, since it may be half written.

    Raises
    ------
    ValueError
        If a line is no object in the sense of `parse_json`; the message has the number of the line.
    """
    budget.check(items=count_separators(text))
    entries: list[dict[str, Any]] = []
    for number, line in enumerate(text.split(b"\n")[:-1], 1):
        try:
            entry = parse_json(line, budget)
        except ValueError as error:
            raise ValueError(f"line {number} is damaged: {error}") from error
        if not isinstance(entry, dict):
            raise ValueError(f"line {number} is damaged: {shown(entry)} is no object")
        entries.append(entry)
    return entries


def _refuse_duplicates(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        ((twice, _),) = Counter(name for name, _ in pairs).most_common(1)
        raise ValueError(f"key {shown(twice)} stands twice in one object")
    return content


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a number")


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
