"""Fingerprints of scenes."""

from dataclasses import replace

import numpy as np
import pytest

from rlbench.apps.render.fingerprint import fingerprint
from tests.apps.render.small_scenes import OTHER_CAMERA, diffuse, room, room_with_takes, square


def test_a_fingerprint_ignores_the_last_bit_of_a_number():
    jitter = replace(room().meshes[1], vertices=room().meshes[1].vertices * np.float32(1 + 1e-7))
    other = replace(room(), meshes=(room().meshes[0], jitter, *room().meshes[2:]))
    assert fingerprint(room(), 8) == fingerprint(other, 8)


def test_a_fingerprint_notices_a_new_mesh():
    more = replace(room(), meshes=(*room().meshes, square("new", 1.0, 2.0, diffuse(0, 0, 0))))
    assert fingerprint(room(), 8) != fingerprint(more, 8)


def test_takes_do_not_change_the_fingerprint_of_the_main_clip():
    assert fingerprint(room_with_takes(), 8) == fingerprint(room(), 8)


@pytest.mark.parametrize(
    "change",
    [
        {"lights": lambda time: {"lamp": 0.5 if time == 3 else 1.0}},
        {"cuts": (2,)},
        {
            "camera": lambda time: OTHER_CAMERA if time in (1.0, 2.0) else room().camera(time),
            "cuts": (2,),
        },
    ],
    ids=["lights", "cuts", "camera"],
)
def test_a_fingerprint_notices_lights_and_cuts(change):
    assert fingerprint(replace(room(), **change), 8) != fingerprint(room(), 8)
