"""A name that stays for a pseudo-terminal whose own name changes from start to start."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from hiltest.errors import ConfigError


@contextlib.contextmanager
def port_link(path: Path, target: str) -> Iterator[None]:
    """Keep a symbolic link to a terminal for the time of the context.

    A link that an earlier start has left behind is replaced; nothing else is.

    Raises
    ------
    ConfigError
        When something else is at `path`, or it cannot be written.
    """
    try:
        if path.is_symlink() and os.readlink(path).startswith("/dev/pts/"):
            path.unlink()
        path.symlink_to(target)
    except OSError as error:
        raise ConfigError(f"cannot make the link {path}: {error.strerror}. Name another one with --link") from error
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            if os.readlink(path) == target:
                path.unlink()
