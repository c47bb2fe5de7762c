"""Scenes by others as scene plugins: `living-room` and, for each seed, `living-room-007`."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace

from rlbench.apps.render.gltf.document import FORMATS as GLTF
from rlbench.apps.render.gltf.read_scene import GLTF_VERSION
from rlbench.apps.render.mitsuba.variant import select_variant
from rlbench.apps.render.mitsuba.xml_scene import REPAIRS_VERSION
from rlbench.apps.render.scene import Camera, Scene, SceneError, XmlFile
from rlbench.apps.render.scenes.collection.catalog import LocatedScene, digest, locate
from rlbench.apps.render.user.camera_path import matrix_from_camera
from rlbench.apps.render.user.clip import UserSceneOptions, plan_clip
from rlbench.apps.render.user.scene_file import open_scene_file
from rlbench.apps.render.user.wander import WANDER_VERSION
from rlbench.clips.presets import get_preset


def collection_scene(name: str, seed: int | None = None) -> Scene:
    """A scene of the collection: a dolly from its own camera or, with `seed`, a random path.

    Nothing is traced before `Scene.inspect`. Shapes whose files are missing are left out and
    recorded. Raises SceneError for a scene that is not on this machine.

    >>> collection_scene("no-such-scene")
    Traceback (most recent call last):
        ...
    rlbench.apps.render.scene.SceneError: no scene 'no-such-scene' in the collection; ...
    """
    located = locate(name)
    entry = located.entry
    is_xml = located.scene.suffix == ".xml"
    if not is_xml and located.scene.suffix.lower() not in GLTF:
        raise SceneError(
            f"Cycles renders {located.scene.name}, so it is not a scene of a preset. Render it by: "
            f"rlbench render {located.scene}"
        )
    source = f"{digest(located)} {REPAIRS_VERSION} {WANDER_VERSION} {name} {seed}"
    if not is_xml:
        source += f" {GLTF_VERSION} {entry.sky} {entry.camera}"
    described = Scene(
        name,
        entry.title,
        (),
        lambda time: Camera((0, 0, 0), (0, 0, 1)),  # until it is inspected
        xml_file=XmlFile(located.scene, (), bool(located.missing)) if is_xml else None,
        source_hash=hashlib.blake2b(source.encode(), digest_size=16).hexdigest(),
        licence=f"{entry.licence}, '{entry.title}' by {entry.author}, {entry.source}",
        missing_files=located.missing,
    )

    def inspect(frames: int, size: tuple[int, int]) -> Scene:
        chosen = _inspect(located, seed, frames, size)
        return replace(
            described,
            meshes=chosen.meshes,
            sky=chosen.sky,
            camera=chosen.camera,
            exposure=chosen.exposure,
            max_depth=chosen.max_depth,
            missing_files=chosen.missing_files,
        )

    return replace(described, inspector=inspect)


def _inspect(located: LocatedScene, seed: int | None, frames: int, size: tuple[int, int]) -> Scene:
    options = UserSceneOptions(
        file=located.scene,
        camera="dolly" if seed is None else "wander",
        frames=frames,
        size=size,
        seed=seed,
        sky=located.entry.sky,
        skip_missing=bool(located.missing),
    )
    select_variant()
    user_scene = open_scene_file(options.file, options.parameters, options.skip_missing)
    if start := located.entry.camera:
        camera = Camera(start.origin, start.target, fov=start.fov)
        matrix = matrix_from_camera(camera)
        user_scene = replace(user_scene, camera_to_world=matrix, fov=start.fov)
    job, _ = plan_clip(options, user_scene, get_preset("mini"))
    return job.scene.inspect(frames, size)


def _plugin(name: str) -> Callable[[int | None], Scene]:
    """The scene plugin of a name, with an optional seed."""

    def scene(seed: int | None = None) -> Scene:
        return collection_scene(name, seed)

    return scene


# entry points in the group rlbench.scenes
bathroom = _plugin("bathroom")
bathroom2 = _plugin("bathroom2")
classroom = _plugin("classroom")
cornell_box_picture = _plugin("cornell_box_picture")
dining_room = _plugin("dining-room")
isometric_room = _plugin("isometric-room")
kitchen = _plugin("kitchen")
living_room = _plugin("living-room")
living_room_2 = _plugin("living-room-2")
low_poly_jungle_scene = _plugin("low-poly-jungle-scene")
office_room = _plugin("office-room")
shanghai = _plugin("shanghai")
snowy_hut = _plugin("snowy-hut")
spaceship = _plugin("spaceship")
staircase = _plugin("staircase")
staircase2 = _plugin("staircase2")
veach_ajar = _plugin("veach-ajar")
veach_bidir = _plugin("veach-bidir")
veach_mis = _plugin("veach-mis")
