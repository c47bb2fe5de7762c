"""Windows of large frames: a window shows what the whole frame shows there, and its motion."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.apps.render.mitsuba.gbuffer import render_gbuffer
from rlbench.apps.render.mitsuba.open_tracer import ScalarTracer, open_tracer
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import Window
from rlbench.apps.render.windows import MOST_MOTION, show_window
from tests.apps.render.small_scenes import room

H, W, SIDE = 40, 64, 16  # the virtual frame, and the side of the window
CORNERS = {0.0: (10, 20), 1.0: (12, 25)}  # rows and columns, by time


@pytest.fixture(scope="module", autouse=True)
def _variant():
    select_variant()


def windowed(scene):
    return replace(scene, window=lambda time: Window(H, W, *CORNERS[max(time, 0.0)]))


def cut_out(image, time):
    top, left = CORNERS[time]
    return image[top : top + SIDE, left : left + SIDE]


def test_a_window_shows_the_g_buffer_of_the_whole_frame_there():
    scene = room()
    whole, part = open_tracer(scene, H, W), open_tracer(windowed(scene), SIDE, SIDE)
    for each in (whole, part):
        each.set_time(1.0)
    expected, found = render_gbuffer(whole), render_gbuffer(part)
    for name in ("albedo", "normal", "depth"):
        # rays through the same film position differ in the last bits
        np.testing.assert_allclose(found[name], cut_out(expected[name], 1.0), atol=1e-3)
    moved = np.subtract(CORNERS[1.0], CORNERS[0.0])[::-1]  # x, y
    expected_motion = cut_out(expected["motion"], 1.0) + moved
    np.testing.assert_allclose(found["motion"], expected_motion, atol=1e-3)


def test_the_scalar_tracer_crops_the_same_part():
    scene = room()
    whole, part = ScalarTracer(scene, H, W), ScalarTracer(windowed(scene), SIDE, SIDE)
    expected = cut_out(whole.trace_mean(64, "input"), 0.0)
    found = part.trace_mean(64, "input")
    # means of 64 samples with other random numbers, over the whole window
    assert found.mean() == pytest.approx(expected.mean(), rel=0.1)


@pytest.mark.parametrize("clip", [f"room-{seed:03d}" for seed in range(6)])
def test_a_drawn_window_lies_in_its_frame_and_limits_motion(clip):
    shown = show_window(room(), clip, frames=4)
    scene = shown.inspect(4, (SIDE, SIDE))
    corners = [scene.window(float(time)) for time in range(-1, 4)]
    for height, width, top, left in corners:
        assert 192 <= height <= 1080
        assert 0 <= top <= height - SIDE
        assert 0 <= left <= width - SIDE
    again = show_window(room(), clip, frames=4).inspect(4, (SIDE, SIDE))
    assert [again.window(float(time)) for time in range(-1, 4)] == corners
    assert shown.source_hash != show_window(room(), "room-999", frames=4).source_hash
    tracer = open_tracer(
        replace(scene, window=None), 48, round(48 * corners[0].width / corners[0].height)
    )
    tracer.set_time(2.0)
    length = np.linalg.norm(render_gbuffer(tracer, ("motion",))["motion"], axis=-1)
    # the limit holds for a motion in proportion to speed, of which this room's is not exactly
    assert np.percentile(length, 95) * corners[0].height / 48 < 1.25 * MOST_MOTION
