"""Colours of the pages: letters and marks stand out from what is behind them, in light and in dark."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import hiltest.report

STYLE = (Path(hiltest.report.__file__).parent / "style.css").read_text(encoding="utf-8")
# WCAG 2.2: 1.4.3 for letters, 1.4.11 for what a drawing is understood by.
LETTERS, MARKS = 4.5, 3.0


def colours(scheme: str) -> dict[str, str]:
    """Return the named colours of a scheme; the dark one comes second."""
    blocks = re.findall(r":root \{(.*?)\}", STYLE, re.S)
    assert len(blocks) == 2
    return dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", blocks[scheme == "dark"]))


def contrast(first: str, second: str) -> float:
    lighter, darker = sorted((luminance(first), luminance(second)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def luminance(colour: str) -> float:
    """Return the relative luminance as WCAG defines it."""
    channels = (int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    linear = [channel / 12.92 if channel <= 0.04045 else ((channel + 0.055) / 1.055) ** 2.4 for channel in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(
    ("front", "behind", "least"),
    [
        *(
            (front, behind, LETTERS)
            for front in ("ink", "soft", "accent", "good", "bad", "warn")
            for behind in ("page", "card")
        ),
        *((tone, f"{tone}-page", LETTERS) for tone in ("good", "bad", "warn")),
        *(("ink", f"{tone}-page", LETTERS) for tone in ("good", "bad", "warn")),
        *(
            (front, "card", MARKS)
            for front in ("accent", "other", "good", "bad", "fifth", "sixth", "seventh", "eighth", "soft")
        ),
        *((front, "good-page", MARKS) for front in ("accent", "other", "bad")),
        *((front, "track", MARKS) for front in ("accent", "good", "bad", "soft")),
    ],
)
def test_what_is_in_front_stands_out(front: str, behind: str, least: float, scheme: str) -> None:
    named = colours(scheme)
    assert contrast(named[front], named[behind]) >= least


def test_eight_series_have_eight_colours() -> None:
    rules = re.findall(r"([^{}]*)\{ color: var\(--([a-z]+)\); \}", STYLE)
    named = {f"series-{k}": [colour for text, colour in rules if f".series-{k}" in text] for k in range(8)}
    assert all(len(colour) == 1 for colour in named.values()), named
    for scheme in ("light", "dark"):
        assert len({colours(scheme)[colour] for (colour,) in named.values()}) == 8


def test_contrast_is_measured_as_it_is_defined() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    # The usual example of a grey that just passes on white.
    assert contrast("#767676", "#ffffff") == pytest.approx(4.54, abs=0.005)
