"""Settings with which Cycles gives independent, unbiased, unfiltered samples.

SPDX-License-Identifier: GPL-3.0-or-later
"""

from __future__ import annotations

import math
from typing import Any

import bpy
import mathutils

LAYER = "view"  # the prefix of every channel
# README.md gives the reason for each
CYCLES = {
    "device": "CPU",
    "sampling_pattern": "TABULATED_SOBOL",
    "use_animated_seed": False,
    "auto_scrambling_distance": False,
    "scrambling_distance": 1.0,
    "pixel_filter_type": "BOX",
    "use_adaptive_sampling": False,
    "use_denoising": False,
    "time_limit": 0.0,
    "use_auto_tile": False,
    "use_guiding": False,
    "use_fast_gi": False,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "blur_glossy": 0.0,
    "caustics_reflective": True,
    "caustics_refractive": True,
    "light_sampling_threshold": 0.0,
    "use_light_tree": True,
    "min_light_bounces": 0,
    "min_transparent_bounces": 0,
    "film_exposure": 1.0,
    "film_transparent_glass": False,
    "use_layer_samples": "IGNORE",
}
RENDER = {
    "engine": "CYCLES",
    "use_motion_blur": False,  # with it, the Vector pass is zero
    "use_persistent_data": False,  # with it, changing passes crash, and seeds change meaning
    "use_compositing": False,
    "use_sequencer": False,
    "use_freestyle": False,
    "use_multiview": False,
    "use_border": False,
    "film_transparent": False,
    "resolution_percentage": 100,
    "pixel_aspect_x": 1.0,
    "pixel_aspect_y": 1.0,
    "dither_intensity": 0.0,
    "use_file_extension": False,
    "use_overwrite": True,
    "use_placeholder": False,
}


def prepare(scene: Any, job: dict[str, Any]) -> None:
    """All settings of a job, equal for all its images, so that none can leak into another job."""
    for group, settings in ((scene.cycles, CYCLES), (scene.render, RENDER)):
        for name, value in settings.items():
            setattr(group, name, value)
    bounces = job["max_bounces"] if job["max_bounces"] is not None else scene.cycles.max_bounces
    for kind in ("max", "diffuse", "glossy", "transmission", "volume"):
        setattr(scene.cycles, f"{kind}_bounces", bounces)
    scene.render.resolution_y, scene.render.resolution_x = job["size"]
    if job["threads"]:
        scene.render.threads_mode, scene.render.threads = "FIXED", job["threads"]
    if job["world"] is not None:
        scene.world = _white(job["world"])
    output = scene.render.image_settings
    output.file_format, output.color_depth = "OPEN_EXR_MULTILAYER", "32"
    output.exr_codec = "ZIP"
    _passes(scene, job["geometry"])


def _white(strength: float) -> Any:
    world = bpy.data.worlds.new("rlbench")
    world.use_nodes = True
    background = next(n for n in world.node_tree.nodes if n.type == "BACKGROUND")
    background.inputs[0].default_value = (1, 1, 1, 1)
    background.inputs[1].default_value = strength
    return world


def _passes(scene: Any, geometry: bool) -> None:
    """One layer with radiance, or with the passes of a G-buffer; equal for all images of a job."""
    kept, *others = scene.view_layers
    for layer in others:
        layer.use = False
    kept.use, kept.name = True, LAYER
    for group in (kept, kept.cycles):
        for name in (p.identifier for p in group.bl_rna.properties):
            if name.startswith("use_pass_") and name != "use_pass_combined":
                setattr(group, name, False)
    kept.use_pass_z = kept.use_pass_normal = kept.use_pass_vector = geometry
    kept.cycles.denoising_store_passes = geometry


def aim(scene: Any, path: dict[str, Any], start: int) -> None:
    """Replace the camera by a pinhole along `path`, with keys, which the Vector pass needs."""
    data = bpy.data.cameras.new("rlbench")
    item = bpy.data.objects.new("rlbench", data)
    scene.collection.objects.link(item)
    item.rotation_mode, data.sensor_fit = "QUATERNION", "HORIZONTAL"
    data.clip_start, data.clip_end = 1e-4, 1e6
    for index, (rows, fov) in enumerate(zip(path["matrices"], path["fov"], strict=True)):
        matrix = mathutils.Matrix(rows)
        item.location, item.rotation_quaternion = matrix.to_translation(), matrix.to_quaternion()
        data.lens = data.sensor_width / (2 * math.tan(math.radians(fov) / 2))
        for owner, name in ((item, "location"), (item, "rotation_quaternion"), (data, "lens")):
            owner.keyframe_insert(name, frame=start - 1 + index)
    scene.camera = item
