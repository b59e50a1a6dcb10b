"""docs/api.md names what `import hiltest` gives, the fixtures and the hooks, and its examples run."""

from __future__ import annotations

import inspect
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import hiltest
from hiltest import hookspecs, plugin
from hiltest.boards import default_firmware

PAGE = (Path(__file__).parents[2] / "docs" / "api.md").read_text(encoding="utf-8")
SCRIPT, SUITE, HOOKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)


def named_under(heading: str) -> list[str]:
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"^\| `(?:hiltest\.)?([\w]+)", section, re.M)


def test_every_public_name_is_on_the_page_and_every_name_on_it_is_there() -> None:
    assert sorted(named_under("Names")) == sorted(hiltest.__all__)
    assert [name for name in hiltest.__all__ if getattr(hiltest, name, None) is None] == []
    with pytest.raises(AttributeError, match="has no attribute 'Bord'"):
        _ = hiltest.Bord


def test_every_fixture_and_every_hook_is_on_the_page() -> None:
    assert sorted(named_under("Fixtures")) == sorted(plugin.__all__)
    hooks = [name for name, _ in inspect.getmembers(hookspecs, inspect.isfunction) if name.startswith("pytest_")]
    assert sorted(named_under("Hooks")) == hooks


def test_the_public_names_are_imported_when_they_are_used() -> None:
    program = "import sys, hiltest; print('numpy' in sys.modules); hiltest.VirtualK64F; print('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]


def test_the_script_counts_the_same_cycles_both_ways(tmp_path: Path) -> None:
    shutil.copy(default_firmware(), tmp_path / "app.elf")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    called, profiled = done.stdout.splitlines()
    assert profiled.startswith(f"{called} cycles of cortex-m4-trm/3")
    assert int(called) > 0


def test_the_tests_and_the_hooks_run_as_they_stand(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_board=SUITE)
    pytester.makeconftest(HOOKS)
    result = pytester.runpytest_subprocess("-s")
    result.assert_outcomes(passed=2)
    assert result.ret == 0
    result.stdout.fnmatch_lines(["*build *: PASS*"])
    pytester.makepyfile(test_board=SUITE.replace("min=1", "min=1000"))
    pytester.runpytest_subprocess("-s").stdout.fnmatch_lines(["*test_slots: board.slots = *, limit at least 1*fail"])
