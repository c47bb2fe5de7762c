"""Small scenes with known pixels."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rlbench.apps.render.scene import Camera, Mesh, Scene, Take

STEP = np.array([0.1, -0.05, 0.02])  # metres that the cube of `room` moves per frame


def grey(value):
    return {"type": "rgb", "value": [value] * 3}


def diffuse(*colour):
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(colour)}}


def square(name, half, z, material, up=1, **more):
    corners = [[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]
    faces = [[0, 1, 2], [0, 2, 3]] if up > 0 else [[0, 2, 1], [0, 3, 2]]
    vertices = np.array(corners, np.float32)
    return Mesh(name, vertices, np.array(faces, np.uint32), material, **more)


def box(name, low, high, material):
    vertices = [[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)]
    sides = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    return Mesh(name, np.array(vertices, np.float32), np.array(faces, np.uint32), material)


def ball(rings=48, around=64):
    """A sphere of radius one, at whose poles many faces meet."""
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.arange(around) * 2 * np.pi / around, indexing="ij"
    )
    vertices = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1
    ).reshape(-1, 3)
    row, column = np.indices((rings, around)).reshape(2, -1)
    corner = [row * around + column, (row + 1) * around + column]
    after = [row * around + (column + 1) % around, (row + 1) * around + (column + 1) % around]
    faces = np.concatenate(
        [np.stack([*corner, after[1]], 1), np.stack([corner[0], after[1], after[0]], 1)]
    )
    return Mesh("ball", vertices.astype(np.float32), faces.astype(np.uint32), {}, smooth=True)


def room(static=False):
    """Ground, a moving cube, gold, a pane of glass, a lamp and a sky; the camera passes by."""
    cube = box("cube", (-0.5, -0.5, 0.1), (0.5, 0.5, 1.1), diffuse(0.2, 0.4, 0.8))
    gold = {"type": "roughconductor", "alpha": 0.2, "material": "Au"}
    pane = box("pane", (-1.5, -2.0, 0.0), (-0.5, -1.9, 1.5), {"type": "dielectric"})
    lamp = {"type": "area", "radiance": grey(12.0)}
    pace = 0.0 if static else 1.0
    return Scene(
        name="room",
        title="A room for tests",
        meshes=(
            square("ground", 5.0, 0.0, diffuse(0.6, 0.5, 0.4)),
            cube,
            box("gold", (1.0, -0.5, 0.0), (2.0, 0.5, 1.0), gold),
            pane,
            square("lamp", 1.0, 4.0, diffuse(0.0, 0.0, 0.0), up=-1, emission=lamp),
        ),
        camera=lambda time: Camera((0.5 + 0.2 * pace * time, -6.0, 2.5), (0, 0, 0.5), fov=50.0),
        sky=({"type": "constant", "radiance": grey(0.3)},),
        vertex_animation=lambda time: {
            "cube": (cube.vertices + pace * time * STEP).astype(np.float32),
        },
        exposure=2.0,
        static=static,
    )


def looking_down(material, height=3.0, fov=50.0, sky=1.0, depth=2):
    """A wide plane of one material at z = 0, seen straight from above under a constant sky."""
    return Scene(
        name="plane",
        title="A plane for tests",
        meshes=(square("plane", 100.0, 0.0, material),),
        camera=lambda time: Camera((0, 0, height), (0, 0, 0), up=(0, 1, 0), fov=fov),
        sky=({"type": "constant", "radiance": grey(sky)},),
        max_depth=depth,
    )


def stretching(material):
    """The plane of `looking_down`, which grows by a tenth of its first size each frame."""
    scene = looking_down(material)
    (plane,) = scene.meshes
    return replace(
        scene, vertex_animation=lambda time: {"plane": plane.vertices * np.float32(1 + time / 10)}
    )


def around_the_corner(material):
    """Seen from the origin along y: a tilted square at 4 m, which shows a wall 3 m to the right."""
    tilted = np.array([[-1, 3, -1], [1, 5, -1], [1, 5, 1], [-1, 3, 1]], np.float32)
    wall = np.array([[3, 0, -4], [3, 0, 4], [3, 8, 4], [3, 8, -4]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    return Scene(
        name="corner",
        title="A corner for tests",
        meshes=(
            Mesh("tilted", tilted, faces, material),
            Mesh("wall", wall, faces, diffuse(0.2, 0.4, 0.8)),
        ),
        camera=lambda time: Camera((0, 0, 0), (0, 1, 0), fov=10.0),
        sky=({"type": "constant", "radiance": grey(1.0)},),
    )


def atlas(half, height, texels):
    """A square lamp of 2 x 2 squares, each shining with one texel of an image."""
    corners = np.array([[-1, -1], [0, -1], [-1, 0], [0, 0]], np.float32) * half
    quad = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32) * half
    vertices = np.concatenate([np.column_stack([quad + c, [height] * 4]) for c in corners])
    middles = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]], np.float32)
    faces = np.concatenate([np.array([[0, 2, 1], [0, 3, 2]]) + 4 * i for i in range(4)])
    image = {"type": "bitmap", "data": texels, "raw": True, "filter_type": "nearest"}
    return Mesh(
        "lamp",
        vertices.astype(np.float32),
        faces.astype(np.uint32),
        diffuse(0.0, 0.0, 0.0),
        uv=np.repeat(middles, 4, axis=0),
        emission={"type": "area", "radiance": image},
    )


def under_a_lamp(half, height, radiance, albedo):
    """The point of a floor below the middle of a square lamp that faces it, and its radiance.

    Howell's catalogue of configuration factors, B-4: a differential element parallel to a
    rectangle, its normal through the rectangle's corner; four such rectangles make the lamp.
    """
    lamp = {"type": "area", "radiance": grey(radiance)}
    scene = Scene(
        name="lamp",
        title="A lamp for tests",
        meshes=(
            square("floor", 50.0, 0.0, diffuse(albedo, albedo, albedo)),
            square("lamp", half, height, diffuse(0.0, 0.0, 0.0), up=-1, emission=lamp),
        ),
        camera=lambda time: Camera((5.0, 0.0, height / 2), (0, 0, 0), fov=0.2),
        max_depth=2,
    )
    side = half / height
    slant = math.sqrt(1 + side**2)
    factor = 4 / (2 * math.pi) * 2 * side / slant * math.atan(side / slant)
    return scene, albedo * radiance * factor


OTHER_CAMERA = Camera((4.0, -4.0, 1.5), (0, 0, 0.5), fov=50.0)


def room_with_takes():
    """The room with two takes: one with a cut, after which the lamp goes out; one static."""
    first = room().camera
    shots = Take(
        "cut",
        lambda time: first(time) if time < 2 else OTHER_CAMERA,
        lights=lambda time: {"lamp": 1.0 if time < 3 else 0.0},
        cuts=(2, 9),
    )
    still = Take("still", lambda time: OTHER_CAMERA, vertex_animation=lambda time: {}, static=True)
    return replace(room(), takes=(shots, still))
