"""One pytest session's bench: rig, board, what was measured, and whether the bench still stands.

Imported at the start of every pytest run on the machine, so everything that takes time
to import is imported by the function that needs it.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from hiltest.gate_set import LeftOut
from hiltest.settings import Settings, make_folder

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from hiltest.boards import Board
    from hiltest.errors import BenchError, ProtocolError
    from hiltest.imu_calibration.file import CalibrationFile
    from hiltest.measurement import Limit, Measurement
    from hiltest.report.record import Table
    from hiltest.report.recorder import Recorder
    from hiltest.rig import Rig
    from hiltest.wire_traces import WireTraces

BENCH_LOST = "bench lost"
WRONG_FIRMWARE = "wrong firmware"

# Attributes of a report, plain data, so that they survive the way from a worker.
CAUSE = "hil_cause"
"""Whose fault a failure is, when it is not the test's own."""
REASON = "hil_reason"
"""What the bench or the firmware did, in one line."""
TRACE = "hil_trace"
"""The wire trace of a failed test, relative to the run's folder."""
FOUND_HERE = "hil_found"
"""Measurements and tables, as `pack` made them."""
BENCH = "hil_bench"
"""From a worker: whether there is a rig, and which board with which seed."""

GROUP = "hil"
"""What pytest-xdist calls the tests that it keeps together."""

_BOARD_FIXTURES = frozenset({"board", "turntable"})
_FIXTURES = _BOARD_FIXTURES | {"measure", "rig"}
_FIXTURE_MODULES = frozenset({"hiltest.fixtures", "hiltest.cycle_benchmarks"})
# pytest's options that leave tests out.
_CHOICES = ("keyword", "markexpr", "deselect", "ignore", "ignore_glob", "lf", "stepwise")
# Folders of suites: a bench's own, and the packaged ones.
_SUITES = (("hil", "suites"), ("bench", "suites"))


@dataclass(slots=True)
class Found:
    """What one test measured since its last report."""

    measurements: list[Measurement] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)


SESSION: pytest.StashKey[HilSession] = pytest.StashKey()
FOUND: pytest.StashKey[Found] = pytest.StashKey()
FOUND_AT_ITS_END: pytest.StashKey[Found] = pytest.StashKey()
"""What the report of a tear-down took of it."""
GATING: pytest.StashKey[list[Measurement]] = pytest.StashKey()


def uses_board(item: pytest.Item) -> bool:
    """Say whether a test needs a board: by the marker ``hil`` or by a fixture."""
    return item.get_closest_marker("hil") is not None or bool(_BOARD_FIXTURES & _fixtures_of(item))


def uses_hiltest(item: pytest.Item) -> bool:
    """Say whether a test has anything to do with hiltest."""
    return uses_board(item) or bool(_FIXTURES & _fixtures_of(item))


def uses_rig(item: pytest.Item) -> bool:
    """Say whether a test needs a rig; one that only measures does not."""
    return uses_board(item) or "rig" in _fixtures_of(item)


def is_benchmark(item: pytest.Item) -> bool:
    """Say whether a test shows device cycles in pytest-benchmark, by hiltest's fixture and not another project's."""
    return "benchmark_cycles" in _fixtures_of(item)


class HilSession:
    """Opens the rig and the board once, and remembers what came of it.

    Attributes
    ----------
    trouble : Exception or None
        Why the board cannot be used any more.
    trouble_reported : bool
        Whether a test has already been charged with it; later ones are skipped.
    trouble_met_by : str
        Node id of that test.
    asked_for : bool
        Whether the bench is needed even if no test uses it.
    calibration : CalibrationFile or None
        What ``--hil-calibration`` named.
    left_out : LeftOut
        Tests of the full set.
    only_benchmarks : bool
        Whether pytest was asked for benchmarks of device cycles and for no other test of ours.
    """

    def __init__(self, config: pytest.Config, settings: Settings) -> None:
        self.config = config
        self.settings = settings
        self.trouble: BenchError | ProtocolError | None = None
        self.trouble_reported = False
        self.trouble_met_by = ""
        self.calibration: CalibrationFile | None = None
        self.measured_by: dict[str, str] = {}
        self._rig: Rig | None = None
        self._board: Board | None = None
        self._opened_s = 0.0
        self.asked_for = False
        self._needs_rig = False
        self.only_benchmarks = False
        self._traces: WireTraces | None = None
        self._recorder: Recorder | None = None
        self._made_folder = False
        self.left_out = LeftOut()

    @property
    def is_worker(self) -> bool:
        """True in a worker of pytest-xdist, which writes no files."""
        return hasattr(self.config, "workerinput")

    @property
    def hands_out(self) -> bool:
        """True in the process that hands tests out to workers, which opens no board."""
        option = self.config.option
        return not self.is_worker and getattr(option, "dist", "no") != "no" and bool(getattr(option, "tx", None))

    def begin(self, items: Sequence[pytest.Item]) -> bool:
        """Load the rig and open the board, if any test will need them; a worker opens it for the first that does.

        Returns
        -------
        bool
            Whether there is something to record, and this process is the one to do it.

        Raises
        ------
        pytest.UsageError
            If the rig, the firmware or an option is wrong; no file has been touched then.
        """
        if self.config.option.collectonly or not (self.asked_for or any(map(uses_hiltest, items))):
            return False
        self._needs_rig |= any(map(uses_rig, items))
        ours = list(filter(uses_hiltest, items))
        self.only_benchmarks = not self.asked_for and bool(ours) and all(map(is_benchmark, ours))
        self.open(with_board=any(map(uses_board, items)))
        return not self.is_worker

    def open(self, *, with_board: bool) -> None:
        """Load the rig, if one is needed, and, `with_board`, open the board; one that is lost is kept in `trouble`.

        From here on there is something to record, even if no test needs it.

        Raises
        ------
        pytest.UsageError
            If the rig, the firmware or an option is wrong, or no record can be written.
        """
        from hiltest.errors import BenchError, ConfigError, ProtocolError
        from hiltest.imu_calibration.file import load_calibration
        from hiltest.wire_traces import remove_traces

        self.asked_for = True
        try:
            # Reading the rig is what finds its mistakes.
            self._needs_rig |= with_board
            _ = self.rig_if_needed
            if self.settings.calibration is not None and self.calibration is None:
                self.calibration = load_calibration(self.settings.calibration)
            if not self.is_worker:
                # Before anything is written to the folder, the first words on the line among it.
                self.claim_folder()
                remove_traces(self.settings.out)
            if with_board and not (self.is_worker or self.hands_out):
                # The first test that needs a lost board is charged with it.
                with suppress(BenchError, ProtocolError):
                    self.connect()
        except ConfigError as error:
            raise pytest.UsageError(str(error)) from error

    def claim_folder(self) -> Recorder:
        """Return the recorder, whose folder belongs to this session alone until `release_folder`.

        Raises
        ------
        ConfigError
            If another run has the folder, or it cannot be written to.
        """
        from hiltest.report.journal import Journal
        from hiltest.report.recorder import Recorder

        if self._recorder is None:
            self._made_folder = not self.settings.out.exists()
            make_folder(self.settings.out)
            rig = self.rig_if_needed
            poses = self.settings.poses or (rig.procedure.poses if rig else "all")
            self._recorder = Recorder(Journal(self.settings.out), suite=self.settings.suite, poses=poses)
        return self._recorder

    def release_folder(self) -> None:
        """Give the folder back, when every file of the run is written."""
        if self._recorder is not None:
            self._recorder.release()
        if self._made_folder:
            with suppress(OSError):  # a usage error leaves nothing in it, and a run does
                self.settings.out.rmdir()

    @property
    def rig(self) -> Rig:
        """The rig, read once."""
        if self._rig is None:
            from hiltest.bench_files import rig_file
            from hiltest.rig_file import load_rig

            self._rig = load_rig(rig_file(self.config.invocation_params.dir, self.settings.rig))
        return self._rig

    @property
    def rig_if_needed(self) -> Rig | None:
        """The rig, or None: tests that only measure need none but the one that was asked for.

        Asked for is what an option names, and the default rig of a bench of one's own.
        """
        from hiltest.bench_files import has_own_rig

        asked_for = self.settings.rig is not None or has_own_rig(self.config.invocation_params.dir)
        return self.rig if self._needs_rig or asked_for or self._rig is not None else None

    def connect(self) -> Board:
        """Return the board, opened and identified.

        Raises
        ------
        BenchError, ProtocolError
            The first one that this session met: a lost board is not tried again.
        """
        if self.trouble is not None:
            raise self.trouble
        if self._board is None:
            from hiltest.boards import open_board
            from hiltest.errors import BenchError, ProtocolError
            from hiltest.imu_calibration.owner import refuse_another_board
            from hiltest.wire_traces import WireTraces

            self._opened_s = time.monotonic()
            self._traces = WireTraces(self.settings.out)
            try:
                self._board = open_board(
                    self.rig, firmware=self.settings.firmware, port=self.settings.port, seed=self.settings.seed,
                    transcript=self._traces.transcript,
                )
                if self.calibration is not None:
                    refuse_another_board(self.calibration, self._board, self.rig)
            except (BenchError, ProtocolError) as error:
                self.trouble = error
                self.keep_trace("the first words to the board", "set-up", error)
                raise
        return self._board

    @property
    def board(self) -> Board | None:
        """The board, if it is open."""
        return self._board

    @property
    def seed(self) -> int:
        """Seed of the simulated world: the command line's, or else the rig's."""
        return self.rig.seed if self.settings.seed is None else self.settings.seed

    def blame(self, error: BaseException, nodeid: str) -> str:
        """Return whose fault a failed test is, empty when it is the test's own.

        A lost board is remembered, so that the tests after this one can be skipped.
        """
        from hiltest.errors import BenchError, ProtocolError

        if not isinstance(error, BenchError | ProtocolError):
            return ""
        if board_is_gone(error):
            self.trouble = self.trouble or error
            self.trouble_met_by = self.trouble_met_by or nodeid
            self.trouble_reported = True
        return BENCH_LOST if isinstance(error, BenchError) else WRONG_FIRMWARE

    def begin_trace(self) -> None:
        """Forget what went over the line before the test that begins."""
        if self._traces is not None:
            self._traces.begin()

    def keep_trace(self, test: str, phase: str, error: BaseException) -> str:
        """Write what went over the line during a test that failed; the file, or empty."""
        if self._traces is None:
            return ""
        about = self._board.description if self._board else f"rig {self.rig.name}"
        return self._traces.keep(test, phase, error, about=about)

    @property
    def chose_tests(self) -> bool:
        """Whether the user asked for a part of the tests: by ``-k``, ``-m``, ``--ignore``, files or node ids.

        Benchmarks of device cycles, and no other tests, are a part too: they measure nothing that is judged.
        """
        if self.only_benchmarks:
            return True
        given = vars(self.config.option)
        if any(given.get(name) for name in _CHOICES):
            return True
        named = self.config.args if self.config.args_source is pytest.Config.ArgsSource.ARGS else []
        here = self.config.invocation_params.dir
        return bool(named) and not any("::" not in each and (here / each).is_dir() for each in named)

    def test_id(self, nodeid: str) -> str:
        """Return the id of a test for the record: for a suite it does not depend on where pytest was started."""
        nodeid = nodeid.removesuffix(f"@{GROUP}")
        file, colons, rest = nodeid.partition("::")
        parts = Path(os.path.normpath(self.config.rootpath / file)).parts
        for index in range(len(parts) - 1, 1, -1):
            if parts[index - 2 : index] in _SUITES:
                return "/".join(parts[index:]) + colons + rest
        return nodeid

    def judge(
        self, name: str, value: float | int | None, *, unit: str, limit: Limit | None = None, **more: Any
    ) -> Measurement:
        """Make a measurement and judge it by the rig's limit, or else by `limit`.

        Parameters
        ----------
        name, value, unit, limit, **more
            As `hiltest.measurement.judge` has them.

        Raises
        ------
        ValueError
            If the unit is not the one of the rig's limit.
        """
        from hiltest.measurement import judge

        rig = self.rig_if_needed
        if rig is None:
            # Without a rig nothing says that a board cannot know it.
            return judge(name, value, unit=unit, limit=limit, could_offer=True, **more)
        wanted = rig.units.get(name, unit)
        if unit != wanted:
            raise ValueError(f"{name} is measured in {unit!r}, and its limit in {rig.path} is in {wanted!r}")
        kind = self._board.kind if self._board else rig.board.kind
        return judge(
            name, value, unit=unit, limit=rig.limits.get(name) or limit,
            information=rig.information.get(name), could_offer=kind == "virtual", **more,
        )

    def keep(self, item: pytest.Item, measurement: Measurement) -> None:
        """Take a measurement of a running test.

        Raises
        ------
        ValueError
            If another test has already measured something of this name.
        """
        owner = self.measured_by.setdefault(measurement.name, item.nodeid)
        if owner != item.nodeid:
            raise ValueError(f"{measurement.name} was already measured by {owner}; names are unique in a run")
        item.stash.setdefault(FOUND, Found()).measurements.append(measurement)
        if measurement.gates:
            item.stash.setdefault(GATING, []).append(measurement)
        item.user_properties.extend(_properties(measurement))
        item.ihook.pytest_hil_measurement(item=item, measurement=measurement)

    def end(self) -> list[Measurement]:
        """Close the board and return what only the end of a session can measure."""
        if self._board is None:
            return []
        seconds = self._board.virtual_seconds
        self._board.close()
        return [
            self.judge("board.virtual_seconds", seconds, unit="s"),
            self.judge("board.wall_seconds", time.monotonic() - self._opened_s, unit="s", volatile=True),
        ]

    def describe(self) -> list[str]:
        """Return the two header lines: which board, and what its numbers rest on."""
        if self.trouble is not None:
            return [f"hiltest: {self.trouble}", f"rig: {self._rig_line()}"]
        if self._board is None:
            return []
        board, identity = self._board, self._board.identity
        return [
            f"hiltest: {board.description}; firmware {identity.name} {identity.version} build {identity.build_id}, "
            f"protocol {identity.protocol_version}",
            f"cycle model {board.cycle_model}, {identity.core_clock_hz / 1e6:g} MHz; rig: {self._rig_line()}",
        ]

    def _rig_line(self) -> str:
        return f"{self.rig.name} ({self.rig.path}, {self.settings.sources['rig']})"


def board_is_gone(error: BenchError | ProtocolError) -> bool:
    """Say whether an error leaves a board that later tests cannot use.

    A missing sensor does not, nor does a missing operator or table: what needs none of them still runs.
    """
    from hiltest.errors import OperatorAbsentError, SensorAbsentError, TurntableError

    return not isinstance(error, SensorAbsentError | OperatorAbsentError | TurntableError)


def carry_over(item: pytest.Item) -> None:
    """Take again, at the set-up of another attempt, what the tear-down of the one before measured.

    pytest-rerunfailures before 16 shows nobody the reports that follow a failed one.
    """
    before = item.stash.get(FOUND_AT_ITS_END, None)
    if before is not None:
        item.stash.setdefault(FOUND, Found()).measurements.extend(before.measurements)


def pack(found: Found) -> dict[str, Any]:
    """Return plain data that a report can carry from a worker to the controller: no enum, no number of numpy's."""
    return {
        "measurements": [plain_data(each.rounded()) for each in found.measurements],
        "tables": [plain_data(each.rounded()) for each in found.tables],
    }


def plain_data(record: DataclassInstance) -> dict[str, Any]:
    """Return what `asdict` makes of a part of the record, of JSON's own kinds alone."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(record)))
    return plain


def _fixtures_of(item: pytest.Item) -> set[str]:
    """Return the names of hiltest's own fixtures that a test uses.

    Another project's fixture may be called ``board`` too; its tests are none of our business.
    """
    info = getattr(item, "_fixtureinfo", None)  # pytest has no public way to ask which definition a name resolves to
    if info is None:
        return set()
    used = {name: definitions[-1].func for name, definitions in info.name2fixturedefs.items() if definitions}
    return {name for name, function in used.items() if function.__module__ in _FIXTURE_MODULES}


def _properties(measurement: Measurement) -> list[tuple[str, object]]:
    name = f"hil.{measurement.name}"
    shown = measurement.rounded()
    properties: list[tuple[str, object]] = [
        (name, "" if shown.value is None else shown.value), (f"{name}.unit", shown.unit),
        (f"{name}.outcome", str(shown.outcome)),
    ]
    if shown.limit is not None:
        properties.append((f"{name}.limit", str(shown.limit)))
    if shown.cycle_model:
        properties.append((f"{name}.cycle_model", shown.cycle_model))
    return properties
