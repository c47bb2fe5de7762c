"""Renders a dump as the how-to on importing says, by a plain Blender; needs bpy.

    python write_dump.py FOLDER

A room of three walls without sky: floor, cubes, a lamp, a camera that moves.
"""

import math
import sys
from pathlib import Path

import bpy

FOLDER = Path(sys.argv[1])
FRAMES, SAMPLES, HALF = 3, 2, 96
GEOMETRY = ("use_pass_z", "use_pass_vector", "use_pass_normal")

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene


def paint(item, color):
    """Give an object a diffuse material."""
    material = bpy.data.materials.new(item.name)
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (*color, 1)
    item.data.materials.append(material)


for place, turn in (
    ((0, 0, 0), (0, 0, 0)),
    ((0, 5, 5), (math.pi / 2, 0, 0)),
    ((-5, 0, 5), (0, math.pi / 2, 0)),
    ((5, 0, 5), (0, -math.pi / 2, 0)),
    ((0, 0, 9), (math.pi, 0, 0)),
):
    bpy.ops.mesh.primitive_plane_add(size=40, location=place, rotation=turn)
    paint(bpy.context.object, (0.7, 0.6 - 0.04 * place[0], 0.5))
for number in range(5):
    place = (-3 + 1.5 * number, 1 + number % 2, 0.6)
    bpy.ops.mesh.primitive_cube_add(size=1.2, location=place, rotation=(0, 0, 0.4 * number))
    paint(bpy.context.object, (0.9 - 0.15 * number, 0.2 + 0.1 * number, 0.3))
bpy.ops.object.light_add(type="AREA", location=(1, -1, 6))
bpy.context.object.data.energy, bpy.context.object.data.size = 900, 3
bpy.ops.object.camera_add(location=(0, -6, 3), rotation=(1.25, 0, 0))
camera = scene.camera = bpy.context.object
for frame in range(FRAMES + 1):
    camera.location.x = -0.3 + 0.2 * frame
    camera.keyframe_insert("location", frame=frame)
for curve in camera.animation_data.action.fcurves:
    for point in curve.keyframe_points:
        point.interpolation = "LINEAR"

scene.render.engine = "CYCLES"
scene.render.resolution_x, scene.render.resolution_y = 96, 72
scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
scene.render.image_settings.color_depth = "32"
scene.render.use_motion_blur = False
scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = False, False
scene.cycles.pixel_filter_type, scene.cycles.use_sample_subset = "BOX", True
scene.cycles.samples, scene.cycles.use_animated_seed = SAMPLES + 2 * HALF + 1, True
layer = scene.view_layers[0]


def render(name, offset, length, seed=0, has_geometry=False):
    """Render all frames of one folder of the dump."""
    scene.cycles.sample_offset, scene.cycles.sample_subset_length = offset, length
    scene.cycles.seed = seed
    for each in GEOMETRY:
        setattr(layer, each, has_geometry)
    layer.cycles.denoising_store_passes = has_geometry
    for frame in range(1, FRAMES + 1):
        scene.frame_set(frame)
        scene.render.filepath = str(FOLDER / name / f"shot{frame:04d}.exr")
        bpy.ops.render.render(write_still=True)


render("geometry", 0, 1, has_geometry=True)
for sample in range(1, SAMPLES + 1):
    render(f"sample{sample}", sample, 1)
render("referenceA", SAMPLES + 1, HALF, seed=1)
render("referenceB", SAMPLES + 1 + HALF, HALF, seed=2)
