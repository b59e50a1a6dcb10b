"""The record of a real run."""

from ..verdict.conftest import real_record

__all__ = ["real_record"]
