"""Random training scenes from a seed: rooms, halls, open places and shallow water.

No test scene is imported or imitated: shapes, layouts, textures, light and motion all come from the
seed, so a method trained here has not seen what it is measured on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from rlbench.render.scene import Camera, Mesh, Plugin, Scene
from rlbench.scenes import generator_looks as looks
from rlbench.scenes import generator_shapes as shapes
from rlbench.scenes.generator_places import PLACES, Place
from rlbench.scenes.generator_shapes import Floats, Shape, moved, turn

FAMILIES = ("room", "hall", "open", "water")
LIGHTS = ("lamps", "bulbs", "sky", "sun", "sunsky")
MOVES = ("dolly", "dolly", "orbit", "orbit", "orbit", "pan", "still", "frozen")
PALE = {"wall": 0.55, "floor": 0.35, "column": 0.4, "ground": 0.3, "block": 0.25, "wood": 0.2}
GREY = 0.45  # mean albedo that the light estimate assumes
MIDDLE = 0.22  # display value that the mean radiance is exposed to


@dataclass(frozen=True)
class Light:
    """Lamps and sky, and the mean radiance they are expected to give."""

    level: float
    sky: tuple[Plugin, ...] = ()
    lamps: tuple[Mesh, ...] = ()
    sharp: bool = False  # would mirrors and glass make fireflies of it?


class Track(NamedTuple):
    """A camera path, all places it visits [p 3], the point it looks at, and pixels per radian."""

    camera: Callable[[float], Camera]
    visits: Floats
    focus: Floats
    focal: float


class Mover(NamedTuple):
    """A shape, its vertices at each time, and the disc x, y, radius that it stays in."""

    shape: Shape
    pose: Callable[[float], Floats]
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
    light = _light(rng, place, kind)
    track = _track(rng, place, move)
    movers = {} if move == "frozen" else _movers(rng, place, track, int(move == "still"))
    parts = place.shell | _clutter(rng, place, track, movers, light.sharp)
    waving = {} if move == "frozen" else _waving(rng, parts)
    poses = waving | {name: m.pose for name, m in movers.items()}
    parts |= {name: m.shape for name, m in movers.items()}

    def moving(time: float) -> dict[str, NDArray[np.float32]]:
        return {name: pose(time).astype(np.float32) for name, pose in poses.items()}

    now = moving(0.0)
    dresses = _materials(rng, light.sharp)
    meshes = [_mesh(rng, name, part, dresses[name], now.get(name)) for name, part in parts.items()]

    return Scene(
        name=f"generated-{seed}",
        title=f"{family}, {kind}, {move}",
        meshes=(*meshes, *light.lamps),
        camera=track.camera,
        sky=light.sky,
        moving=moving,
        exposure=MIDDLE / light.level * 2 ** rng.uniform(-0.7, 0.7),
        depth=10 if any(m.material["type"] == "dielectric" for m in meshes) else 8,
        static=move == "frozen",
    )


def _dealt(seed: int, cards: Sequence[str], salt: int) -> str:
    """The card of this seed: each run of len(cards) seeds is one shuffled pack."""
    pack, turn_ = divmod(seed, len(cards))
    order = np.random.default_rng([0xDEA1, salt, pack]).permutation(len(cards))
    return cards[order[turn_]]


def _light(rng: Generator, place: Place, kind: str) -> Light:
    """Sky and lamps of one kind, and the mean radiance that the grey place reflects."""
    sky, toward, sun, dome = _sky(rng, place, kind)
    glows = []
    if kind == "bulbs":
        glows.append(_bulbs(rng, place))
    elif kind == "lamps" or (place.roof and rng.random() < 0.6):
        glows.append(_lamps(rng, place, 1.0 if kind == "lamps" else 0.3))
    flux = sum(glow.flux for glow in glows)
    if place.roof:
        x, y = 2 * place.half[0], 2 * place.half[1]
        area = 2 * x * y + 2 * (x + y) * (place.top - place.floor)
        for hole in place.holes:
            slant = max(0.0, float(toward @ hole.outward))
            flux += hole.area * (0.7 * np.pi * dome + 0.7 * sun * slant)
        level = flux * GREY / (np.pi * area * (1 - GREY))
    else:
        level = GREY * (flux / 120 / np.pi + 0.8 * dome + 0.7 * sun * toward[2] / np.pi)
    lamps = tuple(glow.mesh for glow in glows)
    return Light(float(level), sky, lamps, sharp=kind in ("bulbs", "sunsky"))


def _sky(
    rng: Generator, place: Place, kind: str
) -> tuple[tuple[Plugin, ...], Floats, float, float]:
    """Emitters, direction to the sun, irradiance of the sun and radiance of the sky dome."""
    outward = np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a), 0.0])
    if place.holes:
        outward = np.array(place.holes[rng.integers(len(place.holes))].outward)
    tilt = rng.uniform(0.35, 0.9) if outward[2] < 0.5 else rng.uniform(1.0, 1.3)
    around = np.arctan2(outward[1], outward[0]) + rng.uniform(-0.8, 0.8)
    flat = np.cos(tilt)
    toward = np.array([flat * np.cos(around), flat * np.sin(around), np.sin(tilt)])
    if kind == "sunsky":
        plugin = {"type": "sunsky", "sun_direction": [float(v) for v in toward]}
        scale = {"sun_scale": 10.0, "sky_scale": 10.0, "turbidity": float(rng.uniform(2.5, 6))}
        return (plugin | scale,), toward, 11.0, 0.9  # measured from the plugin, 15 to 60 degrees
    night = kind in ("lamps", "bulbs")
    tint = looks.colour(rng, 0.9, 1, vivid=0.5) * (rng.uniform(0.01, 0.1) if night else 1)
    sky: tuple[Plugin, ...] = ({"type": "constant", "radiance": looks.rgb(tint)},)
    dome = float(tint @ looks.BRIGHTNESS)
    if kind != "sun":
        return sky, toward, 0.0, dome
    beam = np.array([1, rng.uniform(0.75, 1), rng.uniform(0.5, 0.95)]) * rng.uniform(5, 14)
    sun = {"type": "directional", "direction": [float(-v) for v in toward]}
    power = float(beam @ looks.BRIGHTNESS)
    return (*sky, sun | {"irradiance": looks.rgb(beam)}), toward, power, dome


def _lamps(rng: Generator, place: Place, scale: float) -> looks.Glow:
    """A few rectangles under the roof, or hanging in the open."""
    spread = np.array(place.half) - 0.7 * place.lamp - 0.1
    lamps = []
    for _ in range(int(rng.integers(1, 5))):
        x, y = rng.uniform(0.5, 1.4, 2) * place.lamp
        down = shapes.quad(np.array([[-x, y, 0], [x, y, 0], [x, -y, 0], [-x, -y, 0]]) / 2)
        slant = turn(0 if place.roof else rng.uniform(-0.6, 0.6), int(rng.integers(2)))
        height = place.top - (0.02 + 0.01 * len(lamps) if place.roof else rng.uniform(0, 1))
        lamps.append(moved(down, [*rng.uniform(-spread, spread), height], slant))
    tint = looks.colour(rng, 0.9, 1, vivid=0.45) * rng.uniform(4, 12) * scale / place.lamp**2
    return looks.panels("lamps", lamps, tint)


def _bulbs(rng: Generator, place: Place) -> looks.Glow:
    """Many small coloured lamps on walls and roof, or around an open place."""
    count = int(rng.integers(6, 17) * rng.integers(8, 21))
    sizes = rng.uniform(0.05, 0.2, count) * (1.5 if place.top > 3.8 else 1)
    x, y = place.half
    if place.roof:
        spot = rng.uniform(
            [-x + 0.2, -y + 0.2, 0.4], [x - 0.2, y - 0.2, place.top - 0.2], (count, 3)
        )
        side = rng.choice(5, count, p=[0.2, 0.2, 0.2, 0.2, 0.2])
        normals = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1.0]])[side]
        faces = np.array([-x, x, -y, y, place.top])[side]
        axis = np.array([0, 0, 1, 1, 2])[side]
        spot[np.arange(count), axis] = faces + 0.02 * normals[np.arange(count), axis]
        return looks.bulbs(rng, spot, normals, sizes)
    angle, far = rng.uniform(0, 2 * np.pi, count), rng.uniform(5.6, 8, count)
    spot = np.stack([far * np.cos(angle), far * np.sin(angle), rng.uniform(0.5, 4, count)], -1)
    inward = rng.uniform([-2, -2, 0], [2, 2, 1], (count, 3)) - spot
    normals = inward / np.linalg.norm(inward, axis=-1, keepdims=True)
    return looks.bulbs(rng, spot, normals, 2 * sizes)


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
            return focus + turn(swing) @ (start - focus), focus
        return start, start + turn(swing) @ (focus - start)

    reach = min(0.35, 16 * speed) if move in ("dolly", "orbit", "pan") else 0.0
    swings = np.linspace(-1, 1, 9)
    visits = np.array([pose(reach * s)[0] for s in swings])
    while (np.abs(visits[:, :2]) > walk).any() or (visits[:, 2] < 0.5 * place.eye[0]).any():
        reach *= 0.8
        visits = np.array([pose(reach * s)[0] for s in swings])
    pace = min(speed / max(reach, 1e-6), 0.4)

    def camera(time: float) -> Camera:
        origin, target = pose(reach * float(np.sin(pace * time + phase)))
        return Camera(tuple(map(float, origin)), tuple(map(float, target)), fov=float(fov))

    return Track(camera, visits, focus, float(focal))


def _movers(rng: Generator, place: Place, track: Track, least: int) -> dict[str, Mover]:
    """Up to two things that slide, bob and spin, and a waving cloth, near the focus."""
    found: dict[str, Mover] = {}
    names = ["mover0", "mover1", "cloth"][: int(rng.integers(least, 4))]
    away = float(np.linalg.norm(track.visits.mean(0) - track.focus))
    for name in rng.permutation(names):
        make = _hanging if name == "cloth" else _sliding
        size = rng.uniform(0.6, 1.1) * (1.0 if place.top < 4 else 1.4)
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
    disc = (float(spot[0]), float(spot[1]), mover.disc[2])
    return Mover(moved(mover.shape, spot), lambda time: mover.pose(time) + spot, disc)


def _sliding(rng: Generator, size: float, speed: float) -> Mover:
    """A thing that slides to and fro, bobs above the floor and spins; `speed` in metres a frame."""
    makers = (_ball, _ring, _crate, _vase, _stack)
    shape = makers[rng.integers(len(makers))](rng, 0.8 * size)
    reach = min(size * rng.uniform(0.2, 0.8), 12 * speed)
    pace, phase = min(speed / reach, 0.5), rng.uniform(0, 2 * np.pi)
    heading = turn(rng.uniform(0, 2 * np.pi)) @ [1, 0, 0]
    spin = rng.choice([0, -1, 1]) * min(2 * speed / size, 0.15)
    hover = rng.uniform(0, 0.8) * size
    bob = rng.uniform(0, 0.9) * min(hover, reach)

    def pose(time: float) -> Floats:
        swing = float(np.sin(pace * time + phase))
        place = reach * swing * heading + [0, 0, hover + bob * np.cos(pace * time)]
        return moved(shape, place, turn(spin * time)).vertices

    radius = reach + float(np.hypot(*shape.vertices[:, :2].T).max())
    return Mover(shape, pose, (0.0, 0.0, radius))


def _hanging(rng: Generator, size: float, speed: float) -> Mover:
    """A cloth that hangs and waves; the crests move at about `speed` metres a frame."""
    cloth = moved(shapes.sheet(size, 1.4 * size, 28), [0, 0, 0], turn(np.pi / 2, 0))
    face = turn(rng.uniform(0, 2 * np.pi))
    waves = shapes.ripple(rng, 3, 0.8 * size, 0.12 * size)
    waves[:, 3] = np.hypot(*waves[:, :2].T) * speed / 2
    foot = np.array([0, 0, (0.7 + rng.uniform(0, 0.4)) * size])

    def pose(time: float) -> Floats:
        loose = 0.7 - cloth.vertices[:, 2] / size  # pinned along its upper edge
        blow = shapes.lift(waves, cloth.vertices[:, ::2], time) * np.minimum(loose, 1)
        return (cloth.vertices + blow[:, None] * [0, 1, 0]) @ face.T + foot

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
    wanted = int(rng.integers(10, 24))
    for _ in range(4 * wanted):
        name, item = _thing(rng, 1.0 if place.top < 4 else 1.4)
        if name == "glass" and sharp:
            continue
        radius = float(np.hypot(*item.vertices[:, :2].T).max())
        spot = rng.uniform(-room + radius, np.maximum(room - radius, radius - room + 0.01))
        if rng.random() < 0.5:
            spot = np.clip(track.focus[:2] + rng.normal(size=2), -room + radius, room - radius)
        if _blocked(spot, radius, taken, track, place.near):
            continue
        taken.append((float(spot[0]), float(spot[1]), radius))
        found.setdefault(name, []).append(moved(item, [*spot, place.floor + 0.003]))
        if sum(map(len, found.values())) == wanted:
            break
    if "leaf" in place.shell:
        found.setdefault("leaf", []).append(place.shell["leaf"])
    return {name: shapes.merged(items) for name, items in found.items()}


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


def _thing(rng: Generator, size: float) -> tuple[str, Shape]:
    """A random object about the origin and the name of its material."""
    name = str(
        rng.choice(["solid0", "solid1", "solid2", "glass", "leaf"], p=[0.3, 0.25, 0.2, 0.1, 0.15])
    )
    size *= rng.uniform(0.5, 1.1)
    if name == "leaf":
        radii = size * rng.uniform(0.25, 0.6, 3)
        bush = shapes.leaves(
            rng, int(rng.integers(150, 500)), radii, size * rng.uniform(0.08, 0.25)
        )
        return name, moved(bush, [0, 0, radii[2] + 0.15 * size])
    makers = (
        (_ball, _drum, _ring, _crate, _vase)
        if name == "glass"
        else (_ball, _drum, _ring, _crate, _vase, _stack, _rods, _table)
    )
    item = makers[rng.integers(len(makers))](rng, size)
    return name, moved(item, [0, 0, 0], turn(rng.uniform(0, 2 * np.pi)))


def _ball(rng: Generator, size: float) -> Shape:
    return shapes.sphere(0.4 * size)


def _drum(rng: Generator, size: float) -> Shape:
    return shapes.cylinder(
        0.3 * size, size * rng.uniform(0.3, 1.5), float(rng.choice([1, 0.6, 0.05]))
    )


def _ring(rng: Generator, size: float) -> Shape:
    thick = size * rng.uniform(0.06, 0.16)
    ring = shapes.torus(0.35 * size, thick)
    if rng.random() < 0.5:
        return ring
    return moved(ring, [0, thick, 0.35 * size + thick], turn(np.pi / 2, 0))


def _crate(rng: Generator, size: float) -> Shape:
    return shapes.box(*(size * rng.uniform(0.3, 0.9, 3)))


def _vase(rng: Generator, size: float) -> Shape:
    radii = 0.35 * size * rng.uniform(0.3, 1, 4)
    height = np.linspace(0, size * rng.uniform(0.7, 1.4), 25)
    radius = np.interp(height, np.linspace(0, height[-1], 4), radii)
    profile = np.stack(
        [np.convolve(np.pad(radius, 3, "edge"), np.ones(7) / 7, "valid"), height], -1
    )
    return shapes.lathe([[0, 0], *profile, [0, height[-1]]])


def _stack(rng: Generator, size: float) -> Shape:
    z, blocks = 0.0, []
    for _ in range(int(rng.integers(2, 6))):
        x, y, rise = size * rng.uniform([0.3, 0.3, 0.15], [0.8, 0.8, 0.4])
        offset = [*(rng.uniform(-0.08, 0.08, 2) * size), z]
        blocks.append(moved(shapes.box(x, y, rise), offset, turn(rng.uniform(-0.5, 0.5))))
        z += rise
    return shapes.merged(blocks)


def _rods(rng: Generator, size: float) -> Shape:
    feet, tops = rng.uniform(-0.4, 0.4, (2, int(rng.integers(3, 14)), 2)) * size
    rods = [
        shapes.rod([*a, 0], [*b, size * rng.uniform(0.8, 2)], rng.uniform(0.008, 0.03))
        for a, b in zip(feet, 0.5 * feet + 0.5 * tops, strict=True)
    ]
    return shapes.merged(rods)


def _table(rng: Generator, size: float) -> Shape:
    x, y, z = size * rng.uniform([0.7, 0.5, 0.4], [1.2, 0.9, 0.8])
    legs = [
        shapes.rod([i * x * 0.45, j * y * 0.45, 0], [i * x * 0.45, j * y * 0.45, z], 0.03)
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    ball = shapes.sphere(0.2 * size)
    return shapes.merged(
        [*legs, moved(shapes.box(x, y, 0.05), [0, 0, z]), moved(ball, [0, 0, z + 0.05])]
    )


def _waving(rng: Generator, parts: Mapping[str, Shape]) -> dict[str, Callable[[float], Floats]]:
    """Deforming parts: ripples on water, and leaves that sway in one scene of two."""
    poses: dict[str, Callable[[float], Floats]] = {}
    if "leaf" in parts and rng.random() < 0.5:
        poses["leaf"] = _sway(parts["leaf"], shapes.ripple(rng, 3, 2.0, rng.uniform(0.03, 0.12)))
    if "water" in parts:
        poses["water"] = _swell(parts["water"], shapes.ripple(rng, 6, 1.0, rng.uniform(0.01, 0.05)))
    return poses


def _sway(part: Shape, waves: Floats) -> Callable[[float], Floats]:
    def pose(time: float) -> Floats:
        plane = part.vertices[:, :2]
        push = [shapes.lift(waves, plane + k, time) for k in (0, 7, 13)]
        return part.vertices + np.stack(push, -1) * [1, 1, 0.3]

    return pose


def _swell(part: Shape, waves: Floats) -> Callable[[float], Floats]:
    def pose(time: float) -> Floats:
        plane = part.vertices[:, :2]
        return np.column_stack([plane, part.vertices[:, 2] + shapes.lift(waves, plane, time)])

    return pose


def _materials(rng: Generator, sharp: bool) -> dict[str, Plugin]:
    """A material for every name that a part can have."""
    plain = (looks.diffuse, looks.textured, looks.plastic)
    finishes = [*plain, looks.metal, looks.plastic if sharp else looks.mirror]
    order = rng.permutation(len(finishes))
    solids = {f"solid{k}": finishes[order[k]](rng) for k in range(3)}
    movers = {f"mover{k}": finishes[order[k + 3]](rng) for k in range(2)}
    shell = {name: plain[rng.integers(3)](rng, PALE[name], 0.4) for name in PALE}
    thin = {"leaf": looks.leaf(rng), "cloth": looks.twosided(looks.textured(rng))}
    clear = {"glass": looks.glass(rng), "water": looks.glass(rng)}
    return solids | movers | shell | thin | clear


def _mesh(
    rng: Generator, name: str, part: Shape, material: Plugin, pose: NDArray[np.float32] | None
) -> Mesh:
    tile = rng.uniform(0.5, 2.5)  # metres that one tile of a texture covers
    return Mesh(
        name,
        part.vertices.astype(np.float32) if pose is None else pose,
        part.faces.astype(np.uint32),
        material,
        (part.uv / tile).astype(np.float32),
        smooth=name not in ("leaf", "wall", "floor", "block"),
    )
