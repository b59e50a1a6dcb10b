"""Imports point one way: from what a user runs, over procedures and boards, down to physics and numbers."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import hiltest

# The table of which package may import which others: docs/architecture.md has it. Modules directly under hiltest that
# have no row (plugin, ...), and the packages named in APPLICATION, are what a user runs: they may import
# everything, and no row may name them.
PAGE = (Path(__file__).parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8")
(ARROWS,) = re.findall(r"^```arrows\n(.*?)^```", PAGE, re.M | re.S)
APPLICATION = frozenset({"commands"})
# Numbers in, numbers out: beside themselves and the standard library, only these.
PURE = frozenset(
    {
        "budgets",
        "errors",
        "state",
        "text",
        "measurement",
        "calibration",
        "orientation",
        "world",
    }
)
NUMERICAL = frozenset({"numpy", "scipy"})


def table() -> dict[str, frozenset[str]]:
    rows = (line.split("->") for line in ARROWS.splitlines() if line.strip())
    return {name.strip(): frozenset(targets.split()) for name, targets in rows}


@dataclass(frozen=True)
class Import:
    """One module imports another: `target` is the deepest module that the statement names."""

    source: str
    target: str
    line: int
    for_types_only: bool

    def __str__(self) -> str:
        return f"{self.source}:{self.line} imports {self.target}"


def modules_under(folder: Path) -> dict[str, Path]:
    """Return every module of a package folder by its dotted name.

    An installed package has a copy of hil/ in its folder "bench": suites, which nothing imports.
    """
    results = {}
    for path in sorted(folder.rglob("*.py")):
        if path.is_relative_to(folder / "bench"):
            continue
        parts = path.relative_to(folder.parent).with_suffix("").parts
        results[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return results


def imports_of(modules: dict[str, Path]) -> Iterator[Import]:
    for name, path in modules.items():
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for_types = set(nodes_for_types_only(tree))
        for node in ast.walk(tree):
            for target in named_in(node, package, modules):
                yield Import(name, target, getattr(node, "lineno", 0), node in for_types)


def nodes_for_types_only(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            for statement in node.body:
                yield from ast.walk(statement)


def named_in(node: ast.AST, package: str, modules: dict[str, Path]) -> Iterator[str]:
    """Yield the modules that an import statement names, relative ones made absolute."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*above, base] if base else above)
        for alias in node.names:
            inner = f"{base}.{alias.name}"
            yield inner if inner in modules else base


def unit(module: str) -> str:
    """Return the row a module of the package belongs to: the part after the package's name."""
    return module.partition(".")[2].partition(".")[0]


def room(module: str) -> str:
    """Return the room a module of a divided package belongs to: the two parts after the package's name."""
    return ".".join(module.split(".")[1:3])


def complaints(folder: Path) -> list[str]:
    """Return every import in a package folder that the table does not allow, and every cycle."""
    modules = modules_under(folder)
    rows, package = table(), folder.name
    packages = {unit(name) for name, path in modules.items() if name.count(".") > 1 or path.name == "__init__.py"}
    results = [
        f"package {item} has no row in the table: say what it may import"
        for item in sorted(packages - rows.keys() - APPLICATION - {""})
    ]
    divided = {name.partition(".")[0] for name in rows if "." in name}
    rooms = {room(name) for name in modules if unit(name) in divided and name.count(".") > 1}
    results += [f"room {name} has no row in the table: say what it may import" for name in sorted(rooms - rows.keys())]
    runtime: dict[str, set[str]] = {name: set() for name in modules}
    for item in imports_of(modules):
        source = unit(item.source)
        top = item.target.split(".")[0]
        if top == package:
            if not item.for_types_only and item.target in modules:
                runtime[item.source].add(item.target)
            target = unit(item.target)
            if source in rows and target not in rows[source] | {source, ""}:
                results.append(f"{item}: {source} may import {' '.join(sorted(rows[source])) or 'nothing'}")
            inner, inner_target = room(item.source), room(item.target)
            if "." in inner and inner in rows and source == target and inner_target not in rows[inner] | {inner}:
                results.append(f"{item}: {inner} may import {' '.join(sorted(rows[inner])) or 'nothing'}")
        elif source in PURE and top not in NUMERICAL | sys.stdlib_module_names:
            results.append(f"{item}: {source} is pure, with {' and '.join(sorted(NUMERICAL))} at most")
    try:
        TopologicalSorter(runtime).prepare()
    except CycleError as error:
        results.append(f"import cycle: {' <- '.join(error.args[1])}")
    return results


def test_every_import_of_the_package_follows_the_table():
    assert complaints(Path(hiltest.__file__).parent) == []


def test_the_walk_sees_the_package():
    modules = modules_under(Path(hiltest.__file__).parent)
    arrows = {(item.source, item.target) for item in imports_of(modules)}
    # At the top of a file, in a function, and for types only.
    assert ("hiltest.boards.bench", "hiltest.virtual.board.k64f") in arrows
    assert ("hiltest.rig.rig", "hiltest.world") in arrows
    assert ("hiltest.session.fixtures", "hiltest.boards") in arrows
    rows = {name(source) for source, _ in arrows for name in (unit, room)}
    assert rows >= table().keys() - {"errors", "virtual.model"}


def test_the_table_itself_points_one_way():
    rows = table()
    TopologicalSorter(rows).prepare()
    assert {target for targets in rows.values() for target in targets} <= rows.keys()
    assert not {target for name in PURE for target in rows[name]} - PURE


GOOD = {
    "__init__.py": "",
    "errors.py": "import enum\n",
    "orientation/__init__.py": "",
    "orientation/angles.py": "import numpy as np\n",
    "calibration/__init__.py": "from hiltest.calibration.fit import Fit\n",
    "calibration/fit.py": "import scipy.linalg\nfrom ..errors import HiltestError\n",
    "link/__init__.py": "",
    "link/session.py": "import serial\nfrom hiltest.calibration.fit import Fit\n",
    "boards/__init__.py": "from hiltest.boards.real import RealBoard\n",
    "boards/real.py": "from hiltest.orientation import angles\nfrom hiltest.link.session import Session\n",
    "commands/__init__.py": "",
    "commands/run.py": "from hiltest.session import start\n",
    "session.py": "import pytest\nfrom hiltest import boards\n",
}


def tree(folder: Path, changes: dict[str, str]) -> Path:
    for name, text in (GOOD | changes).items():
        path = folder / "hiltest" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder / "hiltest"


def test_a_tree_whose_arrows_are_right_has_no_complaint(tmp_path):
    assert complaints(tree(tmp_path, {})) == []


@pytest.mark.parametrize(
    ("module", "text", "complaint"),
    [
        ("link/session.py", "from hiltest.boards.real import RealBoard", "link.session:1 imports hiltest.boards.real"),
        ("link/session.py", "from hiltest import boards", "link.session:1 imports hiltest.boards"),
        ("link/session.py", "import hiltest.boards as b", "link.session:1 imports hiltest.boards"),
        ("link/session.py", "from ..boards import real", "link.session:1 imports hiltest.boards.real"),
        ("link/session.py", "def f():\n    import hiltest.boards.real", "link.session:2 imports hiltest.boards.real"),
        (
            "link/session.py",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from hiltest.boards.real import RealBoard",
            "link.session:3 imports hiltest.boards.real: link may import budgets calibration errors",
        ),
        ("boards/real.py", "from hiltest.session import start", "boards.real:1 imports hiltest.session"),
        ("boards/real.py", "from hiltest.commands import run", "boards.real:1 imports hiltest.commands.run"),
        (
            "errors.py",
            "from hiltest.orientation import angles",
            "errors:1 imports hiltest.orientation.angles:",
        ),
        ("calibration/fit.py", "import pytest", "calibration.fit:1 imports pytest: calibration is pure"),
        ("calibration/fit.py", "from serial.tools import list_ports", "calibration.fit:1 imports serial.tools"),
        ("orientation/angles.py", "def f():\n    import serial", "angles:2 imports serial: orientation is pure"),
        ("study/__init__.py", "", "package study has no row"),
        ("virtual/study/__init__.py", "", "room virtual.study has no row"),
        ("virtual/calls/watch.py", "import hiltest.virtual.board", "virtual.calls.watch:1 imports hiltest.virtual"),
    ],
)
def test_a_turned_arrow_is_named_with_module_and_line(tmp_path, module, text, complaint):
    result = complaints(tree(tmp_path, {module: text}))
    assert any(complaint in item for item in result), result


def test_a_cycle_within_a_package_is_found_and_one_for_types_is_none(tmp_path):
    back = "from hiltest.link.session import Session\n"
    (cycle,) = complaints(
        tree(
            tmp_path,
            {
                "link/frames.py": back,
                "link/session.py": "def f():\n    from hiltest.link import frames\n",
            },
        )
    )
    assert cycle.startswith("import cycle: ")
    assert {"hiltest.link.frames", "hiltest.link.session"} == set(cycle.removeprefix("import cycle: ").split(" <- "))
    for_types = "import typing\nif typing.TYPE_CHECKING:\n    from hiltest.link import frames\n"
    assert complaints(tree(tmp_path, {"link/frames.py": back, "link/session.py": for_types})) == []
