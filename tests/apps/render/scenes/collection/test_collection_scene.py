"""Scenes by others as clips: the scene's own camera, random paths by seed, and missing files."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from rlbench.apps.render.jobs.job import Job
from rlbench.apps.render.jobs.render_clips import preset_jobs, render_missing, scene_of_clip
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.scene import SceneError
from rlbench.apps.render.scenes.collection import catalog
from rlbench.apps.render.scenes.collection.catalog import load_catalog, pins_folder
from rlbench.apps.render.scenes.collection.pins import Pin, PinnedFile, blob_id, format_pin
from rlbench.apps.render.scenes.collection.scene import collection_scene
from rlbench.clips.header import read_header
from rlbench.clips.presets import PRESETS, Preset
from tests.apps.render.conftest import install_scene
from tests.apps.render.user.test_wander import write_flat

PRESET = Preset("small", "tests", (16, 24), frames=2, reference_spp=2, pool_spp=2)


@pytest.fixture
def attic(tmp_path, monkeypatch):
    """A scene that is pinned and lies in a mirror."""
    monkeypatch.setenv("RLBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv(catalog.MIRROR_VARIABLE, str(tmp_path / "mirror"))
    select_variant()
    folder = tmp_path / "mirror" / "attic"
    write_flat(folder, '<shape type="obj"><string name="filename" value="flag.obj"/></shape>')
    files = tuple(
        PinnedFile(path.name, blob_id(path), path.stat().st_size)
        for path in (folder / "scene.xml", folder / "flag.obj")
    )
    pins_folder().mkdir(parents=True)
    pin = Pin("wig42/rooms", 40 * "a", "attic", files)
    (pins_folder() / "attic.tsv").write_text(format_pin(pin))
    return folder


def test_each_scene_of_the_catalog_is_a_scene_plugin(attic):
    for name in load_catalog():
        if name != "attic":
            with pytest.raises(SceneError, match=f"scene {name} lies in none of"):
                scene_of_clip(f"{name}-003")


def test_the_camera_and_the_exposure_are_chosen_when_the_scene_is_inspected(attic):
    main, random = collection_scene("attic"), collection_scene("attic", 2)
    inspected = main.inspect(3, (16, 24)), random.inspect(3, (16, 24))
    origins = [[scene.camera(time).origin for time in (0.0, 2.0)] for scene in inspected]
    np.testing.assert_allclose(origins[0][0], (-2.5, 1.4, 0.6), atol=1e-5)
    assert origins[0] != origins[1]
    assert all(scene.exposure != 1.0 and scene.inspector is None for scene in inspected)
    assert random.source_hash == inspected[1].source_hash != main.source_hash
    assert random.inspect(3, (16, 24)).camera(1.0) == inspected[1].camera(1.0)


def test_a_clip_is_rendered_and_found_finished(attic):
    scene = collection_scene("attic", 1)
    job = Job("attic-001", scene, PRESET, attic.parent / "clip")
    (folder,) = render_missing([job])
    header = read_header(folder)
    assert (header.scene, header.missing_files) == ("attic", ())
    assert "unknown" in header.licence
    assert header.exposure != 1.0
    assert job.is_finished


def test_missing_files_change_the_scene_and_are_refused_in_a_reported_clip(attic, monkeypatch):
    before = collection_scene("attic", 1)
    (attic / "flag.obj").unlink()
    after = collection_scene("attic", 1)
    assert after.source_hash != before.source_hash
    assert after.inspect(1, (16, 24)).missing_files == ("flag.obj",)
    install_scene(monkeypatch, "attic", partial(collection_scene, "attic"))
    reported = Preset("shown", "tests", (16, 24), 2, 2, ("attic-001",))
    with pytest.raises(SceneError, match=r"misses 1 files, such as flag.obj: run `rlbench scenes"):
        preset_jobs(reported)
    assert len(preset_jobs(replace(reported, uses=("decide",)))) == 1


def test_scenes_that_are_reported_are_in_no_preset_for_training_or_decisions():
    catalog_names, reported, others = set(load_catalog()), set(), set()
    for preset in PRESETS.values():
        names = {c if c in catalog_names else c.rpartition("-")[0] for c in preset.scenes}
        (reported if preset.uses == ("report",) else others).update(names & catalog_names)
    assert {"living-room", "classroom", "staircase2"} <= reported
    assert not reported & others


def test_no_training_path_is_one_of_a_decision():
    assert not set(PRESETS["train-real"].scenes) & set(PRESETS["real-development"].scenes)
    assert not any(clip.startswith("living-room-2") for clip in PRESETS["train-real"].scenes)
