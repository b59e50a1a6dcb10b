"""Profiles of functions of an ELF: as tables, flame graphs and JSON documents."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiltest.lazy_exports import when_used

if TYPE_CHECKING:
    from hiltest.virtual.profiling.document import ProfileDocument
    from hiltest.virtual.profiling.image import ProfiledImage

__all__ = ["ProfileDocument", "ProfiledImage"]

__getattr__ = when_used(
    __name__,
    {
        "ProfileDocument": "document",
        "ProfiledImage": "image",
    },
)
