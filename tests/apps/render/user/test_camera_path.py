"""Camera paths: orbit, dolly, and matrices of a JSON file."""

import numpy as np
import pytest

from rlbench.apps.render.user.clip import UserSceneOptions, ensure_user_clip
from rlbench.clips.header import read_header
from tests.apps.render.user.xml_room import (
    FOV,
    PASSING,
    PRESET,
    buffer,
    check_refused,
    flown,
    look_at,
)


def test_the_sensor_of_the_file_is_the_middle_of_an_orbit(room):
    clip = ensure_user_clip(UserSceneOptions(room), PRESET)
    middle = buffer(clip, "depth", 1)
    still = ensure_user_clip(
        UserSceneOptions(room, flown(room.parent, [look_at([0, 1.2, 4], [0, 0.8, 0])])), PRESET
    )
    np.testing.assert_allclose(middle, buffer(still, "depth", 0), rtol=1e-4)


@pytest.mark.parametrize("camera", [pytest.param("orbit", marks=pytest.mark.slow), "dolly"])
def test_an_orbit_or_dolly_moves_the_camera(room, camera):
    clip = ensure_user_clip(UserSceneOptions(room, camera), PRESET)
    # half a degree of 60, or 2 % of the way, on 48 pixels
    assert 0.1 < np.median(np.linalg.norm(buffer(clip, "motion", 1), axis=-1)) < 2


def test_a_still_camera_makes_a_static_clip(room):
    header = read_header(ensure_user_clip(UserSceneOptions(room, "still"), PRESET))
    assert header.static
    assert "motion" not in header.buffers


INSIDE = look_at([1.5, 0.3, 0.5], [0, 0.3, 0])  # of the cube
AWAY = look_at([0, 1, 20], [0, 1, 40])


@pytest.mark.parametrize(
    ("matrices", "fov", "more", "match"),
    [
        ([PASSING[0], INSIDE], FOV, {}, r"frame 1: .*only black.*100% .*backs of .*inside a wall"),
        ([*PASSING[:2], AWAY], FOV, {}, r"frame 2: .*\(0, 1, 20\).*no surface; the scene spans"),
        ([np.diag([2, 2, 2, 1])], FOV, {}, "matrix 0 is not rigid.*lengths 2, 2, 2"),
        ([PASSING[0] + np.eye(4)[[1]].T * [[1, 0, 0, 0]]], FOV, {}, "not rigid"),
        ([PASSING[0], np.diag([-1.0, 1, 1, 1])], FOV, {}, "matrix 1 mirrors"),
        ([PASSING[0].T], FOV, {}, "last row.*transposed"),
        ([np.eye(4) * np.nan], FOV, {}, "four rows of four finite"),
        ([np.eye(3)], FOV, {}, "four rows of four finite"),
        ([], FOV, {}, "no list of matrices"),
        *((PASSING, fov, {}, "between 0 and 180") for fov in (0, 180, "wide")),
        (PASSING, FOV, {"frames": 4}, "has 3 matrices"),
        (PASSING, FOV, {"camera": "zoom"}, "takes still, orbit, dolly, or a JSON"),
    ],
)
def test_an_invalid_camera_path_is_refused(room, matrices, fov, more, match):
    path = flown(room.parent, matrices, fov)
    check_refused(UserSceneOptions(room, **{"camera": path, **more}), match)
