"""What all tests share."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import pytest
from hypothesis import settings

from . import totals
from .debian_packages import packaged_file

if TYPE_CHECKING:
    from .finished_run import Finished

pytest_plugins = ["pytester"]

# A shell ignores Ctrl-C for what it starts in the background, and every process that is started from there inherits
# that, those too which tests end with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)
# nohup ignores the hang-up likewise. A handler that does nothing keeps this process as safe, and is not inherited.
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGHUP, lambda *_: None)

# How long an example takes is the machine's affair, which may be busy.
settings.register_profile("hiltest", deadline=None)
settings.load_profile("hiltest")

# Runs that tests make have no part in the job that runs the tests, nor its check an annotation of them; nor are they in
# a worker of pytest-xdist, where pytest-benchmark measures nothing.
for name in (
    "GITHUB_STEP_SUMMARY",
    "GITHUB_ACTIONS",
    "GITHUB_SHA",
    "GITHUB_REF_NAME",
    "PYTEST_XDIST_WORKER",
    "PYTEST_XDIST_WORKER_COUNT",
):
    os.environ.pop(name, None)


HERE = Path(__file__).parent
_FOLDERS_OF_RUNS = {HERE / text for text in ("docs", "end_to_end", "report/browser", "serve")}
# Whole runs, examples of pages, every option of every command, or minutes at a terminal: what tests of single parts
# have shown, once more and at length.
_ONLY_IN_CI = {
    HERE / f"{text}.py"
    for text in (
        "boards/test_calibrate_at_a_terminal",
        "boards/test_operator_at_a_terminal",
        "boards/test_timing_measure",
        "calibration/test_direction_error",
        "docs/test_against_gravity_page",
        "docs/test_benchmarks_page",
        "docs/test_calibrate_page",
        "docs/test_ci_page",
        "docs/test_compare_page",
        "docs/test_fit_imu_page",
        "docs/test_fit_page",
        "docs/test_fusion_page",
        "docs/test_gate_page",
        "docs/test_gyroscope_page",
        "docs/test_serve_page",
        "docs/test_timing_page",
        "docs/test_trend_page",
        "end_to_end/test_against",
        "end_to_end/test_agent",
        "end_to_end/test_calibration_file",
        "end_to_end/test_device_benchmarks",
        "end_to_end/test_dishonest_firmware",
        "end_to_end/test_field_recording",
        "end_to_end/test_harsh_bench",
        "end_to_end/test_killed_run",
        "end_to_end/test_nxp_fusion",
        "end_to_end/test_red_when_wrong",
        "end_to_end/test_regressions",
        "end_to_end/test_untrimmed_accelerometer",
        "end_to_end/test_wrong_compass",
        "end_to_end/test_wrong_firmware",
        "firmware/test_calibrators_of_ones_own",
        "mutation/test_mutations",
        "run_record/test_killed_at_every_step",
        "campaigns/test_advice_for_a_campaign",
        "campaigns/test_bisect",
        "campaigns/test_campaign",
        "campaigns/test_campaign_summary",
        "serve/test_clients",
        "serve/test_ending",
        "serve/test_main_job",
        "serve/test_start",
        "test_json_documents",
        "test_read_files",
        "test_written_files",
        "virtual/test_foreign_programs",
    )
}
_FIXTURES_THAT_RUN = {"default_run", "pytester"}
_PART = "HILTEST_CI_PART"
# Files of which CI runs another share: their tests are short.
_SHARES = {HERE / "museum/test_museum.py": 3}


def pytest_configure(config: pytest.Config) -> None:
    """Register the plugin that prints totals."""
    config.pluginmanager.register(totals)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what makes a run, or looks at a page in a browser; single tests elsewhere bear the mark themselves.

    Of those that only CI runs, leave those out that are not of the part that the environment asks for, as ``2/4``.
    """
    if moved := [str(path) for path in sorted(_ONLY_IN_CI) if not path.exists()]:
        raise pytest.UsageError(f"tests/conftest.py: _ONLY_IN_CI names files that do not exist: {', '.join(moved)}")
    for item in items:
        if _FIXTURES_THAT_RUN.intersection(item.fixturenames) or _FOLDERS_OF_RUNS.intersection(item.path.parents):
            item.add_marker("slow")
        if item.path in _ONLY_IN_CI and item.get_closest_marker("slow"):
            item.add_marker("ci")
        if item.get_closest_marker("ci"):
            item.add_marker("slow")
    if asked := os.environ.get(_PART):
        part, parts = map(int, asked.split("/"))
        long: dict[int, list[pytest.Item]] = {}
        for item in items:
            if item.get_closest_marker("ci"):
                long.setdefault(_SHARES.get(item.path, parts), []).append(item)
        others = {
            item
            for share, group in long.items()
            for index, item in enumerate(group)
            if index % share != (part - 1) % share
        }
        items[:] = [item for item in items if item not in others]
        config.hook.pytest_deselected(items=[*others])


_running: list[pytest.Item] = []


def _no_run_without_the_mark(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "subprocess.Popen" and _running and not _running[0].get_closest_marker("slow"):
        command = [str(item) for item in arguments[1]] if isinstance(arguments[1], list | tuple) else []
        if command[1:3] in (["-m", "hiltest"], ["-m", "pytest"]):
            raise RuntimeError(f"a test that starts {' '.join(command[1:3])} is marked slow")


sys.addaudithook(_no_run_without_the_mark)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Know which test runs, so that none without the mark starts a run."""
    _running[:] = [item]
    try:
        return (yield)
    finally:
        _running.clear()


@pytest.fixture(scope="session")
def shared_folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the workers of pytest-xdist have together."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if hasattr(request.config, "workerinput") else own


@pytest.fixture(scope="session")
def default_run(shared_folder: Path) -> Finished:
    """``hiltest run`` on the default bench: made once, and only to be read."""
    # Here: `pytest-benchmark compare`, started in this checkout, loads this file too, and as part of no package.
    from .finished_run import run_once

    return run_once(shared_folder / "default-run")


@pytest.fixture(scope="session")
def real_record(default_run: Finished) -> dict[str, Any]:
    """``run.json`` of the main job on the default bench."""
    assert default_run.code == 0, default_run.output + default_run.errors
    return default_run.record


@pytest.fixture(scope="session", autouse=True)
def _runs_without_hypothesis() -> None:
    """Leave Hypothesis out of runs that tests make: its plugin imports it at the end of each, a third of a small one.

    Not sooner, or the workers of pytest-xdist would be without it too.
    """
    arguments = os.environ.get("PYTEST_ADDOPTS", "")
    os.environ["PYTEST_ADDOPTS"] = f"{arguments} -p no:hypothesispytest".strip()


@pytest.fixture(scope="session", autouse=True)
def _every_record_is_valid(tmp_path_factory: pytest.TempPathFactory, shared_folder: Path) -> Iterator[None]:
    """Check every run.json that the tests' runs have left, with the shipped schema and by reading it.

    Tests that write such a file by hand, to see it refused, call it otherwise.
    """
    yield
    folders = {tmp_path_factory.getbasetemp(), shared_folder / "default-run"}
    records = sorted({record for folder in folders for record in folder.rglob("run.json")})
    if not records:
        return
    from jsonschema import Draft202012Validator
    from tests.command_files import json_schema

    from hiltest.run_record.reader import read_record

    validator = Draft202012Validator(json_schema("hiltest.run/1"))
    for path in records:
        content = json.loads(path.read_text(encoding="utf-8"))
        assert [f"{path}: {error.json_path}: {error.message}" for error in validator.iter_errors(content)] == []
        read_record(path)


@pytest.fixture(scope="session")
def require_tool() -> Callable[[str], str]:
    """Return a function that finds a program, and skips the test when it is missing.

    With HILTEST_REQUIRE_TOOLS set, as where every tool is meant to be installed, it fails instead.
    """

    def find(name: str) -> str:
        path = shutil.which(name)
        if path is None:
            _missing(f"{name} is not installed")
        return path

    return find


@pytest.fixture(scope="session")
def require_module() -> Callable[[str], None]:
    """Return a function that skips the test when a package cannot be imported, or fails as `require_tool` does."""

    def check(name: str) -> None:
        if find_spec(name) is None:
            _missing(f"the package {name} is not installed")

    return check


@pytest.fixture(scope="session")
def micropython_hex(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> Path:
    """Return MicroPython for the BBC micro:bit, from Debian's package."""
    package, file = "firmware-microbit-micropython", "usr/share/firmware-microbit-micropython/firmware.hex"
    return packaged_file(package, file, tmp_path_factory.mktemp("micropython"), require_tool)


def _missing(reason: str) -> NoReturn:
    if os.environ.get("HILTEST_REQUIRE_TOOLS"):
        pytest.fail(f"{reason}, and HILTEST_REQUIRE_TOOLS is set", pytrace=False)
    pytest.skip(reason)


@pytest.fixture
def own_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An installed package with calibrators: `tests.own_package`."""
    from hiltest.calibration.own import own_calibrator

    from .own_package import install

    folder = tmp_path / "site-packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(install(folder))
    own_calibrator.cache_clear()
    yield
    own_calibrator.cache_clear()
