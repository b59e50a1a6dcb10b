"""Count words and names that the rules of CONTRIBUTING.md forbid: ``python -m tests.plain_english``.

A count above its limit ends with exit code 1; ``-v`` prints the places. A limit is lowered when a count falls, and
never raised.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
PRONOUNS_AND_PARTICIPLES = {
    "each",
    "found",
    "said",
    "known",
    "left",
    "kept",
    "given",
    "them",
    "these",
    "those",
    "what",
    "wanted",
    "told",
    "seen",
    "taken",
    "made",
    "here",
    "there",
}
PREPOSITIONS = {"of", "in", "at", "by", "with", "for", "on", "behind", "beside", "without", "within"}
BEGINNINGS = {"Of", "What", "Where", "Whether", "None"}


@dataclass
class Count:
    """How often a rule is broken, and where.

    `limit` is the largest share of `of_all` that passes.
    """

    rule: str
    limit: float
    of_all: int = 0
    places: list[str] = field(default_factory=list)

    @property
    def share(self) -> float:
        """Part of all places that break the rule."""
        return len(self.places) / max(self.of_all, 1)

    @property
    def passes(self) -> bool:
        """Whether the share is within its limit."""
        return self.share <= self.limit


def assigned_names(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield variables, parameters and attributes that are assigned, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, node.lineno


def docstrings(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield the texts of modules, classes, functions and fields, with their lines."""
    for node in ast.walk(tree):
        for statement in getattr(node, "body", []) if not isinstance(node, ast.Lambda | ast.IfExp) else []:
            is_text = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            if is_text and isinstance(statement.value.value, str):
                yield statement.value.value, statement.lineno


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a text, roughly: up to a full stop, or a paragraph long."""
    prose = re.sub(r"```.*?```|``?[^`]*``?|^\s*\|.*$|^ *[\w*, ]+ : .*$", " ", text, flags=re.DOTALL | re.MULTILINE)
    for paragraph in re.split(r"\n\s*\n|\n-{3,}\n|\n\s*[-*] ", prose):
        yield from re.split(r"(?<=[.!?:])\s+", " ".join(paragraph.split()))


def count_all() -> list[Count]:
    """Return the counts over the package, its tests, the pages and their sources."""
    names = Count("names that are pronouns or participles", limit=0.001)
    names_in_tests = Count("names in tests that are pronouns or participles", limit=0.0066)
    functions = Count("functions that are named by a preposition", limit=0.001)
    word_what = Count("'what' among the words of pages and docstrings", limit=0.001)
    begun = Count("sentences that begin with Of, What, Where, Whether or None", limit=0.004)

    def read_text(text: str, place: str) -> None:
        words = re.findall(r"[A-Za-z']+", text.lower())
        word_what.of_all += len(words)
        word_what.places += [place] * words.count("what")
        for sentence in filter(None, sentences(text)):
            begun.of_all += 1
            if sentence.split()[0] in BEGINNINGS and not sentence.endswith("?"):
                begun.places.append(f"{place}: {sentence[:80]}")

    def read_names(tree: ast.AST, place: str, count: Count) -> None:
        for name, line in assigned_names(tree):
            count.of_all += 1
            if name.strip("_") in PRONOUNS_AND_PARTICIPLES:
                count.places.append(f"{place}:{line}: {name}")

    for path in sorted((ROOT / "tests").rglob("*.py")):
        read_names(ast.parse(path.read_text(encoding="utf-8")), str(path.relative_to(ROOT)), names_in_tests)
    for path in sorted([*(ROOT / "src/hiltest").rglob("*.py"), *(ROOT / "hil").rglob("*.py")]):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        place = str(path.relative_to(ROOT))
        read_names(tree, place, names)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                functions.of_all += 1
                if node.name.strip("_").split("_")[0] in PREPOSITIONS:
                    functions.places.append(f"{place}:{node.lineno}: {node.name}")
        for text, line in docstrings(tree):
            read_text(text, f"{place}:{line}")
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]:
        read_text(path.read_text(encoding="utf-8"), str(path.relative_to(ROOT)))
    return [names, names_in_tests, functions, word_what, begun]


def main() -> int:
    """Print the counts; with ``-v`` every place."""
    counts = count_all()
    for count in counts:
        verdict = "ok" if count.passes else "TOO MANY"
        print(
            f"{len(count.places):6} of {count.of_all:6} = {100 * count.share:.2f} % (limit {100 * count.limit:g} %): "
            f"{count.rule}: {verdict}"
        )
        if "-v" in sys.argv:
            print(*(f"    {place}" for place in count.places), sep="\n")
    return 0 if all(count.passes for count in counts) else 1


if __name__ == "__main__":
    sys.exit(main())
