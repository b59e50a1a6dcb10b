"""Bench of one pytest session: rig, board, measurements, and the fault that ended it.

Every pytest run on the machine imports this module, so that slow imports are made by the functions
that need them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from hiltest.run_record.outcomes import TestOutcome
from hiltest.session.gate import SessionGate
from hiltest.session.record_folder import RecordFolder, folder_beside_complete, folder_remark
from hiltest.session.results import FOUND, GATING, TestFindings, properties_of
from hiltest.session.selection import (
    Choice,
    id_in_record,
    is_repeated,
    only_looks,
    only_shows_cycles,
    uses_board,
    uses_hiltest,
    uses_rig,
)
from hiltest.session.settings import RUN_COMMAND, Settings, check_environment
from hiltest.text import id_without_repetition

if TYPE_CHECKING:
    from hiltest.boards import Board, OnChip
    from hiltest.errors import BenchError, ProtocolError
    from hiltest.measurement import Limit, Measurement
    from hiltest.procedures.imu_calibration.calibration_file import CalibrationFile
    from hiltest.rig import Rig
    from hiltest.run_record.recorder import Recorder
    from hiltest.session.bench_page import BenchPage
    from hiltest.session.by_hand import ByHand
    from hiltest.session.progress_line import ProgressLine
    from hiltest.session.session_tape import Replay
    from hiltest.session.wire_traces import WireTraces
    from hiltest.tape.tape import Tape
    from hiltest.virtual.coverage.lcov import Coverage
    from hiltest.virtual.coverage.source_map import SourceMap

_BENCHMARKS = "benchmarks"

SESSION: pytest.StashKey[HilSession] = pytest.StashKey()


class HilSession:
    """Opens the rig and the board once, and keeps the fault if that fails.

    Attributes
    ----------
    trouble : Exception or None
        Reason why the board is no longer usable.
    crash : str
        That reason, if it is the firmware's fault on the virtual board, which every run of the build repeats.
    trouble_reported : bool
        True if a test has already been charged with it; later ones are skipped.
    trouble_met_by : str
        Node id of that test.
    is_required : bool
        True if the bench is needed even if no test uses it.
    calibration : CalibrationFile or None
        Calibration of ``--hil-calibration``.
    choice : Choice
        Tests that the user asked for.
    gate : SessionGate
        Base of the run.
    folder : RecordFolder
        Folder of the record.
    coverage : Coverage or None
        Coverage of the firmware, available after `end`, if it was requested.
    replay : Replay or None
        Recording that the run is replayed from.
    divergence : str
        Difference between the run and the recorded one, available after `end`; empty without one.
    page : BenchPage or None
        Page with the operator's questions.
    """

    def __init__(self, config: pytest.Config, settings: Settings) -> None:
        self.config = config
        self.replay: Replay | None = None
        self.divergence = ""
        self.page: BenchPage | None = None
        self.on_chip: OnChip | None = None  # facts about firmware that was flashed
        self._tape: Tape | None = None
        if settings.replay is not None:
            settings = self._begin_replay(settings, settings.replay)
        self.settings = settings
        self.trouble: BenchError | ProtocolError | None = None
        self.crash = ""
        self.trouble_reported = False
        self.trouble_met_by = ""
        self.calibration: CalibrationFile | None = None
        self.measured_by: dict[str, str] = {}
        self._rig: Rig | None = None
        self._board: Board | None = None
        self._opened_s = 0.0
        self.is_required = False
        self._needs_rig = False
        self._traces: WireTraces | None = None
        self.choice = Choice(config)
        self.gate = SessionGate(settings.baseline, settings.sources["baseline"])
        self.folder = RecordFolder(settings.out)
        self.coverage: Coverage | None = None
        self._source: SourceMap | None = None
        self._remarks: list[str] = []
        self._errors: list[tuple[BaseException, str]] = []  # errors of fixtures, and the test that each failed first

    def _begin_replay(self, settings: Settings, path: Path) -> Settings:
        """Open the recording; return the settings of the recorded run."""
        from hiltest.errors import ConfigError
        from hiltest.session.session_tape import open_replay

        try:
            self.replay = open_replay(path)
            self._tape = self.replay.player
            return self.replay.settings(settings)
        except ConfigError as error:
            raise pytest.UsageError(str(error)) from error

    @property
    def tape(self) -> Tape:
        """The tape, which all questions of the run to its bench pass through."""
        if self._tape is None:
            from hiltest.session.session_tape import open_record
            from hiltest.tape.tape import LIVE

            record = self.settings.record
            self._tape = (
                LIVE
                if record is None
                else open_record(record, self.settings, self.rig, holds_limits=self.must_meet_every_limit)
            )
        return self._tape

    @property
    def is_worker(self) -> bool:
        """True in a worker of pytest-xdist, which writes no files."""
        return hasattr(self.config, "workerinput")

    @property
    def hands_out(self) -> bool:
        """True in the process that distributes tests to workers, which opens no board."""
        option = self.config.option
        return not self.is_worker and getattr(option, "dist", "no") != "no" and bool(getattr(option, "tx", None))

    def begin(self, items: Sequence[pytest.Item]) -> bool:
        """Load the rig and open the board, if a test will need them; a worker opens the board later.

        Returns
        -------
        bool
            True if there is something to record, and this process is responsible for the record.

        Raises
        ------
        pytest.UsageError
            If the rig, the firmware or an option is wrong; no file has been changed then.
        """
        if only_looks(self.config) or not (self.is_required or any(map(uses_hiltest, items))):
            return False
        self._needs_rig |= any(map(uses_rig, items))
        ours = list(filter(uses_hiltest, items))
        if not self.is_required:  # hiltest run knows its folder before it opens the bench
            self._choose_folder(ours)
        self.open(with_board=any(map(uses_board, items)))
        return not self.is_worker

    def _choose_folder(self, items: Sequence[pytest.Item]) -> None:
        """Separate the records of benchmarks and of some of the tests from a complete one."""
        out = self.settings.out
        if items and all(map(only_shows_cycles, items)):
            self.choice.only_benchmarks = True
            self.folder = RecordFolder(out / _BENCHMARKS)
        elif self.choice.chose_our_tests:
            self._record_in(folder_beside_complete(out))
        elif not self.must_meet_every_limit:
            self._record_in(folder_beside_complete(out, [self.test_id(item.nodeid) for item in items]))

    def _record_in(self, folder: Path) -> None:
        if folder != self.folder.path:
            self.folder = RecordFolder(folder)
            self._remarks = [folder_remark(self.settings.out, folder)]

    def open(self, *, with_board: bool) -> None:
        """Load the rig, if one is needed, and, `with_board`, open the board; `trouble` tells if it is lost.

        From now on there is something to record, even if no test needs it.

        Raises
        ------
        pytest.UsageError
            If the rig, the firmware or an option is wrong, or no record can be written.
        """
        from hiltest.errors import BenchError, ConfigError, ProtocolError
        from hiltest.procedures.imu_calibration.calibration_file import load_calibration
        from hiltest.session.wire_traces import remove_traces

        self.is_required = True
        try:
            check_environment()
            self._check_tape()
            # Reading the rig is the check for its mistakes.
            self._needs_rig |= with_board
            _ = self.rig_if_needed
            if self.settings.calibration is not None and self.calibration is None:
                self.calibration = load_calibration(self.settings.calibration)
            self.gate.read()
            if not self.is_worker:
                # The claim comes before anything is written to the folder, including the trace of the first bytes.
                self.claim_folder()
                remove_traces(self.folder.path)
                if self.settings.coverage is not None:
                    from hiltest.virtual.coverage.lcov import refuse_file

                    refuse_file(self.settings.coverage)
            if with_board and not self.is_worker:
                # The first test that needs a lost board is charged with it.
                with suppress(BenchError, ProtocolError):
                    self._connect_here()
        except ConfigError as error:
            raise pytest.UsageError(str(error)) from error

    def _check_tape(self) -> None:
        """Refuse to record or replay a run that would differ the second time."""
        from hiltest.errors import ConfigError

        settings = self.settings
        option = settings.sources["record" if settings.record is not None else "replay"]
        if settings.record is None and settings.replay is None:
            return
        if self.is_worker or self.hands_out:
            raise ConfigError(f"{option} needs a single process: leave out -n and --dist")
        if settings.coverage is not None:
            raise ConfigError(f"{option}: a recording has no coverage: leave out {settings.sources['coverage']}")

    def claim_folder(self) -> Recorder:
        """Return the recorder of this session, which now owns its folder exclusively.

        Raises
        ------
        ConfigError
            If another run uses the folder, or it cannot be written to.
        """
        return self.folder.claim(self.settings, self.rig_if_needed)

    @property
    def rig(self) -> Rig:
        """The rig, read once."""
        if self._rig is None:
            from hiltest.rig.bench_files import rig_file
            from hiltest.rig.rig_file import load_rig

            start, named = self.config.invocation_params.dir, self.settings.rig
            if self.replay is not None:
                self._rig = self.replay.rig(None if named is None else rig_file(start, named))
            else:
                self._rig = load_rig(rig_file(start, named, port=self.settings.port))
            self._rig.refuse_playback("a run")
        return self._rig

    @property
    def rig_if_needed(self) -> Rig | None:
        """The rig, or None: tests that only measure need no rig, unless the user asked for one."""
        return self.rig if self._needs_rig or self._rig_is_requested or self._rig is not None else None

    @property
    def must_meet_every_limit(self) -> bool:
        """True if a limit of the rig without a measurement fails the run.

        It does not under plain pytest with the packaged rig, whose limits belong to the packaged suites.
        """
        if self.replay is not None:
            return self.replay.run.holds_limits
        return self._rig_is_requested or self.config.pluginmanager.has_plugin(RUN_COMMAND)

    @property
    def _rig_is_requested(self) -> bool:
        """True if an option names the rig, or the bench has a default rig of its own."""
        from hiltest.rig.bench_files import has_own_rig

        return self.settings.rig is not None or has_own_rig(self.config.invocation_params.dir)

    def connect(self) -> Board:
        """Return the board, opened: its firmware has answered, or reported something.

        Raises
        ------
        BenchError, ProtocolError
            The first error of this session: it does not try a lost board again.
        """
        if self.trouble is not None:
            raise self.trouble
        if self._board is None:
            from hiltest.boards import open_board
            from hiltest.errors import BenchError, ProtocolError
            from hiltest.procedures.imu_calibration.owner import refuse_another_board
            from hiltest.session.wire_traces import WireTraces

            self._opened_s = time.monotonic()
            self._traces = WireTraces(self.folder.path)
            try:
                opened = open_board(
                    self.rig,
                    firmware=self.settings.firmware,
                    port=self.settings.port,
                    seed=self.settings.seed,
                    transcript=self._traces.transcript,
                    base=self.settings.base,
                    watches_execution=self.settings.coverage is not None,
                    tape=self.tape,
                    on_chip=self.on_chip,
                )
                self._board = opened
                if opened.execution is not None:
                    from hiltest.virtual.coverage.source_map import SourceMap

                    self._source = SourceMap(opened.execution.image)
                if self.calibration is not None:
                    refuse_another_board(self.calibration, opened, self.rig)
            except (BenchError, ProtocolError) as error:
                self._lose_board(error)
                self.keep_trace("the first words to the board", "set-up", error)
                raise
        return self._board

    @cached_property
    def hand_journal(self) -> ByHand | None:
        """The operator's steps, kept for the continuation of the run; None without an operator or a journal."""
        if self.is_worker or not self._answering_board() or self.rig.turntable.kind != "operator":
            return None
        if self.settings.record or self.settings.replay:  # a recording needs every answer from the first question on
            return None
        from hiltest.procedures.tumble import poor_coverage
        from hiltest.rig.rig import conditions_sha256
        from hiltest.session.by_hand import ByHand

        assert self._board is not None
        identity = self._board.identity
        calibration = self.calibration.sha256 if self.calibration else ""
        return ByHand(
            self.claim_folder(),
            {
                "firmware": f"{identity.name} {identity.version} {identity.build_id}",
                "board": identity.unique_id.hex(),
                "rig": conditions_sha256(self.rig),
                "choice of poses": str(self.settings.poses or self.rig.procedure.poses),
                "calibration file": calibration,
                "set of tests": self.settings.suite,
            },
            lambda tumble: poor_coverage(tumble, self.rig),
        )

    def _connect_here(self) -> None:
        """Open the board; if a worker will do so, only check it before an older firmware runs for minutes."""
        if not self.hands_out:
            self.connect()
        elif self.gate.runs_older:
            self.connect().close()
            self._board = None

    def restart_wall_clock(self) -> None:
        """Exclude the time before the first test from the board's wall time."""
        self._opened_s = time.monotonic()

    @property
    def board(self) -> Board | None:
        """The board, if it is open."""
        return self._board

    @property
    def seed(self) -> int:
        """Seed of the simulated world: the command line's, or else the rig's."""
        return self.rig.seed if self.settings.seed is None else self.settings.seed

    def blame(self, error: BaseException, nodeid: str) -> TestOutcome | None:
        """Return the outcome of a test that bench or firmware failed; None if the test failed by itself.

        A lost board is remembered, so that later tests can be skipped. Faults of sensors are the bench's, except on a
        virtual board, whose sensors are sound: there the firmware causes them.
        """
        from hiltest.errors import BenchError, DeviceError, ProtocolError, SensorFaultError, board_is_gone

        if isinstance(error, SensorFaultError) or (isinstance(error, DeviceError) and error.is_of_sensors):
            board = self._answering_board()
            return None if board and board.sensors_are_sound else TestOutcome.CONNECTION_LOST
        if not isinstance(error, BenchError | ProtocolError):
            return None
        if board_is_gone(error):
            if self.trouble is None:
                self._lose_board(error)
            self.trouble_met_by = self.trouble_met_by or nodeid
            self.trouble_reported = True
        return TestOutcome.CONNECTION_LOST if isinstance(error, BenchError) else TestOutcome.WRONG_FIRMWARE

    def _lose_board(self, error: BenchError | ProtocolError) -> None:
        """Note why the board is no longer usable, and whether every run of the build repeats it."""
        from hiltest.errors import BoardFault, BoardResetError, DeviceTimeoutError, SyncError, remove_registers

        self.trouble = error
        port = self.settings.port or self.rig.board.port
        is_simulated = self.rig.board.kind == "virtual" and (not port or port.startswith("hil:")) and not self.replay
        is_of_firmware = isinstance(error, BoardFault | BoardResetError | DeviceTimeoutError | SyncError)
        if is_simulated and self.rig.faults is None and is_of_firmware:
            self.crash = remove_registers(str(error)).rstrip(".")

    def failed_first(self, error: BaseException, nodeid: str) -> str:
        """Return the test that an error failed first, since a shared fixture fails each test that requests it."""
        for earlier, first in self._errors:
            if earlier is error:
                return first
        self._errors.append((error, nodeid))
        return nodeid

    def begin_test(self, nodeid: str) -> None:
        """Drop the bytes on the line from before the test that begins, and note its id."""
        if self._traces is not None:
            self._traces.begin()
        if self._tape is not None:
            self._tape.begin_test(self.test_id(nodeid))

    def flush_tape(self) -> None:
        """Write the recording of this run to the disk."""
        if self._tape is not None:
            self._tape.flush()

    @contextmanager
    def refusing_reset(self) -> Iterator[None]:
        """Wrap a test: if the board was reset meanwhile, report the reset as its result."""
        from hiltest.errors import BenchError, ProtocolError

        try:
            yield
        except (BenchError, ProtocolError, KeyboardInterrupt, SystemExit, pytest.exit.Exception):
            raise
        except BaseException:
            self._refuse_reset()
            raise
        self._refuse_reset()

    def _refuse_reset(self) -> None:
        if self.trouble is None and (board := self._answering_board()):
            board.session.refuse_reset()

    def _answering_board(self) -> Board | None:
        """Return the board if it is open and answers requests."""
        return self._board if self._board is not None and self._board.answers_requests else None

    def keep_trace(self, test: str, phase: str, error: BaseException) -> str:
        """Write the bytes on the line during a failed test; return the file, or an empty text."""
        if self._traces is None:
            return ""
        about = self._board.description if self._board else f"rig {self.rig.name}"
        return self._traces.keep(test, phase, error, about=about)

    def test_id(self, nodeid: str) -> str:
        """Return the id of a test for the record; for a suite it does not depend on pytest's starting folder."""
        return id_in_record(nodeid, self.config.rootpath)

    def check(
        self,
        name: str,
        value: float | int | None,
        *,
        unit: str,
        limit: Limit | None = None,
        uncertainty: float | None = None,
        **more: Any,
    ) -> Measurement:
        """Make a measurement and check it against the rig's limit, or else against `limit`.

        Parameters
        ----------
        name, value, unit, limit, uncertainty, **more
            Arguments of `hiltest.measurement.check`; the uncertainty is that of the rig's reference by default.

        Raises
        ------
        ValueError
            If the unit differs from that of the rig's limit.
        """
        from hiltest.measurement import check

        rig = self.rig_if_needed
        if rig is None:
            # Without a rig the kind of the board is unknown, and with it the values that it cannot offer.
            return check(name, value, unit=unit, limit=limit, could_offer=True, uncertainty=uncertainty, **more)
        unit_of_limit = rig.units.get(name, unit)
        if unit != unit_of_limit:
            raise ValueError(
                f"{name} is measured in {unit!r}, but its limit in {rig.path} has the unit {unit_of_limit!r}"
            )
        kind = self._board.origin if self._board else rig.board.kind
        return check(
            name,
            value,
            unit=unit,
            limit=rig.limits.get(name) or limit,
            information=rig.information.get(name),
            could_offer=kind == "virtual",
            uncertainty=rig.guard_band_deg(name) if uncertainty is None else uncertainty,
            **more,
        )

    def keep(self, item: pytest.Item, measurement: Measurement) -> None:
        """Add a measurement of a running test.

        Raises
        ------
        ValueError
            If another test has already measured something of this name; a repetition of a test is no other test.
        BoardResetError
            If the board was reset, since the measurement may belong to a board that has lost its state.
        """
        self._refuse_reset()
        test = id_without_repetition(item.nodeid) if is_repeated(item) else item.nodeid
        owner = self.measured_by.setdefault(measurement.name, test)
        if owner != test:
            raise ValueError(f"{measurement.name} was already measured by {owner}; names are unique in a run")
        item.stash.setdefault(FOUND, TestFindings()).measurements.append(measurement)
        if measurement.gates:
            item.stash.setdefault(GATING, []).append(measurement)
        item.user_properties.extend(properties_of(measurement))
        item.ihook.pytest_hil_measurement(item=item, measurement=measurement)

    def end(self) -> list[Measurement]:
        """Close the board and return the measurements of the whole session."""
        seconds, memory_use = self._end_tape()
        if self._board is None:
            return []
        self._board.close()
        if self._source is not None and self._board.execution is not None:
            self.coverage = self._source.coverage(self._board.execution.code())
        return [
            *(
                self.check(
                    f"firmware.{name}",
                    None if isinstance(used, str) else used,
                    unit="B",
                    not_offered=used if isinstance(used, str) else "",
                )
                for name, used in memory_use.items()
            ),
            self.check("board.virtual_seconds", seconds, unit="s"),
            self.check("board.wall_seconds", time.monotonic() - self._opened_s, unit="s", volatile=True),
        ]

    def _end_tape(self) -> tuple[float | None, Mapping[str, int | str]]:
        """Ask the board's last questions: its running time, and the memory use of its firmware."""
        from hiltest.errors import DivergenceError

        if self._tape is None:
            return None, {}
        seconds: float | None = None
        memory_use: Mapping[str, int | str] = {}
        try:
            self._tape.begin_test("the end of the run")
            if self._board is not None:
                seconds, memory_use = self._board.virtual_seconds, self._board.memory_use()
            self.divergence = self._tape.end()
        except DivergenceError as error:
            self.divergence = str(error)
        return seconds, memory_use

    @cached_property
    def progress(self) -> ProgressLine:
        """Progress display of long work."""
        from hiltest.session.progress_line import progress_of

        return progress_of(self.config) if self.page is None else progress_of(self.config, self.page.progress)

    def clear_progress(self) -> None:
        """Clear the progress line before pytest writes there."""
        if "progress" in vars(self):
            self.progress.clear()

    def describe(self) -> list[str]:
        """Return the header lines: the board, the conditions of its numbers, and the base of the comparison."""
        base = [*self.gate.describe(), *self._remarks]
        if (self.trouble or self._board) and self.rig.faults is not None:
            base = [f"injected faults: {self.rig.faults}", *base]
        if self.trouble is not None:
            return [f"hiltest: {self.trouble}", f"rig {self._rig_line()}", *base]
        if self._board is None:
            return base
        board = self._board
        return [
            f"{board.description}; {board.firmware_line}",
            f"rig {self._rig_line()}; cycles by {board.cycle_model} at {board.core_clock_hz / 1e6:g} MHz",
            *([self.hand_journal.remark] if self.hand_journal and self.hand_journal.remark else []),
            *base,
        ]

    def _rig_line(self) -> str:
        return f"{self.rig.name} ({self.settings.sources['rig']})"
