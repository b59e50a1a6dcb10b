"""The frame of a sensor of one's own: module, register table, test, and a project with its entry point."""

from __future__ import annotations

import keyword
import re
import sys
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.rig.parts import MODELS, PARTS

_TEMPLATES = Path(__file__).with_name("sensor_template")
_NAME = re.compile(r"[a-z][a-z0-9_]{1,40}")
_FILES = {"model.py": "{}.py", "table.toml": "{}.toml", "test.py": "test_{}.py", "pyproject.toml": "pyproject.toml"}


def write_sensor_frame(name: str, folder: Path) -> list[Path]:
    """Write the files of a sensor's plugin into a folder.

    Raises
    ------
    ConfigError
        If the name is wrong or taken, or a file already exists or cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(
            f"--sensor {name}: the name becomes a module: use small letters, digits and _, such as ak8963"
        )
    if keyword.iskeyword(name) or name in (*sys.stdlib_module_names, "hiltest", "pytest"):
        raise ConfigError(
            f"--sensor {name}: Python has a word or a module of this name: add the maker, as in st_{name}"
        )
    if name in (*MODELS, *PARTS):
        raise ConfigError(f"--sensor {name}: hiltest has this part already: a rig names it under [[sensors.parts]]")
    files = {folder / file.format(name): template for template, file in _FILES.items()}
    if present := [file for file in files if file.exists()]:
        raise ConfigError(f"{present[0]} already exists; nothing was written. Choose another folder, or move it away")
    words = {"MODULE": name, "CLASS": name.title().replace("_", ""), "PART": name.upper()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, template in files.items():
            text = (_TEMPLATES / f"{template}.txt").read_text(encoding="utf-8")
            for word, replacement in words.items():
                text = re.sub(rf"\b{word}\b", replacement, text)
            file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write to {folder}: {error.strerror}. Choose a writable folder") from error
    return [*files]
