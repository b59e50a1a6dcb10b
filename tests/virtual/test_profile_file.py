"""A timing profile of one's own: it prices what it says, is told from every other, and is refused where it is none."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hiltest.boards.bench import VirtualBench
from hiltest.errors import ConfigError
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.model.profile_file import ROWS, RULES, load_profile, place_of, shipped_profiles

from .conftest import SHIPPED
from .pipeline_model import MULTIPLIES

ONE = "cortex-m4-trm/1"  # has no row that others need not have
TEXT = place_of(ONE).read_text(encoding="utf-8")
MAC = re.search(r"\[cost\.fp_accumulate\].*?\n\n", TEXT, re.S)[0]
RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"


def written(folder: Path, text: str, name: str = "mine.toml") -> str:
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def with_mac(value: int) -> str:
    return TEXT.replace(MAC, MAC.replace("value = 3", f"value = {value}"))


def test_every_shipped_profile_has_every_row_that_is_known() -> None:
    for name in shipped_profiles():
        rows = load_profile(name).rows
        assert list(rows) == [*ROWS, *(rule for rule in RULES if rule in rows)]
    of_other_cores = {*MULTIPLIES, "refill_call", "refill_multiple"}
    assert list(load_profile("cortex-m4-trm/3").rows) == [
        *ROWS,
        *(rule for rule in RULES if rule not in of_other_cores),
    ]


@pytest.mark.parametrize(
    ("name", "digest"),
    [
        ("cortex-m4-trm/1", "d18e92c2bf956d09b26e346d3e99f00a08a756378a73045aefdcd5d3a019fab1"),
        ("cortex-m4-trm/2", "948bec611d8492ff4802aafb4584de486342b19705e2ddf1bdd7c6f36dd09249"),
        ("cortex-m4-trm/3", "77264309365d3ee4a5f2352938f2a60e3da910385cbf2cc35c95bbb0241e4762"),
    ],
)
def test_a_published_version_never_changes_its_numbers(name: str, digest: str) -> None:
    # A correction is a new profile. Only a row that prices nothing may be added.
    profile = load_profile(name)
    assert profile.digest == digest
    assert profile.rows.keys() >= load_profile(ONE).rows.keys()
    assert all(row.source and row.band[0] <= row.value <= row.band[1] for row in profile.rows.values())


def test_a_rule_may_be_added_to_a_profile_that_has_none(tmp_path: Path) -> None:
    rule = '[cost.address_use]\nvalue = 2\nband = [1, 3]\nsource = "mine"\n'
    text = f'name = "mine/1"\nbase = "{ONE}"\n{rule}'
    rows = load_profile(written(tmp_path, text)).rows
    assert rows["address_use"].value == 2
    assert rows.keys() - ROWS.keys() == {"address_use"}


def test_memories_of_one_profile_go_with_the_instructions_of_another() -> None:
    both = load_profile("cortex-m4-k64f/2")
    assert both.rows == load_profile("cortex-m4-trm/2").rows
    assert both.memory.items() > load_profile("cortex-m4-k64f/1").memory.items()


def test_a_file_prices_what_it_says(tmp_path: Path) -> None:
    mine = load_profile(written(tmp_path, with_mac(2)))
    assert mine.rows["fp_accumulate"].value == 2
    others = {name: row for name, row in mine.rows.items() if name != "fp_accumulate"}
    assert others == {name: load_profile(ONE).rows[name] for name in others}


def test_a_file_that_takes_a_published_name_is_told_from_it_and_from_another(tmp_path: Path) -> None:
    two = load_profile(written(tmp_path, with_mac(2)))
    three = load_profile(written(tmp_path, TEXT, "copy.toml"))
    assert re.fullmatch(rf"{ONE}\+[0-9a-f]{{8}}", two.name)
    assert len({two.name, three.name, ONE}) == 3
    # The numbers are the same, and it is only a copy; the published name belongs to the published file.
    assert three.digest == load_profile(ONE).digest


def test_a_file_that_was_edited_meanwhile_is_read_again(tmp_path: Path) -> None:
    file = written(tmp_path, with_mac(2))
    assert load_profile(file) is load_profile(file)
    written(tmp_path, with_mac(3))
    assert load_profile(file).rows["fp_accumulate"].value == 3


def test_a_board_made_with_a_file_counts_by_it(tmp_path: Path) -> None:
    dearer = TEXT.replace("value = 1\nband = [1, 1]", "value = 2\nband = [1, 2]", 1)  # of the first row, data
    mine = VirtualK64F(SHIPPED, profile=written(tmp_path, dearer)).call("crc32", b"123456789", 9)
    usual = VirtualK64F(SHIPPED, profile=ONE).call("crc32", b"123456789", 9)
    assert (mine.value, mine.instructions) == (usual.value, usual.instructions)
    # 64 of its 99 instructions are integer ones; docs/profile.md shows them.
    assert mine.cycles == usual.cycles + 64


def test_a_rig_names_a_file_beside_itself(tmp_path: Path) -> None:
    written(tmp_path, with_mac(2))
    rig = RIG.read_text(encoding="utf-8").replace('kind = "virtual"\n', 'kind = "virtual"\ntiming = "mine.toml"\n', 1)
    bench = VirtualBench(load_rig(written(tmp_path, rig, "rig.toml")))
    assert bench.machine.processor.profile.rows["fp_accumulate"].value == 2


def test_a_rig_that_names_no_profile_is_named(tmp_path: Path) -> None:
    rig = RIG.read_text(encoding="utf-8").replace('kind = "virtual"\n', 'kind = "virtual"\ntiming = "no-such"\n', 1)
    with pytest.raises(ConfigError, match=r"rig\.toml: board\.timing: no timing profile 'no-such'; known: cortex-m4-"):
        VirtualBench(load_rig(written(tmp_path, rig, "rig.toml")))


def test_only_a_virtual_board_has_a_timing_profile_to_choose(tmp_path: Path) -> None:
    rig = (RIG.parent / "frdm-k64f.toml").read_text(encoding="utf-8")
    rig = rig.replace('kind = "real"\n', 'kind = "real"\ntiming = "mine.toml"\n', 1)
    with pytest.raises(ConfigError, match=r'board\.timing: belongs to a board of kind "virtual"'):
        load_rig(written(tmp_path, rig, "rig.toml"))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (TEXT.replace('name = "cortex-m4-trm/1"', ""), "mine.toml: name: must be at most 64 lower-case letters"),
        (TEXT.replace("cortex-m4-trm/1", "Mine @sram"), 'not "Mine @sram"; write for example'),
        (TEXT.replace('name = "cortex-m4-trm/1"', 'nam = "x"'), "unknown key 'nam'; did you mean 'name'"),
        ('name = "mine/1"\ncost = 3\n', r'no table \[cost.ROW\]; write base = "cortex-m4-trm/3" below its name, '),
        ('name = "mine/1"\nbase = "cortex-m4-trm/1"\n[memory]\n', '13 rows in total; write base = "cortex-m4-k64f/3" '),
        (TEXT.replace(MAC, ""), "cost.fp_accumulate is missing, 1 rows in total"),
        (TEXT.replace("[cost.it]", "[cost.itt]"), "cost: unknown key 'itt'; did you mean 'it'"),
        (TEXT.replace(MAC, MAC.replace("value", "valeu")), "unknown key 'valeu'; did you mean 'value'"),
        (TEXT.replace(MAC, MAC.replace("value = 3", "value = 2.5")), "fp_accumulate.value: must be whole .* not 2.5"),
        (TEXT.replace(MAC, MAC.replace("value = 3", "value = true")), "fp_accumulate.value: must be whole .* not true"),
        (TEXT.replace(MAC, MAC.replace("value = 3", "value = -1")), "from 1 to 1000, not -1"),
        (TEXT.replace(MAC, MAC.replace("value = 3", "value = 4")), "band: 2 to 3 does not contain the value 4"),
        (TEXT.replace(MAC, MAC.replace("[2, 3]", "[3, 2]")), "band: 3 to 2 does not contain"),
        (TEXT.replace(MAC, MAC.replace("[2, 3]", "3")), r"band: must be the lowest and the highest cycles, .* not 3"),
        (TEXT.replace(MAC, MAC.replace("source = ", "source = 3 #")), "fp_accumulate.source: must state"),
        (TEXT.replace(MAC, "[cost]\nfp_accumulate = 3\n"), "must be a table of value, band and source, not 3"),
        (TEXT.replace("value = 15\nband = [15, 15]", "value = 17\nband = [15, 17]"), "must be fp_divide or one"),
        (
            TEXT.replace(
                "[cost.branch]        # the branch itself, taken or not\nvalue = 1\nband = [1, 1]",
                "[cost.branch]\nvalue = 0\nband = [0, 1]",
            ),
            "cost.branch.value: must be whole cycles from 1",
        ),
        (
            TEXT.replace(MAC, MAC.replace("value = 3\nband = [2, 3]", "value = 0\nband = [0, 3]")),
            "fp_accumulate.value: must be whole cycles from 1",
        ),
        (TEXT.replace(MAC, MAC.replace("[2, 3]", "[0, 3]")), "fp_accumulate.band: must be whole cycles from 1"),
        (TEXT.replace("value = 0\nband = [0, 2]", "value = 3\nband = [0, 3]"), "its band must be less than 3"),
        (TEXT.replace("value = 0\nband = [0, 2]", "value = 0\nband = [0, 900]"), "its band must be less than 3"),
        (TEXT.replace("band = [0, 2]", "band = [-1, 2]", 1), "band: must be whole cycles from 0 to 1000, not -1"),
        (TEXT.replace(MAC, MAC.replace('"TRM', r'"\u001b[2JTRM')), "source: must be one line of printable characters"),
        (TEXT.replace(MAC, MAC.replace('"TRM', r'"TRM\n')), r'printable characters, not "TRM\\n'),
        ("x = " + "[" * 5000, r'not TOML: .*; write base = "cortex-m4-trm/3" below'),
        ("#" * 70_000, "larger than 65536 bytes, the budget of a timing profile; name a timing profile"),
    ],
)
def test_what_is_no_profile_is_refused_with_the_place_and_what_to_do(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        load_profile(written(tmp_path, text))


def test_bytes_that_are_no_text_and_files_that_are_none_are_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="not UTF-8 text at byte 0"):
        load_profile(str(tmp_path / "mine.toml"))
    for name in ("gone.toml", "nul\0.toml"):
        with pytest.raises(ConfigError, match="name a timing profile"):
            load_profile(str(tmp_path / name))
