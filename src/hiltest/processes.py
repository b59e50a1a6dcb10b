"""Ends of this process and of those that it starts: output that fails, signals, a parent that dies, lack of resources.

Every pytest run on the machine may import this module, so that it imports only the standard library.
"""

from __future__ import annotations

import errno
import fcntl
import io
import os
import select
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

_HUNG_S = 10.0
"""A terminal or a reader that accepts nothing for this time hangs; the output is then dropped."""
_PARENT_PIPE = "HILTEST_PARENT_PIPE"
"""Variable with the file descriptor of a pipe that the parent holds open until it ends."""
_LACKING = {getattr(errno, name) for name in ["ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EMFILE", "ENFILE", "ENOMEM"]}


def lacks_resources(error: BaseException | None) -> bool:
    """Return whether an error, or one of its causes, is a lack of memory, open files, processes or disk space."""
    while error is not None:
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _LACKING):
            return True
        if "No usable temporary directory" in str(error):  # tempfile hides why
            return True
        error = error.__cause__
    return False


class Output(io.RawIOBase):
    """A process's output, which is dropped after its first fault: no verdict depends on a terminal.

    Attributes
    ----------
    fault : OSError or None
        First error; ``EPIPE`` if the reader closed the pipe, ``ETIMEDOUT`` if it hangs.
    """

    def __init__(self, descriptor: int) -> None:
        self.fault: OSError | None = None
        self._descriptor = self._to = descriptor
        # Opened again, the terminal or pipe can be written without blocking while its other users still block.
        if os.isatty(descriptor) or stat.S_ISFIFO(os.fstat(descriptor).st_mode):
            with suppress(OSError):
                opened = os.open(f"/proc/self/fd/{descriptor}", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
                # pytest captures the descriptors 0 to 2, of which one may have been closed and so is free.
                self._to = fcntl.fcntl(opened, fcntl.F_DUPFD_CLOEXEC, 3)
                os.close(opened)

    def writable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the file descriptor that the process was started with."""
        return self._descriptor

    def isatty(self) -> bool:
        """Return whether the output is a terminal."""
        return os.isatty(self._descriptor)

    def write(self, data: Any) -> int:
        """Write bytes, or drop them after a fault."""
        while self.fault is None:
            try:
                return os.write(self._to, data)
            except BlockingIOError:
                poll = select.poll()
                poll.register(self._to, select.POLLOUT)
                if not poll.poll(_HUNG_S * 1e3):
                    self.fault = OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT))
            except OSError as error:
                self.fault = error
        return len(data)


def guard_output(stream: TextIO) -> TextIO:
    """Return a stream whose faults do not end the program, in place of one that the process was started with.

    Both streams write each line at its end: a program may use both, and nobody flushes the new one at the end.
    """
    if stream not in (sys.__stdout__, sys.__stderr__) or not isinstance(stream, io.TextIOWrapper):
        return stream
    with suppress(OSError):
        stream.reconfigure(line_buffering=True)  # flushes it
    return io.TextIOWrapper(
        io.BufferedWriter(Output(stream.fileno())),
        encoding=stream.encoding,
        errors="backslashreplace",  # a file's name may not be encodable
        line_buffering=True,
    )


def output_fault(stream: TextIO) -> OSError | None:
    """Return the fault of a guarded stream; None if there is none, or if its reader had enough or hangs."""
    with suppress(OSError):
        stream.flush()
    raw = getattr(getattr(stream, "buffer", None), "raw", None)
    fault = raw.fault if isinstance(raw, Output) else None
    return None if fault is None or fault.errno in (errno.EPIPE, errno.ETIMEDOUT, errno.EIO) else fault


def interrupt_by_signals() -> None:
    """Let SIGTERM and SIGHUP act as Ctrl-C, unless they are ignored, as by nohup, or handled already."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, _interrupt)


def _interrupt(_number: int, frame: Any) -> None:
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler):  # a shell ignores Ctrl-C for commands in the background
        raise KeyboardInterrupt
    handler(signal.SIGINT, frame)


@contextmanager
def asked_to_end() -> Iterator[list[int]]:
    """Return a list that collects Ctrl-C instead of interrupting; a second Ctrl-C interrupts."""
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came  # signals reach the main thread only
        return

    def note(number: int, _frame: object) -> None:
        came.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield came
    finally:
        signal.signal(signal.SIGINT, before)


def follow_parent() -> None:
    """Interrupt this process when the process that called `run_child` ends, however it ends."""
    descriptor = os.environ.pop(_PARENT_PIPE, "")
    if descriptor:
        threading.Thread(target=_wait_for_parent, args=(int(descriptor),), daemon=True).start()


def _wait_for_parent(descriptor: int) -> None:
    with suppress(OSError):
        os.read(descriptor, 1)  # nothing is ever written: the pipe ends with the parent
        os.kill(os.getpid(), signal.SIGTERM)


_children: dict[subprocess.Popen[str], bool] = {}
"""Running children; True for those that were asked to end."""


def run_child(
    command: Sequence[str], *, environment: Mapping[str, str], cwd: Path | None = None, shows_errors: bool = False
) -> subprocess.CompletedProcess[str]:
    """Run a command of hiltest, which ends when this process ends.

    Its process group is its own: Ctrl-C reaches it once, through this process. A second Ctrl-C kills it.

    Parameters
    ----------
    shows_errors
        True to print the standard error of the command, as it comes, instead of returning it.
    """
    reading, writing = os.pipe()
    printing: threading.Thread | None = None
    errors_writing = subprocess.PIPE
    if shows_errors:  # not to the terminal itself, which may be closed: its end must not end the child
        errors_reading, errors_writing = os.pipe()
        printing = threading.Thread(target=_print_errors, args=(errors_reading,), daemon=True)
        printing.start()
    try:
        child = subprocess.Popen(
            command,
            cwd=cwd,
            env={**environment, _PARENT_PIPE: str(reading)},
            stdout=subprocess.PIPE,
            stderr=errors_writing,
            text=True,
            errors="replace",
            pass_fds=(reading,),
            process_group=0,
        )
    except BaseException:
        os.close(writing)
        raise
    finally:
        os.close(reading)
        if printing is not None:
            os.close(errors_writing)
    _children[child] = False
    with child:
        try:
            try:
                output, errors = child.communicate()
            except KeyboardInterrupt:
                end_children()
                child.communicate()
                raise
        except BaseException:
            _signal_group(child, signal.SIGKILL)
            raise
        finally:
            del _children[child]
            os.close(writing)
    if printing is not None:
        printing.join(_HUNG_S)
    return subprocess.CompletedProcess(command, child.returncode, output, errors or "")


def _print_errors(descriptor: int) -> None:
    with open(descriptor, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            sys.stderr.write(line)


def end_children() -> None:
    """Ask each running child to end; it keeps its measurements."""
    for child, was_asked in [*_children.items()]:
        if not was_asked:
            _children[child] = True
            _signal_group(child, signal.SIGTERM)


def _signal_group(child: subprocess.Popen[str], number: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(child.pid, number)
