"""Builds the block hook in C into the wheel where there is a compiler; without one the wheel is pure Python."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from packaging.tags import sys_tags

_BUILD = "src/hiltest/virtual/native/build.py"


class NativeBlockHook(BuildHookInterface):
    """Adds the shared library, which fits every Python of this platform."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile it beside its source, from where an editable install uses it."""
        root = Path(self.root)
        spec = importlib.util.spec_from_file_location("native_build", root / _BUILD)
        assert spec is not None
        assert spec.loader is not None
        build = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(build)
        reason = build.compile_library()
        if reason:
            self.app.display_warning(f"the virtual board will count in Python, which is slower: {reason}")
            return
        build_data["artifacts"].append(str(build.LIBRARY.relative_to(root)))
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{_platform()}"


def _platform() -> str:
    """Name this platform without a promise to older ones (manylinux): the library was linked here."""
    return next(tag.platform for tag in sys_tags() if "manylinux" not in tag.platform)
