"""Options, their ini and environment twins, the marker, and what an unused plugin costs."""

from __future__ import annotations

import pytest
from tests.heavy_imports import HEAVY

from hiltest.session.settings import OPTIONS

SHOW = """
    def test_it(hil_settings):
        for name in ("rig", "firmware", "port", "out", "seed", "poses", "suite", "calibration", "baseline"):
            print(f"{name}={getattr(hil_settings, name)} from {hil_settings.sources[name]}")
"""


@pytest.mark.parametrize("option", OPTIONS, ids=lambda option: option.name)
def test_help_shows_every_option_with_its_argument(pytester: pytest.Pytester, option: object) -> None:
    result = pytester.runpytest_inprocess("--help")
    assert isinstance(option, type(OPTIONS[0]))
    result.stdout.fnmatch_lines(["hardware-in-the-loop*"])
    result.stdout.re_match_lines([rf"  {option.flag}={option.metavar.replace('|', '.')}\b"])
    result.stdout.re_match_lines([rf"  {option.ini} \(string\):"])


def test_the_markers_are_registered_and_strict(pytester: pytest.Pytester) -> None:
    pytester.runpytest_inprocess("--markers").stdout.fnmatch_lines(
        [
            "@pytest.mark.hil: the test needs a board;*",
            "",
            "@pytest.mark.full: *left out of the gate set*",
        ]
    )
    pytester.makepyfile("import pytest\n\n@pytest.mark.hill\ndef test_it():\n    pass\n")
    result = pytester.runpytest_inprocess("--strict-markers")
    result.stdout.fnmatch_lines(["*'hill' not found in `markers`*"])


def test_the_command_line_wins_over_environment_ini_and_default(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytester.makepyfile(SHOW)
    pytester.makeini("[pytest]\nhil_seed = 3\nhil_poses = level\nhil_port = socket://ini:1\n")
    monkeypatch.delenv("HIL_RIG")
    monkeypatch.setenv("HIL_SEED", "2")
    monkeypatch.setenv("HIL_POSES", "all")
    pytester.runpytest_inprocess("-s", "--hil-seed=1").stdout.fnmatch_lines(
        [
            "*rig=None from default",
            "port=socket://ini:1 from hil_port",
            "seed=1 from --hil-seed",
            "poses=all from HIL_POSES",
            "suite=gate from default",
        ]
    )


@pytest.mark.parametrize("value", ["-1", "1.5", "x", "4294967296", ""])
def test_a_seed_that_is_none_is_a_usage_error(pytester: pytest.Pytester, value: str) -> None:
    result = pytester.runpytest_inprocess(f"--hil-seed={value}")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*--hil-seed: * is not a seed*"])


def test_a_bad_value_in_the_environment_names_the_variable(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_POSES", "some")
    result = pytester.runpytest_inprocess()
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: HIL_POSES: 'some' is not one of 'all', 'level'"])


def test_a_suite_that_is_none_is_a_usage_error(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_SUITE", "quick")
    result = pytester.runpytest_inprocess()
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: HIL_SUITE: 'quick' is not one of 'gate', 'full'"])


def test_without_the_plugin_its_options_are_unknown(pytester: pytest.Pytester) -> None:
    result = pytester.runpytest_subprocess("-p", "no:hiltest", "--hil-seed=1")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    pytester.makepyfile("def test_it():\n    pass\n")
    pytester.runpytest_subprocess("-p", "no:hiltest").assert_outcomes(passed=1)


def test_a_project_with_its_own_board_fixture_is_left_alone(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("""
        import pytest

        @pytest.fixture
        def board():
            return "chess"

        def test_it(board):
            assert board == "chess"
    """)
    result = pytester.runpytest_inprocess("--hil-rig=no-such-rig.toml")
    result.assert_outcomes(passed=1)
    result.stdout.no_fnmatch_line("*hiltest:*")
    assert not (pytester.path / "hil-out").exists()


def test_an_unused_plugin_imports_nothing_heavy(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_it():\n    pass\n")
    pytester.makeconftest(f"""
        import sys

        def pytest_unconfigure():
            print("hiltest" in sys.modules, [name for name in {HEAVY!r} if name in sys.modules])
    """)
    result = pytester.runpytest_subprocess("-s", "-p", "no:benchmark")
    result.stdout.fnmatch_lines(["*True []"])


def test_an_unknown_variable_of_the_environment_is_a_usage_error_that_names_the_nearest(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HIL_BASLINE", "kept.json")
    pytester.makepyfile(test_of_a_project="def test_it():\n    pass\n")
    assert pytester.runpytest_inprocess().ret == 0  # nothing here uses hiltest
    pytester.makepyfile(test_lamp="def test_it(measure):\n    pass\n")
    result = pytester.runpytest_inprocess()
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: the environment: unknown key 'HIL_BASLINE'; did you mean 'HIL_BASELINE'?"])
    assert not (pytester.path / "hil-out").exists()
    monkeypatch.delenv("HIL_BASLINE")
    monkeypatch.setenv("HILTEST_REQUIRE_TOOLS", "1")
    assert pytester.runpytest_inprocess().ret == 0


@pytest.mark.parametrize("characters", [255, 300])
def test_a_name_that_no_folder_can_have_is_a_usage_error(pytester: pytest.Pytester, characters: int) -> None:
    pytester.makepyfile("def test_it(measure):\n    pass\n")
    result = pytester.runpytest_inprocess(f"--hil-out={'x' * characters}")
    if characters == 255:
        assert result.ret == 0
        return
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*--hil-out: a name of 300 bytes is too long: file names have at most 255 bytes"])


def test_modules_of_the_package_are_imported_as_they_are_and_tests_with_rewritten_assertions(
    pytester: pytest.Pytester,
) -> None:
    pytester.makepyfile("""
        from hiltest import measurement

        def test_it():
            assert type(measurement.__spec__.loader).__name__ == "SourceFileLoader"
            assert type(__spec__.loader).__name__ == "AssertionRewritingHook"
    """)
    pytester.runpytest_subprocess("-p", "hiltest").assert_outcomes(passed=1)
