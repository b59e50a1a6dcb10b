"""The fixtures ``rig``, ``board``, ``turntable``, ``measure`` and others that suites need."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import hiltest
from hiltest.session.bench_session import SESSION, HilSession
from hiltest.session.operator_prompt import ask
from hiltest.session.results import FOUND, TestFindings
from hiltest.session.selection import place_in_record
from hiltest.session.settings import Settings

if TYPE_CHECKING:
    from hiltest.boards import Board
    from hiltest.measurement import Counted, CycleRange, Limit, Measurement
    from hiltest.procedures import Turntable
    from hiltest.procedures.imu_calibration import ImuCalibration
    from hiltest.rig import Rig
    from hiltest.run_record.run import Cell
    from hiltest.session.benchmark_hooks import BenchmarkCycles
    from hiltest.session.progress_line import ProgressLine
    from hiltest.virtual.profiling.image import ProfiledImage


class Measure:
    """Records measurements of one test; a value out of its limit fails the test at its end.

    A call never raises for a bad value, so that later measurements are still made.
    """

    def __init__(self, item: pytest.Item, session: HilSession) -> None:
        self._item = item
        self._session = session

    def __call__(
        self,
        name: str,
        value: float | int | Counted | None,
        unit: str = "",
        *,
        limit: Limit | None = None,
        not_checked: str = "",
        not_offered: str = "",
        volatile: bool = False,
        cycle_model: str = "",
        band: CycleRange | None = None,
        note: str = "",
        uncertainty: float | None = None,
    ) -> Measurement:
        """Record one measurement.

        Parameters
        ----------
        name
            Name, dotted and unique in the run: ``heading.direct.max``.
        value
            Number; None if this board cannot offer it. On a virtual board, which can offer everything,
            a missing number under a limit ends the run with exit code 22. The cost of a function, as
            ``cycles(elf).call(...)`` returns it, includes unit and cycle model.
        unit
            Unit; equal to that of the rig's limit, if there is one.
        limit
            Limit for a name without a limit in the rig, which takes precedence.
        not_checked
            Reason why a limit cannot be applied; the run then ends with exit code 22.
        not_offered
            Reason why there is no value, if it follows from another result of the run, such as the cost of an iteration
            if none was needed. A comparison then shows the reason, and does not report a missing measurement.
        volatile
            True if two runs of the same seed may differ in it.
        cycle_model
            Cycle model, required for unit ``cycle``.
        band
            Uncertainty range of a virtual board's cycles.
        note
            Description of the measured quantity, if the name does not describe it.
        uncertainty
            Expanded uncertainty of the value, by default that of the angles of a rig that is turned by hand.

        Returns
        -------
        Measurement
            Measurement with its outcome.

        Raises
        ------
        ValueError
            If the unit is not the one of the rig's limit, another test has measured this name, or a
            cycle count comes without its cycle model. Nothing is recorded then.
        """
        from hiltest.measurement import Counted

        if isinstance(value, Counted):
            if unit not in ("", "cycle") or cycle_model:
                raise ValueError(f"{name}: a counted call has its unit and its cycle model: leave both out")
            unit, cycle_model, band = "cycle", value.cycle_model, getattr(value, "band", None)
            value = value.cycles
        caller = sys._getframe(1)
        place = place_in_record(caller.f_code.co_filename, caller.f_lineno, self._session.config)
        measurement = self._session.check(
            name,
            value,
            unit=unit,
            limit=limit,
            not_checked=not_checked,
            not_offered=not_offered,
            volatile=volatile,
            cycle_model=cycle_model,
            band=band,
            note=note,
            uncertainty=uncertainty,
            place=place,
            test=self._session.test_id(self._item.nodeid),
        )
        self._session.keep(self._item, measurement)
        return measurement

    def limit(self, name: str) -> Limit | None:
        """Return the limit that the rig gives a measurement; None without one."""
        rig = self._session.rig_if_needed
        return rig.limits.get(name) if rig else None

    def table(self, name: str, columns: Mapping[str, str], rows: Iterable[Iterable[Cell]]) -> None:
        """Record numbers for a plot.

        Parameters
        ----------
        name
            Name, unique in the run.
        columns
            Column name to unit, in order.
        rows
            One cell per column.

        Raises
        ------
        ValueError
            If the length of a row differs from the number of columns.
        """
        from hiltest.run_record.run import Column, Table

        cells = tuple(tuple(row) for row in rows)
        if any(len(row) != len(columns) for row in cells):
            raise ValueError(f"table {name!r}: every row needs {len(columns)} cells, one per column")
        table = Table(name, tuple(Column(*column) for column in columns.items()), cells)
        self._item.stash.setdefault(FOUND, TestFindings()).tables.append(table)


@pytest.fixture(scope="session")
def hil_settings(request: pytest.FixtureRequest) -> Settings:
    """Settings of the session: seed, poses and the other options."""
    return _session(request).settings


@pytest.fixture(scope="session")
def rig(request: pytest.FixtureRequest) -> Rig:
    """The rig: field, mounting, turntable and limits."""
    return _session(request).rig


@pytest.fixture(scope="session")
def board(request: pytest.FixtureRequest) -> Board:
    """The board: its firmware has answered, or reported something. The same one for the whole session."""
    return _session(request).connect()


@pytest.fixture(scope="session")
def turntable(request: pytest.FixtureRequest, rig: Rig) -> Iterator[Turntable]:
    """The turntable: simulated on a virtual board, an operator or motors on a real one."""
    from hiltest.procedures import limits_out_of_reach, open_table

    session = _session(request)
    shown = {} if session.page is None else {"show_points": session.page.show_points(rig)}
    remark = limits_out_of_reach(rig, rig.procedure.known_angle_poses(session.settings.poses))
    table = open_table(
        session.connect(),
        rig,
        prompt=lambda text: _ask(request.config, text),
        tape=session.tape,
        remark=remark,
        **shown,
    )
    yield table
    table.close()


@pytest.fixture(scope="session")
def hil_calibration(request: pytest.FixtureRequest) -> ImuCalibration | None:
    """The calibration of ``--hil-calibration``, which is this board's; None without the option."""
    file = _session(request).calibration
    return file.calibration if file else None


@pytest.fixture
def measure(request: pytest.FixtureRequest) -> Measure:
    """Record a measurement: ``measure(name, value, unit, limit=Limit(max=2))``."""
    return Measure(request.node, _session(request))


class Cycles:
    """Opens ELFs to count cycles of their functions, without rig and board."""

    def __init__(self, session: HilSession) -> None:
        self._session = session

    def __call__(
        self,
        elf: str | Path | None = None,
        *,
        profile: str | None = None,
        memory: str | None = None,
        part: str | None = None,
        clock_hz: float | None = None,
    ) -> ProfiledImage:
        """Return an ELF on a virtual board of its own.

        Parameters
        ----------
        elf
            Any program for a Cortex-M4, relative to pytest's root folder; by default the firmware
            under test: that of ``--hil-firmware``, or the packaged one.
        profile
            Timing profile; by default ``cortex-m4-trm/3``.
        memory
            Memories of another part, as for `hiltest.cycles`.
        part
            Chip whose memories and timing are used, as for `hiltest.cycles`.
        clock_hz
            Core clock that the functions are called at [Hz], by default the highest one of the part, else 120 MHz.

        Raises
        ------
        ConfigError
            If the ELF cannot be loaded, or the timing profile, the part or the clock does not exist.
        """
        session = self._session
        path = session.settings.firmware if elf is None else session.config.rootpath / elf
        return hiltest.cycles(path, profile=profile, memory=memory, part=part, clock_hz=clock_hz)


@pytest.fixture(scope="session")
def cycles(request: pytest.FixtureRequest) -> Cycles:
    """Count a function's cycles: ``measure("cycles.fn", cycles("app.elf").call("fn", 3), limit=Limit(max=900))``."""
    return Cycles(_session(request))


@pytest.fixture
def benchmark_cycles() -> BenchmarkCycles:
    """Measure a kernel's cycles; if pytest-benchmark is loaded, its table shows them."""
    from hiltest.session.benchmark_hooks import BenchmarkCycles

    return BenchmarkCycles()


@pytest.fixture(scope="session")
def hil_progress(request: pytest.FixtureRequest) -> ProgressLine:
    """Show the progress of long work and the time left: on a terminal's current line, else as occasional lines."""
    return _session(request).progress


def _session(request: pytest.FixtureRequest) -> HilSession:
    return request.config.stash[SESSION]


def _ask(config: pytest.Config, text: str) -> str:
    """Ask the operator on a line of its own, while pytest's capturing, also of the keyboard, is suspended.

    Raises
    ------
    OperatorAbsentError
        If there is no terminal to ask at.
    """
    capture = config.pluginmanager.getplugin("capturemanager")
    if capture is not None:
        capture.suspend(in_=True)
    try:
        config.stash[SESSION].clear_progress()
        if (reporter := config.pluginmanager.getplugin("terminalreporter")) is not None:
            reporter.ensure_newline()
        return ask(text, config.stash[SESSION].page, is_turn=True)
    finally:
        if capture is not None:
            capture.resume()
