"""The set-up of CONTRIBUTING.md installs all packages of the tests, with tox and without it."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from configparser import ConfigParser
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OWN = {"hiltest", "tests", "hil", "conftest"}
# A fuzzer that only `tox -e reliability` has.
ELSEWHERE = {"atheris"}


def distributions(requirements: list[str]) -> set[str]:
    return {re.split(r"[<>=\[;!~ ]", text)[0].lower().replace("_", "-") for text in requirements}


def test_the_set_up_and_tox_install_one_list_of_packages() -> None:
    assert ".venv/bin/pip install -e '.[tests]' tox" in PAGE
    tox = ConfigParser()
    tox.read(ROOT / "tox.ini", encoding="utf-8")
    running_tests = [tox[name] for name in tox.sections() if "pytest -W" in tox[name].get("commands", "")]
    assert len(running_tests) > 5
    assert {section.get("extras") for section in running_tests} == {"tests"}


def test_every_package_that_a_test_imports_at_its_top_is_installed_by_the_set_up() -> None:
    installed = distributions([*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["tests"]])
    missing: dict[str, str] = {}
    by_module = packages_distributions()
    for file in sorted((ROOT / "tests").rglob("*.py")):
        for node in ast.parse(file.read_bytes()).body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
            for name in {name.partition(".")[0] for name in names} - OWN - ELSEWHERE - set(sys.stdlib_module_names):
                owners = {owner.lower().replace("_", "-") for owner in by_module.get(name, [name])}
                if not owners & installed:
                    missing[name] = str(file.relative_to(ROOT))
    assert missing == {}
