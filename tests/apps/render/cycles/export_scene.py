"""Exports the glTF file of shared_scene.py, with its camera, in other formats; needs bpy."""

import json
import math
import sys
from pathlib import Path

import bpy
import mathutils

folder = Path(sys.argv[1])
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=str(folder / "both.gltf"))
scene, path = bpy.context.scene, json.loads((folder / "path.json").read_text())
lens = bpy.data.cameras.new("eye")
eye = bpy.data.objects.new("eye", lens)
scene.collection.objects.link(eye)
scene.camera, eye.rotation_mode = eye, "QUATERNION"
lens.sensor_fit, lens.angle = "HORIZONTAL", math.radians(path["fov"])
for index, rows in enumerate(path["camera_to_world"]):
    place = mathutils.Matrix(rows) @ mathutils.Matrix.Diagonal((-1, 1, -1, 1))
    eye.location, eye.rotation_quaternion = place.to_translation(), place.to_quaternion()
    eye.keyframe_insert("location", frame=index)
    eye.keyframe_insert("rotation_quaternion", frame=index)
scene.frame_start, scene.frame_end = 0, len(path["camera_to_world"]) - 1
# settings that a file may have, and a clip must not use
scene.render.use_motion_blur = scene.render.film_transparent = True
scene.cycles.seed, scene.cycles.use_animated_seed, scene.cycles.film_exposure = 5, True, 3.0
scene.view_layers.new("another")
scene.render.resolution_x = scene.render.resolution_y = 64  # glTF keeps the vertical view
lens.dof.use_dof = True
lens.dof.aperture_fstop = 0.1
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "both.blend"))
scene.view_layers.remove(scene.view_layers["another"])
bpy.ops.wm.usd_export(filepath=str(folder / "both.usd"), export_animation=True)
bpy.ops.export_scene.gltf(filepath=str(folder / "both.glb"), export_cameras=True)
one_take = {"bake_anim_use_all_actions": False, "bake_anim_use_nla_strips": False}
one_take["bake_anim_simplify_factor"] = 0.0
bpy.ops.export_scene.fbx(filepath=str(folder / "both.fbx"), **one_take)
