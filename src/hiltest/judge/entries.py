"""Entries from what a user names: a source, a library, a Python function or class, or an image for a Cortex-M4."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from multiprocessing.util import Finalize
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import get_ident
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hiltest.budgets import SOURCE
from hiltest.calibration.fit import Array, MagnetometerFit
from hiltest.calibration.own import OwnCalibrator
from hiltest.calibration.quality import COUNTS_PER_UT
from hiltest.errors import ConfigError
from hiltest.json_files import read_bounded
from hiltest.judge.answers import Answer, Cloud
from hiltest.judge.build import build_image, build_library, is_source
from hiltest.judge.filters import HEADING, INIT, QUATERNION, UPDATE, HostFilter, ImageFilter, JudgedFilter
from hiltest.judge.foreign_entries import ForeignCalibrator, ForeignFilter
from hiltest.judge.host_calibrator import HostCalibrator
from hiltest.judge.image_calibrator import CALIBRATE, CALIBRATE_PAIRS, ImageCalibrator
from hiltest.judge.judgement import ranks_with
from hiltest.judge.own_calibrators import OwnCalibrator as PackagedCalibrator
from hiltest.judge.signature_table import ReadTable
from hiltest.judge.worlds import RIG, World

_FUNCTION = re.compile(r"(?P<file>.+):(?P<function>[A-Za-z_]\w*)")
_ELF_MAGIC, _ARM = b"\x7fELF", 40
_OTHERWISE = "name a source, a library or an ELF"
_MOST_POINTS = 1000


class SourceCalibrator:
    """A calibrator from a source: answers and cycles of the emulated core, time of the host."""

    def __init__(self, image: ImageCalibrator, host: HostCalibrator) -> None:
        self.name, self.built_by, self.flash_bytes = image.name, image.built_by, image.flash_bytes
        self.takes_pairs = image.takes_pairs
        self._image, self._host = image, host

    @property
    def cycle_model(self) -> str:
        return self._image.cycle_model

    def answer(self, cloud: Cloud) -> Answer:
        """Calibrate from samples."""
        answer = self._image.answer(cloud)
        if not isinstance(cloud, World) or cloud.family != RIG:
            return answer
        return replace(answer, host_us=self._host.answer(cloud).host_us)


OpenedCalibrator: TypeAlias = SourceCalibrator | ImageCalibrator | HostCalibrator


@contextmanager
def open_entry(named: str, function: str | None = None, part: str | None = None) -> Iterator[OpenedCalibrator]:
    """Open an entry.

    Parameters
    ----------
    named
        A source (``.c``, ``.cc``, ``.cpp``, ``.cxx``), a shared library, a Python file, or an ELF for a Cortex-M4; with
        ``:function`` behind it, which Python needs.
    function
        Function of a file without one; by default that of the contract.
    part
        Part of an image, or for which a source is compiled.

    Raises
    ------
    ConfigError
        If the file is none of these, cannot be compiled or loaded, or has no such function.
    """
    with ExitStack() as stack:
        file = Path(named)
        if match := _FUNCTION.fullmatch(named):
            file, function = Path(match["file"]), match["function"]
        content = read_bounded(file, SOURCE, otherwise=_OTHERWISE)
        if file.suffix == ".py":
            if match is None:
                raise ConfigError(f"{named}: name its function, too: {named}:calibrate")
            pairs = _python_takes_pairs(file, match["function"])
            yield stack.enter_context(HostCalibrator(named, file, match["function"], takes_pairs=pairs))
        elif is_source(file):
            yield _open_source(stack, named, file, content, function, part)
        elif content[:4] != _ELF_MAGIC:
            raise ConfigError(
                f"{named} is neither a source (.c, .cpp), a shared library, module.py:function, nor an ELF for a "
                "Cortex-M4"
            )
        elif int.from_bytes(content[18:20], "little") == _ARM:
            yield ImageCalibrator(named, file, function or CALIBRATE, part=part)
        else:
            name = function or CALIBRATE
            pairs = name == CALIBRATE_PAIRS
            yield stack.enter_context(HostCalibrator(named, file, name, takes_pairs=pairs))


@contextmanager
def open_foreign(named: str, table: ReadTable, part: str | None = None) -> Iterator[Any]:
    """Open the calibrator (`Entry`) or filter (`JudgedFilter`) of a table; the errors are those of `open_entry`."""
    (read, source), file, built_by = table, Path(named), ""
    content = read_bounded(file, SOURCE, otherwise=_OTHERWISE)
    with ExitStack() as stack:
        if is_source(file):
            for name in read.functions:
                if name.encode() not in content:
                    raise ConfigError(f"{source.path}: no function {name} in {file}; correct its call")
            folder = Path(stack.enter_context(TemporaryDirectory(prefix="hiltest-judge-")))
            build = build_image(file, read.functions, folder, part=part)
            file, built_by = build.file, build.built_by
        elif content[:4] == _ELF_MAGIC and int.from_bytes(content[18:20], "little") != _ARM:  # a library of the host
            host: Any = HostFilter if read.is_filter else partial(HostCalibrator, takes_pairs=True)
            yield stack.enter_context(host(named, file, str(source.path.resolve())))
            return
        foreign: Any = ForeignFilter if read.is_filter else partial(ForeignCalibrator, part=part)
        yield foreign(named, file, table, built_by=built_by)


def _open_source(
    stack: ExitStack, named: str, file: Path, content: bytes, function: str | None, part: str | None
) -> SourceCalibrator:
    name = function or _contract_in(content)
    if name.encode() not in content:
        raise ConfigError(f"{file}: no function {name}; define it as hiltest_judge.h says, or name one: {file}:NAME")
    folder = Path(stack.enter_context(TemporaryDirectory(prefix="hiltest-judge-")))
    build = build_image(file, [name], folder, part=part)
    image = ImageCalibrator(named, build.file, name, built_by=build.built_by, part=part)
    library = build_library(file, folder)
    host = HostCalibrator(named, library.file, name, takes_pairs=image.takes_pairs)
    return SourceCalibrator(image, stack.enter_context(host))


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Points of a log or a study, without gravity; see `hiltest.judge.answers.Cloud`."""

    samples_ut: Array
    accelerations_g: Array

    @property
    def where(self) -> str:
        return f"with {len(self.samples_ut)} samples"


@dataclass(frozen=True, slots=True)
class FileCalibrator:
    """A calibrator in a file; see `hiltest.calibration.own.FileCalibrator`.

    Parameters
    ----------
    name
        FILE:FUNCTION, see `open_entry`.
    """

    name: str

    @property
    def most_points(self) -> int | None:
        """Number of points that it takes: on the core that of the worlds of `hiltest judge`; None on the host."""
        return None if isinstance(_opened(self.name), HostCalibrator) else _MOST_POINTS

    def calibrate(self, points_counts: ArrayLike) -> tuple[MagnetometerFit, int | None]:
        """Calibrate from points; the cycles are those of the calibrator if they rank with the packaged ones."""
        entry, counts = _opened(self.name), np.asarray(points_counts, np.float64)
        answer = entry.answer(_Points(counts / COUNTS_PER_UT, np.zeros_like(counts)))
        calibration = None if answer.refused else (answer.hard_iron_ut, answer.soft_iron)
        fit = OwnCalibrator(self.name, lambda _samples_ut: calibration)(counts)
        return fit, answer.cycles if ranks_with(entry, PackagedCalibrator("direct")) else None


def open_calibrators(names: Sequence[str]) -> list[str | FileCalibrator]:
    """Open the calibrators that are files, FILE:FUNCTION, and return the other names as they are.

    Raises
    ------
    ConfigError
        As `open_entry` does; or if a function takes accelerations, or a file's function is not named.
    """
    calibrators: list[str | FileCalibrator] = []
    for name in dict.fromkeys(names):
        if ":" in name and _opened(name).takes_pairs:
            raise ConfigError(f"{name} takes accelerations, too: only hiltest judge calls it")
        if ":" not in name and Path(name).is_file():
            raise ConfigError(f"{name}: name its function, too: {name}:{CALIBRATE}")
        calibrators.append(FileCalibrator(name) if ":" in name else name)
    return calibrators


def _opened(named: str) -> OpenedCalibrator:
    file = Path(named.rpartition(":")[0])
    changed_ns = file.stat().st_mtime_ns if file.is_file() else 0
    return _open_once(named, changed_ns, os.getpid(), get_ident())


@cache
def _open_once(named: str, _changed_ns: int, _process: int, _thread: int) -> OpenedCalibrator:
    """Open a calibrator once per thread, since a fork shares the pipes of its process, until this process ends."""
    stack = ExitStack()
    entry = stack.enter_context(open_entry(named))
    Finalize(None, stack.close, exitpriority=1)
    return entry


def _contract_in(content: bytes) -> str:
    """Return the function of the contract that a source defines."""
    text = content.decode("utf-8", errors="replace")
    return CALIBRATE_PAIRS if re.search(rf"\b{CALIBRATE_PAIRS}\s*\(", text) else CALIBRATE


def _python_takes_pairs(file: Path, name: str) -> bool:
    """Return whether a Python function has two parameters, without importing it."""
    node = _python_definition(file, name, ast.FunctionDef)
    if not isinstance(node, ast.FunctionDef):
        return False
    return len(node.args.posonlyargs) + len(node.args.args) - len(node.args.defaults) > 1


def _python_definition(file: Path, name: str, kind: type[ast.FunctionDef | ast.ClassDef]) -> ast.stmt | None:
    """Return a definition of a Python file; None if it has none of this kind and name."""
    content = read_bounded(file, SOURCE, otherwise="name a Python file")
    try:
        tree = ast.parse(content, str(file))
    except (SyntaxError, ValueError) as error:
        raise ConfigError(f"{file}: {error}") from error
    return next((node for node in tree.body if isinstance(node, kind) and node.name == name), None)


def is_python(named: str) -> bool:
    """Return whether a file is Python, with the name of a function or without."""
    return Path(named).suffix.partition(":")[0] == ".py"


def is_filter(named: str, function: str | None) -> bool:
    """Return whether a file has a filter: a Python class, or the functions of the contract."""
    match = _FUNCTION.fullmatch(named)
    if match and is_python(named):
        return _python_definition(Path(match["file"]), match["function"], ast.ClassDef) is not None
    if match or function is not None:
        return False
    content = read_bounded(Path(named), SOURCE, otherwise=_OTHERWISE)
    return UPDATE.encode() in content and CALIBRATE.encode() not in content


@contextmanager
def open_filter(named: str) -> Iterator[JudgedFilter]:
    """Open a filter; the errors are those of `open_entry`."""
    with ExitStack() as stack:
        match = _FUNCTION.fullmatch(named)
        if match and is_python(named):
            yield stack.enter_context(HostFilter(named, Path(match["file"]), match["function"]))
            return
        file = Path(named)
        content = read_bounded(file, SOURCE, otherwise=_OTHERWISE)
        if is_source(file):
            functions = [name for name in (UPDATE, INIT, QUATERNION, HEADING) if name.encode() in content]
            build = build_image(file, functions, Path(stack.enter_context(TemporaryDirectory(prefix="hiltest-judge-"))))
            yield ImageFilter(named, build.file, built_by=build.built_by)
        elif int.from_bytes(content[18:20], "little") == _ARM:
            yield ImageFilter(named, file)
        else:
            yield stack.enter_context(HostFilter(named, file, UPDATE))
