"""A clip folder's files: their names, their channels, and writing one frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rlbench.clips.exr import write_exr
from rlbench.clips.header import VIEWS, ClipError, Header

HALF = ("albedo", "normal")  # view buffers whose names begin so are stored in half; others float
LARGEST_HALF = float(np.finfo(np.float16).max)
CHANNELS = {
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "depth": ("depth.Z",),
    "motion": ("motion.X", "motion.Y"),
    "object": ("object.I",),
    "albedo_first": ("albedo_first.R", "albedo_first.G", "albedo_first.B"),
    "normal_behind": ("normal_behind.X", "normal_behind.Y", "normal_behind.Z"),
    "depth_behind": ("depth_behind.Z",),
    "object_behind": ("object_behind.I",),
    "rgb": ("R", "G", "B"),
}  # of the images in a file; a pool's are s0, s1, ... with s0.R, s0.G, s0.B, ...


def exr_path(folder: Path, kind: str, index: int) -> Path:
    """The file of one kind: view, pool.<kind>, referenceA or referenceB; e.g. view.0003.exr."""
    return folder / f"{kind}.{index:04d}.exr"


def channels(names: Iterable[str]) -> list[str]:
    """The EXR channels of the images `names` of one file, in order."""
    rgb = CHANNELS["rgb"]
    return [c for n in names for c in CHANNELS.get(n, [f"{n}.{letter}" for letter in rgb])]


def images(header: Header, kind: str) -> list[str]:
    """The images that a file of one kind must hold."""
    if kind == "view":
        return list(header.buffers)
    return [f"s{slot}" for slot in range(header.pool_spp)] if kind.startswith("pool.") else ["rgb"]


def file_kinds(pools: Iterable[str]) -> list[str]:
    """The kinds of file that every frame has."""
    return ["view", *(f"pool.{pool}" for pool in pools), "referenceA", "referenceB"]


def write_frame(
    folder: Path,
    index: int,
    gbuffer: Mapping[str, NDArray[Any]],  # h w c, by buffer name; a static clip has no motion
    pools: Mapping[str, NDArray[Any]],  # s h w 3, by kind: independent 1-spp images, linear
    a: NDArray[Any],  # h w 3, linear: one half of the reference
    b: NDArray[Any],  # h w 3, linear: the other, independent half
) -> None:
    """Write the files of one frame, each whole or not at all, the reference last.

    Albedo, normal and pools are half; depth, motion and references float. A pool that holds a
    value beyond half's range (65504) is written as float, so no firefly is clipped.
    """
    size = np.shape(a)[:2]
    _check(index, size, gbuffer, pools, a, b)
    planes: dict[str, NDArray[Any]] = {}
    for name, image in gbuffer.items():
        planes |= _planes(name, image, np.float16 if name.startswith(HALF) else np.float32)
    write_exr(exr_path(folder, "view", index), planes)
    for pool, samples in pools.items():
        _write_pool(folder, index, pool, samples)
    for kind, image in (("referenceA", a), ("referenceB", b)):
        write_exr(exr_path(folder, kind, index), _planes("rgb", image, np.float32))


def write_pool(folder: Path, index: int, pool: str, samples: NDArray[Any]) -> None:
    """Write the file of one pool [s h w 3] of a frame that is there, as `write_frame` does."""
    name = f"pool.{pool}"
    if np.ndim(samples) != 4 or np.shape(samples)[-1] != 3:
        raise ClipError(f"frame {index}: {name} has shape {np.shape(samples)}, expected s h w 3")
    if count := int(not_finite(name, samples).sum()):
        raise ClipError(f"frame {index}: {count} values of {name} are not finite; not written")
    _write_pool(folder, index, pool, samples)


def has_frame(folder: Path, index: int, pools: Iterable[str] = ("path",)) -> bool:
    """Whether every file of a frame with these pools is there, so it need not be traced again."""
    return all(exr_path(folder, kind, index).is_file() for kind in file_kinds(pools))


def _write_pool(folder: Path, index: int, pool: str, samples: NDArray[Any]) -> None:
    precision = np.float32 if _beyond_half(samples) else np.float16
    planes: dict[str, NDArray[Any]] = {}
    for slot, image in enumerate(samples):
        planes |= _planes(f"s{slot}", image, precision)
    write_exr(exr_path(folder, f"pool.{pool}", index), planes)


def not_finite(name: str, array: NDArray[Any]) -> NDArray[np.bool_]:
    """Where an image holds what no clip may hold: NaN or an infinity, save depth's background."""
    bad: NDArray[np.bool_] = ~np.isfinite(array)
    return np.logical_and(bad, ~np.isposinf(array)) if name.startswith("depth") else bad


def _planes(name: str, image: NDArray[Any], precision: type[np.floating]) -> dict[str, Any]:
    """The channels of an image [h w c]."""
    layers = np.moveaxis(image, -1, 0).astype(precision)
    return dict(zip(channels([name]), layers, strict=True))


def _beyond_half(samples: NDArray[Any]) -> bool:
    return bool(np.abs(samples).max(initial=0) > LARGEST_HALF)


def _check(
    index: int,
    size: tuple[int, ...],
    gbuffer: Mapping[str, NDArray[Any]],
    pools: Mapping[str, NDArray[Any]],
    a: NDArray[Any],
    b: NDArray[Any],
) -> None:
    """Raise ClipError for the first array that could not be read back: its shape, or not finite."""
    if not gbuffer:
        raise ClipError(f"frame {index}: no view buffer; write at least one of {', '.join(VIEWS)}")
    if unknown := sorted(set(gbuffer) - set(VIEWS)):
        raise ClipError(f"frame {index}: unknown view buffer {', '.join(unknown)}")
    found = {name: (v, (*size, VIEWS[name])) for name, v in gbuffer.items()}
    found |= {f"pool.{k}": (p, (np.shape(p)[0], *size, 3)) for k, p in pools.items()}
    found |= {"referenceA": (a, (*size, 3)), "referenceB": (b, (*size, 3))}
    for name, (array, wanted) in found.items():
        if np.shape(array) != wanted:
            raise ClipError(f"frame {index}: {name} has shape {np.shape(array)}, expected {wanted}")
        if count := int(not_finite(name, array).sum()):
            raise ClipError(f"frame {index}: {count} values of {name} are not finite; not written")
