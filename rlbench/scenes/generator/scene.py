"""Random training scenes from a seed: rooms, halls, open places and shallow water.

No test scene is imported or imitated: shapes, layouts, textures, light and motion all come from the
seed, so a method trained here has not seen what it is measured on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rlbench.render.scene import Camera, Mesh, MitsubaDict, Scene
from rlbench.scenes.generator import materials
from rlbench.scenes.generator.places import PLACES, SOLIDS, Floats, Place, thing
from rlbench.scenes.parts.shapes import (
    Shape,
    boxes,
    grid,
    merge,
    rotation_matrix,
    transform,
    yaw_matrix,
)

FAMILIES = ("room", "hall", "open", "water")
LIGHTS = ("lamps", "bulbs", "sky", "sun", "sunsky")
MOVES = ("dolly", "dolly", "orbit", "orbit", "orbit", "pan", "still", "frozen")
PALE = {"wall": 0.55, "floor": 0.35, "column": 0.4, "ground": 0.3, "block": 0.25, "wood": 0.2}
MIDDLE = 0.22  # display value that the mean radiance is exposed to


Pose = Callable[[float], NDArray[np.float32]]  # vertices [v 3] at a time


class Track(NamedTuple):
    """A camera path, all places it visits [p 3], the point it looks at, and pixels per radian."""

    camera: Callable[[float], Camera]
    visits: Floats
    focus: Floats
    focal: float


class Mover(NamedTuple):
    """A shape, its vertices at each time, and the disc x, y, radius that it stays in."""

    shape: Shape
    pose: Pose
    disc: tuple[float, float, float]


def scene(seed: int) -> Scene:
    """The training scene of a seed: the same seed always gives the same scene.

    Families, light and camera moves are dealt like cards, so that any few consecutive seeds show
    them all; everything else is drawn freely. Radiance is exposed by an estimate of the light in
    the scene, times 2 ** U(-0.7, 0.7).
    """
    rng = np.random.default_rng([0x5CE4E, seed])
    family, kind, move = (
        _dealt(seed, cards, salt) for salt, cards in enumerate((FAMILIES, LIGHTS, MOVES))
    )
    if family == "water":  # hardly a light path finds a small source through a water surface
        kind = {"bulbs": "lamps", "sunsky": "sky"}.get(kind, kind)
    place = PLACES[family](rng, kind)
    light = materials.light(rng, place, kind)
    track = _track(rng, place, move)
    movers = {} if move == "frozen" else _movers(rng, place, track, int(move == "still"))
    parts = place.shell | _clutter(rng, place, track, movers, light.sharp)
    if kind == "sunsky" and place.roof:  # the lower half of that sky is black
        parts["ground"] = boxes([-200, -200, -0.6], [200, 200, -0.5])
    poses = _waving(rng, parts) | {name: m.pose for name, m in movers.items()}
    parts |= {name: m.shape for name, m in movers.items()}
    parts |= {name: parts[name]._replace(vertices=pose(0.0)) for name, pose in poses.items()}
    if move == "frozen":
        poses = {}
    dresses = _materials(rng, light.sharp)
    meshes = [_mesh(rng, name, part, dresses[name]) for name, part in parts.items()]

    return Scene(
        name=f"generated-{seed}",
        title=f"{family}, {kind}, {move}",
        meshes=(*meshes, *light.lamps),
        camera=track.camera,
        sky=light.sky,
        vertex_animation=lambda time: {name: pose(time) for name, pose in poses.items()},
        exposure=MIDDLE / light.level * 2 ** rng.uniform(-0.7, 0.7),
        max_depth=10 if any(m.material["type"] == "dielectric" for m in meshes) else 8,
        static=not poses and move in ("still", "frozen"),
    )


def _dealt(seed: int, cards: Sequence[str], salt: int) -> str:
    """The card of this seed: each run of len(cards) seeds is one shuffled pack."""
    pack, card = divmod(seed, len(cards))
    order = np.random.default_rng([0xDEA1, salt, pack]).permutation(len(cards))
    return cards[int(order[card])]


def _track(rng: Generator, place: Place, move: str) -> Track:
    """A camera that swings through the place at 0.5 to 6 pixels a frame, 192 pixels wide."""
    fov = rng.uniform(50, 78)
    focal = 96 / np.tan(np.radians(fov / 2))
    walk = np.array(place.walk)
    start = np.append(walk * rng.uniform([-0.8, -0.98], [0.8, -0.7]), rng.uniform(*place.eye))
    focus = np.append(np.array(place.half) * rng.uniform(-0.3, 0.3, 2), rng.uniform(*place.gaze))
    if rng.random() < 0.5:  # from the other end
        start[:2] *= -1
    if place.half[1] < 1.7 * place.half[0] and rng.random() < 0.5:  # along the other axis
        start[:2] = start[1::-1] * walk / walk[::-1]
    speed = 2 ** rng.uniform(-0.8, 2.5) / focal  # radians a frame
    heading = np.append(rng.normal(size=2), 0.2 * rng.normal())
    heading /= np.linalg.norm(heading)
    share, phase = rng.uniform(0.5, 1), rng.uniform(-0.6, 0.6)
    away = float(np.linalg.norm(focus - start))

    def pose(swing: float) -> tuple[Floats, Floats]:
        if move == "dolly":
            step = heading * swing * away
            return start + step, focus + share * step
        if move == "orbit":
            return focus + yaw_matrix(swing) @ (start - focus), focus
        return start, start + yaw_matrix(swing) @ (focus - start)

    reach = min(0.35, 16 * speed) if move in ("dolly", "orbit", "pan") else 0.0
    swings = np.linspace(-1, 1, 9)
    visits = np.array([pose(reach * s)[0] for s in swings])
    while (np.abs(visits[:, :2]) > walk).any() or (visits[:, 2] < 0.5 * place.eye[0]).any():
        reach *= 0.8
        visits = np.array([pose(reach * s)[0] for s in swings])
    pace = min(speed / max(reach, 1e-6), 0.4)

    def camera(time: float) -> Camera:
        origin, target = pose(reach * float(np.sin(pace * time + phase)))
        return Camera(_point(origin), _point(target), fov=float(fov))

    return Track(camera, visits, focus, float(focal))


def _point(place: Floats) -> tuple[float, float, float]:
    return float(place[0]), float(place[1]), float(place[2])


def _movers(rng: Generator, place: Place, track: Track, least: int) -> dict[str, Mover]:
    """Up to two things that slide, bob and spin, and a waving cloth, near the focus."""
    found: dict[str, Mover] = {}
    names = ["mover0", "mover1", "cloth"][: int(rng.integers(least, 4))]
    away = float(np.linalg.norm(track.visits.mean(0) - track.focus))
    for name in rng.permutation(names):
        make = _hanging if name == "cloth" else _sliding
        size = rng.uniform(0.6, 1.1) * place.size
        mover = make(rng, size, away / track.focal * 2 ** rng.uniform(-0.8, 2))
        room = np.maximum(np.array(place.half) - mover.disc[2], 0.0)
        taken = [*place.taken, *(m.disc for m in found.values())]
        for _ in range(30):
            spot = np.clip(track.focus[:2] + 0.8 * rng.normal(size=2), -room, room)
            if not _blocked(spot, mover.disc[2], taken, track, place.near):
                found[str(name)] = _placed(mover, np.append(spot, place.floor + 0.003))
                break
    return found


def _placed(mover: Mover, spot: Floats) -> Mover:
    offset = spot.astype(np.float32)
    disc = (float(spot[0]), float(spot[1]), mover.disc[2])
    return Mover(mover.shape, lambda time: mover.pose(time) + offset, disc)


def _sliding(rng: Generator, size: float, speed: float) -> Mover:
    """A thing that slides to and fro, bobs above the floor and spins; `speed` in metres a frame."""
    shape = SOLIDS[rng.integers(len(SOLIDS))](rng, 0.8 * size)
    reach = min(size * rng.uniform(0.2, 0.8), 12 * speed)
    pace, phase = min(speed / reach, 0.5), rng.uniform(0, 2 * np.pi)
    heading = yaw_matrix(rng.uniform(0, 2 * np.pi))[0]
    spin = rng.choice([0, -1, 1]) * min(2 * speed / size, 0.15)
    hover = rng.uniform(0, 0.8) * size
    bob = rng.uniform(0, 0.9) * min(hover, reach)

    def pose(time: float) -> NDArray[np.float32]:
        swing = np.sin(pace * time + phase)
        rise = np.array([0, 0, hover + bob * np.cos(pace * time)])
        return transform(shape, reach * swing * heading + rise, yaw_matrix(spin * time)).vertices

    radius = reach + float(np.hypot(*shape.vertices[:, :2].T).max())
    return Mover(shape, pose, (0.0, 0.0, radius))


def _hanging(rng: Generator, size: float, speed: float) -> Mover:
    """A cloth that hangs and waves; the crests move at about `speed` metres a frame."""
    cloth = transform(grid(size, 1.4 * size, (28, 28)), 0, rotation_matrix((1, 0, 0), np.pi / 2))
    face = yaw_matrix(rng.uniform(0, 2 * np.pi))
    waves = _ripple(rng, 3, 0.8 * size, 0.12 * size)
    waves[:, 3] = np.hypot(*waves[:, :2].T) * speed / 2
    rise = [0, 0, (0.7 + rng.uniform(0, 0.4)) * size]
    loose = np.minimum(0.7 - cloth.vertices[:, 2] / size, 1)  # pinned along its upper edge

    def pose(time: float) -> NDArray[np.float32]:
        blow = loose * _lift(waves, cloth.vertices[:, ::2], time)
        waving = cloth.vertices + blow[:, None] * np.array([0, 1, 0], np.float32)
        return transform(cloth._replace(vertices=waving), rise, face).vertices

    return Mover(cloth, pose, (0.0, 0.0, 0.65 * size))


def _clutter(
    rng: Generator,
    place: Place,
    track: Track,
    movers: Mapping[str, Mover],
    sharp: bool,
) -> dict[str, Shape]:
    """Objects on the floor, clear of the camera and of each other, merged by material."""
    taken = [*place.taken, *(m.disc for m in movers.values())]
    found: dict[str, list[Shape]] = {}
    room = np.array(place.half)
    wanted = int(rng.integers(10, 24) * place.size)
    for _ in range(4 * wanted):
        name, item = thing(rng, place.size)
        if name == "glass" and sharp:
            continue
        radius = float(np.hypot(*item.vertices[:, :2].T).max())
        spot = rng.uniform(-room + radius, np.maximum(room - radius, radius - room + 0.01))
        if rng.random() < 0.5:
            spot = np.clip(track.focus[:2] + rng.normal(size=2), -room + radius, room - radius)
        if _blocked(spot, radius, taken, track, place.near):
            continue
        taken.append((float(spot[0]), float(spot[1]), radius))
        found.setdefault(name, []).append(transform(item, [*spot, place.floor + 0.003]))
        if sum(map(len, found.values())) == wanted:
            break
    if "leaf" in place.shell:
        found.setdefault("leaf", []).append(place.shell["leaf"])
    return {name: merge(*items) for name, items in found.items()}


def _blocked(
    spot: Floats,
    radius: float,
    taken: Sequence[tuple[float, float, float]],
    track: Track,
    near: float,
) -> bool:
    crowd = any(np.hypot(spot[0] - x, spot[1] - y) < radius + r for x, y, r in taken)
    clear = np.hypot(*(track.visits[:, :2] - spot).T).min() - radius
    return bool(crowd or clear < near)


def _waving(rng: Generator, parts: Mapping[str, Shape]) -> dict[str, Pose]:
    """Deforming parts: ripples on water, and leaves that sway in one scene of two."""
    poses: dict[str, Pose] = {}
    if "leaf" in parts and rng.random() < 0.5:
        gusts = _ripple(rng, 3, 2.0, rng.uniform(0.03, 0.12))
        poses["leaf"] = _waved(parts["leaf"], gusts, (1.0, -0.6, 0.3))
    if "water" in parts:
        swell = _ripple(rng, 6, 1.0, rng.uniform(0.01, 0.05))
        poses["water"] = _waved(parts["water"], swell, (0.0, 0.0, 1.0))
    return poses


def _waved(part: Shape, waves: Floats, along: tuple[float, float, float]) -> Pose:
    push = np.array(along, np.float32)
    return lambda time: part.vertices + _lift(waves, part.vertices[:, :2], time)[:, None] * push


def _ripple(rng: Generator, count: int, length: float, height: float) -> Floats:
    """Random plane waves [count 5]: wave vector x y (rad per m), height (m), rad per frame, phase.

    Lengths spread by a factor of two about `length`; crests travel 1 to 4 % of it a frame.
    """
    angle, phase = rng.uniform(0, 2 * np.pi, (2, count))
    number = 2 * np.pi / (length * 2 ** rng.uniform(-1, 1, count))
    speed = 2 * np.pi * rng.uniform(0.01, 0.04, count)
    heights = height / number / (1 / number).sum()
    return np.stack([number * np.cos(angle), number * np.sin(angle), heights, speed, phase], -1)


def _lift(waves: Floats, plane: NDArray[np.float32], time: float) -> NDArray[np.float32]:
    """Height of the waves over each point [v 2], metres; at most the sum of their heights."""
    angle = plane @ waves[:, :2].T + waves[:, 3] * time + waves[:, 4]
    return np.asarray(np.sin(angle) @ waves[:, 2], np.float32)


def _materials(rng: Generator, sharp: bool) -> dict[str, MitsubaDict]:
    """A material for every name that a part can have."""
    plain = (materials.diffuse, materials.textured, materials.plastic)
    finishes = [*plain, materials.metal, materials.plastic if sharp else materials.mirror]
    order = rng.permutation(len(finishes))
    solids = {f"solid{k}": finishes[order[k]](rng) for k in range(3)}
    movers = {f"mover{k}": finishes[order[k + 3]](rng) for k in range(2)}
    shell = {name: plain[rng.integers(3)](rng, PALE[name], 0.4) for name in PALE}
    thin = {"leaf": materials.leaf(rng), "cloth": materials.twosided(materials.textured(rng))}
    clear = {"glass": materials.glass(rng), "water": materials.glass(rng)}
    return solids | movers | shell | thin | clear


def _mesh(rng: Generator, name: str, part: Shape, material: MitsubaDict) -> Mesh:
    tile = np.float32(rng.uniform(0.5, 2.5))  # metres that one tile of a texture covers
    smooth = name not in ("leaf", "wall", "floor", "block")
    return Mesh(name, part.vertices, part.faces, material, part.uv / tile, smooth=smooth)
