"""The scene of the how-to on denoising an animation, for a plain Blender: writes 4 spp a frame.

    BLENDER_PYTHON docs/denoise_scene.py FOLDER

A room lit by one small lamp behind a screen, a chequered floor, boxes, and a camera that moves.
"""

import math
import sys
from pathlib import Path
from typing import Any

import bpy

Numbers = tuple[float, ...]
FOLDER, FRAMES, SAMPLES = Path(sys.argv[1]), 24, 4

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene


def paint(item: Any, color: Numbers, roughness: float = 0.7, second: Numbers = ()) -> None:
    """Give an object a material, chequered where there is a second colour."""
    material = bpy.data.materials.new(item.name)
    material.use_nodes = True
    nodes, shader = material.node_tree.nodes, material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = roughness
    if second:
        checker = nodes.new("ShaderNodeTexChecker")
        checker.inputs["Color1"].default_value = (*color, 1)
        checker.inputs["Color2"].default_value = (*second, 1)
        checker.inputs["Scale"].default_value = 24
        links = material.node_tree.links
        links.new(checker.outputs["Color"], shader.inputs["Base Color"])
    item.data.materials.append(material)


def add_box(
    place: Numbers, size: Numbers, turn: float, color: Numbers, roughness: float = 0.7
) -> None:
    """A box on the floor."""
    bpy.ops.mesh.primitive_cube_add(size=1, location=place, rotation=(0, 0, turn))
    bpy.context.object.scale = size
    paint(bpy.context.object, color, roughness)


for place, turn, color in (
    ((0, 5, 4), (math.pi / 2, 0, 0), (0.7, 0.7, 0.65)),
    ((-5, 0, 4), (0, math.pi / 2, 0), (0.7, 0.25, 0.15)),
    ((5, 0, 4), (0, -math.pi / 2, 0), (0.2, 0.45, 0.65)),
    ((0, 0, 6), (math.pi, 0, 0), (0.75, 0.75, 0.75)),
    ((0, -9, 4), (-math.pi / 2, 0, 0), (0.7, 0.7, 0.7)),
):
    bpy.ops.mesh.primitive_plane_add(size=24, location=place, rotation=turn)
    paint(bpy.context.object, color)
bpy.ops.mesh.primitive_plane_add(size=24, location=(0, 0, 0))
paint(bpy.context.object, (0.75, 0.72, 0.66), second=(0.2, 0.17, 0.15))
for number in range(6):
    place = (-3.4 + 1.4 * number, 1.6 + 1.3 * (number % 2), 0.5 + 0.25 * (number % 3))
    color = (0.85 - 0.12 * number, 0.25 + 0.1 * number, 0.3 + 0.07 * number)
    add_box(place, (0.8, 0.8, 2 * place[2]), 0.5 * number, color, 0.15 + 0.1 * number)
add_box((1.2, 3.4, 3.2), (3.4, 0.1, 2.2), 0.0, (0.6, 0.6, 0.6))  # hides the lamp
bpy.ops.object.light_add(type="AREA", location=(1.2, 4.2, 3.4), rotation=(math.pi / 2, 0, 0))
bpy.context.object.data.energy, bpy.context.object.data.size = 900, 0.5
bpy.ops.object.camera_add(location=(0, -6, 2.4), rotation=(1.42, 0, 0))
camera = scene.camera = bpy.context.object
camera.data.lens = 28
for frame in range(FRAMES + 2):
    turn = 2 * math.pi * frame / FRAMES
    camera.location.x, camera.location.z = 0.8 * math.sin(turn), 2.4 + 0.2 * math.cos(turn)
    camera.rotation_euler.z = 0.06 * math.sin(turn)
    for name in ("location", "rotation_euler"):
        camera.keyframe_insert(name, frame=frame)

scene.render.engine = "CYCLES"
scene.render.resolution_x, scene.render.resolution_y = 256, 160
scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
scene.render.use_motion_blur = False
scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = False, False
scene.cycles.samples, scene.cycles.use_animated_seed = SAMPLES, True
layer = scene.view_layers[0]
layer.use_pass_z = layer.use_pass_vector = layer.use_pass_normal = True
layer.cycles.denoising_store_passes = True
for frame in range(1, FRAMES + 1):
    scene.frame_set(frame)
    scene.render.filepath = str(FOLDER / f"{frame:04d}.exr")
    bpy.ops.render.render(write_still=True)
