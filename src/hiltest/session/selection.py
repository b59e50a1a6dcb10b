"""The choice of tests: all tests, or some that the user has chosen."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import pytest

from hiltest.session.settings import setting

# Options of pytest that leave tests out.
_CHOICES = ("keyword", "markexpr", "deselect", "ignore", "ignore_glob", "lf", "stepwise")
_NOT_COLLECTED = ("ignore", "ignore_glob", "lf")
_CONFTEST = "conftest.py"
# Options with which pytest shows something instead of running tests.
_LOOKS = ("collectonly", "showfixtures", "show_fixtures_per_test", "markers", "cacheshow", "help")


def only_looks(config: pytest.Config) -> bool:
    """Return whether pytest was asked only to show something, such as the collected tests."""
    return any(vars(config.option).get(name) for name in _LOOKS)


class Choice:
    """Choice of tests of a session, which decides which measurements may be missing from its record.

    Attributes
    ----------
    left_out : OmittedTests
        Omitted tests of the full set.
    deselected : bool
        True if tests of hiltest in the set were deselected.
    full_tests_left_out : int
        Number of tests of the full set that do not run in the gate set, whether or not the user's choice has them.
    only_benchmarks : bool
        True if pytest was asked only for benchmarks of device cycles, which measure nothing
        with a limit.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self.left_out = OmittedTests()
        self.deselected = False
        self.full_tests_left_out = 0
        self.only_benchmarks = False

    @property
    def chose_any_tests(self) -> bool:
        """True if the user asked for part of the tests: by ``-k``, ``-m``, ``--ignore``, files or node ids."""
        return self.only_benchmarks or self._has_given(_CHOICES) or self._named_tests

    @property
    def chose_our_tests(self) -> bool:
        """True if tests of hiltest may be missing by the user's choice: ``-m hil`` leaves out only others.

        A test that a conftest deselects is not the user's choice: it counts as missing.
        """
        deselected = self.deselected and self._has_given(_CHOICES)
        return deselected or self.only_benchmarks or self._has_given(_NOT_COLLECTED) or self._named_tests

    def _has_given(self, options: tuple[str, ...]) -> bool:
        options_ = vars(self._config.option)
        return any(options_.get(name) for name in options)

    @property
    def _named_tests(self) -> bool:
        named = self._config.args if self._config.args_source is pytest.Config.ArgsSource.ARGS else []
        start = self._config.invocation_params.dir
        return bool(named) and not any("::" not in argument and (start / argument).is_dir() for argument in named)


MARKER = "full"


class OmittedTests(NamedTuple):
    """Tests of the full set, which this session omits."""

    tests: tuple[str, ...] = ()
    """Node ids."""
    how: str = ""
    """Option that includes them."""

    def describe(self) -> list[str]:
        """Return the remark that follows the collection of tests."""
        if not self.tests:
            return []
        count = f"{len(self.tests)} test{'s' * (len(self.tests) != 1)}"
        return [f"gate set: {count} of the full set left out; {self.how} runs them"]

    def check_that_some_are_left(self, items: Sequence[pytest.Item]) -> None:
        """Check that a choice leaves a test to run.

        Raises
        ------
        pytest.UsageError
            If `items` is empty.
        """
        if self.tests and not items:
            raise pytest.UsageError(f"no test to run in the {self.describe()[0]}")


def leave_out_full(config: pytest.Config, items: list[pytest.Item], candidates: Sequence[pytest.Item]) -> OmittedTests:
    """Deselect the tests of the full set.

    Parameters
    ----------
    items
        All tests that will run; changed in place.
    candidates
        Tests that use hiltest. The same mark in another project's tests has another meaning.

    Returns
    -------
    OmittedTests
        Tests that were deselected.
    """
    full = [item for item in candidates if item.get_closest_marker(MARKER) is not None]
    left_out = OmittedTests(tuple(item.nodeid for item in full), f"{setting('suite').flag_in(config)} full")
    if full:
        config.hook.pytest_deselected(items=full)
        items[:] = [item for item in items if item not in full]
    return left_out


_BOARD_FIXTURES = frozenset({"board", "turntable"})
_FIXTURES = _BOARD_FIXTURES | {"measure", "rig"}
_FIXTURE_MODULES = frozenset({"hiltest.session.fixtures", "hiltest.session.benchmark_hooks"})


def uses_board(item: pytest.Item) -> bool:
    """Return whether a test needs a board: by the marker ``hil`` or by a fixture."""
    return item.get_closest_marker("hil") is not None or bool(_BOARD_FIXTURES & _own_fixtures(item))


def uses_hiltest(item: pytest.Item) -> bool:
    """Return whether a test uses hiltest."""
    return uses_board(item) or bool(_FIXTURES & _own_fixtures(item))


def uses_rig(item: pytest.Item) -> bool:
    """Return whether a test needs a rig; a test that only measures does not."""
    return uses_board(item) or "rig" in _own_fixtures(item)


def is_benchmark(item: pytest.Item) -> bool:
    """Return whether a test shows device cycles in pytest-benchmark, by hiltest's fixture and not another project's."""
    return "benchmark_cycles" in _own_fixtures(item)


def is_repeated(item: pytest.Item) -> bool:
    """Return whether pytest-repeat runs a test several times."""
    return "__pytest_repeat_step_number" in getattr(getattr(item, "callspec", None), "params", ())


def only_shows_cycles(item: pytest.Item) -> bool:
    """Return whether a test shows device cycles and measures nothing that could have a limit."""
    return is_benchmark(item) and "measure" not in _own_fixtures(item)


def _own_fixtures(item: pytest.Item) -> set[str]:
    """Return the names of hiltest's own fixtures that a test uses.

    Another project's fixture may also be called ``board``; its tests do not use hiltest.
    """
    info = getattr(item, "_fixtureinfo", None)  # pytest has no public function that resolves a fixture's name
    if info is None:
        return set()
    used = {name: definitions[-1].func for name, definitions in info.name2fixturedefs.items() if definitions}
    return {name for name, function in used.items() if function.__module__ in _FIXTURE_MODULES}


GROUP = "hil"
"""Mark of pytest-xdist for tests that it keeps together."""

# Folders of suites: those of a bench, and the packaged ones.
_SUITES = (("hil", "suites"), ("bench", "suites"))


def id_in_record(nodeid: str, root: Path) -> str:
    """Return the id of a test for the record; for a suite it does not depend on the folder pytest was started in.

    Parameters
    ----------
    nodeid
        Node id of pytest, with the group that pytest-xdist appends.
    root
        Folder that the file is relative to.
    """
    nodeid = nodeid.removesuffix(f"@{GROUP}")
    file, colons, rest = nodeid.partition("::")
    parts = Path(os.path.normpath(root / file)).parts
    for index in range(len(parts) - 1, 1, -1):
        if parts[index - 2 : index] in _SUITES:
            return "/".join(parts[index:]) + colons + rest
    return nodeid


def suite_digests(files: Iterable[str], root: Path) -> dict[str, str]:
    """Return the SHA-256 of files of tests, and of each conftest.py that pytest reads for them, by name in the record.

    Parameters
    ----------
    files
        Files of node ids, relative to `root`.
    """
    paths = {Path(os.path.normpath(root / file)) for file in files}
    names = {path: id_in_record(os.path.relpath(path, root), root) for path in paths}
    for folder in {folder for path in paths for folder in path.parents}:
        if folder.is_relative_to(root) or any(path.parent == folder for path in paths):
            name = os.path.relpath(folder / _CONFTEST, root)
            short = id_in_record(name, root)
            names[folder / _CONFTEST] = f"./{name}" if short == name else short  # ./ tells it from that of the suites
    return {name: sha256(path.read_bytes()).hexdigest() for path, name in sorted(names.items()) if path.is_file()}


def place_in_record(file: str, line: int, config: pytest.Config) -> str:
    """Return the position of a call relative to the folder pytest was started in: ``hil/suites/test_heading.py:81``.

    For the packaged suites, whose path depends on the machine, it is the name in the record: ``test_heading.py:81``.
    """
    root, start = config.rootpath, config.invocation_params.dir
    stands = start / file
    if stands.is_relative_to(start):
        return f"{stands.relative_to(start).as_posix()}:{line}"
    return f"{os.path.relpath(stands, start) if stands.is_relative_to(root) else id_in_record(file, root)}:{line}"
