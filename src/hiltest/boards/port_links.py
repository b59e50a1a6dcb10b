"""A name that stays for a pseudo-terminal whose own name changes from start to start."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from hiltest.errors import ConfigError


@contextlib.contextmanager
def _kept_alone(path: Path) -> Iterator[None]:
    """Hold what only one process can hold, for as long as it lives: where a link leads does not say who keeps it."""
    folder = os.path.realpath(path.parent)
    name = hashlib.sha256(os.fsencode(os.path.join(folder, path.name))).hexdigest()
    with socket.socket(socket.AF_UNIX) as held:
        try:
            held.bind(f"\0hiltest-link-{name}")  # of the system, not of a file: it ends with the process
        except OSError as error:
            if error.errno == errno.EADDRINUSE:  # anything else: a system without such names, where nobody is asked
                raise ConfigError(
                    f"cannot make the link {path}: another hiltest serve keeps it. Name another one with --link"
                ) from error
        yield


@contextlib.contextmanager
def port_link(path: Path, target: str) -> Iterator[None]:
    """Keep a symbolic link to a terminal for the time of the context.

    A link that an earlier start has left behind is replaced; nothing else is.

    Raises
    ------
    ConfigError
        When something else is at `path`, another process keeps it, or it cannot be written.
    """
    with _kept_alone(path):
        yield from _link(path, target)


def _link(path: Path, target: str) -> Iterator[None]:
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
