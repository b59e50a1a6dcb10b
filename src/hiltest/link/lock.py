"""Exclusive use of a board by one process: a lock on a file, which the system releases when the process ends.

The lock is on a separate file and not on the serial device, so that it persists while the board is flashed: then no
port is open, and the device may vanish and return. The file names the holder.
"""

from __future__ import annotations

import fcntl
import getpass
import os
import shlex
import sys
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Self
from urllib.parse import quote

from hiltest.errors import PortRefusedError
from hiltest.json_files import json_line, parse_json
from hiltest.text import legible

# Folder in which programs of all users lock devices (FHS 3.0, 5.9); the folder for temporary files may differ between
# users.
_LOCKS_OF_ALL = Path("/run/lock")
_LONGEST_NAME, _LONGEST_COMMAND, _LONGEST_FILE = 200, 300, 4096
# Time to wait for the holder's entry: it is written right after locking; until then the file may name an earlier
# holder.
_LOOKS, _LOOK_EVERY_S = 10, 0.02


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a board."""

    pid: int
    user: str
    command: str
    since: str
    rig: str

    @classmethod
    def this_process(cls, rig: str) -> Holder:
        """Return the description of this process."""
        program = Path(sys.argv[0])
        name = program.parent.name if program.name == "__main__.py" else program.name  # run by python -m
        command = shlex.join([name, *sys.argv[1:]])[:_LONGEST_COMMAND]
        try:
            user = getpass.getuser()
        except (KeyError, OSError):  # a container may have a user without a name
            user = str(os.getuid())
        return cls(os.getpid(), user, command, datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S UTC"), rig)

    @classmethod
    def parse(cls, text: bytes) -> Holder | None:
        """Parse a lock file, which anybody may have written; return None if it is invalid."""
        try:
            content = parse_json(text)
            words = [legible(str(content[name]))[:_LONGEST_COMMAND] for name in ("user", "command", "since", "rig")]
            return cls(int(content["pid"]), *words)
        except (ValueError, KeyError, TypeError):
            return None

    @property
    def is_running(self) -> bool:
        """True if the process exists."""
        try:
            os.kill(self.pid, 0)
        except PermissionError:  # another user's process
            return True
        except (OSError, OverflowError):
            return False
        return self.pid > 0

    def __str__(self) -> str:
        rig = f", rig {self.rig}" if self.rig else ""
        return f"process {self.pid} of {self.user} uses it since {self.since} ({self.command}{rig})"


class BoardLock:
    """Exclusive use of a board, from construction until `release` or the end of the process.

    The process that has it may lock it again, as flashing does for the port that it opens afterwards.

    Parameters
    ----------
    place
        Canonical identity of the board: serial number, device or address.
    rig
        Name of the rig, for messages to other processes.
    name
        Name of the board in messages; by default its place.

    Raises
    ------
    PortRefusedError
        When another process has the board, which the message names; or when there is no folder for locks.
    """

    def __init__(self, place: str, *, rig: str = "", name: str | None = None) -> None:
        self._file = _folder() / f"hiltest-{quote(place, safe='')[-_LONGEST_NAME:]}.lock"
        self._name = place if name is None else name
        self._released = False
        with _GUARD:
            held = _HELD.get(self._file)
            if held is not None and held.count:
                held.count += 1
            else:
                _HELD[self._file] = _Held(self._acquire(Holder.this_process(rig)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Release the board, unless this process has locked it more than once. Idempotent."""
        with _GUARD:
            if self._released:
                return
            self._released = True
            held = _HELD[self._file]
            held.count -= 1
            if held.count:
                return
            del _HELD[self._file]
            with suppress(OSError):  # another user's file stays; it then names a process that has ended
                os.unlink(self._file)
            os.close(held.descriptor)

    def _acquire(self, holder: Holder) -> int:
        """Return the descriptor of the locked file."""
        while True:
            try:
                descriptor = _open_file(self._file)
            except OSError as error:
                raise PortRefusedError(
                    self._name,
                    f"it cannot be locked with {self._file}: {error.strerror or error}",
                    "Make that folder writable.",
                ) from error
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if not _is_at(descriptor, self._file):  # its holder removed it after this process opened it
                    os.close(descriptor)
                    continue
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, json_line(asdict(holder)).encode(), 0)
            except BlockingIOError:
                owner = _holder_text(descriptor)
                os.close(descriptor)
                raise PortRefusedError(self._name, owner, "Wait until it ends, or end it, then run again.") from None
            except BaseException:
                os.close(descriptor)
                raise
            return descriptor


@dataclass(slots=True)
class _Held:
    """A lock of this process, and its count."""

    descriptor: int
    count: int = 1


# Reentrant, because the garbage collector may close a port, and so release a lock, during any of the above.
_GUARD = threading.RLock()
_HELD: dict[Path, _Held] = {}


def _folder() -> Path:
    return _LOCKS_OF_ALL if os.access(_LOCKS_OF_ALL, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())


def _open_file(file: Path) -> int:
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW
    while True:
        # Opened without O_CREAT first, because in a shared folder Linux refuses that flag for another user's file.
        with suppress(FileNotFoundError):
            return os.open(file, flags)
        with suppress(FileExistsError):
            descriptor = os.open(file, flags | os.O_CREAT | os.O_EXCL, 0o666)
            os.fchmod(descriptor, 0o666)  # regardless of the umask: the next user may be another one
            return descriptor


def _is_at(descriptor: int, file: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(file))
    except FileNotFoundError:
        return False


def _holder_text(descriptor: int) -> str:
    for _ in range(_LOOKS):
        holder = Holder.parse(os.pread(descriptor, _LONGEST_FILE, 0))
        if holder is not None and holder.is_running:
            return str(holder)
        time.sleep(_LOOK_EVERY_S)
    return "an unknown process uses it"
