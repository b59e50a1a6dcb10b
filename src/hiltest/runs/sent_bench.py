"""A bench as it is sent to another machine, and the run of a seed there: no file system is shared.

Sent are ``hil/`` of the folder that the command was given in, the files with pytest's settings there and above,
``conftest.py``, and what the options and variables name, with what a rig among them names. All lie there as they do
here, below a folder that is the root of the bench: a name that is relative here is the same there, and where that
folder's name is taken out of what was written there, it is what a run here would have written.
"""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from hiltest import __version__
from hiltest.bench_files import rig_file
from hiltest.errors import ConfigError
from hiltest.record.files import RUN_FILE
from hiltest.rig.file import load_rig
from hiltest.runs.older_firmware import coverage_in, last_words, run_command
from hiltest.settings import OPTIONS

LARGEST_BYTES = 256 << 20
"""Of the files of a bench that is sent."""
# Which files pytest asks for its settings, in the folder of the command and above; a suite's conftest.py is in hil/.
_SETTINGS = ("pytest.toml", ".pytest.toml", "pytest.ini", ".pytest.ini", "pyproject.toml", "tox.ini", "setup.cfg")
# What a run reads of the environment: its settings, pytest's options, and the commit of a job.
_FILES = tuple(option.variable for option in OPTIONS if option.name in ("rig", "firmware", "calibration"))
_READ = frozenset({"PYTEST_ADDOPTS", "GITHUB_SHA", "GITHUB_REF_NAME", *(option.variable for option in OPTIONS)})


@dataclass(frozen=True, slots=True)
class SentBench:
    """All that a run of the suites depends on, but for its seed and hiltest."""

    files: bytes
    """Zip archive; names are from the root of the file system on."""
    here: str
    """Folder of the command."""
    options: tuple[str, ...]
    """For pytest."""
    environment: dict[str, str]
    """The variables that a run reads."""
    covers: bool = False
    """Whether the run leaves its coverage in its folder."""


@dataclass(frozen=True, slots=True)
class EndedThere:
    """A run that has ended on another machine."""

    exit_code: int
    said: str
    """The last line that it wrote."""
    files: dict[str, bytes]
    """What it left in its folder."""

    def write(self, folder: Path) -> None:
        """Write the files into the folder of a run here, the record last: then all the others are there.

        Raises
        ------
        OSError
            If they cannot be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        for name in sorted(self.files, key=RUN_FILE.__eq__):
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(self.files[name])


def sent_bench(
    options: Sequence[str], environment: Mapping[str, str] = os.environ, *, covers: bool = False
) -> SentBench:
    """Return the bench of this folder, to be sent.

    Parameters
    ----------
    options
        For pytest.
    covers
        See `SentBench`.

    Raises
    ------
    ConfigError
        If a file cannot be read, or they are too large together.
    """
    here = Path.cwd()
    read = _variables(environment)
    files = io.BytesIO()
    total = 0
    with zipfile.ZipFile(files, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in _files_of_bench(here, options, read):
            try:
                total += path.stat().st_size
                if total > LARGEST_BYTES:
                    raise ConfigError(f"{path}: with this file more than {LARGEST_BYTES >> 20} MiB would go to the "
                                      f"workers: keep in {here / 'hil'} what the runs need")  # fmt: skip
                archive.writestr(str(path.relative_to("/")), path.read_bytes())
            except (OSError, UnicodeError) as error:
                raise ConfigError(f"cannot send {path} to the workers: {error}") from error
    return SentBench(files.getvalue(), str(here), tuple(options), read, covers)


def digest_of_bench(options: Sequence[str], environment: Mapping[str, str] = os.environ) -> str:
    """Return a digest of all that a run in this folder depends on, but for firmware that no option names.

    Raises
    ------
    ConfigError
        If a file cannot be read.
    """
    here = Path.cwd()
    read = _variables(environment)
    digest = hashlib.sha256(repr((__version__, str(here), list(options), sorted(read.items()))).encode())
    for path in _files_of_bench(here, options, read):
        try:
            content = path.read_bytes()
        except OSError as error:
            raise ConfigError(f"cannot read {path}: {error.strerror or error}") from error
        digest.update(repr((str(path), hashlib.sha256(content).hexdigest())).encode())
    return digest.hexdigest()


def _variables(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name in _READ}


def _files_of_bench(here: Path, options: Sequence[str], read: Mapping[str, str]) -> list[Path]:
    given = (*options, *(read.get(name, "") for name in _FILES))
    named = [path for each in given if (path := _named_path(each, here)) is not None]
    return sorted(set(_files_of(here, [*named, *_of_rig(here, options, read)])))


def _named_path(text: str, here: Path) -> Path | None:
    """Return the file or folder that an option, a variable or an argument of pytest names, if it does."""
    name = _value(text).partition("::")[0]
    with suppress(OSError, ValueError):  # too long for a name, or with a NUL
        path = Path(os.path.normpath(here / name))
        if name and path.exists() and path != here and path not in here.parents:
            return path
    return None


def _value(option: str) -> str:
    return option.partition("=")[2] if option.startswith("-") else option


def _of_rig(here: Path, options: Sequence[str], environment: Mapping[str, str]) -> Iterator[Path]:
    """Yield the files that the rig names; which of them there are, and that all is well with them, a run says."""
    flag = "--hil-rig="
    named = [each.removeprefix(flag) for each in options if each.startswith(flag)] or [environment.get("HIL_RIG", "")]
    with suppress(ConfigError, OSError):
        rig = load_rig(rig_file(here, named[-1] or None))
        playback = rig.world.playback if rig.world else None
        for name in (rig.board.firmware, rig.board.timing, playback and playback.file):
            if name and (path := Path(os.path.normpath(rig.path.parent / name))).is_file():
                yield path


def _files_of(here: Path, named: Iterable[Path]) -> Iterator[Path]:
    settings = (folder / name for folder in (here, *here.parents) for name in _SETTINGS)
    for path in (here / "hil", here / "conftest.py", *settings, *named):
        if path.is_file():
            yield path
        elif path.is_dir():
            yield from (each for each in path.rglob("*") if each.is_file() and "__pycache__" not in each.parts)


def run_there(bench: SentBench, seed: int) -> EndedThere:
    """Run one seed on this machine, in a folder that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="hiltest-") as folder:
        root = os.path.realpath(folder)
        with zipfile.ZipFile(io.BytesIO(bench.files)) as archive:
            archive.extractall(root)
        here = Path(root + bench.here)
        here.mkdir(parents=True, exist_ok=True)
        out = Path(root) / "record"
        mine = {name: value for name, value in os.environ.items() if name not in _READ}
        done = run_command(
            f"--seed={seed}", f"--out={out}", *coverage_in(out, covers=bench.covers),
            "--", *(_there(each, root) for each in bench.options), folder=out, here=here,
            environment={**mine, **{name: _there(each, root) for name, each in bench.environment.items()}},
        )  # fmt: skip
        files = {
            str(path.relative_to(out)): path.read_bytes().replace(root.encode(), b"")
            for path in out.rglob("*") if path.is_file()
        }
        return EndedThere(done.returncode, last_words(done.stderr or done.stdout).replace(root, ""), files)


def _there(text: str, root: str) -> str:
    """Return an option, argument or variable with the place there of an absolute path that was sent."""
    value = _value(text)
    if not value.startswith("/") or not os.path.exists(root + value.partition("::")[0]):
        return text
    return text.removesuffix(value) + root + value
