"""Builds the libraries in C into the wheel where there is a compiler; without one the wheel is pure Python."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from packaging.tags import sys_tags

_BUILD = "src/hiltest/c_library.py"


class NativeBlockHook(BuildHookInterface):
    """Adds the shared libraries, which fit every Python of this platform."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile them beside their sources, from where an editable install uses them."""
        root = Path(self.root)
        spec = importlib.util.spec_from_file_location("c_library", root / _BUILD)
        assert spec is not None
        assert spec.loader is not None
        build = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(build)
        for library, sources in build.SOURCES.items():
            reason = build.compiled(library, sources)
            if reason:
                self.app.display_warning(f"no {library.stem} in C, and what it does is slower in Python: {reason}")
            else:
                build_data["artifacts"].append(str(library.relative_to(root)))
        if not build_data["artifacts"]:
            return
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{_platform()}"


def _platform() -> str:
    """Name this platform without a promise to older ones (manylinux): the library was linked here."""
    return next(tag.platform for tag in sys_tags() if "manylinux" not in tag.platform)
