"""Exports are what the tools' own documents ask for, one way better each, and no number is turned around."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest

from hiltest.measurement import Limit, Measurement, check
from hiltest.report.exports import bencher_metrics, exported, github_action_entries

MODEL = "cortex-m4-trm/3@sram"


def one(*measurements: Measurement) -> Mapping[int | None, Mapping[str, Measurement]]:
    return {1: {measurement.name: measurement for measurement in measurements}}


TOTAL = check("cycles.direct.total", 11_061, unit="cycle", limit=Limit(max=12_500), cycle_model=MODEL)
BIAS = check("heading.direct.bias", -0.25, unit="deg", limit=Limit.within(0.7))
COVERAGE = check("tumble.coverage", 97.5, unit="%")
SECTOR = check("heading.direct.worst_sector", 200, unit="deg")
MINE = check("mine.left", 5, unit="", limit=Limit(min=3))
ALL = one(
    TOTAL,
    BIAS,
    COVERAGE,
    SECTOR,
    MINE,
    check("a.fact", 7, unit="mT"),
    check("no.number", None, unit="deg"),
    check("board.wall_seconds", 8.1, unit="s", limit=Limit(max=60), volatile=True),
    check("not.finite", math.nan, unit="deg", limit=Limit(max=1)),
)


def check_bmf(content: Any) -> None:
    """Check what https://bencher.dev/bmf.json demands, and the lengths that Bencher keeps of names."""
    assert isinstance(content, dict)
    for benchmark, measures in content.items():
        assert 0 < len(benchmark) <= 1024
        assert isinstance(measures, dict)
        assert measures
        for measure, metric in measures.items():
            assert 0 < len(measure) <= 64
            assert metric.keys() <= {"value", "lower_value", "upper_value"}
            assert "value" in metric
            assert all(isinstance(item, int | float) and not isinstance(item, bool) for item in metric.values())
            assert metric.get("lower_value", metric["value"]) <= metric["value"]
            assert metric.get("upper_value", metric["value"]) >= metric["value"]


def check_action(content: Any) -> None:
    """Check what the action's README asks of a custom benchmark: a list, not empty, of name, unit and value."""
    assert isinstance(content, list)
    assert content
    for entry in content:
        assert {"name", "unit", "value"} <= entry.keys() <= {"name", "unit", "value", "range", "extra"}
        assert all(isinstance(entry[key], str) for key in entry.keys() - {"value"})
        assert isinstance(entry["value"], int | float)
        if "range" in entry:
            # It draws a range that it can read as a number behind a plus-minus sign.
            assert float(entry["range"].removeprefix("± ")) >= 0
    names = [entry["name"] for entry in content]
    assert len(set(names)) == len(names), "it compares what has the same name"


def test_bencher_gets_every_number_with_a_sense_in_a_measure_of_its_sense() -> None:
    content = bencher_metrics(exported(ALL))
    check_bmf(content)
    assert content == {
        f"cycles.direct.total ({MODEL})": {"cycle, smaller is better": {"value": 11_061}},
        "heading.direct.bias, magnitude": {"deg, smaller is better": {"value": 0.25}},
        "mine.left": {"value, larger is better": {"value": 5}},
        "tumble.coverage": {"%, larger is better": {"value": 97.5}},
    }


def test_the_action_gets_one_sense_a_file() -> None:
    numbers = exported(ALL)
    smaller = github_action_entries([number for number in numbers if not number.larger_is_better])
    larger = github_action_entries([number for number in numbers if number.larger_is_better])
    check_action(smaller)
    check_action(larger)
    assert smaller == [
        {"name": f"cycles.direct.total ({MODEL})", "unit": "cycle", "value": 11_061, "extra": "limit at most 12 500"},
        {"name": "heading.direct.bias, magnitude", "unit": "deg", "value": 0.25, "extra": "limit within ±0.7"},
    ]
    assert [(item["name"], item["value"]) for item in larger] == [("mine.left", 5), ("tumble.coverage", 97.5)]


def test_over_seeds_it_is_the_mean_with_the_smallest_and_the_largest() -> None:
    values = {1: -0.1, 2: 0.4, 3: 0.1, 4: None}
    by_seed = {seed: {BIAS.name: check(BIAS.name, value, unit="deg")} for seed, value in values.items()}
    numbers = exported(by_seed)
    bmf = bencher_metrics(numbers)
    check_bmf(bmf)
    # Of magnitudes: the mean of the values themselves, 0.13, would hide that two seeds are off.
    assert bmf == {
        "heading.direct.bias, magnitude": {
            "deg, smaller is better": {"value": 0.2, "lower_value": 0.1, "upper_value": 0.4},
        }
    }
    (entry,) = github_action_entries(numbers)
    check_action([entry])
    assert (entry["value"], entry["range"]) == (0.2, "± 0.2")
    assert entry["extra"] == "no limit\nmean of 3 seeds, 0.1 to 0.4"


def test_cycles_of_two_models_have_two_names() -> None:
    other = check(TOTAL.name, 11_061, unit="cycle", cycle_model="silicon-dwt")
    names = {item.name for run in (one(TOTAL), one(other)) for item in exported(run)}
    assert names == {f"cycles.direct.total ({MODEL})", "cycles.direct.total (silicon-dwt)"}


def test_names_longer_than_bencher_keeps_are_cut_behind_no_sense() -> None:
    long = check("x" * 2000, 1.0, unit="<u>" * 100, limit=Limit(max=2))
    content = bencher_metrics(exported(one(long)))
    check_bmf(content)
    ((measure, _),) = content["x" * 1024].items()
    assert measure.endswith(", smaller is better")


@pytest.mark.parametrize("measurements", [(), (SECTOR,)])
def test_what_has_no_sense_is_not_exported(measurements: tuple[Measurement, ...]) -> None:
    assert exported(one(*measurements)) == []
