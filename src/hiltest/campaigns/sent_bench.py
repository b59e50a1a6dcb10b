"""A bench that is sent to another machine, and the run of a seed there; no shared file system is needed.

The archive contains ``hil/`` of the command's folder, the files with pytest's settings there and above,
``conftest.py``, and the files that options and variables name, including those of the rig. All keep their paths,
below a temporary folder that is the root of the bench: relative names stay the same, and once the temporary
folder's name is removed from the output, the output equals that of a local run.
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
from hiltest.errors import ConfigError
from hiltest.path_names import path_below
from hiltest.rig.bench_files import rig_file
from hiltest.rig.rig_file import load_rig
from hiltest.run_record.files import RUN_FILE
from hiltest.session.older_firmware import coverage_in, last_words, run_command
from hiltest.session.settings import OPTIONS

LARGEST_BYTES = 256 << 20
"""Limit on the size of the files of a bench."""
# Files that pytest reads its settings from, in the command's folder and above; a suite's conftest.py is in hil/.
_SETTINGS = ("pytest.toml", ".pytest.toml", "pytest.ini", ".pytest.ini", "pyproject.toml", "tox.ini", "setup.cfg")
# Variables that a run reads: its settings, pytest's options, and the commit of a job.
_FILES = tuple(option.variable for option in OPTIONS if option.name in ("rig", "firmware", "calibration"))
_READ = frozenset({"PYTEST_ADDOPTS", "GITHUB_SHA", "GITHUB_REF_NAME", *(option.variable for option in OPTIONS)})


@dataclass(frozen=True, slots=True)
class SentBench:
    """Everything that a run of the suites depends on, except its seed and hiltest."""

    files: bytes
    """Zip archive; names are relative to the root of the file system."""
    folder: str
    """Folder of the command."""
    options: tuple[str, ...]
    """Options of pytest."""
    environment: dict[str, str]
    """Variables that a run reads."""
    covers: bool = False
    """True if the run writes its coverage into its folder."""


@dataclass(frozen=True, slots=True)
class RemoteResult:
    """A run that has finished on another machine."""

    exit_code: int
    last_line: str
    """Last line of its output."""
    files: dict[str, bytes]
    """Files in its folder."""

    def write(self, folder: Path) -> None:
        """Write the files into a local folder; the record is last, so that its presence implies the others.

        Raises
        ------
        OSError
            If a file cannot be written.
        ConfigError
            If a name leads elsewhere; nothing is written then.
        """
        remedy = "the worker is not to be trusted: look at its machine"
        paths = {name: path_below(folder, name, remedy=remedy) for name in sorted(self.files, key=RUN_FILE.__eq__)}
        folder.mkdir(parents=True, exist_ok=True)
        for name, path in paths.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(self.files[name])


def sent_bench(
    options: Sequence[str], environment: Mapping[str, str] = os.environ, *, covers: bool = False
) -> SentBench:
    """Return the bench of this folder, ready to be sent.

    Parameters
    ----------
    options
        Options of pytest.
    covers
        True if the run writes its coverage, as in `SentBench`.

    Raises
    ------
    ConfigError
        If a file cannot be read, or the files are too large together.
    """
    folder = Path.cwd()
    read = _variables(environment)
    files = io.BytesIO()
    total = 0
    with zipfile.ZipFile(files, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in _files_of_bench(folder, options, read):
            try:
                total += path.stat().st_size
                if total > LARGEST_BYTES:
                    raise ConfigError(
                        f"{path}: with this file the workers would receive more than {LARGEST_BYTES >> 20} MiB: keep "
                        f"only files that the runs need in {folder / 'hil'}"
                    )
                archive.writestr(str(path.relative_to("/")), path.read_bytes())
            except (OSError, UnicodeError) as error:
                raise ConfigError(f"cannot send {path} to the workers: {error}") from error
    return SentBench(files.getvalue(), str(folder), tuple(options), read, covers)


def digest_of_bench(options: Sequence[str]) -> str:
    """Return a digest of everything that a run in this folder depends on, except firmware that no option names.

    Raises
    ------
    ConfigError
        If a file cannot be read.
    """
    folder = Path.cwd()
    read = _variables(os.environ)
    digest = hashlib.sha256(repr((__version__, str(folder), list(options), sorted(read.items()))).encode())
    for path in _files_of_bench(folder, options, read):
        try:
            content = path.read_bytes()
        except OSError as error:
            raise ConfigError(f"cannot read {path}: {error.strerror or error}") from error
        digest.update(repr((str(path), hashlib.sha256(content).hexdigest())).encode())
    return digest.hexdigest()


def _variables(environment: Mapping[str, str]) -> dict[str, str]:
    return {name: value for name, value in environment.items() if name in _READ}


def _files_of_bench(folder: Path, options: Sequence[str], read: Mapping[str, str]) -> list[Path]:
    texts = (*options, *(read.get(name, "") for name in _FILES))
    named = [path for text in texts if (path := _named_path(text, folder)) is not None]
    return sorted(set(_existing_files(folder, [*named, *_rig_files(folder, options, read)])))


def _named_path(text: str, folder: Path) -> Path | None:
    """Return the file or folder that an option, a variable or an argument of pytest names, if any."""
    name = _value(text).partition("::")[0]
    with suppress(OSError, ValueError):  # too long for a name, or with a NUL
        path = Path(os.path.normpath(folder / name))
        if name and path.exists() and path != folder and path not in folder.parents:
            return path
    return None


def _value(option: str) -> str:
    return option.partition("=")[2] if option.startswith("-") else option


def _rig_files(folder: Path, options: Sequence[str], environment: Mapping[str, str]) -> Iterator[Path]:
    """Yield the existing files that the rig names; errors are left to the run to report."""
    flag = "--hil-rig="
    named = [option.removeprefix(flag) for option in options if option.startswith(flag)] or [
        environment.get("HIL_RIG", "")
    ]
    with suppress(ConfigError, OSError):
        rig = load_rig(rig_file(folder, named[-1] or None))
        playback = rig.world.playback if rig.world else None
        recordings = map(str, rig.motion_recordings().values())
        for name in (rig.board.firmware, rig.board.timing, playback and playback.file, *recordings):
            if name and (path := Path(os.path.normpath(rig.path.parent / name))).is_file():
                yield path


def _existing_files(start: Path, named: Iterable[Path]) -> Iterator[Path]:
    settings = (folder / name for folder in (start, *start.parents) for name in _SETTINGS)
    for path in (start / "hil", start / "conftest.py", *settings, *named):
        if path.is_file():
            yield path
        elif path.is_dir():
            yield from (child for child in path.rglob("*") if child.is_file() and "__pycache__" not in child.parts)


def run_there(bench: SentBench, seed: int) -> RemoteResult:
    """Run one seed on this machine, in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="hiltest-") as folder:
        root = os.path.realpath(folder)
        with zipfile.ZipFile(io.BytesIO(bench.files)) as archive:
            for name in archive.namelist():
                path_below(Path(root), name, remedy="rename the file of the bench that is sent")
            archive.extractall(root)
        cwd = Path(root + bench.folder)
        cwd.mkdir(parents=True, exist_ok=True)
        out = Path(root) / "record"
        mine = {name: value for name, value in os.environ.items() if name not in _READ}
        done = run_command(
            f"--seed={seed}",
            f"--out={out}",
            *coverage_in(out, covers=bench.covers),
            "--",
            *(_relocate(option, root) for option in bench.options),
            folder=out,
            cwd=cwd,
            environment={**mine, **{name: _relocate(value, root) for name, value in bench.environment.items()}},
        )
        files = {
            str(path.relative_to(out)): path.read_bytes().replace(root.encode(), b"")
            for path in out.rglob("*")
            if path.is_file()
        }
        return RemoteResult(done.returncode, last_words(done.stderr or done.stdout).replace(root, ""), files)


def _relocate(text: str, root: str) -> str:
    """Return an option, argument or variable with the new position of an absolute path that was sent."""
    value = _value(text)
    if not value.startswith("/") or not os.path.exists(root + value.partition("::")[0]):
        return text
    return text.removesuffix(value) + root + value
