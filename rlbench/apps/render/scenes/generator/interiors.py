"""Random rooms, how light enters them, and where the furniture stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from rlbench.apps.render.scenes.generator.furniture import (
    Piece,
    build_cabinet,
    build_chair,
    build_divider,
    build_floor_lamp,
    build_ornament,
    build_picture,
    build_plant,
    build_shade,
    build_shelf,
    build_sofa,
    build_table,
    finish_piece,
    move,
)
from rlbench.apps.render.scenes.generator.motion import CameraTrack, is_blocked
from rlbench.apps.render.scenes.generator.places import Disc, Place
from rlbench.apps.render.scenes.generator.solids import Opening, Openings, build_walls, opening_row
from rlbench.apps.render.scenes.parts.shapes import (
    Float64Array,
    Shape,
    boxes,
    cylinder,
    disc,
    icosphere,
    lathe,
    quads,
    transform,
    yaw_matrix,
)
from rlbench.apps.render.scenes.parts.sheets import sheet

LIGHTS = ("cove", "uplight", "ajar", "sky", "sun", "panel", "panel", "bulbs", "spots", "mixed")
DAYLIGHTS = ("sky", "sun", "panel", "mixed")
TREATMENTS = ("bare", "blinds", "blinds", "curtains", "mullions", "panes")
WALL_ITEMS = (build_cabinet, build_sofa, build_plant, build_table)
TALL_ITEMS = (build_shelf, build_shelf, build_divider)
DOOR_WIDTH, DOOR_HEIGHT = 0.9, 2.05  # metres
RUG_TOP = 0.014  # metres, a little above the rug
NEXT_ROOM = (3.0, 2.6)  # metres, width and depth of the room behind a door


@dataclass(frozen=True)
class Interior:
    """A room with its fixtures, still without furniture."""

    place: Place
    openings: Openings
    fixtures: list[Piece]

    @property
    def area(self) -> float:
        """Area of walls, floor and ceiling, in m2."""
        x, y = 2 * self.place.half_size[0], 2 * self.place.half_size[1]
        return 2 * x * y + 2 * (x + y) * self.place.lamp_height

    def hang(self, wall: int, pieces: Sequence[Piece], along: float = 0.0) -> list[Piece]:
        """Pieces, built with the wall at y = 0 and the room at y < 0, moved to one of the walls."""
        flat = move(pieces, [along, self.place.half_size[1 - wall % 2], 0])
        return move(flat, [0, 0, 0], yaw_matrix(wall * np.pi / 2))


class FloorPlan(NamedTuple):
    """Discs of the floor that are taken, and the camera path, from which furniture keeps away."""

    track: CameraTrack
    discs: list[Disc]

    def claim(self, item: Sequence[Piece], spot: Float64Array, clearance: float) -> bool:
        """Take the disc that an item would cover about `spot` [2]; False if it is not free."""
        low, high = _bounds(item)
        radius = 0.47 * float(np.hypot(*(high - low)[:2]))
        if is_blocked(spot, radius, self.discs, self.track, clearance):
            return False
        self.discs.append((float(spot[0]), float(spot[1]), radius))
        return True


def draw_interior(rng: Generator, light: str, treatment: str) -> Interior:
    """A room with windows, doors and built-in lamps for one of LIGHTS and one of TREATMENTS."""
    half_size, height = (rng.uniform(1.7, 3.0), rng.uniform(2.2, 3.8)), rng.uniform(2.35, 3.1)
    thickness, walls = rng.uniform(0.12, 0.5), [int(k) for k in rng.permutation(4)]
    openings: Openings = {}
    if light in DAYLIGHTS:
        for k in walls[: 2 if light == "sky" else int(rng.integers(1, 3))]:
            length = 2 * half_size[k % 2] - 0.5
            openings[k] = opening_row(rng, length, rng.uniform(0.8, 1.7), 0.4, height)
    if light == "ajar":
        x = rng.uniform(-0.6, 0.6)
        door = Opening(x - DOOR_WIDTH / 2, x + DOOR_WIDTH / 2, 0.01, DOOR_HEIGHT)
        openings[walls[0]] = [door]
    shell, apertures = build_walls(half_size, height, thickness, openings, has_roof=True)
    place = Place(
        half_size,
        (half_size[0] - 0.4, half_size[1] - 0.4),
        (0.95, 1.7),
        (0.5, 1.2),
        height,
        shell,
        (),
        apertures,
        has_roof=True,
        camera_clearance=0.6,
        object_scale=0.5,
    )
    interior = Interior(place, openings, [Piece(*part) for part in shell.items()])
    for wall, row in openings.items():
        for opening in row:
            fitting = _fit_opening(rng, opening, thickness, height, light, treatment)
            interior.fixtures.extend(interior.hang(wall, fitting))
    if light in ("sky", "sun"):
        ground = finish_piece(rng, "paint", boxes([-60, -60, -1.0], [60, 60, -0.5]))
        interior.fixtures.append(ground)
    interior.fixtures.extend(_build_fixed_lamps(rng, interior, walls, light))
    return interior


def furnish(
    rng: Generator, interior: Interior, track: CameraTrack, occupied: Sequence[Disc], light: str
) -> dict[str, list[Shape]]:
    """Shapes of the fixtures and of furniture along the walls and in the middle, by finish.

    Furniture is clear of the camera, of occupied discs and of each other.
    """
    is_shielded = light in ("cove", "uplight", "ajar")
    has_bulbs = light in ("bulbs", "mixed") or (is_shielded and rng.random() < 0.6)
    plan = FloorPlan(track, list(occupied))
    pieces = [
        *interior.fixtures,
        *_line_walls(rng, interior, plan, light, has_bulbs),
        *_furnish_middle(rng, interior.place, plan, has_bulbs),
    ]
    for wall in set(range(4)) - set(interior.openings):
        length = 2 * interior.place.half_size[wall % 2] - 0.4
        pieces += interior.hang(wall, _hang_pictures(rng, length))
    shapes: dict[str, list[Shape]] = {}
    for finish, shape in pieces:
        shapes.setdefault(finish, []).append(shape)
    return shapes


def _line_walls(
    rng: Generator, interior: Interior, plan: FloorPlan, light: str, has_bulbs: bool
) -> list[Piece]:
    """Furniture along walls without doors, lamps first; nothing tall stands before a window."""
    pieces: list[Piece] = []
    lamps = {"uplight": 3, "bulbs": 2, "mixed": 1}.get(light, 0)
    for attempt in range(60):
        wall = int(rng.integers(4))
        if lamps > 0 and has_bulbs and attempt % 2:
            item = build_cabinet(rng, has_lamp=True)
        elif lamps > 0:
            item = build_floor_lamp(rng, is_uplight=light == "uplight")
        else:
            builders = WALL_ITEMS if wall in interior.openings else WALL_ITEMS + TALL_ITEMS
            item = builders[rng.integers(len(builders))](rng)
        low, high = _bounds(item)
        reach = interior.place.half_size[wall % 2] - (high - low)[0] / 2 - 0.1
        along = rng.uniform(-reach, reach) if reach > 0 else 0.0
        if any(one.low < 0.1 for one in interior.openings.get(wall, [])):
            continue
        item = move(item, [-(low + high)[0] / 2, -high[1] - 0.03, 0])
        moved = interior.hang(wall, item, along)
        if plan.claim(item, np.mean(_bounds(moved), 0)[:2], 0.4):
            pieces += moved
            lamps -= 1
    return pieces


def _furnish_middle(rng: Generator, place: Place, plan: FloorPlan, has_bulbs: bool) -> list[Piece]:
    """Tables with chairs near the focus, perhaps under a lamp, a rug, and things on the floor."""
    pieces: list[Piece] = []
    bounds = np.array(place.half_size) - 0.7
    rug = np.append(rng.uniform(0.35, 0.65, 2) * place.half_size, 0.012)
    if rng.random() < 0.7:
        flat = boxes(-rug * [1, 1, 0], rug)
        stretched = (flat.vertices[:, :2] / rug[:2] / 2 + 0.5).astype(np.float32)
        pieces.append(Piece("rug", flat._replace(uv=stretched)))
    groups, things = int(rng.integers(2, 5)), int(rng.integers(3, 9))
    for attempt in range(60):
        turn = yaw_matrix(rng.choice(4) * np.pi / 2 + rng.normal() * 0.15)
        spot = np.clip(plan.track.focus[:2] + rng.normal(size=2) * 0.8, -bounds, bounds)
        is_group = attempt < 30 and groups > 0
        if is_group:
            item, clearance = _build_group(rng), 0.6
        elif things:
            item, clearance = build_ornament(rng, rng.uniform(0.2, 0.6)), 0.5
            spot = rng.uniform(-bounds - 0.3, bounds + 0.3)
        else:
            break
        item = move(item, [0, 0, 0], turn)
        if not plan.claim(item, spot, clearance):
            continue
        pieces += move(item, [*spot, RUG_TOP])
        groups, things = groups - is_group, things - (not is_group)
        if is_group and has_bulbs:
            pieces += move(_build_pendant(rng, place.lamp_height), [*spot, 0])
    return pieces


def _build_group(rng: Generator) -> list[Piece]:
    """A table with up to four chairs, or an armchair."""
    if rng.random() < 0.25:
        return build_sofa(rng)
    table = build_table(rng)
    half = _bounds(table)[1]
    for k in range(4):
        if rng.random() < 0.6:
            distance = half[1 - k % 2] + rng.uniform(0.12, 0.3)
            chair = move(build_chair(rng), [0, 0, 0], yaw_matrix(rng.normal() * 0.2))
            table = table + move(
                move(chair, [0, distance, 0]), [0, 0, 0], yaw_matrix(k * np.pi / 2)
            )
    return table


def _hang_pictures(rng: Generator, length: float) -> list[Piece]:
    """Pictures and mirrors in a row along a wall."""
    pieces: list[Piece] = []
    left = -length / 2 + rng.uniform(0, 0.6)
    while left < length / 2 - 0.5:
        width, height = rng.uniform(0.25, 1.0), rng.uniform(0.3, 0.9)
        if left + width < length / 2 and rng.random() < 0.75:
            spot = [left + width / 2, -0.003, rng.uniform(1.75, 1.95) - height]
            pieces += move(build_picture(rng, width, height), spot)
        left += width + rng.uniform(0.1, 0.7)
    return pieces


def _fit_opening(
    rng: Generator, opening: Opening, thickness: float, height: float, light: str, treatment: str
) -> list[Piece]:
    """What belongs to an opening: a room behind a door, or the treatment of a window, and a sky."""
    if light == "ajar":
        return _build_next_room(rng, opening, thickness, height)
    if light == "sun" and treatment == "panes":  # glass would stop the sun
        treatment = "mullions"
    fitting = _build_treatment(rng, opening, thickness, treatment)
    return fitting + [_build_panel(opening, thickness)] * (light in ("panel", "mixed"))


def _build_fixed_lamps(
    rng: Generator, interior: Interior, walls: Sequence[int], light: str
) -> list[Piece]:
    """Troughs on two or three of the walls, or spots under the ceiling."""
    height = interior.place.lamp_height
    if light == "spots":
        return _build_spots(rng, interior.place.half_size, height)
    troughs: list[Piece] = []
    for wall in walls[: int(rng.integers(2, 4))] if light == "cove" else ():
        trough = _build_trough(rng, 2 * interior.place.half_size[wall % 2] - 0.7, height)
        troughs += interior.hang(wall, trough)
    return troughs


def _build_panel(opening: Opening, thickness: float) -> Piece:
    """A bright panel, in place of the sky, that closes an opening from outside."""
    left, right, low, high = opening
    corner = [left - 0.02, thickness + 0.005, low - 0.02]
    return Piece("panel", quads(corner, [right - left + 0.04, 0, 0], [0, 0, high - low + 0.04]))


def _build_treatment(
    rng: Generator, opening: Opening, thickness: float, treatment: str
) -> list[Piece]:
    """What hangs or stands in a window: blinds, curtains, glazing bars or a pane of glass."""
    left, right, low, high = opening
    width, height = right - left, high - low
    if treatment == "blinds":
        z = np.arange(high - 0.02, high - height * rng.uniform(0.4, 1), -0.05)[:, None]
        angle = rng.uniform(-1.1, 1.1)
        deep = 0.048 * np.array([0, np.cos(angle), np.sin(angle)])
        corner = z * [0, 0, 1] + [left + 0.01, 0.05, 0] - deep / 2
        slats = quads(corner, [width - 0.02, 0, 0], deep)
        return [finish_piece(rng, str(rng.choice(("lacquer", "paint", "wood"))), slats)]
    if treatment == "curtains":
        finish, foot = (
            str(rng.choice(("shade", "fabric"))),
            rng.choice([0.03, max(low - 0.1, 0.03)]),
        )
        share, folds = rng.uniform(0.15, 0.4), rng.uniform(8, 16)
        curtains = []
        for begin in (left - 0.1, right + 0.1 - share * width):
            x = np.linspace(begin, begin + share * width, 60)
            fold = -0.09 + 0.04 * np.sin(folds * x * 2)
            rows = [np.stack([x, fold, 0 * x + level], -1) for level in (foot, high + 0.08)]
            curtains.append(sheet(np.stack(rows)))
        return [finish_piece(rng, finish, *curtains)]
    if treatment == "mullions":
        x = np.linspace(left, right, int(rng.integers(3, 6)))[1:-1, None] * [1, 0, 0]
        z = np.linspace(low, high, int(rng.integers(3, 6)))[1:-1, None] * [0, 0, 1]
        upright, level = x + [0, 0.7 * thickness, low], z + [left, 0.7 * thickness, 0]
        bars = [
            boxes(upright - [0.02, 0.02, 0], upright + [0.02, 0.02, height]),
            boxes(level - [0, 0.02, 0.02], level + [width, 0.02, 0.02]),
        ]
        return [finish_piece(rng, str(rng.choice(("wood", "lacquer"))), *bars)]
    if treatment == "panes":
        pane = quads([left, 0.6 * thickness, low], [width, 0, 0], [0, 0, height])
        return [Piece("pane", pane)]
    return []


def _build_next_room(rng: Generator, door: Opening, thickness: float, height: float) -> list[Piece]:
    """A lit room behind a door that stands ajar."""
    width, depth = NEXT_ROOM
    middle = (door.left + door.right) / 2
    low, high = (
        np.array([middle - width / 2, thickness, -0.01]),
        np.array([middle + width / 2, thickness + depth, height]),
    )
    sides = []
    for axis, end in ((0, low), (0, high), (1, high), (2, low), (2, high)):
        a, b = low - [0.1, 0, 0.1], high + 0.1
        a[axis], b[axis] = (
            (end[axis] - 0.1, end[axis]) if end is low else (end[axis], end[axis] + 0.1)
        )
        sides.append(boxes(a, b))
    angle, leaf_width = rng.uniform(0.5, 1.5), DOOR_WIDTH - 0.02
    leaf = transform(
        boxes([0, 0, 0.02], [leaf_width, 0.04, DOOR_HEIGHT - 0.02]), 0, yaw_matrix(angle)
    )
    hinged = transform(leaf, [door.left + 0.01, thickness + 0.005, 0])
    if rng.random() < 0.5:  # the lamp faces the door, or the floor
        lamp = quads([middle - 0.4, high[1] - 0.02, 1.2], [0.8, 0, 0], [0, 0, 0.6])
    else:
        lamp = quads([middle - 0.4, high[1] - 1.3, height - 0.02], [0, 0.8, 0], [0.8, 0, 0])
    return [
        *(Piece("wall", side) for side in sides),
        finish_piece(rng, str(rng.choice(("wood", "lacquer", "paint"))), hinged),
        Piece("glow", lamp),
    ]


def _build_trough(rng: Generator, length: float, height: float) -> list[Piece]:
    """A ledge high on a wall that hides a strip of light, which shines on the ceiling."""
    z, x = height - rng.uniform(0.45, 0.9), length / 2
    ledge = boxes([[-x, -0.2, z], [-x, -0.21, z]], [[x, 0, z + 0.02], [x, -0.2, z + 0.08]])
    strip = quads([0.02 - x, -0.18, z + 0.03], [2 * x - 0.04, 0, 0], [0, 0.15, 0])
    return [
        finish_piece(rng, str(rng.choice(("paint", "wood", "lacquer"))), ledge),
        Piece("glow", strip),
    ]


def _build_spots(rng: Generator, half_size: tuple[float, float], height: float) -> list[Piece]:
    """Small lamps in tubes under the ceiling, which light narrow cones."""
    counts = rng.integers(1, 4, 2) + [0, 1]
    rows = [np.linspace(-1, 1, 2 * n + 1)[1::2] * h for n, h in zip(counts, half_size, strict=True)]
    radius, deep = rng.uniform(0.05, 0.09), rng.uniform(0.025, 0.06)
    tube = lathe([(radius, height - deep), (radius, height)], 16)
    face = disc(0.8 * radius, 0.0, 12)
    lamp = face._replace(faces=face.faces[:, ::-1])
    spots = [[float(x), float(y), 0.0] for x in rows[0] for y in rows[1]]
    return [
        *(Piece("bulb", transform(lamp, [x, y, height - 0.015])) for x, y, _ in spots),
        finish_piece(rng, "paint", *(transform(tube, spot) for spot in spots)),
    ]


def _build_pendant(rng: Generator, height: float) -> list[Piece]:
    """A lamp that hangs from the ceiling on a cord: in an open shade, or in a globe of glass."""
    low = rng.uniform(1.5, min(1.9, height - 0.5))
    cord = Piece("steel", cylinder(0.006, low + 0.1, height, 6))
    if rng.random() < 0.15:
        globe = transform(icosphere(3), [0, 0, low], scale=0.14)
        bulb = transform(icosphere(2), [0, 0, low], scale=0.11)
        return [cord, Piece("pane", globe), Piece("bulb", bulb)]
    return [cord, *move(build_shade(rng, rng.uniform(0.12, 0.25)), [0, 0, low])]


def _bounds(pieces: Sequence[Piece]) -> tuple[Float64Array, Float64Array]:
    """Low and high corner [3] of the pieces."""
    vertices = np.concatenate([shape.vertices for _, shape in pieces]).astype(float)
    return vertices.min(0), vertices.max(0)
