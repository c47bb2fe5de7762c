"""Events of generated scenes: what is switched, where the camera cuts, how fast things move."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from rlbench.render.presets import PRESETS
from rlbench.render.scene import Scene
from rlbench.scenes.generator.scene import EVENTS, eventful_scene, scene

SEEDS = range(128, 144)  # two packs: every event
TIMES = np.arange(12.0)  # of the frames of preset train-eventful


@pytest.fixture(scope="module")
def eventful_scenes() -> dict[int, Scene]:
    return {seed: eventful_scene(seed) for seed in SEEDS}


def get_event(scene: Scene) -> str:
    return scene.title.rpartition(", ")[2]


def get_direction(scene: Scene, time: float) -> np.ndarray:
    camera = scene.camera(time)
    direction = np.subtract(camera.target, camera.origin)[:2]
    return direction / np.linalg.norm(direction)


def test_every_pack_of_seeds_has_every_event(eventful_scenes):
    counts = Counter(map(get_event, eventful_scenes.values()))
    assert counts == Counter(EVENTS + EVENTS)


def test_a_switched_scene_changes_one_emitter_once(eventful_scenes):
    for switched in eventful_scenes.values():
        factors = [dict(switched.lights(time)) for time in TIMES]
        names = {name for frame in factors for name in frame}
        if "switch" not in get_event(switched):
            assert not names
            continue
        (name,) = names
        assert name in {mesh.name for mesh in switched.meshes if mesh.emission} | {"sky0"}
        values = [frame[name] for frame in factors]
        assert np.count_nonzero(np.diff(values)) == 1
        assert values[0] == 1
        assert 1 / 8 <= values[-1] <= 4


def test_a_cut_turns_the_camera_at_its_frame_only(eventful_scenes):
    for seed, cut in eventful_scenes.items():
        if "cut" not in get_event(cut):
            assert cut.cuts == ()
            continue
        (frame,) = cut.cuts
        still = scene(seed)
        for time in TIMES:
            cosine = get_direction(cut, time) @ get_direction(still, time)
            angle = np.degrees(np.arccos(min(1.0, cosine)))
            assert angle < 1e-3 if time < frame else 39.9 < angle < 140.1
            assert cut.camera(time).origin == still.camera(time).origin
        assert not cut.static


def test_a_scene_that_hurries_follows_the_same_path_faster(eventful_scenes):
    hurried = [s for s in eventful_scenes.items() if get_event(s[1]).startswith("hurry")]
    assert len(hurried) == 4
    for seed, fast in hurried:
        slow = scene(seed)
        candidates = np.linspace(2, 4, 2001)
        offsets = [
            np.abs(np.subtract(fast.camera(1.0).origin, slow.camera(speed).origin)).max()
            + np.abs(np.subtract(fast.camera(1.0).target, slow.camera(speed).target)).max()
            for speed in candidates
        ]
        assert min(offsets) < 1e-3  # metres; the speeds are 0.001 apart


def test_no_seed_of_the_training_presets_belongs_to_a_test_set():
    tested = {seed for preset in PRESETS.values() if preset.is_test_set for seed in preset.seeds}
    trained = {
        seed for preset in PRESETS.values() if not preset.is_test_set for seed in preset.seeds
    }
    assert not tested & trained
