"""A lost connection and wrong firmware are outcomes of their own, and failed tests stay failed tests."""

from __future__ import annotations

import json

import pytest

HEAD = "from hiltest.errors import LinkLostError, VersionMismatchError\n\n"


def outcomes_of(pytester: pytest.Pytester) -> dict[str, str]:
    record = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    return {test["id"].split("::")[-1]: test["outcome"] for test in record["tests"]}


def test_a_lost_link_is_no_failed_test(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        HEAD
        + """
def test_before(measure):
    measure("x", 1, "")

def test_lost(measure):
    measure("y", 2, "")
    raise LinkLostError("/dev/ttyACM0", "unplugged")
"""
    )
    result = pytester.runpytest_inprocess()
    assert result.ret == 20
    result.stdout.fnmatch_lines(
        [
            "*.L*",
            "CONNECTION LOST: lost /dev/ttyACM0: unplugged. Check cable and power, then run*",
            "*connection lost: *::test_lost",
            "*1 passed, 1 connection lost*",
        ]
    )
    assert " ".join(result.outlines).count("unplugged") == 1, "the sentence has said why"
    assert outcomes_of(pytester) == {"test_before": "passed", "test_lost": "connection lost"}


def test_a_lost_link_in_a_fixture_is_the_same(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        HEAD
        + """
import pytest

@pytest.fixture
def points():
    raise LinkLostError("/dev/ttyACM0", "unplugged")

def test_lost(points, measure):
    pass
"""
    )
    assert pytester.runpytest_inprocess("-v").ret == 20
    assert outcomes_of(pytester) == {"test_lost": "connection lost"}


def test_wrong_firmware_wins_over_a_lost_bench_and_a_failed_test_over_both(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        test_them=HEAD
        + """
def test_lost(measure):
    raise LinkLostError("p", "gone")

def test_wrong(measure):
    raise VersionMismatchError("speaks protocol 2")

def test_failed(measure):
    assert False
"""
    )
    assert pytester.runpytest_inprocess("-k", "test_lost").ret == 20
    both = pytester.runpytest_inprocess("-k", "test_lost or test_wrong")
    assert both.ret == 23
    both.stdout.fnmatch_lines(["*connection lost: *::test_lost", "*wrong firmware: *::test_wrong: speaks protocol 2*"])
    assert outcomes_of(pytester) == {"test_lost": "connection lost", "test_wrong": "wrong firmware"}
    assert pytester.runpytest_inprocess().ret == 1


def test_what_several_tests_lack_is_said_once(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
from hiltest.errors import OperatorAbsentError

import pytest

@pytest.mark.parametrize("question", ["lie still: ", "turn it: ", "turn it: "])
def test_by_hand(measure, question):
    raise OperatorAbsentError.asked(question)
""")
    result = pytester.runpytest_inprocess()
    assert result.ret == 20
    answer = " ".join(" ".join(result.outlines).split())
    assert [answer.count(f"at the terminal: {asked}. Run the") for asked in ("lie still", "turn it")] == [1, 1]
    assert "test_by_hand[turn it: 0] and 1 more: no operator answered" in answer


def test_stopping_at_the_first_failure_keeps_the_code_of_a_lost_bench(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(HEAD + "def test_lost(measure):\n    raise LinkLostError('p', 'gone')\n")
    assert pytester.runpytest_inprocess("-x").ret == 20


def test_no_tests_is_still_5(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it(measure):\n    pass\n")
    assert pytester.runpytest_inprocess("-k", "nothing").ret == pytest.ExitCode.NO_TESTS_COLLECTED


def test_skips_and_expected_failures_are_no_failures(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        import pytest

        def test_skipped(measure):
            pytest.skip("not today")

        @pytest.mark.xfail(reason="known")
        def test_expected(measure):
            assert False
    """)
    assert pytester.runpytest_inprocess().ret == 0
    assert outcomes_of(pytester) == {"test_skipped": "skipped", "test_expected": "xfailed"}


def test_a_failing_teardown_is_an_error(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        import pytest

        @pytest.fixture
        def lamp():
            yield
            raise RuntimeError("stuck")

        def test_it(lamp, measure):
            pass
    """)
    assert pytester.runpytest_inprocess().ret == 1
    assert outcomes_of(pytester) == {"test_it": "error"}


def test_a_test_without_hiltest_fails_as_any_other_does(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        from hiltest.errors import VersionMismatchError

        def test_of_a_project():
            raise VersionMismatchError("not the board of this session")
        """
    )
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*raise VersionMismatchError*"])
    assert result.ret == 1


def test_an_error_of_a_fixture_that_tests_share_is_told_once(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CI", raising=False)  # where pytest's own short summary repeats each message whole
    pytester.makepyfile(
        test_lamp="""
import pytest

from hiltest.errors import FirmwareContradictionError

@pytest.fixture(scope="module")
def points(board):
    raise FirmwareContradictionError("the firmware contradicts itself")

@pytest.mark.hil
@pytest.mark.parametrize("number", range(3))
def test_them(points, number, measure):
    measure("lamp.bright", number, "")
"""
    )
    result = pytester.runpytest_inprocess("-q")
    output = " ".join(result.stdout.str().split())
    assert result.ret == 1
    assert "FAIL: 3 tests failed." in output
    assert output.count("test_lamp.py::test_them[0] and 2 more: the firmware contradicts itself Next: ") == 1
    assert output.count("which shares the fixture") == 2
    assert output.count("raise FirmwareContradictionError") == 1
