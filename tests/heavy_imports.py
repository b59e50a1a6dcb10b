"""Packages that take long to import: what does not need them must not wait for them."""

from __future__ import annotations

HEAVY = (
    "numpy",
    "scipy",
    "pydantic",
    "cffi",
    "capstone",
    "elftools",
    "serial",
    "jinja2",
    "rich",
    "click",
    "hiltest.boards",
    "hiltest.measurement",
    "hiltest.rig.rig",
)
