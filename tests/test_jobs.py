"""Work that a dask scheduler's workers do: nothing is lost, counted twice or different from what is done here."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from textwrap import dedent, indent
from typing import Any
from zipfile import ZipFile

import pytest
from tests.command_files import run

from hiltest.campaigns import sent_bench as sent_bench_module
from hiltest.campaigns.sent_bench import sent_bench
from hiltest.errors import ConfigError, SchedulerError
from hiltest.run_record.files import RUN_FILE
from hiltest.run_record.reader import read_record
from hiltest.studies import jobs
from hiltest.studies.study import Plan
from hiltest.studies.study_run import BLOCKS_FILE, run_study

ENOUGH_S = 120.0  # for what takes seconds where nothing else runs
PLAN = Plan("ellipsoids", 3, 60, 20)
BLOCKS = 20
FIRMWARE = Path(__file__).parents[1] / "src" / "hiltest" / "firmware" / "hiltest-frdm-k64f.elf"
RIG = Path(__file__).parents[1] / "hil" / "rigs" / "virtual-k64f.toml"


class Cluster:
    """A scheduler and workers of one thread each, as a user starts them: a process each."""

    def __init__(self, folder: Path, **settings: str) -> None:
        self._folder = folder
        self._file = folder / "scheduler.json"
        self._settings = settings
        self.workers: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._started(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(self._file)
        )
        wait_until(self._file.exists)
        self.address: str = json.loads(self._file.read_text(encoding="utf-8"))["address"]

    def _started(self, *words: str) -> subprocess.Popen[bytes]:
        with (self._folder / "log.txt").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *words],
                stdout=log,
                stderr=log,
                cwd=self._folder,
                env={**os.environ, **self._settings},
            )

    def has(self, count: int) -> None:
        """See to it that there are so many workers."""
        self.workers = [worker for worker in self.workers if worker.poll() is None]
        for worker in self.workers[count:]:
            worker.kill()
            worker.wait(ENOUGH_S)
        for _ in range(count - len(self.workers)):
            self.workers.append(
                self._started(
                    "worker", self.address, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1"
                )
            )
        wait_until(lambda: len(self.asked(lambda client: client.nthreads())) == count)

    def asked(self, question: Callable[[Any], Any]) -> Any:
        """Return what the scheduler answers another client."""
        from distributed import Client

        with Client(self.address, timeout=ENOUGH_S, set_as_default=False) as client:
            return question(client)

    def tasks(self) -> int:
        """Return how many tasks the scheduler has."""
        return int(self.asked(lambda client: client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))))

    def kill_one_with_work(self) -> None:
        """Kill the worker that has most pieces, begun, waiting, or done and not yet taken from it."""
        result = self.asked(
            lambda client: client.run(
                lambda dask_worker: (
                    sum(key.startswith("measure_block") for key in dask_worker.state.tasks),
                    os.getpid(),
                )
            )
        )
        pieces, process = max(result.values())
        assert pieces > 0
        os.kill(process, signal.SIGKILL)

    def end(self) -> None:
        """End all of them."""
        for worker in (*self.workers, self.scheduler):
            worker.kill()
            worker.wait(ENOUGH_S)


def wait_until(condition: Callable[[], bool]) -> None:
    until_s = time.monotonic() + ENOUGH_S
    while not condition():
        assert time.monotonic() < until_s
        time.sleep(0.05)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory, require_module: Callable[[str], None]) -> Iterator[Cluster]:
    """A scheduler that tests share; each says how many workers it needs."""
    require_module("distributed")
    shared = Cluster(tmp_path_factory.mktemp("cluster"))
    yield shared
    shared.end()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What must be the same in every record of the plan: a study done in this process."""
    folder = tmp_path_factory.mktemp("whole")
    run_study(PLAN, folder, jobs=1, progress=lambda *_: None)
    return content(folder)


def content(folder: Path) -> dict[str, Any]:
    record: dict[str, Any] = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    return {key: record[key] for key in ("verdict", "seed", "measurements", "tables")}


def blocks_kept(folder: Path) -> list[int]:
    lines = [json.loads(line) for line in (folder / BLOCKS_FILE).read_text(encoding="utf-8").splitlines()]
    return [line["number"] for line in lines if line["kind"] == "block"]


@pytest.mark.parametrize(
    "text",
    [
        "0",
        "1001",
        "-1",
        "1.5",
        "",
        "two",
        "٣",
        "9" * 5000,
        "127.0.0.1:8786",
        "http://127.0.0.1:8786",
        "tcp://host",
        "tcp://:8786",
        "tcp://host:0",
        "tcp://host:65536",
        "tcp://host:8786/",
        "tcp://user@host:8786",
        "tcp://ho st:1",
        "tcp://host:8786\n",
    ],
)
def test_what_is_neither_a_number_of_processes_nor_an_address_is_4(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("study", "ellipsoids", "--jobs", text, "--out", str(tmp_path)) == 4
    assert "such as tcp://127.0.0.1:8786" in " ".join(capsys.readouterr().err.split())
    assert not list(tmp_path.iterdir())


def test_jobs_without_several_seeds_are_4(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("run", "--jobs", "2", "--out", str(tmp_path / "out")) == 4
    assert "add --seeds A..B" in capsys.readouterr().err


def test_without_the_extra_an_address_is_4_and_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert run("study", "ellipsoids", "--jobs", "tcp://127.0.0.1:8786", "--out", str(tmp_path)) == 4
    assert "pip install 'hiltest[dask]'" in capsys.readouterr().err


@pytest.mark.slow
def test_an_address_where_nobody_answers_is_20(
    tmp_path: Path,
    require_module: Callable[[str], None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    require_module("distributed")
    monkeypatch.setattr(jobs, "ANSWER_S", 0.5)
    with socket.socket() as unheard:
        unheard.bind(("127.0.0.1", 0))  # and does not listen
        address = f"tcp://127.0.0.1:{unheard.getsockname()[1]}"
        assert run("study", "ellipsoids", "--jobs", address, "--out", str(tmp_path)) == 20
    assert f"{address}: no scheduler answers" in capsys.readouterr().err


@pytest.mark.slow
class TestCluster:
    """A scheduler with workers that come and go."""

    def test_without_workers_a_study_waits_no_longer_than_it_says(
        self, cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        cluster.has(0)
        monkeypatch.setattr(jobs, "NO_WORKER_S", 1.5)
        with pytest.raises(
            SchedulerError, match=r"no worker for 1.5 s. Start workers with dask worker tcp://.*are saved"
        ):
            run_study(PLAN, tmp_path, jobs=cluster.address, progress=lambda *_: None)
        wait_until(lambda: cluster.tasks() == 0)

    def test_the_numbers_of_a_study_are_those_of_one_process(
        self, cluster: Cluster, tmp_path: Path, whole: dict[str, Any]
    ) -> None:
        cluster.has(2)
        run_study(PLAN, tmp_path, jobs=cluster.address, progress=lambda *_: None)
        assert content(tmp_path) == whole
        wait_until(lambda: cluster.tasks() == 0)

    def test_what_was_asked_to_end_takes_back_what_it_sent_and_goes_on(
        self, cluster: Cluster, tmp_path: Path, whole: dict[str, Any]
    ) -> None:
        cluster.has(2)
        shown: list[int] = []
        with pytest.raises(KeyboardInterrupt):
            run_study(
                PLAN,
                tmp_path,
                jobs=cluster.address,
                progress=lambda _what, done, _of: shown.append(done),
                asked_to_end=lambda: len(shown) > 5,
            )
        stored = blocks_kept(tmp_path)
        assert 5 <= len(stored) < BLOCKS
        wait_until(lambda: cluster.tasks() == 0)
        run_study(PLAN, tmp_path, jobs=cluster.address, progress=lambda _what, done, of: shown.append(of))
        assert shown[-1] == 60 * (BLOCKS - len(stored))
        assert content(tmp_path) == whole

    def test_a_study_loses_and_doubles_nothing_when_a_worker_is_killed(
        self, cluster: Cluster, tmp_path: Path, whole: dict[str, Any]
    ) -> None:
        at_the_end: list[int] = []

        def progress(_what: str, done: int, of: int) -> None:
            if done == 3 * PLAN.instances:
                cluster.kill_one_with_work()
            if done == of:
                at_the_end.extend(blocks_kept(tmp_path))

        cluster.has(2)
        run_study(PLAN, tmp_path, jobs=cluster.address, progress=progress)
        wait_until(lambda: sum(worker.poll() is None for worker in cluster.workers) == 1)
        assert sorted(at_the_end) == list(range(BLOCKS))
        assert content(tmp_path) == whole

    def test_a_worker_with_another_hiltest_is_4_and_named(
        self, cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        cluster.has(1)
        monkeypatch.setattr(jobs, "__version__", "99.1")
        with pytest.raises(
            ConfigError, match=r"the worker tcp://.* has hiltest .*, but this machine has 99.1: install"
        ):
            run_study(PLAN, tmp_path, jobs=cluster.address, progress=lambda *_: None)
        assert blocks_kept(tmp_path) == []

    def test_seeds_lose_and_double_nothing_when_a_worker_is_killed(
        self, cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
    ) -> None:
        """The run of seed 2 waits, the first time, until its worker has been killed over it."""
        begun = tmp_path / "begun"
        bench(
            tmp_path,
            f"""
            begun = Path({str(begun)!r})
            if hil_settings.seed == 2 and not begun.exists():
                begun.with_suffix(".new").write_text(f"{{os.getppid()}} {{os.getpid()}}")
                begun.with_suffix(".new").replace(begun)
                time.sleep({ENOUGH_S})
        """,
        )
        monkeypatch.chdir(tmp_path)
        words = ["--seeds", "1..2", "--rig", str(tmp_path / "hil/rigs/mine.toml"), "--may-fail", "1", "--out"]
        cluster.has(2)
        command = [sys.executable, "-m", "hiltest", "run", *words, "out", "--jobs", cluster.address]
        by_workers = subprocess.Popen(command)
        try:
            wait_until(begun.exists)
            worker, process = map(int, begun.read_text(encoding="utf-8").split())
            assert worker in {worker.pid for worker in cluster.workers}
            os.kill(worker, signal.SIGKILL)
            os.kill(process, signal.SIGKILL)
            assert by_workers.wait(ENOUGH_S) == 0, capfd.readouterr()
        finally:
            by_workers.kill()
        assert run("run", *words, "here", "--jobs", "2") == 0
        for name in ("seeds.json", "seeds.md"):
            assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
        files = [
            {str(path.relative_to(tmp_path / name)) for path in (tmp_path / name).rglob("*")}
            for name in ("out", "here")
        ]
        assert files[0] == files[1] > {f"seed-000{seed}/{RUN_FILE}" for seed in (1, 2)}
        for seed in (1, 2):
            target, place = (read_record(tmp_path / name / f"seed-000{seed}").run for name in ("out", "here"))
            assert (target.seed, target.rig, target.board) == (seed, place.rig, place.board)
        wait_until(lambda: cluster.tasks() == 0)

    def test_what_is_done_is_kept_when_workers_die_over_a_seed_and_when_the_scheduler_is_lost(
        self,
        tmp_path: Path,
        require_module: Callable[[str], None],
        monkeypatch: pytest.MonkeyPatch,
        capfd: pytest.CaptureFixture[str],
    ) -> None:
        require_module("distributed")
        strict = Cluster(tmp_path, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0")
        done = tmp_path / "out" / "seed-0001" / RUN_FILE
        bench(
            tmp_path,
            f"""
            if hil_settings.seed == 2:
                while not Path({str(done)!r}).exists():
                    time.sleep(0.05)
                os.kill(os.getppid(), 9)
        """,
        )
        monkeypatch.chdir(tmp_path)
        study = tmp_path / "study"
        study.mkdir()
        try:
            strict.has(2)
            words = ["--seeds", "1..2", "--rig", "hil/rigs/mine.toml", "--out", "out", "--jobs", strict.address]
            assert run("run", *words) == 20
            output = capfd.readouterr()
            assert "1 of 2 seeds finished; records in out/seed-0001" in output.out
            assert "workers died while computing the same piece" in output.err
            with pytest.raises(SchedulerError, match=r"the connection was lost .*repeat the command to continue"):
                run_study(
                    PLAN,
                    study,
                    jobs=strict.address,
                    progress=lambda _what, done, _of: strict.scheduler.kill() if done == 3 * PLAN.instances else None,
                )
        finally:
            strict.end()
        stored = blocks_kept(study)
        assert len(set(stored)) == len(stored)
        assert 3 <= len(stored) < BLOCKS


class TestSentBench:
    """What goes to the workers."""

    @pytest.fixture(autouse=True)
    def path(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        """A bench beside files that are none of its own, in the folder of the command."""
        (folder := tmp_path / "mine").mkdir()
        bench(folder, "pass")
        for name in ("large.bin", "given.elf", "hil-out/report.html", "hil/__pycache__/own.pyc", "../above.elf"):
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(b"x")
        monkeypatch.chdir(folder)
        return folder

    def test_it_has_what_the_bench_is_made_of_and_what_options_variables_and_the_rig_name(self, path: Path) -> None:
        rig = path / "hil" / "rigs" / "mine.toml"
        text = rig.read_text(encoding="utf-8").replace("[world]", '[world]\nmotion_recordings = ["../../build/*.npz"]')
        rig.write_text(text, encoding="utf-8")
        (path / "build" / "trial.npz").touch()
        options = ["--hil-firmware=given.elf", "--hil-rig=mine", "-q", "hil/suites/test_mine.py::test_mine"]
        environment = {"HIL_FIRMWARE": "../above.elf", "HIL_OUT": "hil-out", "HOME": str(path.parent)}
        sent = sent_bench(options, environment)
        with ZipFile(BytesIO(sent.files)) as archive:
            names = {
                str(Path("/", item).relative_to(path.parent))
                for item in archive.namelist()
                if Path("/", item).is_relative_to(path.parent)
            }
        assert names == {
            "mine/hil/rigs/mine.toml",
            "mine/hil/suites/own.py",
            "mine/hil/suites/test_mine.py",
            "mine/pytest.ini",
            "mine/build/mine.elf",
            "mine/build/trial.npz",
            "mine/given.elf",
            "above.elf",
        }
        assert (sent.folder, sent.options) == (str(path), tuple(options))
        assert sent.environment == {"HIL_FIRMWARE": "../above.elf", "HIL_OUT": "hil-out"}

    def test_what_is_too_large_is_refused_by_its_name(self, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sent_bench_module, "LARGEST_BYTES", 1 << 20)
        with (path / "hil" / "recording.bin").open("wb") as file:
            file.truncate((1 << 20) + 1)
        with pytest.raises(
            ConfigError, match=r"hil/recording.bin: with this file the workers would receive more than 1 MiB"
        ):
            sent_bench([], {})


SUITE = """
import os, time
from pathlib import Path

from hiltest.measurement import Limit
from own import LARGEST

def test_mine(measure, board, rig, hil_settings):
    assert rig.path.is_relative_to(Path.cwd())
    {body}
    measure("mine.seed", board.seed, "", limit=Limit(max=LARGEST))
"""


def bench(folder: Path, body: str) -> None:
    """Write a bench whose seed 2 misses a limit; its rig names a firmware outside of hil/."""
    text = RIG.read_text(encoding="utf-8").partition("[limits]")[0]
    for name in ("rigs", "suites"):
        (folder / "hil" / name).mkdir(parents=True)
    (folder / "build").mkdir()
    (folder / "build" / "mine.elf").write_bytes(FIRMWARE.read_bytes())
    (folder / "hil" / "rigs" / "mine.toml").write_text(
        text.replace("[board]", '[board]\nfirmware = "../../build/mine.elf"'), encoding="utf-8"
    )
    (folder / "hil" / "suites" / "own.py").write_text("LARGEST = 1\n", encoding="utf-8")
    (folder / "pytest.ini").write_text("[pytest]\npythonpath = hil/suites\n", encoding="utf-8")
    lines = indent(dedent(body).strip(), " " * 4).lstrip()
    (folder / "hil" / "suites" / "test_mine.py").write_text(SUITE.format(body=lines))
