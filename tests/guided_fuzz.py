"""Inputs that coverage guides, for every decoder and reader of test_fuzzed_inputs.py.

    python -m tests.guided_fuzz [--inputs N] [--seed S] [--jobs J] [NAME ...]

Atheris, a fuzzer on libFuzzer's engine, mutates valid inputs, large ones among them, and keeps those that reach new
branches of the package. An input that raises what its reader does not document ends the fuzzing of that reader, and is
printed. Inputs over twice their budget of time or memory are read again without Atheris, which makes reading slow.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import mmap
import os
import random
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from struct import Struct

import atheris  # type: ignore[import-not-found]

# It names every module that it instruments.
with contextlib.redirect_stderr(io.StringIO()), atheris.instrument_imports(include=["hiltest"]):
    from tests.input_budgets import Meter, OverBudgetError, enlarged
    from tests.test_fuzzed_inputs import NAMES, Reader, every_reader

_LARGE = 8  # large inputs to begin with; larger ones are seeded, in test_fuzzed_inputs.py
_LARGE_BYTES = 2048
_TOTALS = Struct("<QQ")  # read, refused


def main() -> int:
    """Fuzz, and print totals."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="readers that are fuzzed at a time")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = folder / "run.json"
        run.write_bytes(_a_run(folder))
        readers = every_reader(folder, run.read_bytes())
        waiting = sorted(arguments.names or NAMES, key=lambda name: readers[name].share)
        running: dict[int, Fuzzing] = {}
        failed: list[str] = []
        while waiting or running:
            while waiting and len(running) < arguments.jobs:
                fuzzing = Fuzzing(readers[waiting[-1]], waiting.pop(), folder)
                inputs = max(20, round(arguments.inputs * fuzzing.reader.share))
                running[fuzzing.start(inputs, arguments.seed)] = fuzzing
            child, status = os.wait()
            fuzzing = running.pop(child)
            if not fuzzing.succeeds(status, run):
                failed.append(fuzzing.name)
    print(
        f"failed: {', '.join(failed)}"
        if failed
        else "each input was read, or refused as documented, within twice its budget"
    )
    return 1 if failed else 0


def _a_run(folder: Path) -> bytes:
    command = [sys.executable, "-m", "hiltest", "run", "--out", str(folder / "run"), "--", "-k", "identity"]
    subprocess.run(command, check=False, capture_output=True)  # its limits are not all measured
    return next((folder / "run").rglob("run.json")).read_bytes()


class Fuzzing:
    """The fuzzing of one reader in a process of its own."""

    def __init__(self, reader: Reader, name: str, folder: Path) -> None:
        self.reader, self.name = reader, name
        self._folder, self._counts = folder / name.replace(" ", "-"), mmap.mmap(-1, _TOTALS.size)
        self._began_s = time.monotonic()

    def start(self, inputs: int, seed: int) -> int:
        """Begin, and return the number of the process; its output goes to a file."""
        self._folder.mkdir()
        if child := os.fork():
            return child
        status = 1
        log = os.open(self._folder / "log", os.O_WRONLY | os.O_CREAT)
        for stream in (1, 2):
            os.dup2(log, stream)
        try:
            fuzz(self.reader, self._folder, inputs, seed, self._counts)
            status = 0
        except SystemExit as ended:
            status = int(ended.code or 0)
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            os._exit(status)

    def succeeds(self, status: int, run: Path) -> bool:
        """Print the totals of a process that has ended with a status; return whether its reader did as documented."""
        read, refused = _TOTALS.unpack(self._counts[:])
        print(f"{self.name}: {read} read, {refused} refused, {time.monotonic() - self._began_s:.0f} s", flush=True)
        if os.waitstatus_to_exitcode(status) != 0 or not read:
            print((self._folder / "log").read_text(errors="replace"))
            return False
        suspects = sorted(map(str, self._folder.glob("over-budget-*")))
        again = [sys.executable, "-m", "tests.input_budgets", str(run), self.name, *suspects]
        return not suspects or subprocess.run(again, check=False).returncode == 0


def fuzz(reader: Reader, folder: Path, inputs: int, seed: int, counts: mmap.mmap) -> None:
    """Give a reader so many inputs."""
    corpus, dice = folder / "seeds", random.Random(seed)
    corpus.mkdir()
    large = [enlarged(dice, content, most_bytes=_LARGE_BYTES) for content in reader.corpus[:_LARGE]]
    for number, content in enumerate([*reader.corpus, *large]):
        (corpus / str(number)).write_bytes(content)
    totals, meter = [0, 0], Meter()

    def one_input(data: bytes) -> None:
        try:
            meter.read(lambda: reader.take(data, folder), reader.budget, len(data))
            totals[0] += 1
        except reader.refuses:
            totals[1] += 1
        except OverBudgetError:
            totals[1] += 1
            (folder / f"over-budget-{sum(totals)}").write_bytes(data)
        finally:
            counts[:] = _TOTALS.pack(*totals)

    longest = max(map(len, [*reader.corpus, *large]))
    # No small inputs first: those of the corpus are what readers take.
    options = [f"-runs={inputs}", f"-seed={seed}", f"-max_len={longest}", "-len_control=0"]
    atheris.Setup([sys.argv[0], *options, f"-artifact_prefix={folder}/", str(corpus)], one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
