"""What all tests share."""

from __future__ import annotations

import json
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import NoReturn

import pytest
from hypothesis import settings

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
for name in ("GITHUB_STEP_SUMMARY", "GITHUB_ACTIONS", "GITHUB_SHA", "GITHUB_REF_NAME",
             "PYTEST_XDIST_WORKER", "PYTEST_XDIST_WORKER_COUNT"):
    os.environ.pop(name, None)


@pytest.fixture(scope="session", autouse=True)
def _every_record_is_valid(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Check every run.json that the tests' runs have left, with the shipped schema and by reading it.

    Tests that write such a file by hand, to see it refused, call it otherwise.
    """
    yield
    records = sorted(tmp_path_factory.getbasetemp().rglob("run.json"))
    if not records:
        return
    from jsonschema import Draft202012Validator

    from hiltest.record.reader import read_record
    from hiltest.record.schema import SCHEMA_FILE

    validator = Draft202012Validator(json.loads(SCHEMA_FILE.read_text(encoding="utf-8")))
    for path in records:
        content = json.loads(path.read_text(encoding="utf-8"))
        assert [f"{path}: {each.json_path}: {each.message}" for each in validator.iter_errors(content)] == []
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


def _missing(reason: str) -> NoReturn:
    if os.environ.get("HILTEST_REQUIRE_TOOLS"):
        pytest.fail(f"{reason}, and HILTEST_REQUIRE_TOOLS is set", pytrace=False)
    pytest.skip(reason)
