"""The exposure of a user's scene."""

import pytest

from rlbench.apps.render.mitsuba.open_tracer import open_tracer
from rlbench.apps.render.user import auto_exposure
from rlbench.apps.render.user.clip import UserSceneOptions
from tests.apps.render.small_scenes import looking_down
from tests.apps.render.user.xml_room import (
    BODY,
    check_refused,
    document,
)


def test_the_estimated_exposure_makes_a_uniform_image_grey(llvm):
    # an albedo of one half under a sky of 0.4 on all sides shows 0.2 everywhere
    material = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5] * 3}}
    tracer = open_tracer(looking_down(material, sky=0.4), 16, 16)
    assert auto_exposure.estimate_exposure(tracer, 1) == pytest.approx(
        0.18 / 0.2, rel=0.02
    )  # two digits, and noise


def test_a_scene_without_lights_is_refused(room):
    dark = BODY.replace(
        '<emitter type="area"><rgb name="radiance" value="17, 12, 4"/></emitter>', ""
    )
    check_refused(UserSceneOptions(document(room.parent, dark)), "no light")
