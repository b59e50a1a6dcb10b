"""One run of the suites by ``hiltest run``: pytest in this process, and the finished record."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click
import pytest

from hiltest.errors import ConfigError
from hiltest.processes import lacks_resources
from hiltest.rig.bench_files import suites
from hiltest.run_record.exit_codes import ExitCode
from hiltest.run_record.files import OLDER_FOLDER, REPORT_FILE, RUN_FILE
from hiltest.run_record.run import Run
from hiltest.session.bench_session import SESSION
from hiltest.session.older_firmware import OlderFirmware
from hiltest.session.record_folder import folder_beside_complete, folder_remark
from hiltest.session.selection import Choice, only_looks
from hiltest.session.settings import RUN_COMMAND

if TYPE_CHECKING:
    from hiltest.session.bench_page import BenchPage

_JUNIT_FILE = "junit.xml"


class RunCommand:
    """A pytest plugin that opens the bench at once, and receives the finished record.

    Parameters
    ----------
    older
        Older firmware, which runs first on the same bench as the base.
    flashes
        True if the firmware is flashed first.
    page_host
        Address for the page of an operator; None for no page.
    """

    __name__ = RUN_COMMAND

    def __init__(
        self, older: OlderFirmware | None = None, *, flashes: bool = False, page_host: str | None = None
    ) -> None:
        self.run: Run | None = None
        self.folder = Path()
        self._older = older
        self._flashes = flashes
        self._page_host = page_host
        self._page: BenchPage | None = None
        self._remarks: list[str] = []

    # This hook is the first, before any plugin reads its output folder.
    @pytest.hookimpl(tryfirst=True)
    def pytest_cmdline_main(self, config: pytest.Config) -> None:
        """Record chosen tests beside a complete run instead of replacing it."""
        if not config.pluginmanager.has_plugin("hiltest"):
            raise pytest.UsageError("hiltest run needs the pytest plugin hiltest: leave out -p no:hiltest")
        out = Path(config.option.hil_out)
        folder = folder_beside_complete(out) if Choice(config).chose_any_tests and not only_looks(config) else out
        if folder == out:
            return
        config.option.hil_out = str(folder)
        if config.option.xmlpath == str(out / _JUNIT_FILE):
            config.option.xmlpath = str(folder / _JUNIT_FILE)
        if self._older is not None:
            self._older = replace(self._older, folder=folder / OLDER_FOLDER)
        self._remarks = [folder_remark(out, folder)]

    def pytest_report_collectionfinish(self) -> list[str]:
        """Return remarks on the folder of chosen tests, the page, and flashed firmware."""
        return self._remarks

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: Sequence[pytest.Item]) -> None:
        """Refuse a folder or file without tests, which would otherwise be judged by the tests of the suites alone."""
        for argument in config.args[1:]:
            path = config.invocation_params.dir / argument
            if path.exists() and not any(item.path.is_relative_to(path) for item in items):
                kind = "folder" if path.is_dir() else "file"
                raise pytest.UsageError(f"the {kind} {argument} has no tests; leave it out to run only the suites")

    # This hook is the last, so that the hiltest plugin has read its options. A wrong rig or firmware then ends the
    # command before pytest has collected or written anything.
    @pytest.hookimpl(trylast=True)
    def pytest_configure(self, config: pytest.Config) -> None:
        """Open the bench, which this command always needs."""
        hil = config.stash[SESSION]
        self.folder = hil.settings.out
        if self._older is not None:
            try:
                check_against(hil.gate.asked_for, hil.settings.port)
                self._older.check(hil.rig)
            except ConfigError as error:
                raise pytest.UsageError(str(error)) from error
            hil.gate.compare_with(self._older)
        if only_looks(config):
            return
        if self._page_host is not None:
            from hiltest.session.bench_page import BenchPage

            try:
                hil.page = self._page = BenchPage(self._page_host)
            except ConfigError as error:
                raise pytest.UsageError(str(error)) from error
            self._remarks.append(f"page: {self._page.url}")
        if self._flashes:
            from hiltest.session.flashed_board import open_flashed

            self._remarks += open_flashed(hil)
        else:
            hil.open(with_board=True)

    @pytest.hookimpl(tryfirst=True)
    def pytest_internalerror(self, excinfo: pytest.ExceptionInfo[BaseException]) -> None:
        """End the command if a resource is used up, which is no error of pytest."""
        if lacks_resources(excinfo.value):
            pytest.exit(f"cut short: {excinfo.exconly()}", returncode=ExitCode.CUT_SHORT)

    def pytest_hil_finished(self, run: Run) -> None:
        """Store the finished record, and show its verdict."""
        self.run = run
        if self._page is not None:
            self._page.end(run.verdict, self.folder / REPORT_FILE)

    def pytest_unconfigure(self) -> None:
        """Stop serving the page."""
        if self._page is not None:
            self._page.close()


class _CollectionFreezer:
    """Excludes long-lived objects from garbage collection.

    pytest collects ten times at its end, to find errors in finalizers, which took 0.5 s of the whole run.
    """

    @pytest.hookimpl(trylast=True)
    def pytest_collection_finish(self) -> None:
        """Exclude modules and suites."""
        gc.freeze()

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self) -> None:
        """Collect the garbage of the tests, and exclude all other objects."""
        gc.collect()
        gc.freeze()


def run_suites(
    options: Sequence[str],
    out: Path,
    *,
    older: OlderFirmware | None = None,
    flashes: bool = False,
    page_host: str | None = None,
) -> tuple[int, Path | None]:
    """Run pytest on the suites.

    Parameters
    ----------
    options
        Options of pytest.
    out
        Folder of the record.
    older
        Older firmware, the base of the run.
    flashes, page_host
        See `RunCommand`.

    Returns
    -------
    int, Path or None
        Exit code, and the file with the record; None if no record was finished.
    """
    command = RunCommand(older, flashes=flashes, page_host=page_host)
    folder = Path.cwd()
    # Otherwise pytest warns that it came too late to rewrite the assertions of the package that started it.
    no_warning = "ignore:Module already imported:pytest.PytestAssertRewriteWarning"
    # The packaged suites may lie inside another project's tree; the root is the folder of the command nevertheless.
    arguments = [
        str(suites(folder)),
        "-p",
        "hiltest",
        "-p",
        "no:cacheprovider",
        "--import-mode=importlib",
        f"--rootdir={folder}",
        "--tb=short",
        "--no-header",
        "-rN",
        "-W",
        no_warning,
        f"--junit-xml={out / _JUNIT_FILE}",
        f"--hil-out={out}",
        *options,
    ]
    try:
        code = pytest.main(arguments, plugins=[command, _CollectionFreezer()])
    except OSError as error:
        if command.run is None or not lacks_resources(error):
            raise
        click.echo(f"cut short: a file beside the record cannot be written: {error}", err=True)
        code = 0
    if command.run is None:
        return int(code), None
    # A conftest may change pytest's last word, but not the verdict of the record.
    return int(code) or command.run.verdict.exit_code, command.folder / RUN_FILE


def check_against(base: str | None, port: str | None) -> None:
    """Check that no option contradicts ``--against``.

    Raises
    ------
    ConfigError
        If another base or a real board is requested.
    """
    if base:
        raise ConfigError(f"--against and {base}: a run has one base; leave one of them out")
    if port:
        raise ConfigError("--against runs two ELF files on the virtual board: leave out --port")
