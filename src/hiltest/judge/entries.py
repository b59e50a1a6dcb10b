"""Entries from what a user names: a source, a library, a Python function or class, or an image for a Cortex-M4."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hiltest.budgets import SOURCE
from hiltest.errors import ConfigError
from hiltest.json_files import read_bounded
from hiltest.judge.answers import Answer, Entry
from hiltest.judge.build import build_image, build_library, is_source
from hiltest.judge.filters import HEADING, INIT, QUATERNION, UPDATE, HostFilter, ImageFilter, JudgedFilter
from hiltest.judge.foreign_entries import ForeignCalibrator, ForeignFilter
from hiltest.judge.host_calibrator import HostCalibrator
from hiltest.judge.image_calibrator import CALIBRATE, CALIBRATE_PAIRS, ImageCalibrator
from hiltest.judge.signature_table import ReadTable
from hiltest.judge.worlds import RIG, World

_PYTHON = re.compile(r"(?P<file>.+\.py):(?P<function>[A-Za-z_]\w*)")
_ELF_MAGIC, _ARM = b"\x7fELF", 40
_OTHERWISE = "name a source, a library or an ELF"


class SourceCalibrator:
    """A calibrator from a source: answers and cycles of the emulated core, time of the host."""

    def __init__(self, image: ImageCalibrator, host: HostCalibrator) -> None:
        self.name, self.built_by, self.flash_bytes = image.name, image.built_by, image.flash_bytes
        self._image, self._host = image, host

    @property
    def cycle_model(self) -> str:
        return self._image.cycle_model

    def answer(self, world: World) -> Answer:
        """Calibrate from the samples of a world."""
        answer = self._image.answer(world)
        if world.family != RIG:
            return answer
        return replace(answer, host_us=self._host.answer(world).host_us)


@contextmanager
def open_entry(named: str, function: str | None, part: str | None = None) -> Iterator[Entry]:
    """Open an entry.

    Parameters
    ----------
    named
        A source (``.c``, ``.cc``, ``.cpp``, ``.cxx``), a shared library, ``module.py:function``, or an ELF for a
        Cortex-M4.
    function
        Function of a file; by default that of the contract.
    part
        Part of an image, or for which a source is compiled.

    Raises
    ------
    ConfigError
        If the file is none of these, cannot be compiled or loaded, or has no such function.
    """
    with ExitStack() as stack:
        if python := _PYTHON.fullmatch(named):
            file, name = Path(python["file"]), python["function"]
            pairs = _python_takes_pairs(file, name)
            yield stack.enter_context(HostCalibrator(named, file, name, takes_pairs=pairs))
            return
        file = Path(named)
        content = read_bounded(file, SOURCE, otherwise=_OTHERWISE)
        if file.suffix == ".py":
            raise ConfigError(f"{named}: name its function, too: {named}:calibrate")
        if is_source(file):
            yield _open_source(stack, file, content, function, part)
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
    stack: ExitStack, file: Path, content: bytes, function: str | None, part: str | None
) -> SourceCalibrator:
    name = function or _contract_in(content)
    if name.encode() not in content:
        raise ConfigError(f"{file}: no function {name}; define it as hiltest_judge.h says, or name another: --function")
    folder = Path(stack.enter_context(TemporaryDirectory(prefix="hiltest-judge-")))
    build = build_image(file, [name], folder, part=part)
    image = ImageCalibrator(str(file), build.file, name, built_by=build.built_by, part=part)
    library = build_library(file, folder)
    host = HostCalibrator(str(file), library.file, name, takes_pairs=image.takes_pairs)
    return SourceCalibrator(image, stack.enter_context(host))


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
    if python := _PYTHON.fullmatch(named):
        return _python_definition(Path(python["file"]), python["function"], ast.ClassDef) is not None
    if function is not None:
        return False
    content = read_bounded(Path(named), SOURCE, otherwise=_OTHERWISE)
    return UPDATE.encode() in content and CALIBRATE.encode() not in content


@contextmanager
def open_filter(named: str) -> Iterator[JudgedFilter]:
    """Open a filter; the errors are those of `open_entry`."""
    with ExitStack() as stack:
        if python := _PYTHON.fullmatch(named):
            yield stack.enter_context(HostFilter(named, Path(python["file"]), python["function"]))
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
