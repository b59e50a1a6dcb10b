"""``hiltest compare`` and ``hiltest baseline``: exit codes, and what a reader and a program get."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from .. import in_process

pytestmark = pytest.mark.slow

Changed = Callable[..., Path]


def hiltest(*arguments: object, columns: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command; `columns` is the width of its terminal."""
    return in_process.hiltest(*arguments, environment={"TERM": "dumb", "COLUMNS": str(columns or 200)})


def test_0_says_that_nothing_got_worse(changed: Changed) -> None:
    done = hiltest("compare", changed("base"), changed("new", values={"cycles.direct.total": 10_000}))
    assert done.returncode == 0, done.stderr
    better = r"1 better: cycles\.direct\.total .*; \d+ unchanged\."
    assert re.search(rf"^May be merged .*\(against \S+\): {better}$", done.stdout, re.M)
    assert re.search(
        r"^better \(1\)\n  cycles\.direct\.total [\d ]+ -> 10 000 cycles \(-[\d ]+, -\S+ %; limit at most 12 000;"
        r"\s+heading\.direct\.max\s+(\S+) -> \1 deg\)$",
        done.stdout,
        re.M,
    )
    assert "cycles counted by cortex-m4-trm/3@sram" in done.stdout.splitlines()
    done = hiltest("compare", changed("base"), changed("new", values={"heading.direct.max": 1.0}))
    assert "counted by" not in done.stdout, "no cycles are shown"


def test_1_says_that_the_new_run_fails_by_itself(changed: Changed, real_record: dict[str, Any]) -> None:
    tests = [{**test, "outcome": "failed", "reason": "it broke"} for test in real_record["tests"][:1]]
    name = tests[0]["id"].rpartition("/")[2]
    done = hiltest("compare", changed("base"), changed("new", {"tests": [*tests, *real_record["tests"][1:]]}))
    assert done.returncode == 1, done.stderr
    assert f"failed: {name} (it broke)" in done.stdout
    ended = {"verdict.exit_code": 6, "verdict.outcome": "exit code 6"}
    done = hiltest("compare", changed("base"), changed("new", ended))
    assert done.returncode == 1, done.stderr
    assert "failed: the run itself (exit code 6); " in done.stdout


def test_what_is_gone_is_accepted_by_the_commands_that_it_says(changed: Changed, tmp_path: Path) -> None:
    base, new, file = changed("base"), changed("new", values={"heading.direct.max": None}), tmp_path / "kept.json"
    done = hiltest("compare", base, new)
    assert done.returncode == 22
    line = next(line for line in done.stdout.splitlines() if "measurement missing" in line)
    for command in re.findall(r"`hiltest ([^`]*)`", line):
        words = [{"FILE": str(file), "TEXT": "no more"}.get(part, part) for part in shlex.split(command)]
        assert hiltest(*words).returncode == 0, command
    assert hiltest("compare", file, new).returncode == 0


def test_what_got_better_is_kept_by_the_command_that_it_says(changed: Changed, tmp_path: Path) -> None:
    file, better = tmp_path / "base line.json", {"cycles.direct.total": 10_000, "cycles.corrected.total": 9_000}
    assert hiltest("baseline", "save", changed("base"), file).returncode == 0
    done = hiltest("compare", file, changed("new", values=better))
    (hint,) = re.findall(r"^2 better; keep them: (hiltest .*) --because TEXT$", done.stdout, re.M)
    done = hiltest(*shlex.split(hint)[1:], "--because", "it is faster")
    assert done.returncode == 0, done.stderr
    done = hiltest(*shlex.split(hint)[1:], "--because", "once more")
    assert (done.returncode, done.stdout) == (4, "")
    assert "nothing changes: " in done.stderr
    done = hiltest("compare", file, changed("new", values=better))
    assert " better" not in done.stdout
    assert done.returncode == 0
    # A run is no baseline that could be updated, and of an older firmware there is nothing to keep.
    done = hiltest("compare", changed("base"), changed("new", values=better))
    assert f"keep them: hiltest baseline save {tmp_path / 'new' / 'run.json'} FILE, and --baseline FILE" in done.stdout
    worse = {**better, "heading.direct.max": 1.7}
    assert "keep them" not in hiltest("compare", file, changed("new", values=worse)).stdout


def test_a_campaign_may_miss_limits_on_as_many_seeds_as_it_was_allowed(changed: Changed, tmp_path: Path) -> None:
    record = json.loads(changed("base/seed-0001").read_text(encoding="utf-8"))
    (missed,) = (measurement for measurement in record["measurements"] if measurement["name"] == "heading.direct.max")
    missed |= {"value": 1.9, "outcome": "fail"}
    out = {"measurements": record["measurements"], "verdict.exit_code": 1, "verdict.outcome": "fail"}
    changed("base/seed-0001", out)
    changed("base/seed-0002", {"seed": 2})
    seeds = tmp_path / "base" / "seeds.json"
    for code in (1, 0):
        seeds.write_text(json.dumps({"exit_code": code}), encoding="utf-8")
        done = hiltest("compare", tmp_path / "base", tmp_path / "base")
        assert done.returncode == code, done.stdout
        assert ("failed: heading.direct.max " in done.stdout) == bool(code)


def test_22_says_why_in_one_line(changed: Changed, tmp_path: Path) -> None:
    (tmp_path / "text.json").write_text("no json", encoding="utf-8")
    done = hiltest("compare", tmp_path / "text.json", changed("new"))
    assert done.returncode == 22
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("Cannot say whether it may be merged "))
    assert "text.json: not JSON" in line
    done = hiltest("compare", changed("base"), changed("new", {"board.cycle_model": "silicon-dwt"}))
    assert done.returncode == 22
    assert "): another cycle model: " in done.stdout


@pytest.mark.parametrize("as_json", [(), ("--json",)], ids=["text", "JSON"])
def test_4_if_the_base_does_not_exist(changed: Changed, tmp_path: Path, as_json: tuple[str, ...]) -> None:
    (tmp_path / "empty").mkdir()
    for name, complaint in (
        ("none.json", "No such file or directory; name a run.json, its folder or a baseline"),
        ("empty", "has no record of a run"),
    ):
        done = hiltest("compare", *as_json, tmp_path / name, changed("new"))
        assert done.returncode == 4
        assert re.match(rf"ERROR: \S+{name}:? {complaint}", done.stderr)
        assert (json.loads(done.stdout)["schema"] if as_json else done.stdout) == ("hiltest.error/1" if as_json else "")


def test_4_for_what_is_no_new_run(changed: Changed, tmp_path: Path) -> None:
    base = changed("base")
    assert hiltest("compare", base, tmp_path / "none.json").returncode == 4
    assert hiltest("compare", base).returncode == 4
    assert hiltest("compare", base, base, "--tolerance", "1").returncode == 4
    (tmp_path / "text.json").write_text("no json", encoding="utf-8")
    done = hiltest("compare", base, tmp_path / "text.json")
    assert (done.returncode, done.stdout) == (4, "")
    assert "text.json" in done.stderr


def test_of_several_new_runs_the_worst_decides(changed: Changed) -> None:
    base, same = changed("base"), changed("same")
    worse = changed("worse", values={"cycles.direct.total": 99_999})
    unlike = changed("unlike", {"poses": "level"})
    assert hiltest("compare", base, same, worse).returncode == 21
    done = hiltest("compare", base, same, worse, unlike)
    assert done.returncode == 22
    assert re.findall(r"^(May be merged|Not to be merged|Cannot say whether it may be merged) ", done.stdout, re.M) == [
        "May be merged",
        "Not to be merged",
        "Cannot say whether it may be merged",
    ]


def test_json_has_every_measurement(changed: Changed) -> None:
    done = hiltest("compare", "--json", changed("base"), changed("new", values={"heading.direct.max": 1.7}))
    content = json.loads(done.stdout)
    assert (done.returncode, content["schema"]) == (21, "hiltest.comparison/1")
    (comparison,) = content["comparisons"]
    differences = {difference["name"]: difference for difference in comparison["differences"]}
    assert len(differences) > 140
    assert (differences["heading.direct.max"]["change"], differences["heading.direct.max"]["new"]) == ("worse", 1.7)
    assert differences["heading.direct.max"]["limit"] == {"min": None, "max": 1.8}
    assert comparison["sentence"].startswith("Not to be merged (against ")


def test_what_changed_is_readable_at_80_columns(changed: Changed) -> None:
    import pty

    values = {"heading.direct-stream.max_centred": 2.5, "cycles.corrected.total": 14_586, "cycles.joint.total": 109_621}
    base, new = changed("base"), changed("new", values=values)
    leader, follower = pty.openpty()
    environment = {**os.environ, "TERM": "dumb", "COLUMNS": "80"}
    command = [sys.executable, "-m", "hiltest", "compare", str(base), str(new)]
    with subprocess.Popen(command, stdout=follower, stderr=subprocess.STDOUT, env=environment) as process:
        os.close(follower)
        shown = b""
        while chunk := _read(leader):
            shown += chunk
    os.close(leader)
    lines = shown.decode().replace("\r\n", "\n").splitlines()
    entries = [line for line in lines if line.startswith("  ")]
    assert entries
    assert all(len(line) <= 80 for line in entries)
    assert not any(re.search(r"\d$", line) and re.match(r" +\d{3}\b", after) for line, after in pairwise(entries))
    assert process.returncode == 21


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 4096)
    except OSError:  # the other end is closed
        return b""


def test_names_that_would_command_a_terminal_are_written_out(changed: Changed) -> None:
    hostile = {"board.build_id": "\x1b[2J[red]", "rig.name": "<script>"}
    done = hiltest("compare", changed("base"), changed("new", hostile, {"cycles.direct.total": 1}))
    assert done.returncode == 0, done.stderr
    assert "\x1b" not in done.stdout
    assert r"\x1b[2J[red]" in done.stdout


def test_a_baseline_is_saved_compared_with_and_updated(changed: Changed, tmp_path: Path) -> None:
    run, file = changed("run"), tmp_path / "baseline.json"
    done = hiltest("baseline", "save", run, file)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(rf"{re.escape(str(file))}: \d+ measurements of build \w+, seed 1\n", done.stdout)
    assert hiltest("compare", file, run.parent).returncode == 0
    before = file.read_text(encoding="utf-8").splitlines()

    worse = changed("worse", values={"cycles.direct.total": 11_999, "heading.direct.max": 1.7})
    assert hiltest("compare", file, worse).returncode == 21
    done = hiltest("baseline", "update", file, worse, "--accept", "cycles.direct.total", "--because", "it checks more")
    assert done.returncode == 0, done.stderr
    assert "cycles.direct.total: " in done.stdout
    assert "11 999" in done.stdout
    after = file.read_text(encoding="utf-8").splitlines()
    changed_lines = [line for line in after if line not in before]
    assert [("cycles.direct.total" in line) for line in changed_lines if line.startswith(' {"name"')] == [True, True]
    assert "it checks more" in "".join(changed_lines)
    done = hiltest("compare", file, worse)
    assert done.returncode == 21
    assert "1 worse: heading.direct.max" in done.stdout


def test_a_limit_that_is_accepted_with_the_number_is_printed(
    changed: Changed, real_record: dict[str, Any], tmp_path: Path
) -> None:
    file, limit = tmp_path / "baseline.json", {"heading.direct.max": {"min": None, "max": 3.0}, "link.retried": None}
    assert hiltest("baseline", "save", changed("run"), file).returncode == 0
    looser = [
        {**measurement, "limit": limit.get(measurement["name"], measurement["limit"])}
        for measurement in real_record["measurements"]
    ]
    run = changed("looser", {"measurements": looser}, {"heading.direct.max": 1.9})
    done = hiltest("baseline", "update", file, run, "--accept", "*", "--because", "another compass")
    was = next(
        measurement["value"]
        for measurement in real_record["measurements"]
        if measurement["name"] == "heading.direct.max"
    )
    lines = done.stdout.splitlines()[:-1]
    assert f"heading.direct.max: {was:.6g} -> 1.9; limit at most 1.8 -> at most 3" in lines
    assert "link.retried: 0 -> 0; limit at most 0 -> none" in lines
    assert len(lines) == 2


def test_a_baseline_of_two_builds_says_so_wherever_it_is_shown(changed: Changed, tmp_path: Path) -> None:
    file = tmp_path / "baseline.json"
    assert hiltest("baseline", "save", changed("a", {"board.build_id": "aaaa"}), file).returncode == 0
    worse = {"cycles.direct.total": 11_999, "heading.direct.max": 1.7}
    made_for = {"commit": "", "branch": "main", "label": "v2"}
    newer = changed("b", {"board.build_id": "bbbb", "revision": made_for}, worse)
    done = hiltest("baseline", "update", file, newer, "--accept", "cycles.direct.total", "--because", "it checks more")
    assert json.loads(file.read_text(encoding="utf-8"))["history"][0]["revision"]["label"] == "v2"
    two_builds = "build aaaa, with 1 measurement accepted from build bbbb"
    assert done.stdout.endswith(f" updated, {two_builds}\n"), done.stdout + done.stderr
    compared = hiltest("compare", file, newer).stdout
    assert f"{file} ({two_builds}, seed 1) -> {newer} (build bbbb, v2, branch main, seed 1)" in compared
    (as_json,) = json.loads(hiltest("compare", "--json", file, newer).stdout)["comparisons"]
    assert as_json["base"]["accepted"] == [{"build_id": "bbbb", "measurements": 1}]
    done = hiltest("baseline", "update", file, newer, "--accept", "heading.dirct.max", "--because", "x")
    assert (done.returncode, "did you mean 'heading.direct.max'?" in done.stderr) == (4, True)


def test_a_change_is_not_accepted_without_a_reason_nor_under_a_name_that_nothing_has(
    changed: Changed, tmp_path: Path
) -> None:
    run, file = changed("run"), tmp_path / "baseline.json"
    hiltest("baseline", "save", run, file)
    before = file.read_bytes()
    assert hiltest("baseline", "update", file, run, "--accept", "*").returncode == 4
    assert hiltest("baseline", "update", file, run, "--accept", "*", "--because", " ").returncode == 4
    assert hiltest("baseline", "update", file, run, "--because", "x").returncode == 4
    done = hiltest("baseline", "update", file, run, "--accept", "heading.dirct.*", "--because", "x")
    assert done.returncode == 4
    assert "no measurement has the name 'heading.dirct.*'" in done.stderr
    assert file.read_bytes() == before


def test_a_baseline_that_cannot_be_written_is_a_usage_error(changed: Changed, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    done = hiltest("baseline", "save", changed("run"), tmp_path / "file" / "baseline.json")
    assert done.returncode == 4
    assert "cannot write" in done.stderr


def test_the_folder_of_a_first_baseline_is_made(changed: Changed, tmp_path: Path) -> None:
    done = hiltest("baseline", "save", changed("run"), tmp_path / "hil" / "baselines" / "mine.json")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "hil" / "baselines" / "mine.json").exists()


def test_a_baseline_that_is_saved_again_keeps_its_history(changed: Changed, tmp_path: Path) -> None:
    run, file = changed("run", values={"cycles.direct.total": 11_000}), tmp_path / "baseline.json"
    assert hiltest("baseline", "save", changed("old"), file).returncode == 0
    accepted = hiltest("baseline", "update", file, run, "--accept", "cycles.*", "--because", "it checks less")
    assert accepted.returncode == 0, accepted.stderr
    assert hiltest("baseline", "save", run, file).returncode == 0
    saved = json.loads(file.read_text(encoding="utf-8"))
    assert [(entry["name"], entry["because"]) for entry in saved["history"]] == [
        ("cycles.direct.total", "it checks less"),
        ("*", "renewed"),
    ]
    assert saved["history"][1]["build_id"] == saved["side"]["build_id"]


def test_a_failed_run_of_another_build_is_saved_with_a_warning(
    changed: Changed, real_record: dict[str, Any], tmp_path: Path
) -> None:
    file, built = tmp_path / "baseline.json", real_record["board"]["build_id"]
    assert "Warning" not in hiltest("baseline", "save", changed("run"), file).stdout
    failed = [
        row | ({"value": 9.0, "outcome": "fail"} if row["name"] == "heading.direct.max" else {})
        for row in real_record["measurements"]
    ]
    done = hiltest("baseline", "save", changed("red", {"measurements": failed, "board.build_id": "aaaa"}), file)
    assert done.returncode == 0, done.stderr
    saved, warning = done.stdout.splitlines()
    assert saved.endswith(f" of build aaaa, seed 1, in place of build {built}")
    assert f"the verdict of {tmp_path / 'red' / 'run.json'} is FAIL: heading.direct.max 9 deg (at most 1.8)" in warning


def test_what_is_no_baseline_is_never_overwritten_by_one(changed: Changed, tmp_path: Path) -> None:
    run = changed("run")
    before = run.read_bytes()
    for place in (run, run.parent, "."):
        done = hiltest("baseline", "save", run, place)
        assert (done.returncode, "is not a baseline" in done.stderr) == (4, True), done.stderr
    assert run.read_bytes() == before
    done = hiltest("baseline", "save", run, tmp_path / ("n" * 300))
    assert (done.returncode, "cannot write" in done.stderr) == (4, True), done.stderr


def on_a_bench(changed: Changed, folder: str, values: dict[str, float]) -> Path:
    """Write a run as a real board makes it: without a seed, and with noise of its own."""
    return changed(folder, {"board.kind": "real", "seed": None}, values)


def test_several_runs_of_a_bench_say_how_much_they_differ(changed: Changed, tmp_path: Path) -> None:
    rms, largest, file = "heading.direct.rms", "heading.direct.max", tmp_path / "base.json"
    noise = [0.00, 0.03, -0.04, 0.02, -0.03, 0.04, -0.005, -0.015]
    runs = [on_a_bench(changed, f"run-{number}", {rms: 0.36 + deviation}) for number, deviation in enumerate(noise)]
    saved = hiltest("baseline", "save", *runs, file)
    assert saved.stdout.rstrip().endswith("8 runs"), saved.stderr
    assert hiltest("compare", file, runs[0]).returncode == 0
    worse = on_a_bench(changed, "worse", {rms: 0.66, largest: 1.7})
    done = hiltest("compare", file, worse)
    assert done.returncode == 21, done.stdout
    (seen_from,) = re.findall(rf"{re.escape(rms)} 0\.36 -> 0\.66 deg .*, seen from (\S+) deg on$", done.stdout, re.M)
    assert 0.05 < float(seen_from) < 0.3
    # One run says nothing of its noise: the same change is three deviations of the default rig.
    alone = hiltest("compare", runs[0], worse)
    assert alone.returncode == 0
    assert "hiltest baseline save RUN RUN ... FILE" in alone.stdout
    twice = hiltest("baseline", "save", runs[0], runs[0], tmp_path / "twice.json")
    assert twice.returncode == 4
    assert "name each run once" in twice.stderr
    accept = ("--accept", rms, "--because", "slower, on purpose")
    few = hiltest("baseline", "update", file, worse, *accept)
    assert few.returncode == 4
    assert "has 1 run, and the baseline 8; name as many" in few.stderr
    assert hiltest("baseline", "update", file, *runs[:7], worse, *accept).returncode == 0


def test_detect_says_how_many_runs_a_side_see_a_change(changed: Changed, tmp_path: Path) -> None:
    baseline = Path(__file__).parents[2] / "hil" / "baselines" / "virtual-k64f.json"
    done = hiltest("compare", "--detect", "0.05 deg", baseline)
    assert done.returncode == 0, done.stderr
    needed = {
        name: int(runs.replace(" ", ""))
        for name, runs in re.findall(r"^(heading\.\S+) +\S+ +([\d ]+?) {2,}", done.stdout, re.M)
    }
    assert 19 < needed["heading.direct.rms"] < 80, (
        "19 at 5 % for this measurement alone, and at most four times as many"
    )
    assert 163 < needed["heading.direct.max"] < 600
    assert 194 < needed["heading.joint.max"] < 777
    assert re.search(r"^heading\.direct\.rms +\S+ +\d+ +1 +0\.01 *$", done.stdout, re.M), "one seed, paired"
    programs = json.loads(hiltest("compare", "--json", "--detect", "0.05deg", baseline).stdout)
    (detection,) = (
        measurement
        for measurement in programs["detection"]["measurements"]
        if measurement["name"] == "heading.direct.rms"
    )
    assert (detection["runs"], detection["seeds"]) == (needed["heading.direct.rms"], 1)
    with_new = hiltest("compare", "--detect", "0.05deg", changed("base"), changed("new"))
    assert with_new.returncode == 0
    assert "May be merged" in with_new.stdout
    assert "heading.direct.rms" in with_new.stdout


@pytest.mark.parametrize(
    "size",
    [
        "",
        "deg",
        "0.05",
        "0deg",
        "-1deg",
        "nandeg",
        "infdeg",
        "1e999deg",
        "0.05furlong",
        "\u0660.5deg",
        "0x1deg",
        "0.05deg\n",
        "1_0deg",
        "0.05deg; rm",
        "9" * 5000 + "deg",
        "\x1b[31mdeg",
    ],
)
def test_a_size_that_is_none_is_a_usage_error_that_names_what_is_expected(size: str) -> None:
    baseline = Path(__file__).parents[2] / "hil" / "baselines" / "virtual-k64f.json"
    done = hiltest("compare", f"--detect={size}", baseline)
    if size.strip() == "0.05deg":
        assert done.returncode == 0
        return
    assert (done.returncode, done.stdout) == (4, "")
    assert "expected a number above 0 with a unit" in done.stderr
    assert "such as 0.05deg" in done.stderr
    assert "\x1b" not in done.stderr
    assert len(done.stderr) < 600
