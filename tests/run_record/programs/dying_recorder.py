"""Keep a record of two tests again and again, each time in a process that dies one step further on.

usage: dying_recorder.py FOLDER line|byte NOTHING|FINISHED|CUT_SHORT

``line``: by SIGKILL before the n-th line of the modules that write the record. ``byte``: by the kernel, in the middle
of a write, when a file reaches n times some bytes. FOLDER gets a folder for each n with what was there before and what
is left, and ``n.begun`` and ``n.finished`` with the ids of the tests, written by the process itself as it went on.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
import sys
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

from hiltest.measurement import Limit, check
from hiltest.report.render import write_reports
from hiltest.run_record.journal import Journal
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.recorder import Recorder, describe_host
from hiltest.run_record.run import Column, Table, TestResult, Verdict

TESTS = ("a", "b")
WRITERS = ("journal.py", "recorder.py", "render.py")
WRITING = ("write_run", "write_atomically")  # of record.py, where all else is free of files
# Of a file's first bytes each, and then these apart: a prime, so that they fall everywhere in a line.
BYTES_APART = 97
MOST_STEPS = 5000


def keep_record(folder: Path, value: float, witness: str = "", *, finish: bool = True) -> None:
    journal = Journal(folder)
    recorder = Recorder(journal, suite="gate", poses="all")
    recorder.begin()
    for test in TESTS:
        note(folder, witness and "begun", test)
        recorder.add(
            [check(f"{test}.value", value, unit="deg", limit=Limit(max=9.0), test=test)],
            [Table(f"{test}.rows", (Column("n"),), ((value,),))],
        )
        recorder.finish_test(TestResult(test, TestOutcome.PASSED, 0.1, reason="ü"))
        note(folder, witness and "finished", test)
    if finish:
        run = recorder.finish(Verdict("pass", 0, f"PASS {value}.", complete=True))
        write_reports(run, folder)
        journal.release()


def note(folder: Path, case: str, test: str) -> None:
    """Tell what was done, past the limit on the size of files: appended to a file of its own by one write."""
    if case:
        out = os.open(folder.with_suffix(f".{case}"), os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.write(out, f"{test}\n".encode())
        os.close(out)


def die_at_line(step: int) -> None:
    remainder = step

    def trace(frame: FrameType, event: str, _argument: Any) -> Any:
        nonlocal remainder
        code = frame.f_code
        writes = os.path.basename(code.co_filename) in WRITERS and code.co_name != "describe_host"
        if not (writes or code.co_name in WRITING):
            return None
        if event == "line":
            remainder -= 1
            if remainder < 0:
                os.kill(os.getpid(), signal.SIGKILL)
        return trace

    sys.settrace(trace)


def die_at_byte(step: int) -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_DFL)  # Python ignores it
    size = step * BYTES_APART
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def die_keeping_record(folder: Path, die: Callable[[], None]) -> None:
    die()
    keep_record(folder, 2.0, "witness")


def in_a_child(work: Callable[[], Any]) -> int:
    """Do something in a process of its own, and return how that ended."""
    child = os.fork()
    if not child:
        try:
            work()
            os._exit(0)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
    status = os.waitpid(child, 0)[1]
    if os.WIFEXITED(status) and os.WEXITSTATUS(status):
        sys.exit("it ended by itself")
    return status


def main(top: Path, kind: str, before: str) -> None:
    die = {"line": die_at_line, "byte": die_at_byte}[kind]
    describe_host()  # once: it asks which packages are installed
    earlier = top / "earlier"
    earlier.mkdir()
    if before != "NOTHING":
        in_a_child(lambda: keep_record(earlier, 1.0, finish=before == "FINISHED"))
    for step in range(MOST_STEPS):
        folder = top / f"{step:04d}"
        shutil.copytree(earlier, folder)
        if in_a_child(partial(die_keeping_record, folder, partial(die, step))) == 0:
            return
    sys.exit("it never came to its end")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
