"""Random furniture, lamps and ornaments: pieces that stand on the origin and face -y.

Every `build_` function returns a list of pieces; lengths are metres. Bulbs are pieces as well, of
the finish `bulb`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from rlbench.apps.render.scenes.generator.finishes import PALETTE_SIZE, PALETTED, PICTURES
from rlbench.apps.render.scenes.generator.solids import SOLIDS, build_box, build_foliage
from rlbench.apps.render.scenes.generator.solids import build_vase as build_vase_solid
from rlbench.apps.render.scenes.parts.shapes import (
    Float32Array,
    Shape,
    boxes,
    cylinder,
    disc,
    icosphere,
    lathe,
    merge,
    paint,
    quads,
    rotation_matrix,
    transform,
    yaw_matrix,
)

BODIES = ("wood", "wood", "lacquer", "lacquer", "paint", "metal", "steel")
ORNAMENTS = ("lacquer", "lacquer", "paint", "metal", "steel", "glass", "wood", "mirror")
LAMP_BODIES = ("metal", "steel", "lacquer")
SHADES = ("shade", "paint", "paint", "lacquer", "metal")
GAP = 0.002  # metres between an ornament and what it stands on


class Piece(NamedTuple):
    """A shape and the name of its finish."""

    finish: str
    shape: Shape


def move(
    pieces: Sequence[Piece], translation: ArrayLike, rotation: Float32Array | None = None
) -> list[Piece]:
    """The pieces rotated, then translated."""
    return [Piece(finish, transform(shape, translation, rotation)) for finish, shape in pieces]


def finish_piece(rng: Generator, finish: str, *shapes: Shape) -> Piece:
    """One piece from shapes, in one random colour if the finish has a palette."""
    shape = merge(*shapes)
    if finish in PALETTED:
        shape = paint(shape, int(rng.integers(PALETTE_SIZE)), PALETTE_SIZE)
    return Piece(finish, shape)


def build_table(rng: Generator, has_lamp: bool = False) -> list[Piece]:
    """A dining, coffee or console table with ornaments."""
    x, y, z = rng.uniform([0.5, 0.4, 0.35], [1.7, 0.9, 0.8])
    top, legs = rng.choice(BODIES, 2)
    feet = np.array([[i, j, 0] for i in (-x, x) for j in (-y, y)]) * 0.45
    width = rng.uniform(0.012, 0.035)
    pieces = [
        finish_piece(rng, legs, boxes(feet - [width, width, 0], feet + [width, width, z])),
        finish_piece(rng, top, transform(build_box(x, y, 0.04), [0, 0, z])),
    ]
    return pieces + _set_out(rng, x, y, z + 0.04, has_lamp=has_lamp)


def build_chair(rng: Generator) -> list[Piece]:
    """A chair with a slatted back."""
    seat, height, tall = rng.uniform([0.38, 0.42, 0.8], [0.5, 0.48, 1.1])
    half = seat / 2 - 0.02
    feet = np.array([[i, j, 0] for i in (-half, half) for j in (-half, half)])
    rise = np.array([[0.018, 0.018, height], [0.018, 0.018, tall]] * 2)
    slats = np.linspace(-half, half, int(rng.integers(3, 8)))[:, None] * [1, 0, 0]
    slats = slats + [0, half, height + 0.06]
    frame = boxes(feet - [0.018, 0.018, 0], feet + rise)
    back = boxes(slats - [0.012, 0.008, 0], slats + [0.012, 0.008, tall - height - 0.1])
    pieces = [
        finish_piece(rng, str(rng.choice(BODIES)), frame, back),
        finish_piece(
            rng,
            str(rng.choice(("wood", "fabric", "paint"))),
            transform(build_box(seat, seat, 0.04), [0, 0, height - 0.02]),
        ),
    ]
    if rng.random() < 0.4:
        cushion = transform(_build_cushion(seat, seat, 0.08), [0, 0, height + 0.025])
        pieces.append(finish_piece(rng, "paint", cushion))
    return pieces


def build_sofa(rng: Generator) -> list[Piece]:
    """An armchair or a sofa: rounded boxes, and cushions of other colours."""
    seats = int(rng.integers(1, 4))
    width, depth, seat_height = 0.65 * seats, rng.uniform(0.75, 0.95), rng.uniform(0.36, 0.45)
    arms = [
        transform(_build_cushion(0.16, depth, 0.55), [side * (width / 2 + 0.08), 0, 0.05])
        for side in (-1, 1)
    ]
    back = transform(_build_cushion(width, 0.22, 0.8), [0, depth / 2 - 0.12, 0.05])
    base = transform(build_box(width, depth, 0.2), [0, 0, 0.06])
    seat = _build_cushion(0.64, depth - 0.2, 0.2)
    middles = (np.arange(seats) - (seats - 1) / 2) * 0.65
    rows = [transform(seat, [x, -0.08, seat_height - 0.18]) for x in middles]
    upholstery = str(rng.choice(("fabric", "fabric", "paint")))
    pieces = [finish_piece(rng, upholstery, base, back, *arms, *rows)]
    for x in middles[rng.random(seats) < 0.7]:
        tilt = rotation_matrix((1, 0, 0), rng.uniform(0.9, 1.3))
        pillow = transform(_build_cushion(0.42, 0.42, 0.14), [x, 0.1, seat_height + 0.2], tilt)
        pieces.append(finish_piece(rng, str(rng.choice(("paint", "fabric"))), pillow))
    return pieces


def build_shelf(rng: Generator) -> list[Piece]:
    """An open shelf with books and ornaments on its boards."""
    width, depth, height = rng.uniform([0.6, 0.25, 0.9], [1.4, 0.38, 2.1])
    levels = np.linspace(0.05, height, int(height / rng.uniform(0.3, 0.45)) + 1)
    boards = np.stack([0 * levels, 0 * levels, levels], -1)
    half = np.array([width / 2, depth / 2, 0.012])
    sides = np.array([[-1], [1]]) * [width / 2, 0, 0] + [0, 0, height / 2]
    frame = [
        boxes(boards - half, boards + half),
        boxes(
            sides - [0.015, depth / 2, height / 2], sides + [0.015, depth / 2, height / 2 + 0.013]
        ),
    ]
    if rng.random() < 0.5:
        frame.append(transform(build_box(width, 0.01, height), [0, depth / 2, 0]))
    pieces = [finish_piece(rng, str(rng.choice(BODIES)), *frame)]
    spacing = levels[1] - levels[0]
    for level in levels:
        if rng.random() < 0.6 and level < height:
            pieces += move(_build_books(rng, 0.9 * width, 0.8 * spacing), [0, 0, level + 0.014])
        elif rng.random() < 0.8:
            pieces += _set_out(rng, width - 0.05, depth, level + 0.012, 0.75 * spacing)
    return pieces


def build_cabinet(rng: Generator, has_lamp: bool = False) -> list[Piece]:
    """A chest with doors and knobs, and ornaments or a lamp on it."""
    width, depth, height = rng.uniform([0.5, 0.35, 0.4], [1.6, 0.5, 1.0])
    doors = int(rng.integers(1, 5))
    x = ((np.arange(doors) + 0.5) / doors - 0.5)[:, None] * [width, 0, 0]
    low, front = x + [0, -depth / 2, 0.08], [0.47 * width / doors, 0.012, 0]
    body, door, knob = rng.choice(BODIES, 3)
    return [
        finish_piece(rng, str(body), build_box(width, depth, height)),
        finish_piece(rng, str(door), boxes(low - front, low + front + [0, -0.012, height - 0.13])),
        finish_piece(
            rng,
            str(knob),
            *(transform(icosphere(1), spot + [0, -0.02, height / 2], scale=0.018) for spot in low),
        ),
        *_set_out(rng, width, depth, height, has_lamp=has_lamp),
    ]


def build_divider(rng: Generator) -> list[Piece]:
    """A room divider of upright slats."""
    width, height = rng.uniform([0.6, 1.3], [1.3, 2.1])
    x = np.arange(-width / 2, width / 2, rng.uniform(0.04, 0.12))[:, None] * [1, 0, 0]
    rails = np.array([[0, 0, 0.0], [0, 0, height]])
    return [
        finish_piece(
            rng,
            str(rng.choice(BODIES)),
            boxes(x - [0.01, 0.02, 0], x + [0.01, 0.02, height]),
            boxes(rails - [width / 2, 0.03, 0], rails + [width / 2, 0.03, 0.03]),
        )
    ]


def build_plant(rng: Generator, size: float = 1.0) -> list[Piece]:
    """A pot with leaves."""
    radius, tall = size * rng.uniform(0.1, 0.2), size * rng.uniform(0.15, 0.35)
    radii = size * rng.uniform(0.15, 0.45, 3)
    leaves = build_foliage(rng, int(rng.integers(60, 300)), radii, size * rng.uniform(0.06, 0.2))
    stem = cylinder(0.012 * size, 0.9 * tall, tall + radii[2], 6)
    return [
        finish_piece(rng, str(rng.choice(ORNAMENTS[:5])), cylinder(radius, 0, tall)),
        Piece("wood", stem),
        Piece("leaf", transform(leaves, [0, 0, tall + radii[2]])),
    ]


def build_ornament(rng: Generator, size: float) -> list[Piece]:
    """A small solid, a stack of books, a bowl, a standing picture or a plant, `size` wide."""
    kind = rng.choice(("solid", "solid", "vase", "books", "bowl", "picture", "plant"))
    if kind == "plant":
        return build_plant(rng, 0.8 * size)
    if kind == "picture":
        tilt = rotation_matrix((1, 0, 0), -0.15)
        return move(build_picture(rng, 0.7 * size, 0.9 * size), [0, 0, 0.01], tilt)
    if kind == "books":
        thick = rng.uniform(0.015, 0.04, int(rng.integers(2, 6)))
        return [
            finish_piece(
                rng,
                "paint",
                transform(
                    build_box(0.9 * size, 0.65 * size, rise),
                    [0, 0, z],
                    yaw_matrix(rng.normal() / 5),
                ),
            )
            for rise, z in zip(thick, thick.cumsum() - thick, strict=True)
        ]
    finish = str(rng.choice(ORNAMENTS))
    if kind == "bowl":
        rim, deep = 0.45 * size, size * rng.uniform(0.15, 0.4)
        profile = [(0.2 * size, 0.0), (0.85 * rim, 0.4 * deep), (rim, deep)]
        finish = "steel" if finish == "glass" else finish
        return [finish_piece(rng, finish, lathe(profile, 24), disc(0.2 * size, 0.0, 24))]
    build = build_vase_solid if kind == "vase" else SOLIDS[rng.integers(len(SOLIDS))]
    return [finish_piece(rng, finish, build(rng, 0.8 * size))]


def build_picture(rng: Generator, width: float, height: float) -> list[Piece]:
    """A framed picture or mirror that hangs or stands; its back is at y = 0."""
    border = rng.uniform(0.015, 0.06)
    x, z = np.array([-width / 2, width / 2]), np.array([0, height])
    low = np.array([[x[0], 0, 0], [x[0], 0, height - border], [x[0], 0, 0], [x[1] - border, 0, 0]])
    size = np.array([[width, 0.03, border]] * 2 + [[border, 0.03, height]] * 2)
    frame = boxes(low - [0, 0.03, 0], low - [0, 0.03, 0] + size)
    sheet = quads([x[0], -0.012, z[0]], [width, 0, 0], [0, 0, height], tile_size=0)
    body = finish_piece(rng, str(rng.choice(BODIES)), frame)
    if rng.random() < 0.2:
        return [body, Piece("mirror", sheet)]
    cell = rng.integers(PICTURES, size=2)
    inside = ((0.02 + 0.96 * sheet.uv + cell) / PICTURES).astype(np.float32)
    return [body, Piece("print", sheet._replace(uv=inside))]


def build_table_lamp(rng: Generator) -> list[Piece]:
    """A lamp with a foot and a shade of paper or metal, open above and below."""
    foot = build_vase_solid(rng, rng.uniform(0.2, 0.35))
    rise = float(foot.vertices[:, 2].max())
    return [finish_piece(rng, str(rng.choice(LAMP_BODIES)), foot)] + move(
        build_shade(rng, rng.uniform(0.1, 0.18)), [0, 0, rise + 0.02]
    )


def build_floor_lamp(rng: Generator, is_uplight: bool) -> list[Piece]:
    """A standing lamp: with a shade, or an opaque bowl that lights the ceiling only."""
    height = rng.uniform(1.0, 1.5) if is_uplight else rng.uniform(1.35, 1.75)
    pole = merge(cylinder(0.014, 0, height, 8), cylinder(0.13, 0, 0.02))
    pieces = [finish_piece(rng, str(rng.choice(LAMP_BODIES)), pole)]
    if not is_uplight:
        return pieces + move(build_shade(rng, rng.uniform(0.14, 0.22)), [0, 0, height])
    radius = rng.uniform(0.18, 0.32)
    bowl = lathe([(0.02, height), (0.75 * radius, height + 0.05), (radius, height + 0.16)])
    pieces.append(finish_piece(rng, str(rng.choice(LAMP_BODIES)), bowl))
    return [*pieces, Piece("glow", disc(0.7 * radius, height + 0.1, 16))]


def build_shade(rng: Generator, radius: float) -> list[Piece]:
    """A bulb of 3 to 7 cm in an open shade above the origin, or a bare globe."""
    tall, taper = radius * rng.uniform(0.9, 1.5), rng.uniform(0.6, 1)
    if rng.random() < 0.5:
        return [Piece("bulb", transform(icosphere(2), [0, 0, 0.6 * radius], scale=0.6 * radius))]
    cone = lathe([(radius, 0), (taper * radius, tall)], 24)
    bulb = transform(icosphere(1), [0, 0, 0.2 * tall], scale=float(rng.uniform(0.03, 0.07)))
    finish = str(rng.choice(SHADES))
    return [finish_piece(rng, finish, cone), Piece("bulb", bulb)]


def _set_out(
    rng: Generator,
    width: float,
    depth: float,
    height: float,
    tallest: float = 0.5,
    has_lamp: bool = False,
) -> list[Piece]:
    """Ornaments side by side on a surface of width x depth; one of them may be a lamp."""
    count = max(1, int(width / rng.uniform(0.2, 0.45)))
    slot = width / count
    lamp = int(rng.integers(count)) if has_lamp else -1
    pieces: list[Piece] = []
    for k in np.flatnonzero((rng.random(count) < 0.75) | (np.arange(count) == lamp)):
        size = min(slot, 0.8 * depth, tallest / 1.5, 0.4) * rng.uniform(0.5, 0.95)
        spot = [(k + 0.5) * slot - width / 2, rng.uniform(-0.1, 0.1) * depth, height + GAP]
        turn = yaw_matrix(rng.uniform(-0.5, 0.5))
        pieces += move(
            build_table_lamp(rng) if k == lamp else build_ornament(rng, size), spot, turn
        )
    return pieces


def _build_books(rng: Generator, width: float, tallest: float) -> list[Piece]:
    """A row of upright books in the colours of the palette."""
    thick = rng.uniform(0.015, 0.05, int(width / 0.033))
    left = thick.cumsum() - thick.sum() / 2
    zero, height = 0 * left, tallest * rng.uniform(0.6, 1, len(left))
    low = np.stack([left - thick, zero - 0.1, zero], -1)
    high = np.stack([left - 0.001, zero + rng.uniform(0.03, 0.09, len(left)), height], -1)
    has_book = rng.random(len(left)) < 0.9
    row = boxes(low[has_book], high[has_book])
    colour = rng.integers(PALETTE_SIZE, size=int(has_book.sum()))
    finish = str(rng.choice(PALETTED))
    return [Piece(finish, paint(row, np.tile(np.repeat(colour, 4), 6), PALETTE_SIZE))]


def _build_cushion(width: float, depth: float, height: float) -> Shape:
    """A box with round edges that stands on the origin."""
    ball = icosphere(3).vertices
    rounded = np.sign(ball) * np.abs(ball) ** 0.45
    vertices = rounded / np.abs(rounded).max() * np.array([width, depth, height]) / 2
    vertices = (vertices + [0, 0, height / 2]).astype(np.float32)
    return icosphere(3)._replace(vertices=vertices, uv=vertices[:, :2] + vertices[:, 2:])
