"""Files of a clip folder: their names and channels, and writing one frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rlbench.clips.exr import write_exr
from rlbench.clips.header import BUFFER_CHANNELS, ClipError, Header

HALF_PREFIXES = ("albedo", "normal")  # buffers with these prefixes are stored as float16
MAX_HALF = float(np.finfo(np.float16).max)
MAX_FLOAT = float(np.finfo(np.float32).max)
CHANNELS = {  # EXR channels of an image; sample 0 of a pool has s0.R, s0.G, s0.B, and so on
    "albedo": ("albedo.R", "albedo.G", "albedo.B"),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "depth": ("depth.Z",),
    "motion": ("motion.X", "motion.Y"),
    "object": ("object.I",),
    "albedo_first": ("albedo_first.R", "albedo_first.G", "albedo_first.B"),
    "normal_psr": ("normal_psr.X", "normal_psr.Y", "normal_psr.Z"),
    "depth_psr": ("depth_psr.Z",),
    "object_psr": ("object_psr.I",),
    "rgb": ("R", "G", "B"),
}


def exr_path(folder: Path, kind: str, index: int) -> Path:
    """The file of one kind: view, pool.<kind>, referenceA or referenceB.

    >>> exr_path(Path("clip"), "pool.path", 3).as_posix()
    'clip/pool.path.0003.exr'
    """
    return folder / f"{kind}.{index:04d}.exr"


def channel_names(names: Iterable[str]) -> list[str]:
    """The EXR channels of the named images of one file, in order.

    >>> channel_names(["depth", "s1"])
    ['depth.Z', 's1.R', 's1.G', 's1.B']
    """
    rgb = CHANNELS["rgb"]
    return [c for n in names for c in CHANNELS.get(n, [f"{n}.{letter}" for letter in rgb])]


def image_names(header: Header, kind: str) -> list[str]:
    """The names of the images that a file of one kind must hold."""
    if kind == "view":
        return list(header.buffers)
    return [f"s{slot}" for slot in range(header.pool_spp)] if kind.startswith("pool.") else ["rgb"]


def file_kinds(pools: Iterable[str]) -> list[str]:
    """The kinds of file that every frame of a clip with these pools has."""
    return ["view", *(f"pool.{pool}" for pool in pools), "referenceA", "referenceB"]


def write_frame(
    folder: Path,
    index: int,
    gbuffer: Mapping[str, NDArray[Any]],
    pools: Mapping[str, NDArray[Any]],
    half_a: NDArray[Any],
    half_b: NDArray[Any],
) -> None:
    """Write the files of one frame, each atomically, the reference last.

    Radiance is linear and not exposed. Albedo, normals and pools are stored as float16; depth,
    motion, object and references as float32. A pool with a value above 65504, the largest float16,
    is stored as float32, so no firefly is clipped.

    Args:
        folder: folder of the clip; it is created if necessary.
        index: number of the frame, from 0.
        gbuffer: buffers [h w c] by name, in the conventions of `rlbench.frames.GBuffer`; a static
            clip has no motion.
        pools: samples [s h w 3] by kind of pool: independent 1-spp images.
        half_a: one half of the reference, [h w 3]; both are NaN alone where the frame has none.
        half_b: the other, independent half, [h w 3].

    Raises:
        ClipError: for an unknown buffer, another shape, or a value that is not finite or would not
            be when it is read back. Nothing is written then.
    """
    size = np.shape(half_a)[:2]
    _check(index, size, gbuffer, pools, half_a, half_b)
    planes: dict[str, NDArray[Any]] = {}
    for name, image in gbuffer.items():
        planes |= _planes(name, image, np.float16 if name.startswith(HALF_PREFIXES) else np.float32)
    write_exr(exr_path(folder, "view", index), planes)
    for pool, samples in pools.items():
        _write_pool(folder, index, pool, samples)
    for kind, image in (("referenceA", half_a), ("referenceB", half_b)):
        write_exr(exr_path(folder, kind, index), _planes("rgb", image, np.float32))


def write_pool(folder: Path, index: int, pool: str, samples: NDArray[Any]) -> None:
    """Add the file of one pool [s h w 3] to a frame that exists, as `write_frame` writes it.

    Raises ClipError for another shape or a value that cannot be stored.
    """
    name = f"pool.{pool}"
    if np.ndim(samples) != 4 or np.shape(samples)[-1] != 3:
        raise ClipError(f"frame {index}: {name} has shape {np.shape(samples)}, expected s h w 3")
    _check_values(index, name, samples)
    _write_pool(folder, index, pool, samples)


def has_frame(folder: Path, index: int, pools: Iterable[str] = ("path",)) -> bool:
    """Whether every file of a frame with these pools exists, so it need not be traced again."""
    return all(exr_path(folder, kind, index).is_file() for kind in file_kinds(pools))


def _write_pool(folder: Path, index: int, pool: str, samples: NDArray[Any]) -> None:
    precision = np.float32 if _exceeds_half(samples) else np.float16
    planes: dict[str, NDArray[Any]] = {}
    for slot, image in enumerate(samples):
        planes |= _planes(f"s{slot}", image, precision)
    write_exr(exr_path(folder, f"pool.{pool}", index), planes)


def nonfinite_mask(name: str, array: NDArray[Any]) -> NDArray[np.bool_]:
    """Mask of the values that no clip may hold: NaN and infinity, except +inf in depth buffers."""
    bad: NDArray[np.bool_] = ~np.isfinite(array)
    return np.logical_and(bad, ~np.isposinf(array)) if name.startswith("depth") else bad


def is_no_reference(half: NDArray[Any]) -> bool:
    """Whether an image is NaN alone, as a frame without a reference has it in place of one."""
    return bool(np.isnan(half).all())


def exceeds_float(radiance: NDArray[Any], exposure: float) -> bool:
    """Whether exposed radiance is beyond the largest float32, in which methods receive it."""
    return float(np.abs(radiance).max(initial=0)) * exposure > MAX_FLOAT


def _planes(name: str, image: NDArray[Any], precision: type[np.floating]) -> dict[str, Any]:
    """The planes [h w] of an image [h w c], by channel name."""
    planes = np.moveaxis(image, -1, 0).astype(precision)
    return dict(zip(channel_names([name]), planes, strict=True))


def _exceeds_half(samples: NDArray[Any]) -> bool:
    return bool(np.abs(samples).max(initial=0) > MAX_HALF)


def _check(
    index: int,
    size: tuple[int, ...],
    gbuffer: Mapping[str, NDArray[Any]],
    pools: Mapping[str, NDArray[Any]],
    half_a: NDArray[Any],
    half_b: NDArray[Any],
) -> None:
    """Raise ClipError for the first array with another shape or a value that cannot be stored."""
    if not gbuffer:
        raise ClipError(
            f"frame {index}: no buffer; write at least one of {', '.join(BUFFER_CHANNELS)}"
        )
    if unknown := sorted(set(gbuffer) - set(BUFFER_CHANNELS)):
        raise ClipError(
            f"frame {index}: unknown buffer {', '.join(unknown)}; the format has: "
            f"{', '.join(BUFFER_CHANNELS)}"
        )
    arrays = {name: (image, (*size, BUFFER_CHANNELS[name])) for name, image in gbuffer.items()}
    arrays |= {f"pool.{k}": (p, (np.shape(p)[0], *size, 3)) for k, p in pools.items()}
    arrays |= {"referenceA": (half_a, (*size, 3)), "referenceB": (half_b, (*size, 3))}
    has_none = is_no_reference(half_a) and is_no_reference(half_b)
    for name, (array, shape) in arrays.items():
        if np.shape(array) != shape:
            raise ClipError(f"frame {index}: {name} has shape {np.shape(array)}, expected {shape}")
        if not (name.startswith("reference") and has_none):
            _check_values(index, name, array)


def _check_values(index: int, name: str, array: NDArray[Any]) -> None:
    """Raise ClipError for values that are not finite, or would not be when they are read back."""
    if count := int(nonfinite_mask(name, array).sum()):
        raise ClipError(f"frame {index}: {count} values of {name} are not finite; not written")
    precision = np.float16 if name.startswith(HALF_PREFIXES) else np.float32
    with np.errstate(over="ignore"):
        lost = np.isinf(np.asarray(array).astype(precision)) & np.isfinite(array)
    if count := int(lost.sum()):
        raise ClipError(
            f"frame {index}: {count} values of {name} exceed {np.finfo(precision).max:g}, the "
            f"largest {np.dtype(precision).name}, in which {name} is stored; not written. Scale or "
            "clip them first"
        )
