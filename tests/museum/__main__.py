"""Renew the table of docs/museum.md: ``python -m tests.museum``, two minutes."""

from __future__ import annotations

import tempfile
from pathlib import Path

from ..end_to_end.firmware_edits import FirmwareCopy
from .exhibits import PAGE, exhibits, page_row, visit


def main() -> None:
    """Run every exhibit, and write its row below the head of the table."""
    with tempfile.TemporaryDirectory() as folder:
        firmware, rows = FirmwareCopy(Path(folder)), []
        for exhibit in exhibits():
            bench = Path(folder) / exhibit.name
            bench.mkdir()
            rows.append(page_row(exhibit, visit(firmware, exhibit.edit, bench)))
            print(rows[-1], flush=True)
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    head = lines[: 1 + next(number for number, line in enumerate(lines) if line.startswith("| --- |"))]
    PAGE.write_text("\n".join([*head, *rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
