"""Which column of a table is the time, and in which unit."""

from __future__ import annotations

import re

_TIME = re.compile(
    r"^(?:time|timestamp|seconds|t)[\s_.]*[(\[]?\s*(?P<unit>s|sec|seconds|ms|us|µs|μs|ns)?\s*[)\]]?$", re.IGNORECASE
)
# Of the micro sign there are two.
_SECONDS = {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}


def seconds_of(header: str) -> float | None:
    """Return what one of a column of time is in seconds; None when its name is not that of a time.

    Examples
    --------
    >>> seconds_of("time_s"), seconds_of("Timestamp [ms]"), seconds_of("t"), seconds_of("temperature")
    (1.0, 0.001, 1.0, None)
    """
    matched = _TIME.match(header.strip())
    return _SECONDS.get((matched["unit"] or "s").lower(), 1.0) if matched else None
