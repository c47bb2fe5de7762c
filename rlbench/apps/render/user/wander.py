"""Random camera paths inside a scene: short walks, pans and dollies that stay in free space.

A walk through the scene starts at a known camera, so each place is joined to it by free segments.
From there a path is drawn and judged by rays through each of its frames. Equal seeds give equal
paths; a path begins the same for every number of frames that its checks accept.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from numpy.random import Generator

from rlbench.apps.render.mitsuba.tracer import Tracer
from rlbench.apps.render.scene import Camera, SceneError
from rlbench.apps.render.user import auto_exposure
from rlbench.apps.render.user.camera_path import camera_from_matrix, matrix_from_camera

WANDER_VERSION = 1  # raised whenever the same seed gives another path
TRIES = 1024  # paths drawn for one seed
STEPS = 4  # most segments of the walk to the beginning of a path
CONE = 6  # rays along each side of the middle of the grid, which a segment must leave free
NEAREST, NEAR, NEAR_SHARE = 0.04, 0.12, 0.08  # of the scale; the share of rays nearer than NEAR
NO_SURFACE = 0.2  # largest share of rays without a surface, or 0.05 more than at the start
BACK_FACES = 0.1  # largest share of back faces above the start's
BEND = 0.03  # relative second difference of inverse depth from which on rays see an edge or a curve
DETAIL = (0.15, 0.6)  # least share of such rays, or this part of the start's if that is less
DARKEST = 0.15  # least mean luminance relative to the start's
SPEED = (0.004, 0.025)  # movement per frame, relative to the median distance in view
TURN = np.radians(0.9)  # largest change of the view's azimuth per frame
PITCH = np.radians([-22, 10])


@dataclass(frozen=True)
class _View:
    """What a grid of rays sees from one camera."""

    distances: Float[Array, "rows columns"]  # infinite where a ray meets nothing
    cosines: Float[Array, "rows columns"]  # of the angles between rays and the view axis
    back_faces: float  # share of rays

    @property
    def median(self) -> float:
        """Median distance of the surfaces in view; 0 if there is none."""
        visible = self.distances[np.isfinite(self.distances)]
        return float(np.median(visible)) if len(visible) else 0.0

    @property
    def free(self) -> float:
        """Distance that is free of surfaces around the middle of the view."""
        low = (len(self.distances) - CONE) // 2
        return float(self.distances[low : low + CONE, low : low + CONE].min())

    @property
    def detail(self) -> float:
        """Share of rays at edges or on curved surfaces.

        Inverse depth is an affine function of the image position on every plane.
        """
        inverse = 1 / np.maximum(self.distances * self.cosines, 1e-9)
        middle = inverse[1:-1, 1:-1]
        across = abs(inverse[1:-1, 2:] + inverse[1:-1, :-2] - 2 * middle)
        along = abs(inverse[2:, 1:-1] + inverse[:-2, 1:-1] - 2 * middle)
        return float((np.maximum(across, along) > BEND * middle).mean())

    @property
    def appeal(self) -> float:
        """How much a view shows: detail that fills the image; 0 if something is too near."""
        if not self.median or self.distances.min() < NEAREST * self.median:
            return 0.0
        return self.detail * (1 - self.no_surface) * max(0.0, 1 - 2 * self.back_faces)

    @property
    def no_surface(self) -> float:
        """Share of rays that meet nothing."""
        return float(1 - np.isfinite(self.distances).mean())


def wander(
    tracer: Tracer, start: Float[Array, "4 4"], fov: float, frames: int, seed: int
) -> list[Float[Array, "4 4"]]:
    """Camera-to-world matrices of a random path of `frames` frames in the scene of `tracer`.

    `start` is a camera-to-world matrix of a good view (`camera_path`), whose height and up axis the
    path keeps within bounds; `fov` is horizontal, in degrees. In every frame, the nearest surface
    keeps its distance, few rays leave the scene, the picture has depth, and light arrives. Raises
    SceneError if no path passes, with the check that most paths failed.
    """
    rng = np.random.default_rng([0x3A4DE5, seed])
    eye = _Eye(tracer, start, fov)
    reasons: Counter[str] = Counter()
    for _ in range(TRIES):
        path = _draw_path(eye, rng, frames)
        reason = next(filter(None, map(eye.find_fault, path)), "") or eye.find_darkness(path)
        if not reason:
            return path
        reasons[reason] += 1
    fault, count = reasons.most_common(1)[0]
    raise SceneError(
        f"--camera wander: no path of seed {seed} passed in {TRIES} tries; {count} of them failed "
        f"because {fault}. Choose another seed, or --camera orbit"
    )


def find_view(tracer: Tracer, fov: float) -> Float[Array, "4 4"]:
    """The camera-to-world matrix of a good view into a scene whose file has no camera.

    Of places inside of the scene and around it, the one that sees most detail, few backs of
    surfaces, and nothing too near. The world is z up, in XML files y up. `fov` is horizontal, in
    degrees. Raises SceneError if all see nothing.
    """
    finder = _Finder(tracer, fov, axis=2 if tracer.scene.xml_file is None else 1)
    box = tracer.mi_scene.bbox()
    low, high = np.array(box.min).ravel(), np.array(box.max).ravel()
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    azimuths = np.arange(8) * np.pi / 4 + 0.3
    views = []
    for azimuth in azimuths:
        along = finder.aim(centre, azimuth, np.radians(-20))
        views.append(finder.aim(centre - 1.6 * radius * along[:3, 2], azimuth, np.radians(-20)))
    for share in product((0.15, 0.5, 0.85), (0.15, 0.5, 0.85), (0.25, 0.5, 0.75)):
        place = low + np.roll(share, finder.axis - 2) * (high - low)
        views += [finder.aim(place, azimuth, np.radians(-8)) for azimuth in azimuths]
    appeals = [finder.look(view).appeal for view in views]
    if max(appeals) <= 0:
        raise SceneError(
            "--camera wander finds no view of the scene, which has no camera of its own. Give "
            "--camera a JSON file of matrices"
        )
    return views[int(np.argmax(appeals))]


class _Finder:
    """Looks into the scene from any camera."""

    def __init__(self, tracer: Tracer, fov: float, axis: int, sign: float = 1.0) -> None:
        self.tracer, self.fov, self.axis = tracer, fov, axis  # the world axis that points up
        self.up = np.zeros(3)
        self.up[axis] = sign

    def look(self, matrix: Float[Array, "4 4"]) -> _View:
        """The distances that a grid of rays meets."""
        self._move(matrix)
        distances, is_back = auto_exposure.hit_distances(self.tracer)
        side = round(len(distances) ** 0.5)
        slope = np.tan(np.radians(self.fov) / 2) * ((np.arange(side) + 0.5) / side * 2 - 1)
        down = slope[:, None] * self.tracer.height / self.tracer.width
        cosines = 1 / np.sqrt(1 + slope**2 + down**2)
        return _View(distances.reshape(side, side), cosines, float(is_back.mean()))

    def aim(self, position: Float[Array, "3"], azimuth: float, pitch: float) -> Array:
        """The matrix of a camera without roll; azimuth and pitch in radians."""
        one, two = (self.axis + 1) % 3, (self.axis + 2) % 3
        forward = np.sin(pitch) * self.up
        forward[one], forward[two] = np.cos(pitch) * np.array([np.cos(azimuth), np.sin(azimuth)])
        (x, y, z), (u, v, w), (a, b, c) = (p.tolist() for p in (position, forward, self.up))
        return matrix_from_camera(Camera((x, y, z), (x + u, y + v, z + w), (a, b, c), self.fov))

    def _move(self, matrix: Float[Array, "4 4"]) -> None:
        camera = camera_from_matrix(matrix, self.fov)
        self.tracer.scene = replace(self.tracer.scene, camera=lambda time: camera)
        self.tracer.set_time(0.0)


class _Eye(_Finder):
    """Judges views against that of the start."""

    def __init__(self, tracer: Tracer, start: Float[Array, "4 4"], fov: float) -> None:
        axis = int(np.argmax(abs(start[:3, 1])))
        super().__init__(tracer, fov, axis, np.sign(start[axis, 1]))
        self.start = start
        first = self.look(start)
        if not first.median:
            raise SceneError(
                "--camera wander starts from the camera of the scene file, which sees no surface. "
                "Point it at the scene, or give --camera a JSON file of matrices"
            )
        self.scale = first.median
        self.least_detail = min(DETAIL[0], DETAIL[1] * first.detail)
        self.most_sky = max(NO_SURFACE, first.no_surface + 0.05)
        self.most_back_faces = first.back_faces + BACK_FACES
        self.luminance = self._measure_luminance(start)

    def find_fault(self, matrix: Float[Array, "4 4"]) -> str:
        """Why a view is refused, in words; empty if it passes."""
        view = self.look(matrix)
        near = view.distances < NEAR * self.scale
        if view.distances.min() < NEAREST * self.scale or near.mean() > NEAR_SHARE:
            return "a surface is too near"
        if view.no_surface > self.most_sky:
            return "too few pixels show a surface"
        if view.back_faces > self.most_back_faces:
            return "too many surfaces show their backs"
        if view.detail < self.least_detail:
            return "the view shows little but walls"
        return ""

    def find_darkness(self, path: list[Float[Array, "4 4"]]) -> str:
        """Why a path is refused for its light; empty if it passes."""
        darkest = min(self._measure_luminance(matrix) for matrix in (path[0], path[-1]))
        return "too little light arrives" if darkest < DARKEST * self.luminance else ""

    def _measure_luminance(self, matrix: Float[Array, "4 4"]) -> float:
        self._move(matrix)
        try:
            return float(
                np.minimum(
                    areas := auto_exposure.trace_areas(self.tracer), 8 * np.median(areas)
                ).mean()
            )
        except SceneError:  # only black
            return 0.0


def _draw_path(eye: _Eye, rng: Generator, frames: int) -> list[Float[Array, "4 4"]]:
    """A path from the end of a random walk."""
    position = _walk(eye, rng)
    azimuths = rng.uniform(-np.pi, np.pi, 6)
    pitch = rng.uniform(*PITCH)
    views = [eye.look(eye.aim(position, azimuth, pitch)) for azimuth in azimuths]
    appeal = np.array([v.detail for v in views]).round(2) + 0.01
    chosen = rng.choice(len(views), p=appeal / appeal.sum())
    azimuth, turn = azimuths[chosen], 0.0
    kind = rng.choice(["dolly", "truck", "pan", "walk"], p=[0.3, 0.25, 0.15, 0.3])
    reach = views[chosen].median
    step = np.exp(rng.uniform(*np.log(SPEED))) * min(reach, eye.scale)
    heading = {"dolly": 0.0, "truck": np.pi / 2, "pan": 0.0, "walk": rng.uniform(-1, 1)}[kind]
    heading += np.pi * (rng.random() < 0.4)
    if kind in ("pan", "walk"):
        turn = rng.uniform(0.25, 1) * rng.choice([-1, 1]) * TURN
    if kind == "pan":
        step = 0.0
    travel = step * (frames - 1)
    along = eye.aim(position, azimuth + heading, 0.0)
    if travel and eye.look(along).free < 1.5 * travel:
        step = 0.0
        turn = turn or rng.choice([-1, 1]) * 0.6 * TURN
    return [
        eye.aim(position + step * frame * along[:3, 2], azimuth + turn * frame, pitch)
        for frame in range(frames)
    ]


def _walk(eye: _Eye, rng: Generator) -> Float[Array, "3"]:
    """A place that free segments join to the start, near the height of the start."""
    position = eye.start[:3, 3].astype(np.float64)
    for _ in range(rng.integers(0, STEPS + 1)):
        azimuth = rng.uniform(-np.pi, np.pi)
        along = eye.aim(position, azimuth, 0.0)
        free = eye.look(along).free
        length = rng.uniform(0.15, 0.75) * min(free, 1.5 * eye.scale)
        position = position + round(length, 4) * along[:3, 2]
    rise = rng.uniform(-0.12, 0.08) * eye.scale
    lifted = position + round(rise, 4) * eye.up
    steep = eye.aim(position, 0.0, np.copysign(np.radians(89), rise))
    return lifted if eye.look(steep).free > 2 * abs(rise) else position
