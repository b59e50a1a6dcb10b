"""Conversion of arguments and answers to JSON, and back by the types that an interface declares.

The types of an interface are the schema: a file's content becomes an object only if it fits the declared type.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
import serial

from hiltest import errors
from hiltest.errors import HiltestError

_PLAIN = (bool, int, float, str)
_OF_PORTS = {"SerialException": serial.SerialException, "SerialTimeoutException": serial.SerialTimeoutException}


@dataclass(frozen=True, slots=True)
class Member:
    """A member of an interface: a method, or a value; `hint` is the type of its answer."""

    is_method: bool
    hint: Any
    signature: inspect.Signature | None = None

    def given(self, positional: Sequence[Any], named: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arguments of a call by name, as JSON."""
        if self.signature is None:
            return {}
        return {name: plain(value) for name, value in self.signature.bind(*positional, **named).arguments.items()}


@cache
def member_of(interface: type, name: str) -> Member:
    """Return a public member of an interface.

    Raises
    ------
    AttributeError
        When it has none of this name, because a question outside the interface cannot be recorded.
    """
    attribute = inspect.getattr_static(interface, name, None)
    if name.startswith("_") or (attribute is None and name not in get_type_hints(interface)):
        raise AttributeError(f"{interface.__name__} has no {name!r}, which recording needs")
    if isinstance(attribute, property):
        return Member(is_method=False, hint=get_type_hints(attribute.fget)["return"])
    if inspect.isfunction(attribute):
        signature = inspect.signature(attribute)
        without_self = signature.replace(parameters=list(signature.parameters.values())[1:])
        return Member(is_method=True, hint=get_type_hints(attribute)["return"], signature=without_self)
    return Member(is_method=False, hint=get_type_hints(interface)[name])


def interface_in(hint: Any) -> type | None:
    """Return the interface that an answer implements, if its type is one and so receives further questions."""
    for argument in (hint, *get_args(hint)):
        if isinstance(argument, type) and getattr(argument, "_is_protocol", False):
            return argument
    return None


def plain(value: Any) -> Any:
    """Return a value as JSON.

    Raises
    ------
    TypeError
        When it cannot be recorded.
    """
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, _PLAIN):
        return value
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {_key(key): plain(item) for key, item in value.items()}
    if isinstance(value, Sequence):
        return [plain(item) for item in value]
    raise TypeError(
        f"{type(value).__name__} cannot be recorded: recorded interfaces exchange plain values, dataclasses, arrays, "
        "and other interfaces"
    )


def restored(hint: Any, content: Any) -> Any:
    """Restore the value of a declared type from JSON.

    Raises
    ------
    ValueError
        When the content does not fit the type.
    """
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind is Any:
        return content
    if kind in (Union, UnionType):
        return _first_match(inner, content)
    if kind in (None, NoneType):
        return _check(content is None, None, hint)
    if kind is float:
        return _check(isinstance(content, int | float) and not isinstance(content, bool), content, hint)
    if kind in _PLAIN:
        return _check(type(content) is kind, content, hint)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(content)
    if kind is np.ndarray:
        return _array(content, get_args(inner[1])[0] if inner else np.float64)
    if isinstance(kind, type) and is_dataclass(kind):
        return _record(kind, content)
    if isinstance(kind, type) and issubclass(kind, Mapping):
        _check(isinstance(content, dict), None, hint)
        return {_restored_key(inner[0], key): restored(inner[1], item) for key, item in content.items()}
    if isinstance(kind, type) and issubclass(kind, Sequence):
        return _sequence(kind, inner, content)
    raise TypeError(f"no value of type {hint} can be replayed")


def _key(key: Any) -> str:
    return key.name if isinstance(key, Enum) and not isinstance(key, str) else str(key)


def _restored_key(hint: Any, key: str) -> Any:
    if hint is int:
        return int(key)
    if not (isinstance(hint, type) and issubclass(hint, Enum)) or issubclass(hint, str):
        return key
    return _check(key in hint.__members__, hint.__members__.get(key), hint)


def _check(is_right: bool, value: Any, hint: Any) -> Any:
    if not is_right:
        raise ValueError(f"it is no {hint}")
    return value


def _first_match(hints: Sequence[Any], content: Any) -> Any:
    for hint in hints:
        try:
            return restored(hint, content)
        except (ValueError, TypeError):
            continue
    raise ValueError(f"it is none of {hints}")


def _array(content: Any, dtype: type[np.generic]) -> Any:
    _check(isinstance(content, list), None, np.ndarray)  # numpy converts None to NaN
    try:
        return np.asarray(content, dtype=dtype)
    except (TypeError, OverflowError) as error:
        raise ValueError(f"it is no array: {error}") from None


def _record(kind: type[Any], content: Any) -> Any:
    _check(isinstance(content, dict), None, kind)
    hints = get_type_hints(kind)
    by_name = {field.name: field for field in fields(kind) if field.init}
    needed = {name for name, field in by_name.items() if field.default is MISSING and field.default_factory is MISSING}
    _check(needed <= content.keys() <= by_name.keys(), None, kind)
    return kind(**{name: restored(hints[name], item) for name, item in content.items()})


def _sequence(kind: type, inner: tuple[Any, ...], content: Any) -> Any:
    _check(isinstance(content, list), None, kind)
    if not issubclass(kind, tuple):
        return [restored(inner[0], item) for item in content]
    each_hint = (inner[0],) * len(content) if inner[-1] is Ellipsis else inner
    _check(len(each_hint) == len(content), None, kind)
    return tuple(restored(hint, item) for hint, item in zip(each_hint, content, strict=True))


def plain_error(error: BaseException) -> dict[str, Any]:
    """Return an error of hiltest, or of a port, as JSON."""
    if isinstance(error, HiltestError):
        about = {name: plain(value) for name, value in vars(error).items() if not name.startswith("_")}
        return {"error": type(error).__name__, "text": str(error), "with": about}
    is_late = isinstance(error, serial.SerialTimeoutException)
    return {"error": "SerialTimeoutException" if is_late else "SerialException", "text": str(error), "with": {}}


def restored_error(content: Any) -> Exception:
    """Restore an error from JSON.

    Raises
    ------
    ValueError
        When it is neither an error of hiltest nor of a port.
    """
    _check(isinstance(content, dict), None, Exception)
    name, text, about = content.get("error"), content.get("text"), content.get("with")
    if name in _OF_PORTS:
        return _OF_PORTS[name](str(text))  # type: ignore[no-any-return]
    kind = getattr(errors, str(name), None)
    if not (isinstance(kind, type) and issubclass(kind, HiltestError) and isinstance(about, dict)):
        raise ValueError(f"it is no error of hiltest: {name!r}")
    error = kind.__new__(kind)  # without its constructor, because only its message was recorded
    error.args = (str(text),)
    vars(error).update(about)
    return error
