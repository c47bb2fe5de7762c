"""Time, keys and layout in a real browser."""

from __future__ import annotations

import numpy as np
import pytest

from rlbench.apps.view.viewer import write
from tests.apps.view.viewer.conftest import CUT, FRAMES, SIDE
from tests.apps.view.viewer.test_browser_images import COLOUR, check, contrast_pixel, radiance, srgb

VIEWS = ("decide", "flip", "layers", "time", "table")


def test_the_scrubber_and_its_keys_show_a_frame(open_page, report):
    screen = open_page("view=time&a=mean")
    x, y = contrast_pixel(report, "mean", "reference", frame=2)
    screen.page.get_by_label("frame", exact=True).focus()
    screen.press("ArrowRight", "ArrowRight")
    assert screen.state["frame"] == 2
    check(screen, report, "mean", x, y, frame=2)
    screen.press(",")
    check(screen, report, "mean", x, y, frame=1)
    screen.press(".", ".", ".")
    assert screen.state["frame"] == 0
    check(screen, report, "mean", x, y, frame=0)


def test_play_runs_and_stops(open_page):
    screen = open_page("view=time")
    screen.page.get_by_label("frames a second").select_option("12")
    screen.press("p")
    screen.page.wait_for_function(
        "async () => (await import('viewer/state.js')).state.frame === 3", timeout=10_000
    )
    screen.press("p")
    assert screen.text("#play") == "Play"
    stopped = screen.state["frame"]
    screen.page.wait_for_timeout(250)
    assert screen.state["frame"] == stopped


def test_curves_show_each_frame_and_mark_cuts(open_page, report):
    screen = open_page("view=time&a=mean")
    svg = screen.page.locator("svg.chart")
    first, second = (float(svg.get_attribute(f"data-{name}")) for name in ("px0", "px1"))
    cut = float(screen.page.get_attribute("line.cut", "x1"))
    assert (cut - first) / (second - first) == pytest.approx(CUT - 0.5, abs=0.01)
    shown = screen.page.evaluate(
        """async () => (await import("viewer/data.js")).data.frames.find((each) =>
          each.metric === "psnr" && each.clip === "alpha" && each.method === "mean"
          && each.spp === 1
        ).values"""
    )
    rows = report.rows.query("metric == 'psnr' and clip == 'alpha' and target_spp == 1")
    rows = rows[(rows["method"] == "mean") & (rows["frame"] >= 0)].sort_values("frame")
    np.testing.assert_allclose(shown, rows["value"], atol=1e-4)
    assert screen.page.locator("path.curve").count() == 3


def test_a_click_on_a_curve_jumps_to_its_frame(open_page):
    screen = open_page("view=time")
    box = screen.page.locator("svg.chart").bounding_box()
    scale = box["width"] / float(screen.page.get_attribute("svg.chart", "width"))
    px = [float(screen.page.get_attribute("svg.chart", f"data-px{i}")) for i in (0, 1)]
    place = box["x"] + (px[0] + 3 * (px[1] - px[0])) * scale
    screen.page.mouse.click(place, box["y"] + box["height"] / 3)
    screen.settle()
    assert screen.state["frame"] == 3


def test_a_dragged_line_is_cut_through_time(open_page, report):
    screen = open_page("view=time&a=mean")
    ends = [screen.place_of(*place, SIDE) for place in ((10, 12), (30, 12))]
    screen.drag(*ends)
    assert screen.state["line"] == "10,12,30,12"
    screen.page.wait_for_selector("canvas[data-slice=mean][width='21']")
    found = screen.page.evaluate(
        """() => {
          const canvas = document.querySelector("canvas[data-slice=mean]");
          return [...canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data];
        }"""
    )
    found = np.reshape(found, (FRAMES, 21, 4))[..., :3] / 255
    expected = [srgb(radiance(report, "mean", frame)[:, 12, 10:31]).T for frame in range(FRAMES)]
    np.testing.assert_allclose(found, expected, atol=2 * COLOUR)


def test_keys_cut_through_the_listed_pixel(open_page):
    screen = open_page("view=time&px=7&py=9")
    screen.press("x")
    assert screen.state["line"] == f"0,9,{SIDE - 1},9"
    screen.press("y")
    assert screen.state["line"] == f"7,0,7,{SIDE - 1}"


def test_the_worst_tile_is_listed_first_and_shown_on_a_click(open_page, report):
    screen = open_page("view=time&a=mean")
    screen.page.wait_for_selector(".worst button")
    image, truth = (
        srgb(np.stack([radiance(report, name, t) for t in range(FRAMES)]))
        for name in ("mean", "reference")
    )
    errors = image - truth
    tiles = (errors**2).reshape(FRAMES, 3, 3, 16, 3, 16).mean(axis=(1, 3, 5))
    frame, row, column = np.unravel_index(tiles.argmax(), tiles.shape)
    first = screen.page.locator(".worst button").first
    assert first.inner_text().startswith(f"frame {frame}, x {16 * column}, y {16 * row}: ")
    first.click()
    state = screen.state
    assert (state["frame"], state["x"], state["y"]) == (frame, 16 * column + 8, 16 * row + 8)
    assert state["zoom"] > 1


def test_every_view_has_a_key_and_tabs_follow_arrows(open_page):
    screen = open_page()
    for key, view in zip("dfltb", VIEWS, strict=True):
        screen.press(key)
        assert screen.state["view"] == view
        assert screen.page.get_attribute(f"#tab-{view}", "aria-selected") == "true"
    screen.page.focus("#tab-table")
    screen.press("ArrowRight")
    assert screen.state["view"] == "decide"


def test_a_question_mark_lists_the_keys(open_page):
    screen = open_page()
    screen.press("?")
    assert "blink between A and B" in screen.text("#help")
    screen.press("Escape")
    assert not screen.page.is_visible("#help")


def test_every_control_can_be_reached_by_tab(open_page):
    screen = open_page("view=flip")
    wanted = screen.page.locator("main :is(button, select, input), .stage").count()
    screen.page.focus("#tab-flip")
    reached = set()
    for _ in range(wanted + 8):
        screen.page.keyboard.press("Tab")
        reached.add(screen.page.evaluate("document.activeElement.outerHTML.slice(0, 120)"))
    in_main = [text for text in reached if "help-button" not in text and "<body" not in text]
    assert len(in_main) >= wanted - 1  # two elements may begin alike


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_views_fit_the_width_in_light_and_dark(open_page, width, scheme):
    screen = open_page("view=decide", width, scheme)
    for key in "dfltb":
        screen.press(key)
        assert screen.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    background = screen.page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert background == {"light": "rgb(255, 255, 255)", "dark": "rgb(22, 22, 24)"}[scheme]


def test_a_page_without_images_offers_decision_and_table(open_page, report, tmp_path):
    rows = report.rows[report.rows["metric"].isin(["psnr", "sample_ms", "plan_ms", "denoise_ms"])]
    write(rows, tmp_path / "r.html", remarks=["keeps no images"])
    screen = open_page("view=flip", file=tmp_path / "r.html")
    assert screen.page.locator("[role=tab]").all_inner_texts() == ["Decide", "Table"]
    assert screen.text("#remarks") == "keeps no images"
