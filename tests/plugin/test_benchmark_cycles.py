"""The fixture ``benchmark_cycles``: device cycles in tables of pytest-benchmark, which no verdict depends on."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from tests.finished_run import run_module

# As in conftest.py: numpy and what is built on it cannot be imported twice in one process.
import hiltest.virtual.profiling.image  # noqa: F401
from hiltest.boards import default_firmware

HOOKS = "from hiltest.session.compare_cycles import pytest_benchmark_group_stats, pytest_benchmark_scale_unit\n"
MODEL = "cortex-m4-trm/3@sram"
BOTH = """
def test_fit(benchmark_cycles):
    benchmark_cycles("direct", 12_345, cycle_model="cortex-m4-trm/3@sram")

def test_host(benchmark):
    benchmark.pedantic(sum, ([1, 2],), rounds=3)
"""


@pytest.fixture(autouse=True)
def _no_rig(monkeypatch: pytest.MonkeyPatch, _no_settings_from_outside: None) -> None:
    monkeypatch.delenv("HIL_RIG")


def fit(cycles: int | list[int], model: str = MODEL) -> str:
    """A project whose only test shows what a kernel took."""
    return f"def test_fit(benchmark_cycles):\n    benchmark_cycles('direct', {cycles}, cycle_model={model!r})\n"


def saved(pytester: pytest.Pytester, text: str, name: str, *options: str) -> dict[str, Any]:
    """Run a project and return what pytest-benchmark writes of it."""
    pytester.makepyfile(test_it=text)
    result = pytester.runpytest_inprocess(f"--benchmark-json={name}.json", *options)
    assert result.ret == 0
    content: dict[str, Any] = json.loads((pytester.path / f"{name}.json").read_text(encoding="utf-8"))
    return content


def compare(pytester: pytest.Pytester, *arguments: str) -> str:
    """Run ``pytest-benchmark compare`` where the project is."""
    (pytester.path / "conftest.py").write_text(HOOKS, encoding="utf-8")
    done = run_module("pytest_benchmark", "compare", *arguments, folder=pytester.path)
    assert done.returncode == 0, done.stderr
    return done.stdout


def tables(output: str) -> dict[str, list[str]]:
    """Return the lines of each table by its title."""
    results: dict[str, list[str]] = {}
    title = None
    for line in output.splitlines():
        if " benchmark" in line and " tests" in line:
            title = line.strip("- ")
            results[title] = []
        elif title is not None and line.strip("-"):
            results[title].append(" ".join(line.split()))
        elif not line:
            title = None
    return results


def test_cycles_have_a_table_of_their_own_and_host_times_stay_in_seconds(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(BOTH)
    result = pytester.runpytest_inprocess("--benchmark-columns=min,ops,rounds")
    assert result.ret == 0
    found = tables(result.stdout.str())
    header, row = found[f"benchmark 'direct, cycles of {MODEL}': 1 tests"]
    # 120 MHz over 12 345 cycles.
    assert (header, row) == ("Name (time in cycles) Min OPS (Kops/s) Rounds", "test_fit 12,345.0000 9.7205 1")
    header, row = found["benchmark: 1 tests"]
    assert header.startswith(("Name (time in ns)", "Name (time in us)"))
    assert row.startswith("test_host ")
    assert not (pytester.path / ".benchmarks").exists(), "nothing was saved"


def test_the_json_holds_cycles_their_model_the_firmware_and_the_board(pytester: pytest.Pytester) -> None:
    content = saved(
        pytester,
        """
        def test_on_the_board(benchmark_cycles, board):
            benchmark_cycles("x", [7, 9, 8], cycle_model=board.cycle_model)

        def test_called(benchmark_cycles, cycles):
            benchmark_cycles("empty", cycles().call("magnetometer_empty", 0, 0))
    """,
        "both",
    )
    on_the_board, called = content["benchmarks"]
    assert content["machine_info"]["board"] == {
        "kind": "virtual",
        "unique_id": b"virtual-frdmk64f".hex(),
        "core_clock_hz": 120_000_000,
    }
    assert on_the_board["group"] == f"x, cycles of {MODEL}"
    assert on_the_board["stats"]["data"] == [7, 9, 8]
    assert on_the_board["options"]["timer"] == "device_cycles"
    about = on_the_board["extra_info"]
    assert (about["cycles"], about["cycle_model"], about["core_clock_hz"]) == (9, MODEL, 120_000_000)
    manifest = json.loads((default_firmware().parent / "manifest.json").read_text(encoding="utf-8"))
    assert about["build_id"] == manifest["build_id"]
    assert (called["extra_info"]["cycles"], called["extra_info"]["cycle_model"]) == (3, MODEL)
    assert "build_id" not in called["extra_info"], "cycles(elf) may call into any ELF"


def test_times_are_of_the_clock_that_a_function_was_called_at_and_two_clocks_share_no_table(
    pytester: pytest.Pytester,
) -> None:
    pytester.makepyfile("""
        import pytest

        @pytest.mark.parametrize("mhz", [48, 96])
        def test_call(benchmark_cycles, cycles, mhz):
            benchmark_cycles("empty", cycles(clock_hz=mhz * 1e6).call("magnetometer_empty", 0, 0))

        def test_both(benchmark_cycles, cycles):
            called = [cycles(clock_hz=hz).call("magnetometer_empty", 0, 0) for hz in (48e6, 96e6)]
            with pytest.raises(ValueError, match="at clocks of 48 and 96 MHz"):
                benchmark_cycles("empty", called)
    """)
    result = pytester.runpytest_inprocess("--benchmark-columns=min", "--benchmark-time-unit=ns")
    assert result.ret == 0
    title = f"benchmark 'empty, cycles of {MODEL}, at {{}} MHz': 1 tests"
    assert tables(result.stdout.str()) == {
        title.format(48): ["Name (time in ns) Min", "test_call[48] 62.5000"],  # 3 cycles
        title.format(96): ["Name (time in ns) Min", "test_call[96] 31.2500"],
    }


def test_a_calibrator_s_cycles_are_shown_with_its_accuracy_there_and_when_they_are_compared(
    pytester: pytest.Pytester,
) -> None:
    text = "\n".join(
        f"def test_{name}(benchmark_cycles):\n"
        f"    benchmark_cycles('fast', {cycles}, cycle_model={MODEL!r}, from_float64_deg={distance_deg})\n"
        for name, cycles, distance_deg in (("small", 700, 0.004), ("large", 900, 0.0155))
    )
    title = f"benchmark 'fast, cycles of {MODEL}; at most 0.015 deg from float64 of the same points': 2 tests"
    content = saved(pytester, text, "saved")
    assert [benchmark["extra_info"]["from_float64_deg"] for benchmark in content["benchmarks"]] == [0.004, 0.0155]
    assert {benchmark["group"] for benchmark in content["benchmarks"]} == {f"fast, cycles of {MODEL}"}
    assert list(tables(compare(pytester, "saved.json"))) == [title]
    # With hooks from a conftest.py and from the plugin both, it is said once.
    assert title in tables(pytester.runpytest_inprocess().stdout.str())


def test_nine_times_the_cycles_are_shown_as_nine_times(pytester: pytest.Pytester) -> None:
    for name, cycles in (("old", 12_345), ("new", 9 * 12_345)):
        saved(pytester, fit(cycles), name)
    (table,) = tables(compare(pytester, "old.json", "new.json", "--columns=min,median")).values()
    assert table == [
        "Name (time in cycles) Min Median",
        "test_fit (old) 12,345.0000 (1.0) 12,345.0000 (1.0)",
        "test_fit (new) 111,105.0000 (9.00) 111,105.0000 (9.00)",
    ]
    (table,) = tables(compare(pytester, "old.json", "new.json", "--columns=min", "--time-unit=us")).values()
    assert table[1] == "test_fit (old) 102.8750 (1.0)"


@pytest.mark.parametrize("group_by", ["group", "func", "fullname"])
def test_two_models_are_never_ranked_together(pytester: pytest.Pytester, group_by: str) -> None:
    for name, model in (("old", "silicon-dwt"), ("new", MODEL)):
        saved(pytester, BOTH.replace(MODEL, model), name)
    result = tables(compare(pytester, "old.json", "new.json", f"--group-by={group_by}", "--columns=min"))
    of_cycles = {title: rows for title, rows in result.items() if "cycles of" in title}
    assert len(of_cycles) == 2
    for title, (header, row) in of_cycles.items():
        model, name = ("silicon-dwt", "old") if "silicon-dwt" in title else (MODEL, "new")
        assert f"cycles of {model}': 1 tests" in title
        assert (header, row) == ("Name (time in cycles) Min", f"test_fit ({name}) 12,345.0000")
    assert all("test_host" in row for title in result.keys() - of_cycles.keys() for row in result[title][1:])


def test_a_saved_run_of_another_model_keeps_its_own_table(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_it=fit(900, "silicon-dwt"))
    assert pytester.runpytest_inprocess("--benchmark-save=one").ret == 0
    pytester.makepyfile(test_it=fit(100))
    result = pytester.runpytest_inprocess("--benchmark-compare=0001", "--benchmark-columns=min")
    assert result.ret == 0
    found = tables(result.stdout.str())
    assert found[f"benchmark 'direct, cycles of {MODEL}': 1 tests"][1] == "test_fit (NOW) 100.0000"
    assert found["benchmark 'direct, cycles of silicon-dwt': 1 tests"][1] == "test_fit (0001_one) 900.0000"


def test_a_saved_run_is_ranked_beside_the_new_one_and_another_build_is_no_other_machine(
    pytester: pytest.Pytester,
) -> None:
    pytester.makepyfile(test_it=fit(900))
    assert pytester.runpytest_inprocess("--benchmark-save=one").ret == 0
    pytester.makepyfile(test_it=fit(100))
    result = pytester.runpytest_inprocess("--benchmark-compare=0001", "--benchmark-columns=min")
    (rows,) = tables(result.stdout.str()).values()
    assert rows[1:] == ["test_fit (NOW) 100.0000 (1.0)", "test_fit (0001_one) 900.0000 (9.00)"]
    assert "machine_info is different" not in result.stdout.str() + result.stderr.str()
    assert "another board" not in result.stdout.str()


def test_another_board_is_named(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_it=fit(900))
    assert pytester.runpytest_inprocess("--benchmark-save=one").ret == 0
    (file,) = (pytester.path / ".benchmarks").rglob("0001_one.json")
    content = json.loads(file.read_text(encoding="utf-8"))
    content["machine_info"]["board"]["kind"] = "real"
    file.write_text(json.dumps(content), encoding="utf-8")
    result = pytester.runpytest_inprocess("--benchmark-compare=0001")
    assert result.ret == 0
    result.stdout.fnmatch_lines(["the saved cycles belong to another board: kind real, now virtual"])


BLOCKED = """
import pytest

@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    # As pytest-codspeed does; it refuses marks that it does not know, too.
    config.option.benchmark_disable = True
    config.pluginmanager.set_blocked("pytest-benchmark")

def pytest_runtest_setup(item):
    assert item.get_closest_marker("benchmark") is None
"""
JUDGED = """
from hiltest.measurement import Limit

def test_fit(benchmark_cycles, cycles, measure):
    found = cycles().call("magnetometer_empty", 0, 0)
    benchmark_cycles("empty", found)
    measure("cycles.empty", found, limit=Limit(max={most}))
"""
WRONG = "def test_fit(benchmark_cycles):\n    benchmark_cycles('direct', 900)\n"

TWICE = fit(100) + "    benchmark_cycles('direct', 200, cycle_model='m')\n"
UNUSED = "def test_fit(benchmark_cycles):\n    pass\n"


@pytest.mark.parametrize(
    ("text", "exit_code"),
    [(JUDGED.format(most=3), 0), (JUDGED.format(most=2), 1), (WRONG, 1), (TWICE, 1), (UNUSED, 0)],
    ids=["pass", "fail", "wrong", "twice", "unused"],
)
def test_exit_code_and_verdict_are_the_same_without_pytest_benchmark(
    pytester: pytest.Pytester, text: str, exit_code: int
) -> None:
    pytester.makepyfile(blocks=BLOCKED, test_it=text)
    pytester.syspathinsert()
    observations = {}
    for options in ((), ("-p", "no:benchmark"), ("-p", "blocks"), ("--benchmark-disable",), ("--benchmark-only",)):
        result = pytester.runpytest_inprocess("-W", "error", *options)
        record = pytester.path / "hil-out" / "run.json"
        verdict = json.loads(record.read_text(encoding="utf-8"))["verdict"] if record.exists() else None
        observations[options] = (result.ret, result.parseoutcomes(), verdict)
    assert len({json.dumps(item) for item in observations.values()}) == 1, observations
    assert observations[()][0] == exit_code


def test_workers_show_nothing_and_pass_all_the_same(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(fit(100) + fit(200).replace("test_fit", "test_other"))
    result = pytester.runpytest_inprocess("-n", "2")
    assert result.ret == 0
    result.assert_outcomes(passed=2)
    assert "cycles of" not in result.stdout.str()
    pytester.makepyfile(WRONG)
    assert pytester.runpytest_inprocess("-n", "2").ret == 1


@pytest.mark.parametrize(
    ("cost", "complaint"),
    [
        ("[], cycle_model='m'", "no round was counted"),
        ("[7, None], cycle_model='m'", "None is not a number of cycles"),
        ("7.5, cycle_model='m'", "7.5 is not a number of cycles"),
        ("-1, cycle_model='m'", "-1 is not a number of cycles"),
        ("7", "their cycle model is unknown"),
        ("cycles().call('magnetometer_empty', 0, 0), cycle_model='m'", f"these were counted by {MODEL} and m"),
    ],
)
def test_what_is_no_cost_is_refused(pytester: pytest.Pytester, cost: str, complaint: str) -> None:
    pytester.makepyfile(f"def test_it(benchmark_cycles, cycles):\n    benchmark_cycles('x', {cost})\n")
    result = pytester.runpytest_inprocess()
    assert result.ret == 1
    result.stdout.fnmatch_lines([f"*ValueError: *{complaint}*"])


def test_options_of_pytest_benchmark_choose_these_tests_too(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(fit(100) + "def test_other():\n    pass\n")
    pytester.runpytest_inprocess("--benchmark-only").assert_outcomes(passed=1, skipped=1)
    pytester.runpytest_inprocess("--benchmark-skip").assert_outcomes(passed=1, skipped=1)


def test_a_mark_of_one_s_own_stays_and_another_project_s_fixture_is_none_of_ours(pytester: pytest.Pytester) -> None:
    content = saved(pytester, "import pytest\n@pytest.mark.benchmark(disable_gc=True)\n" + fit(100), "marked")
    assert content["benchmarks"][0]["options"]["disable_gc"] is True
    content = saved(
        pytester,
        """
        import pytest

        @pytest.fixture
        def benchmark_cycles(benchmark):
            return benchmark

        def test_it(benchmark_cycles):
            benchmark_cycles.pedantic(sum, ([1, 2],))
    """,
        "theirs",
    )
    assert content["benchmarks"][0]["options"]["timer"] == "perf_counter"
    assert "board" not in content["machine_info"]


def test_benchmarks_alone_are_held_to_no_limit_of_the_rig_and_beside_others_they_are(
    pytester: pytest.Pytester, default_rig: str
) -> None:
    path = Path("mine.toml")
    path.write_text(
        default_rig[: default_rig.index("[limits]")] + '[limits]\n"x" = { max = 2, unit = "deg" }\n', encoding="utf-8"
    )
    kernel = fit(100).replace("benchmark_cycles)", "benchmark_cycles, board)")
    workers = ("-n", "2", "--dist", "loadgroup")
    pytester.makepyfile(test_it=kernel)
    assert pytester.runpytest_inprocess("--hil-rig=mine.toml").ret == 0
    assert pytester.runpytest_inprocess("--hil-rig=mine.toml", *workers).ret == 0
    pytester.makepyfile(test_it=kernel + "def test_other(board):\n    pass\n")
    assert pytester.runpytest_inprocess("--hil-rig=mine.toml").ret == 22, "the limit was not judged"
    assert pytester.runpytest_inprocess("--hil-rig=mine.toml", *workers).ret == 22


@pytest.mark.parametrize("workers", [(), ("-n", "2", "--dist", "loadgroup")], ids=["alone", "in a worker"])
def test_benchmarks_alone_leave_the_last_verdict_where_it_is(
    pytester: pytest.Pytester, workers: tuple[str, ...]
) -> None:
    pytester.makepyfile(test_it="def test_size(measure):\n    measure('table.bytes', 100, 'B')\n")
    run = pytester.runpytest_inprocess
    assert run().ret == 0
    out = pytester.path / "hil-out"
    verdict = {path.name: path.read_bytes() for path in out.iterdir()}
    pytester.makepyfile(test_it=fit(100).replace("benchmark_cycles)", "benchmark_cycles, board)"))
    assert run(*workers).ret == 0
    assert {path.name: path.read_bytes() for path in out.iterdir() if path.is_file()} == verdict
    assert [path.name for path in out.iterdir() if path.is_dir()] == ["benchmarks"]
    assert (out / "benchmarks" / "run.json").exists()
    pytester.makepyfile(test_it=fit(100).replace("benchmark_cycles)", "benchmark_cycles, board, measure)"))
    named = run("--hil-rig=virtual-k64f", *workers)
    assert named.ret == 22, "what measures is judged, whatever else it shows: the rig that is named has limits"
    assert (out / "run.json").read_bytes() != verdict["run.json"]


def test_a_histogram_has_a_word_for_the_unit(pytester: pytest.Pytester) -> None:
    if find_spec("pygal") is None:  # not imported: it replaces how this whole process finds packages
        pytest.skip("pygal is not installed")
    pytester.makepyfile(fit([100, 110]))
    assert pytester.runpytest_subprocess("--benchmark-histogram=plot").ret == 0
    (file,) = pytester.path.glob("plot-*.svg")
    assert "Speed in cycles of direct" in file.read_text(encoding="utf-8")
