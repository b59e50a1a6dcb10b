"""Every page as a browser shows it: on a telephone and on a desk, light and dark, by keyboard and on paper."""

from __future__ import annotations

import base64
from collections.abc import Callable
from contextlib import AbstractContextManager
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from hiltest.report.render import html_report
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Run
from hiltest.studies.study import study_of
from hiltest.studies.study_page import page

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

    from .conftest import Visit

Open = Callable[..., "AbstractContextManager[Visit]"]
WIDTHS = pytest.mark.parametrize("width", [390, 1400])
ON_A_DESK = pytest.mark.parametrize("width", [pytest.param(390, marks=pytest.mark.ci), 1400])

# What reaches beyond the right edge, unless it is in a box of its own that scrolls, or is there for the ear alone.
_TOO_WIDE = """() => [...document.querySelectorAll('body *')]
    .filter(each => !each.closest('.scroll, .unseen, thead, .skip'))
    .filter(each => each.getBoundingClientRect().right > innerWidth + 0.5)
    .map(each => each.tagName + ' ' + each.textContent.trim().slice(0, 40))"""
_COLOURS = """async data => {
    const image = await createImageBitmap(await (await fetch('data:image/png;base64,' + data)).blob());
    const context = new OffscreenCanvas(image.width, image.height).getContext('2d');
    context.drawImage(image, 0, 0);
    const pixels = new Uint32Array(context.getImageData(0, 0, image.width, image.height).data.buffer);
    return new Set(pixels).size;
}"""
# Of each drawing with a unit circle: px of a unit across and up, between its outermost grid lines, and of the circle.
_UNIT_CIRCLES = """() => [...document.querySelectorAll('svg[role] .unit')].map(circle => {
    const svg = circle.closest('svg'), box = each => each.getBoundingClientRect();
    const labels = [...svg.querySelectorAll('text')].filter(each => !isNaN(parseFloat(each.textContent)));
    const unit = (anchor, middle, place) => {
        const on = labels.filter(each => each.getAttribute('text-anchor') == anchor);
        const [low, high] = [on[0], on[on.length - 1]].map(each => parseFloat(each.textContent));
        const lines = [...svg.querySelectorAll('.grid')].map(box).filter(each => each[middle] < 0.01).map(place);
        return (Math.max(...lines) - Math.min(...lines)) / (high - low);
    };
    return [unit('middle', 'width', each => each.x), unit('end', 'height', each => each.y),
            [box(circle).width, box(circle).height]];
})"""
_CARDS = """() => [...document.querySelectorAll('section > figure, main > figure')].map(each => each.offsetWidth)"""
# Panels of each grid: all, in the first row and in the last.
_PANELS = """() => [...document.querySelectorAll('.panels')].map(grid => {
    const tops = [...grid.children].map(each => each.offsetTop);
    const inRow = top => tops.filter(each => each == top).length;
    return [tops.length, inRow(tops[0]), inRow(tops[tops.length - 1])];
})"""
# Paper, grid, letters and one line, each with the shades of its edges; an empty box has one colour or two.
PAINTED = 8


def faults(visit: Visit, path: Path) -> list[str]:
    """Return what a reader would meet: complaints, requests, and what has to be scrolled to sideways."""
    asked = [address for address in visit.requests if address != path.as_uri()]
    result = [f"complaint: {complaint}" for complaint in visit.complaints] + [
        f"request: {request}" for request in asked
    ]
    if visit.page.evaluate("document.documentElement.scrollWidth > innerWidth"):
        result.append("the page scrolls sideways")
    return result + [f"too wide: {item}" for item in visit.page.evaluate(_TOO_WIDE)]


def violations(page: Page) -> list[str]:
    """Return what axe-core finds, all of its rules switched on."""
    from axe_playwright_python.sync_playwright import Axe

    result: list[dict[str, Any]] = Axe().run(page).response["violations"]
    return [f"{item['id']}: {item['nodes'][0]['html'][:120]}" for item in result]


@WIDTHS
def test_nothing_complains_nothing_is_asked_for_and_nothing_is_too_wide(
    visit: Open, page_file: Path, width: int
) -> None:
    with visit(page_file, width=width) as place:
        assert faults(place, page_file) == []


@ON_A_DESK
def test_every_plot_has_a_size_and_is_painted(canvas: Page, visit: Open, page_file: Path, width: int) -> None:
    with visit(page_file, width=width) as place:
        plots = place.page.locator("svg[role=img]").all()
        assert bool(plots) is (page_file.stem not in ("nothing", "boards"))
        for plot in plots:
            box = plot.bounding_box()
            assert box is not None
            assert box["width"] > 200
            assert box["height"] > 30
            assert colours_in(canvas, plot.screenshot()) >= PAINTED, plot.inner_html()[:200]


@pytest.mark.parametrize(
    ("width", "scheme"), [(390, "light"), (1400, "dark"), pytest.param(1400, "light", marks=pytest.mark.ci)]
)
def test_axe_finds_nothing(
    visit: Open, page_file: Path, width: int, scheme: str, require_module: Callable[[str], None]
) -> None:
    require_module("axe_playwright_python")
    with visit(page_file, width=width, scheme=scheme) as place:
        assert violations(place.page) == []


def test_the_checks_see_what_they_look_for(
    canvas: Page, visit: Open, tmp_path: Path, require_module: Callable[[str], None]
) -> None:
    require_module("axe_playwright_python")
    path = tmp_path / "bad.html"
    path.write_text(
        "<!doctype html><title>t</title><p style='width:2000px'>wide</p><img src='other.png'>"
        "<script>console.error('no')</script><svg role='img' width='300' height='300'></svg>"
    )
    with visit(path, width=390) as place:
        result = faults(place, path)
        for fault in ("complaint: no", "request: file:", "the page scrolls sideways", "too wide: P wide"):
            assert any(item.startswith(fault) for item in result), fault
        assert colours_in(canvas, place.page.locator("svg").screenshot()) < PAINTED
        assert {item.split(":")[0] for item in violations(place.page)} >= {"html-has-lang", "image-alt", "svg-img-alt"}


def test_the_keyboard_reaches_the_results_and_every_box_that_scrolls(
    everything: Run, visit: Open, tmp_path: Path
) -> None:
    path = written(everything, tmp_path)
    with visit(path, width=390) as place:
        page = place.page
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.className") == "skip"
        assert page.locator(".skip").bounding_box()["x"] >= 0  # type: ignore[index]
        page.keyboard.press("Enter")
        assert page.evaluate("document.activeElement.id") == "main"
        # The numbers behind the plots alone may be wider than a telephone.
        wide = page.evaluate(
            "[...document.querySelectorAll('*')].filter(each => each.scrollWidth > each.clientWidth"
            " && getComputedStyle(each).overflowX == 'auto').map(each => [each.className, each.tabIndex])"
        )
        assert wide
        assert all(item == ["scroll", 0] for item in wide)


def test_a_link_of_the_contents_opens_its_folded_section(browser: Browser, red: Run, tmp_path: Path) -> None:
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.goto(written(red, tmp_path).as_uri())
    assert page.locator("details[open]").count() == 0
    page.locator('nav a[href="#failures"]').click()
    assert page.locator("details[open] > section").get_attribute("id") == "failures"
    page.close()


@pytest.mark.parametrize("page_file", ["study"], indirect=True)
def test_a_click_on_a_point_opens_the_numbers_at_its_row(browser: Browser, page_file: Path) -> None:
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.goto(page_file.as_uri())
    point = page.locator("[data-row]").nth(20)
    words = point.locator("title").text_content()
    assert not page.locator("figure tbody").is_visible()
    point.click()
    assert page.evaluate("[...document.activeElement.cells].map(cell => cell.textContent).join(', ')") == words
    assert page.locator("tr:focus").is_visible()
    page.close()


_VISIBLE_TEXTS = """() => {
    const drawing = document.querySelector("figure svg[role]")
    const scale = drawing.getBoundingClientRect().width / drawing.viewBox.baseVal.width
    return [...drawing.querySelectorAll("text")].filter(text => text.checkVisibility()).map(text => {
        const box = text.getBoundingClientRect()
        return [scale * parseFloat(getComputedStyle(text).fontSize), box.left, box.right, box.top, box.bottom]
    })
}"""


@pytest.mark.parametrize("name", ["choose", "constraints"])
def test_letters_of_a_wide_plot_are_legible_on_a_telephone_and_apart(visit: Open, tmp_path: Path, name: str) -> None:
    record = read_record(Path(__file__).parents[3] / "docs" / "studies" / f"{name}.json").run
    path = tmp_path / f"{name}.html"
    path.write_text(page(study_of(name), record), encoding="utf-8")
    with visit(path, width=390) as place:
        texts = place.page.evaluate(_VISIBLE_TEXTS)
        assert min(size for size, *_ in texts) > 10.5
        assert place.page.locator(".narrow").is_visible()
    boxes = [box for _, *box in texts]
    overlaps = [
        (one, other)
        for one, other in combinations(boxes, 2)
        if one[0] < other[1] and other[0] < one[1] and one[2] < other[3] and other[2] < one[3]
    ]
    assert overlaps == []
    assert all(left >= 0.0 and right <= 390.0 for left, right, *_ in boxes)
    with visit(path, width=1400) as place:
        assert not place.page.locator(".narrow").is_visible()
        assert len(place.page.evaluate(_VISIBLE_TEXTS)) > len(texts), "the labels of the axes are in the drawing"


@pytest.mark.parametrize("page_file", ["boards"], indirect=True)
def test_a_telephone_shows_every_board_of_a_measurement(visit: Open, page_file: Path) -> None:
    with visit(page_file, width=390) as place:
        cells = place.page.locator("td[data-label=microbit-v1]").all()
        boxes = [cell.bounding_box() for cell in cells]
    assert len(boxes) == 3
    assert all(box is not None and box["x"] >= 0.0 and box["x"] + box["width"] <= 390.0 for box in boxes)


def test_a_telephone_shows_what_broke_and_the_next_step_on_its_first_screen(
    browser: Browser, red: Run, tmp_path: Path
) -> None:
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.goto(written(red, tmp_path).as_uri())
    box = page.locator(".verdict").first.bounding_box()
    assert box is not None
    assert "Next:" in page.locator(".verdict").first.inner_text()
    assert box["y"] + box["height"] < 844
    page.close()


def test_on_paper_everything_is_unfolded_and_dark_on_light(browser: Browser, everything: Run, tmp_path: Path) -> None:
    page = browser.new_page(color_scheme="dark")
    page.goto(written(everything, tmp_path).as_uri())
    folded = "[...document.querySelectorAll('details:not([open]) tr')]"
    background = "getComputedStyle(document.documentElement).getPropertyValue('--card')"
    assert page.evaluate(f"{folded}.length > 60 && !{folded}.some(each => each.checkVisibility())")
    assert page.evaluate(background) == "#1b1f25"
    page.emulate_media(media="print")
    assert page.evaluate(f"{folded}.every(each => each.getBoundingClientRect().height)")
    assert page.evaluate(background) == "#ffffff"
    # A4 without its margins: nothing is cut off at the right.
    page.set_viewport_size({"width": 688, "height": 1000})
    cut = "[...document.querySelectorAll('html, .scroll, figure')].filter(each => each.scrollWidth > each.clientWidth)"
    assert page.evaluate(f"{cut}.map(each => each.outerHTML.slice(0, 200))") == []
    assert page.pdf().startswith(b"%PDF")
    page.close()


def test_markup_in_names_does_nothing_and_is_read(hostile: Run, visit: Open, tmp_path: Path) -> None:
    path = written(hostile, tmp_path)
    with visit(path, width=1400) as place:
        assert place.page.title().startswith("hiltest report: <script>document.title='taken'</script>")
        assert place.page.title().endswith(", rig virtual-k64f, FAIL")
        # Were something in it a script after all, or asked for a picture, the page's own policy would refuse.
        asked = "new Promise(tell => {const i = new Image(); i.onerror = i.onload = () => tell(i.naturalWidth);"
        assert place.page.evaluate(asked + "i.src = 'data:image/gif;base64,R0lGODlhAQABAAAAACwAAAAAAQABAAA='})") == 0
        assert any("Content Security Policy" in complaint for complaint in place.complaints)
        assert place.page.locator("body").inner_text().count("<script>document.title='taken'</script>\"'⟨U+202E⟩") >= 5
        assert place.page.locator("a", has_text="wire trace").evaluate("each => each.protocol") == "file:"


@WIDTHS
@pytest.mark.parametrize("page_file", ["everything", "fit"], indirect=True)
def test_calibrated_samples_have_equal_axes_and_a_round_circle(visit: Open, page_file: Path, width: int) -> None:
    with visit(page_file, width=width) as place:
        drawn = place.page.evaluate(_UNIT_CIRCLES)
    assert drawn
    for across, up, circle in drawn:
        # Coordinates are written to a tenth: 0.05 px at both ends of two units of 46 px is a quarter of this.
        assert across == pytest.approx(up, rel=0.005)
        assert circle == [pytest.approx(2 * across, rel=0.005), pytest.approx(2 * up, rel=0.005)]


@pytest.mark.parametrize("page_file", ["everything", "red", "trend"], indirect=True)
def test_cards_and_rows_of_panels_are_full_on_a_desk(visit: Open, page_file: Path) -> None:
    with visit(page_file, width=1400) as place:
        cards, grids = place.page.evaluate(_CARDS), place.page.evaluate(_PANELS)
    assert cards
    assert set(cards) == {1120}, "each card is as wide as the page"
    # Two or three stand beside each other, more in rows; the last row is half full at least.
    assert all(first == panels if panels <= 3 else last * 2 >= first > 1 for panels, first, last in grids), grids


def colours_in(canvas: Page, png: bytes) -> int:
    count: int = canvas.evaluate(_COLOURS, base64.b64encode(png).decode())
    return count


def written(run: Run, folder: Path) -> Path:
    path = folder / "report.html"
    path.write_text(html_report(run), encoding="utf-8")
    return path
