"""The pytest plugin: hooks only. What they do lives in the modules they call."""

from __future__ import annotations
