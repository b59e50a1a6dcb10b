"""The run written by hand."""

from ..written_run import board, findings, good, heading

__all__ = ["board", "findings", "good", "heading"]
