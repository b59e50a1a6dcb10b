"""Coverage of firmware that was not instrumented: as gcov counts it, and with what IT blocks skip left out."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.errors import BoardFault, ConfigError
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.coverage.lcov import Coverage, FileCoverage, from_lcov, to_lcov
from hiltest.virtual.coverage.source_map import SourceMap
from hiltest.virtual.processor.executed_code import ExecutionWatch
from hiltest.virtual.program.elf import load_image

from .conftest import PROGRAMS, Build, follow

LONG_ENOUGH_S = 0.01


def covered(board: VirtualK64F, watch: ExecutionWatch, source: str) -> FileCoverage:
    """Return the coverage of one source file."""
    coverage = SourceMap(board.image).coverage(watch.code())
    (file,) = (file for name, file in coverage.files.items() if name.endswith(source))
    return file


def watched(elf: Path, **more: str) -> tuple[VirtualK64F, ExecutionWatch]:
    board = VirtualK64F(elf, **more)  # type: ignore[arg-type]
    board.may_rest = True
    return board, ExecutionWatch(board.processor)


def by_gcov(tmp_path: Path, require_tool: Callable[[str], str]) -> tuple[dict[int, int], dict[int, list[int]]]:
    """Build walked.c for the host with gcov, run it, and return counts of lines, and of the ways of branches."""
    compiler, gcov = require_tool("gcc"), require_tool("gcov")
    subprocess.run(
        [compiler, "-O0", "--coverage", str(PROGRAMS / "walked.c"), "-o", "walked"], cwd=tmp_path, check=True
    )
    subprocess.run([tmp_path / "walked"], cwd=tmp_path, check=True)
    (data,) = tmp_path.glob("*.gcda")
    command = [gcov, "--branch-probabilities", "--json-format", "--stdout", str(data)]
    output = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    (file,) = json.loads(output)["files"]
    lines = {line["line_number"]: line["count"] for line in file["lines"]}
    ways = {line["line_number"]: [way["count"] for way in line["branches"]] for line in file["lines"]}
    return lines, ways


def test_lines_and_branches_are_counted_as_gcov_counts_them(
    build: Build, tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    board, watch = watched(build(PROGRAMS / "walked.c", "-O0"))
    board.run_until(LONG_ENOUGH_S)
    file = covered(board, watch, "walked.c")
    lines, ways = by_gcov(tmp_path, require_tool)
    text = ["", *(PROGRAMS / "walked.c").read_text(encoding="utf-8").splitlines()]
    # gcov has a function where its name is, we where it opens; it has a label too, and no end of a function.
    assert {text[line] for line in file.lines.keys() - lines.keys()} == {"{", "}"}
    only_gcov = {text[line].strip() for line in lines.keys() - file.lines.keys()}
    assert all(item.startswith(("static", "int main", "case", "default:")) for item in only_gcov)
    both = lines.keys() & file.lines.keys()
    assert len(both) > 35
    unlike = {line: (lines[line], file.lines[line]) for line in both if lines[line] != file.lines[line]}
    # Two statements of one line, and nothing goes from one to the other: gcov adds them up, and here the most counts.
    assert {text[line].strip(): counts for line, counts in unlike.items()} == {
        "case 5: sink = 5; break; case 6: sink = 6; break;": (2, 1)
    }
    switch = next(line for line, item in enumerate(text) if "switch" in item)
    mine: dict[int, list[int]] = {}
    for (line, _), counts in file.branches.items():
        mine.setdefault(line, []).extend(counts)
    theirs = {line: sorted(counts) for line, counts in ways.items() if counts and line != switch}
    assert {line: sorted(counts) for line, counts in mine.items() if line != switch} == theirs
    assert {name: count for name, (_, count) in file.functions.items()} == {
        "never_called": 0,
        "clamped": 3,
        "choose": 7,
        "factorial": 5,
        "sum": 3,
        "loops": 1,
        "main": 1,
    }


# Lines by what follows the second @: how often they are executed, of `main` and of three turns of its loop; in brackets
# how often a branch goes on and jumps, or an IT block skips and executes.
SKIPS = """
        function main
        push {r4, lr}           @@ 1
        movs r4, #3             @@ 1
turn:
        cmp r4, #2              @@ 3
        itte eq                 @@ 3 [2, 1]
        moveq r0, #1            @@ 1
        moveq r1, #1            @@ 1
        movne r0, #2            @@ 2
        cmp r4, #9              @@ 3
        itt eq                  @@ 3 [3, 0]
        ldreq r0, [sp]          @@ 0
        addeq r0, #1            @@ 0
        cmp r4, #1              @@ 3
        it eq                   @@ 3 [2, 1]
        beq.n in_the_middle     @@ 1
        movs r2, #1             @@ 2
in_the_middle:
        movs r3, #1             @@ 3
        subs r4, #1             @@ 3
        bne.n turn              @@ 3 [1, 2]
        cbz r4, out             @@ 1 [0, 1]
        movs r0, #7             @@ 0
out:
        cmp r4, #0              @@ 1
        itt ne                  @@ 1 [1, 0]
        movne r0, #7            @@ 0
        popne {r4, pc}          @@ 0
        it eq                   @@ 1 [0, 1]
        popeq {r4, pc}          @@ 1
        movs r0, #7             @@ 0
        ends main
"""


@pytest.mark.parametrize("profile", ["cortex-m4-trm/1", "cortex-m4-trm/3"])
def test_what_an_it_block_skips_is_not_executed(build: Build, profile: str) -> None:
    elf = build(SKIPS)
    board, watch = watched(elf, profile=profile)
    board.run_until(LONG_ENOUGH_S)
    file = covered(board, watch, "program.S")
    text = ["", *SKIPS.splitlines()]
    expected = {line: item.partition("@@ ")[2] for line, item in enumerate(text) if "@@" in item}
    assert file.lines == {line: int(item.split()[0]) for line, item in expected.items()}
    assert {line: list(ways) for (line, _), ways in file.branches.items()} == {
        line: json.loads(item[item.index("[") :]) for line, item in expected.items() if "[" in item
    }
    assert file.functions == {"main": (3, 1)}
    unwatched = VirtualK64F(elf, profile=profile)
    unwatched.may_rest = True
    unwatched.run_until(LONG_ENOUGH_S)
    assert (board.cycles, board.instructions) == (unwatched.cycles, unwatched.instructions)


def test_library_code_is_left_out(shipped_board: VirtualK64F) -> None:
    coverage = SourceMap(shipped_board.image).coverage(ExecutionWatch(shipped_board.processor).code())
    assert all(name.startswith("firmware_stub/") for name in coverage.files)
    assert coverage.lines.hit == coverage.functions.hit == coverage.branches.hit == 0
    functions = {function for file in coverage.files.values() for function in file.functions}
    assert "main" in functions
    assert "sinf" not in functions
    assert "sinf" in shipped_board.image.symbols


FAULTS = """
int main(void)
{
    volatile int *nowhere = (volatile int *)0x60000000;
    volatile int before = 1, behind = 2;

    before = 3;
    behind = *nowhere;
    before = 4; behind = 5;
    return 0;
}
"""


def test_what_stands_behind_a_fault_is_not_executed(build_c: Build) -> None:
    board, watch = watched(build_c(FAULTS, "-O0"))
    with pytest.raises(BoardFault):
        board.run_until(LONG_ENOUGH_S)
    file = covered(board, watch, "program.c")
    assert [file.lines[line] for line in (7, 8, 9, 10)] == [1, 1, 0, 0]


OVERLAYS = """
#include <stdint.h>
static uint16_t buffer[2] __attribute__((aligned(4)));
volatile int sum;
int main(void)
{

    for (int k = 0; k < 3; k++) {
        buffer[0] = (uint16_t)(0x2000 | k); /* movs r0, #k */
        buffer[1] = 0x4770;                 /* bx lr */
        __asm volatile("dsb" ::: "memory");
        sum += 1 << 4 * ((int (*)(void))((uintptr_t)buffer | 1))();
    }
    return 0;
}
"""


def test_code_that_is_written_anew_runs_and_is_counted_on(build_c: Build) -> None:
    board, watch = watched(build_c(OVERLAYS))
    follow(board, {LONG_ENOUGH_S: {"sum": 0x111}})  # it has returned 0, 1 and 2
    code, buffer = watch.code(), board.image.symbols["buffer"].address
    assert [code.executed[buffer], code.executed[buffer + 2], code.jumped[buffer + 2]] == [3, 3, 3]
    assert watch.code() == code


def test_every_turn_of_a_loop_to_itself_counts(build_c: Build) -> None:
    board, watch = watched(build_c("int main(void) { for (;;) {} }"))
    board.run_until(LONG_ENOUGH_S)
    code = watch.code()
    assert sum(code.executed.values()) == board.instructions
    assert max(code.jumped.values()) > 10_000


def test_what_ran_before_a_reset_counts_too(build: Build) -> None:
    board, watch = watched(build(SKIPS))
    board.run_until(LONG_ENOUGH_S)
    board.reset()
    board.run_until(2 * LONG_ENOUGH_S)
    assert covered(board, watch, "program.S").functions == {"main": (3, 2)}


def test_an_image_without_lines_is_refused(build_c: Build) -> None:
    elf = build_c("int main(void) { return 0; }", "-g0")
    with pytest.raises(ConfigError, match=r"line table of .* is missing"):
        SourceMap(load_image(elf))


counts = st.integers(0, 10**12)
files = st.builds(
    FileCoverage,
    lines=st.dictionaries(st.integers(1, 99), counts),
    functions=st.dictionaries(st.sampled_from("abc"), st.tuples(st.integers(1, 99), counts)),
    branches=st.dictionaries(st.tuples(st.integers(1, 99), st.integers(0, 3)), st.tuples(counts, counts)),
)
coverages = st.builds(Coverage, st.dictionaries(st.sampled_from(["a.c", "/b/c:d,e.c"]), files))


@given(coverages)
def test_a_file_of_lcov_is_read_as_it_was_written(coverage: Coverage) -> None:
    assert from_lcov(to_lcov(coverage), "lcov.info") == coverage


def test_counts_of_two_runs_add_up() -> None:
    first = Coverage({"a.c": FileCoverage({1: 2, 2: 0}, {"f": (1, 2)}, {(1, 0): (2, 0)})})
    second = FileCoverage({1: 1, 2: 3}, {"f": (1, 1)}, {(1, 0): (0, 1)})
    first.add(Coverage({"a.c": second, "b.c": FileCoverage({9: 0})}))
    assert first == Coverage(
        {
            "a.c": FileCoverage({1: 3, 2: 3}, {"f": (1, 3)}, {(1, 0): (2, 1)}),
            "b.c": FileCoverage({9: 0}),
        }
    )
    assert (first.lines, first.functions, first.branches) == ((2, 3), (1, 1), (1, 1))
    assert to_lcov(first).splitlines()[:15] == [
        "TN:",
        "SF:a.c",
        "FN:1,f",
        "FNDA:3,f",
        "FNF:1",
        "FNH:1",
        "BRDA:1,0,0,2",
        "BRDA:1,0,1,1",
        "BRF:2",
        "BRH:2",
        "DA:1,3",
        "DA:2,3",
        "LF:2",
        "LH:2",
        "end_of_record",
    ]


@pytest.mark.parametrize("record", ["DA:1", "FN:main", "FNDA:1,f", "BRDA:1,0,2,-", "DA:1,x"])
def test_what_is_no_record_of_lcov_is_refused_with_its_line(record: str) -> None:
    with pytest.raises(ConfigError, match=r"lcov.info:2: .* is not an LCOV record"):
        from_lcov(f"SF:a.c\n{record}\n", "lcov.info")
