"""Flip and Layers in a real browser: what a key, a slider and a drag show, by their pixels."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest

from tests.apps.view.viewer.conftest import METHODS, SIDE

COLOUR = 2 / 255  # rounding of the tile, of the half float and of 8 bits, on a smooth pixel
SPP = 1.0


def srgb(linear):
    """IEC 61966-2-1, clipped."""
    v = np.clip(np.asarray(linear, float), 0, 1)
    return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)


def radiance(report, method, frame=0, clip=0):
    shown = report.clips[clip]
    if method == "reference":
        return shown.reference[frame]
    images = {each.method: each for each in shown.images if each.target_spp == SPP}
    return images[method].frames[frame].astype(float)


def contrast_pixel(report, first, second, frame=0):
    """x and y of a pixel, away from the border, whose colours differ most."""
    images = [srgb(radiance(report, name, frame)) for name in (first, second)]
    difference = np.abs(images[0] - images[1]).min(axis=0)
    difference[:8], difference[-8:], difference[:, :8], difference[:, -8:] = 0, 0, 0, 0
    y, x = np.unravel_index(difference.argmax(), difference.shape)
    return int(x), int(y)


def ranked(screen):
    return screen.page.eval_on_selector_all(
        "[data-method]", "all => all.map((each) => each.dataset.method)"
    )


def check(screen, report, method, x, y, frame=0, pane=0):
    expected = srgb(radiance(report, method, frame)[:, y, x])
    np.testing.assert_allclose(screen.pixel(x, y, SIDE, pane), expected, atol=COLOUR)


def test_keys_1_to_9_and_r_show_a_method_in_place(open_anywhere, report):
    screen = open_anywhere("view=flip")
    names = ranked(screen)
    assert set(names) == {*METHODS, "reference"}
    x, y = contrast_pixel(report, "mean", "reference")
    for key, name in [("2", names[1]), ("3", names[2]), ("1", names[0]), ("r", "reference")]:
        screen.press(key)
        assert screen.panes()[0]["label"] == name
        check(screen, report, name, x, y)
    screen.press("r")
    check(screen, report, names[0], x, y)


def test_space_blinks_a_and_b(open_page, report):
    screen = open_page("view=flip&a=mean&b=eaw")
    x, y = contrast_pixel(report, "mean", "eaw")
    for name in ("eaw", "mean", "eaw"):
        screen.press(" ")
        check(screen, report, name, x, y)


def test_a_drag_splits_a_from_b(open_anywhere, report):
    screen = open_anywhere("view=flip&a=mean&b=eaw")
    x, y = contrast_pixel(report, "mean", "eaw")
    (box,) = screen.panes()
    middle = box["y"] + box["height"] / 2
    for share, name in ((0.95, "mean"), (0.05, "eaw")):
        screen.drag((box["x"] + 400, middle), (box["x"] + share * box["width"], middle))
        assert screen.state["split"] == pytest.approx(share, abs=0.01)
        check(screen, report, name, x, y)
    screen.press("]", "]")
    assert screen.state["split"] == pytest.approx(0.15, abs=0.01)
    screen.press("s")
    assert screen.state["split"] == -1


CURVES = {
    "srgb": lambda v: v,
    "reinhard": lambda v: v / (1 + v),
    "hable": lambda v: _filmic(2 * v) / _filmic(11.2),
}


def _filmic(v):
    """Hable 2010, Filmic Tonemapping Operators, with its constants."""
    a, b, c, d, e, f = 0.15, 0.5, 0.1, 0.2, 0.02, 0.3
    return (v * (a * v + c * b) + d * e) / (v * (a * v + b) + d * f) - e / f


@pytest.mark.parametrize("curve", CURVES)
def test_exposure_and_tone_curve_act_on_radiance(open_anywhere, report, curve):
    screen = open_anywhere(f"view=flip&show=ref&curve={curve}")
    x, y = contrast_pixel(report, "mean", "reference")
    for keys, stops in (("Shift+E", -0.5), ("Shift+E", -1.0), ("e", -0.5)):
        screen.press(keys)
        assert screen.state["ev"] == stops
        linear = radiance(report, "reference")[:, y, x] * 2**stops
        expected = srgb(CURVES[curve](linear))
        np.testing.assert_allclose(screen.pixel(x, y, SIDE), expected, atol=COLOUR)


def test_the_slider_of_exposure_and_the_key_of_the_curve_change_what_they_should(open_page):
    screen = open_page("view=flip")
    screen.page.get_by_label("exposure").focus()
    screen.press("ArrowRight", "ArrowRight")
    assert screen.state["ev"] == 0.5
    screen.press("c")
    assert screen.state["curve"] == "reinhard"
    screen.page.get_by_label("tone curve").select_option("hable")
    assert screen.state["curve"] == "hable"


def test_a_zoom_shows_single_pixels_in_all_panes(open_anywhere, report):
    x, y = contrast_pixel(report, "mean", "reference")
    screen = open_anywhere("view=flip&show=all")
    screen.press("ArrowRight")  # a pixel near the middle is listed
    for _ in range(6):
        screen.press("+")
    zoomed = screen.state["zoom"]
    assert zoomed > 15
    screen.page.evaluate(
        "async ([x, y]) => (await import('viewer/state.js')).set({ x: x + 0.5, y: y + 0.5 })",
        [x, y],
    )
    screen.settle()
    for pane, box in enumerate(screen.panes()):
        check(screen, report, box["label"], x, y, pane=pane)
    screen.press("0")
    assert screen.state["zoom"] == 0


def test_the_wheel_zooms_about_the_pointer(open_page, report):
    screen = open_page("view=flip&show=ref")
    x, y = contrast_pixel(report, "mean", "reference")
    screen.page.mouse.move(*screen.place_of(x, y, SIDE))
    before = screen.place_of(x, y, SIDE)
    screen.page.mouse.wheel(0, -400)
    screen.settle()
    # a pointer is at whole pixels, and the zoom enlarges the rest
    assert screen.place_of(x, y, SIDE) == pytest.approx(before, abs=3.0)
    check(screen, report, "reference", x, y)


def test_a_pixel_lists_the_values_of_all_methods(open_page, report):
    screen = open_page("view=flip&px=20&py=30&frame=1")
    screen.page.wait_for_selector(".readout table")
    for name in (*METHODS, "reference"):
        cells = screen.page.locator(f".readout [data-row='{name}'] td").all_inner_texts()
        values = radiance(report, name, frame=1)[:, 30, 20]
        np.testing.assert_allclose([float(c) for c in cells[:3]], values, rtol=0.03, atol=1e-3)
    assert cells[3] == ""
    screen.press("ArrowRight", "ArrowDown")
    assert (screen.state["px"], screen.state["py"]) == (21, 31)
    screen.page.wait_for_function(
        "document.querySelector('.readout caption').textContent.startsWith('pixel 21, 31')"
    )


def test_a_drag_with_shift_moves_the_image(open_page, report):
    screen = open_page("view=flip&show=ref&zoom=20")
    (box,) = screen.panes()
    start = (box["x"] + 400, box["y"] + 300)
    screen.page.keyboard.down("Shift")
    screen.drag(start, (start[0] + 100, start[1] - 40))
    screen.page.keyboard.up("Shift")
    state = screen.state
    assert (state["x"], state["y"]) == pytest.approx((SIDE / 2 - 5, SIDE / 2 + 2), abs=0.1)
    x, y = int(state["x"]), int(state["y"])
    check(screen, report, "reference", x, y)


def test_without_webgl2_one_sentence_says_what_is_missing(open_anywhere, request):
    is_plain = request.node.callspec.params["open_anywhere"] == "plain_browser"
    remarks = open_anywhere("view=flip").text("#remarks")
    assert remarks.count("Images are drawn without WebGL2, more slowly") == is_plain


def colour(name, share):
    return np.array(mpl.colormaps[name](np.rint(np.clip(share, 0, 1) * 255) / 255)[:3])


def expected_layer(report, layer, method, x, y):
    """What a layer shows at a pixel, from the arrays and matplotlib's colour maps."""
    clip = report.clips[0]
    images = [each for each in clip.images if each.target_spp == SPP]
    counts = {each.method: each.counts[0] for each in images}
    if layer in ("signed", "squared"):
        error = srgb(radiance(report, method)[:, y, x]) - srgb(clip.reference[0][:, y, x])
    if layer == "signed":
        return colour("RdBu_r", error.mean() / 0.5 + 0.5)
    if layer == "squared":
        return colour("magma", (error**2).mean() / 0.25**2)
    if layer == "counts":
        most = max(each.max() for each in counts.values())
        return colour("viridis", counts[method][y, x] / most)
    values = clip.buffers[layer][0][:, y, x]
    if layer == "albedo":
        return srgb(values)
    if layer == "normal":
        return values / 2 + 0.5
    if layer == "motion":
        size = np.hypot(*clip.buffers[layer][0])
        return colour("viridis", np.hypot(*values) / max(1, size[size < 512].max()))
    logs = np.log2(clip.buffers[layer][0])
    low, high = (end(logs[np.isfinite(logs)]) for end in (np.min, np.max))
    return colour("cividis", (np.log2(values[0]) - low) / (high + 1e-3 - low))


@pytest.mark.parametrize(
    "layer", ["signed", "squared", "counts", "albedo", "normal", "depth", "motion"]
)
def test_layers_show_their_values_on_one_scale(open_anywhere, report, layer):
    screen = open_anywhere("view=layers")
    screen.page.get_by_label("layer").select_option(layer)
    screen.settle()
    # rounding of the tiles moves a colour by a few of the 256 steps of its map
    tolerance = 0.06 if layer in ("signed", "squared", "depth", "motion") else 0.02
    x, y = contrast_pixel(report, "mean", "reference")
    for pane, box in enumerate(screen.panes()):
        expected = expected_layer(report, layer, box["label"], x, y)
        np.testing.assert_allclose(screen.pixel(x, y, SIDE, pane), expected, atol=tolerance)
    panes = 1 if layer in report.clips[0].buffers else len(METHODS)
    assert len(screen.panes()) == panes


def test_the_end_of_the_error_scale_changes_colours(open_page, report):
    screen = open_page("view=layers&layer=squared")
    x, y = contrast_pixel(report, "mean", "reference")
    pane = [box["label"] for box in screen.panes()].index("mean")
    before = screen.pixel(x, y, SIDE, pane)
    screen.page.get_by_label("end of the error scale").press("End")
    screen.settle()
    assert screen.state["range"] == 1
    assert screen.pixel(x, y, SIDE, pane).sum() < before.sum()


def test_the_flip_map_is_that_of_the_authors(open_page, report):
    flip = pytest.importorskip("flip_evaluator")
    images = [radiance(report, name).astype(np.float32) for name in ("reference", "mean")]
    shown = [srgb(image).transpose(1, 2, 0).astype(np.float32) for image in images]
    expected, _, _ = flip.evaluate(*shown, "LDR", applyMagma=False)
    found = open_page().page.evaluate(
        """async ([reference, test, side]) => {
          const { flipMap } = await import("viewer/flip_map.js");
          const image = (planes) => ({ width: side, height: side, planes });
          return [...flipMap(image(test), image(reference)).planes[0]];
        }""",
        [*(image.reshape(3, -1).tolist() for image in images), SIDE],
    )
    # both compute in single precision; the map ends with a power, which enlarges rounding near 0
    np.testing.assert_allclose(np.reshape(found, (SIDE, SIDE)), expected[..., 0], atol=1e-3)


def test_the_layer_flip_shows_the_map_of_each_method(open_anywhere, report):
    screen = open_anywhere("view=layers&layer=flip")
    x, y = contrast_pixel(report, "mean", "reference")
    for pane, box in enumerate(screen.panes()):
        share = screen.page.evaluate(
            """async ([name, i]) => {
              const { clip } = await import("viewer/workspace.js");
              return (await clip().picture(name, 1, 0, "flip")).planes[0][i];
            }""",
            [box["label"], y * SIDE + x],
        )
        found = screen.pixel(x, y, SIDE, pane)
        np.testing.assert_allclose(found, colour("magma", share), atol=0.02)
