"""Links between the pages lead to files and headings, and no page or option of a command is missing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hiltest.commands.cli import every_command

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "firmware_stub").rglob("*.md")])

PAGES_OF_COMMANDS = {name: name for name in ("bisect", "flash", "profile", "serve")}
PAGES_OF_COMMANDS |= {"report": "record", "report export": "trend", "report trend": "trend", "profile worst": "worst"}


def anchors(page: Path) -> set[str]:
    """The names that GitHub gives a page's headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def is_dead(page: Path, link: str) -> bool:
    name, _, anchor = link.partition("#")
    target = page.parent / name if name else page
    return not target.exists() or bool(anchor and anchor not in anchors(target))


def test_every_link_leads_somewhere() -> None:
    links = [(page, link) for page in PAGES for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8"))]
    assert [(page.name, link) for page, link in links if "://" not in link and is_dead(page, link)] == []


@pytest.mark.parametrize(("command", "page"), PAGES_OF_COMMANDS.items())
def test_the_page_of_a_command_names_its_options(command: str, page: str) -> None:
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    options = [max(option.opts, key=len) for option in dict(every_command())[command].params]
    assert [option for option in options if option.startswith("--") and option not in text] == []


def test_the_index_has_every_page() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    pages = {page.name for page in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert pages <= set(re.findall(r"\]\(([\w-]+\.md)\)", index))
