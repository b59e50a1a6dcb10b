"""Builds the libraries in C into the wheel: the virtual board's core, which is required, and those that save time."""

from __future__ import annotations

import importlib.util
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from packaging.tags import sys_tags

_BUILD = "src/hiltest/virtual/core/c_library.py"


class NativeLibrariesHook(BuildHookInterface):
    """Adds the shared libraries, which fit every Python of this platform."""

    PLUGIN_NAME = "custom"

    @cached_property
    def _build(self) -> ModuleType:
        """The package's module that compiles, which cannot be imported before the package is installed."""
        spec = importlib.util.spec_from_file_location("c_library", Path(self.root, _BUILD))
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    def dependencies(self) -> list[str]:
        """Ask for zig's compiler if no other one works; pip, build and tox install it for the build alone."""
        return self._build.build_requirements()

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile them beside their sources, from where an editable install uses them."""
        build = self._build
        built = [build.CORE, build.CORE_BINDING]
        if reason := build.build_core():
            self.app.abort(f"the virtual board's core in C was not built: {reason}")
        for library, sources in build.SOURCES.items():
            if library in built:
                continue
            if reason := build.compiled(library, sources):
                self.app.display_warning(f"no {library.stem} in C, and what it does is slower in Python: {reason}")
            else:
                built.append(library)
        build_data["artifacts"].extend(str(path.relative_to(self.root)) for path in built)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{_platform(build)}"


def _platform(build: ModuleType) -> str:
    """Name the platform: that of a release, or this one without a promise to older ones."""
    if name := build.release_architecture():
        return f"manylinux_{'_'.join(map(str, build.RELEASE_GLIBC))}_{name}"
    return next(tag.platform for tag in sys_tags() if "manylinux" not in tag.platform)
