"""Outcomes of tests."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

_OLDER_WORDS = {"bench lost": "connection lost"}
"""Words of older records, and the current ones."""


class TestOutcome(StrEnum):
    """Outcome of a test: those of pytest, and two for faults of the bench or the firmware."""

    __test__ = False  # pytest takes the class for a test class because of its name

    PASSED = "passed"
    FAILED = "failed"
    ERROR = "error"
    """The test failed outside its own function, as in a fixture."""
    SKIPPED = "skipped"
    XFAILED = "xfailed"
    """The test failed as its mark predicted."""
    XPASSED = "xpassed"
    RERUN = "rerun"
    """An attempt that pytest-rerunfailures repeated."""
    CONNECTION_LOST = "connection lost"
    WRONG_FIRMWARE = "wrong firmware"

    @classmethod
    def _missing_(cls, value: object) -> TestOutcome | None:
        word = _OLDER_WORDS.get(value) if isinstance(value, str) else None
        return cls(word) if word else None

    @classmethod
    def __get_pydantic_json_schema__(cls, core: Any, handler: Any) -> Any:
        """Let the schema of ``run.json`` accept the words of older records."""
        schema = handler.resolve_ref_schema(handler(core))
        schema["enum"] = [*map(str, cls), *_OLDER_WORDS]
        return schema

    @property
    def is_of_bench(self) -> bool:
        """True if the bench or the firmware ended the test."""
        return self in (TestOutcome.CONNECTION_LOST, TestOutcome.WRONG_FIRMWARE)

    @property
    def has_run(self) -> bool:
        """True if the test function ran, and its result counts."""
        return self not in (TestOutcome.SKIPPED, TestOutcome.XFAILED, TestOutcome.RERUN)

    @property
    def came_to_its_end(self) -> bool:
        """True if the test made all its measurements: it neither failed nor lost its board."""
        return self not in RED and not self.is_of_bench


RED = frozenset({TestOutcome.FAILED, TestOutcome.ERROR})
"""Outcomes of a test that failed by its own fault."""
