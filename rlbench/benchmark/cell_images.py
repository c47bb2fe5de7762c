"""Images of a cell, kept beside its rows: RESULTS/images/NAME/0000.exr ..., and NAME/cell.json.

NAME is the file stem of the cell without its times, so images stay when a cell is timed again. A
frame is one OpenEXR file of half floats: R, G, B in linear radiance, and `counts`, the samples of
each pixel. `cell.json` names the cell, the clip's digest and a checksum of each file. The folder
appears whole or not at all, before the rows of its cell.
"""

from __future__ import annotations

import json
import shlex
import shutil
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float16
from numpy import ndarray as Array

from rlbench.benchmark import results
from rlbench.benchmark.cell_key import CellId, CellKey
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.results import RowName
from rlbench.clips.exr import read_exr_header, read_planes, write_exr
from rlbench.clips.header import Header
from rlbench.errors import RlbenchError
from rlbench.run import FrameResult
from rlbench.system import documents, paths, store

FOLDER = "images"  # in a results folder
RECORD = "cell.json"
SCHEMA = 1  # of the record and of the channels
CHANNELS = ("R", "G", "B", "counts")
OF_CLIP = ("pool", "clip_digest", "max_samples")  # keys of the record
HALF_MAX = 65504.0  # largest half float; brighter finite values are stored as this
MAX_NAMED = 6  # cells in a message


class KeptImagesError(RlbenchError, ValueError):
    """Kept images that are missing, damaged, of another clip, or written by a newer version."""


class KeptFrame(NamedTuple):
    """One frame in half floats: relative rounding of at most 2^-11."""

    image: Float16[Array, "3 h w"]  # linear radiance; NaN and infinite values stay
    counts: Float16[Array, "h w"]  # samples of each pixel, exact up to 2048

    @classmethod
    def of(cls, result: FrameResult) -> KeptFrame:
        """The image of a processed frame, and where its samples went."""
        image = result.image[0].float()
        largest = image.clamp(-HALF_MAX, HALF_MAX).where(image.isfinite(), image)
        counts = result.samples.counts[0, 0].clamp(max=int(HALF_MAX))
        return cls(largest.half().cpu().numpy(), counts.half().cpu().numpy())


@dataclass(frozen=True)
class CellImages:
    """All images of a cell, in order, and the content of the clip that they show."""

    pool: str  # kind of the samples
    clip_digest: str  # of the clip with the samples of `pool`
    max_samples: int  # most that one pixel could have, at any budget
    frames: Sequence[KeptFrame]


@dataclass(frozen=True)
class KeptImages:
    """A folder with the images of a cell; frames are read when they are asked for.

    But for the folder, the fields are those of cell.json.
    """

    folder: Path
    key: CellKey
    content_hash: str
    pool: str
    clip_digest: str
    max_samples: int
    checksums: tuple[str, ...]  # SHA-256 of 0000.exr, 0001.exr, ...

    @property
    def cell(self) -> CellId:
        """The cell, without the hash of its times."""
        return CellId(self.key, self.content_hash)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.checksums)

    def frame(self, index: int) -> KeptFrame:
        """Frame `index`, from 0. Raises KeptImagesError for a missing or damaged file."""
        file = frame_file(self.folder, index)
        try:
            if sha256(file.read_bytes()).hexdigest() != self.checksums[index]:
                raise ValueError("its content is not what was written")
            planes = read_planes(file, read_exr_header(file), CHANNELS)
        except (OSError, RuntimeError, ValueError, KeyError) as error:
            raise KeptImagesError(
                f"{file} cannot be read: {error}. Delete {self.folder} and repeat `rlbench run "
                "--keep-images`, which makes the images again"
            ) from error
        return KeptFrame(np.stack(planes[:3]), planes[3].copy())


def images_folder(results: Path, cell: CellId) -> Path:
    """The folder of a cell's images, whether or not it exists; times do not change its name."""
    return results / FOLDER / cell.untimed.file_stem


def frame_file(folder: Path, index: int) -> Path:
    """The file of one frame in a folder of images."""
    return folder / f"{index:04}.exr"


def write_images(results: Path, cell: CellId, images: CellImages) -> Path:
    """Write all images of a cell, in place of older ones of the same cell; returns the folder.

    All content reaches the disk before the folder has its name, so a folder with this name is
    complete even after a power failure.
    """
    folder = paths.check_no_link(results, images_folder(results, cell))
    unfinished = folder.with_name(f".{folder.name}")
    shutil.rmtree(unfinished, ignore_errors=True)  # that a killed run left
    try:
        checksums = tuple(_write_frame(unfinished, *each) for each in enumerate(images.frames))
        identity = {"schema": SCHEMA, **asdict(cell.untimed), "checksums": checksums}
        record = identity | {name: getattr(images, name) for name in OF_CLIP}
        store.write_text(unfinished / RECORD, json.dumps(record, indent=1))
        drop_images(results, cell)
        paths.publish_folder(unfinished, folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    return folder


def find_images(results: Path, cell: CellId) -> KeptImages | None:
    """The images of a cell, or None where it has none or a file is missing."""
    folder = images_folder(results, cell)
    if not (folder / RECORD).is_file():
        return None
    kept = _read_record(folder)
    files = [frame_file(folder, index) for index in range(len(kept))]
    return kept if all(file.is_file() for file in files) else None


def list_images(results: Path) -> list[KeptImages]:
    """All images in a results folder, sorted by name; frames are not read."""
    return [
        _read_record(file.parent) for file in sorted((results / FOLDER).glob(f"[!.]*/{RECORD}"))
    ]


def drop_images(results: Path, cell: CellId) -> None:
    """Remove the images of a cell, if there are any; a kill leaves no folder that looks whole."""
    folder = paths.check_no_link(results, images_folder(results, cell))
    (folder / RECORD).unlink(missing_ok=True)
    shutil.rmtree(folder, ignore_errors=True)


def _write_frame(folder: Path, index: int, frame: KeptFrame) -> str:
    """Write a frame; returns its checksum."""
    file = frame_file(folder, index)
    write_exr(file, dict(zip(CHANNELS, [*frame.image, frame.counts], strict=True)))
    return sha256(file.read_bytes()).hexdigest()


def _read_record(folder: Path) -> KeptImages:
    """The record of a folder. Raises KeptImagesError for one that cannot be used."""
    file = folder / RECORD
    try:
        document = documents.read_json(file)
        if document["schema"] != SCHEMA:
            raise ValueError(f"it has schema {document['schema']}, this version reads {SCHEMA}")
        return documents.decode({**document, "folder": folder}, KeptImages)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise KeptImagesError(
            f"{file} cannot be used: {error}. Delete {folder} and repeat `rlbench run "
            "--keep-images`, or update rlbench"
        ) from error


def find_all_images(
    folder: Path, methods: Sequence[str], clips: Collection[str], budgets: Sequence[float]
) -> list[KeptImages]:
    """The images of each method on each clip at each budget; of all seeds and devices.

    Raises KeptImagesError where a method, clip and budget has none.
    """
    wanted_cells = set(product(methods, clips, budgets))
    stored = [
        cell
        for cell in results.cells(folder)
        if (cell.key.method, cell.key.clip, cell.key.target_spp) in wanted_cells
    ]
    found = [images for cell in stored if (images := find_images(folder, cell))]
    keys = [images.cell.key for images in found]
    missing = wanted_cells - {(key.method, key.clip, key.target_spp) for key in keys}
    if missing:
        presets = {cell.key.preset for cell in stored}
        raise KeptImagesError(_explain(folder, sorted(missing), presets))
    return found


def _explain(
    folder: Path, missing: Sequence[tuple[str, str, float]], presets: Collection[str]
) -> str:
    cells = [f"{method} on {clip} at {spp:g} spp" for method, clip, spp in missing]
    more = f" and {len(cells) - MAX_NAMED} more" if len(cells) > MAX_NAMED else ""
    names = [RowName.parse(method) for method, _, _ in missing]
    labels = sorted({f"@{name.label}" for name in names if name.label})
    options = f", with the options of its rows {', '.join(labels)}" if labels else ""
    preset = next(iter(presets), "mini") if len(presets) < 2 else "PRESET"
    words = ["rlbench", "run", "-m", _join(name.method_name for name in names)]
    words += ["--preset", preset] if preset else ["--clips", "FOLDER"]
    words += ["--scenes", _join(clip for _, clip, _ in missing)]
    words += ["--spp", _join(f"{spp:g}" for _, _, spp in missing)]
    words += ["--keep-images", "--out", str(folder)]
    return (
        f"{folder} has no images of {'; '.join(cells[:MAX_NAMED])}{more}. "
        f"This makes them{options}: {shlex.join(words)}"
    )


def _join(words: Iterable[str]) -> str:
    return ",".join(dict.fromkeys(words))


class KeptCell(NamedTuple):
    """A finished cell of a run whose images were kept."""

    cell: CellId
    images: KeptImages
    clip: StoredSource

    @property
    def header(self) -> Header:
        """The header of the clip."""
        return self.clip.header


def image_pools(folder: Path) -> set[str]:
    """Kinds of the sample pools of all images in a results folder.

    Raises KeptImagesError where there is no image.
    """
    pools = {images.pool for images in list_images(folder)}
    if not pools:
        problem = "has no images" if folder.is_dir() else "does not exist"
        raise KeptImagesError(f"{folder} {problem}; `rlbench run --keep-images` makes them")
    return pools


def find_kept_cells(
    folder: Path, clips: Sequence[StoredSource], methods: Collection[str] = ()
) -> list[KeptCell]:
    """The cells in a results folder with images of `clips`; all `methods`, or those named.

    Raises KeptImagesError where there is none, and where a clip has changed since the images.
    """
    by_name = {clip.header.name: clip for clip in clips}
    kept = []
    for cell in sorted(results.cells(folder), key=lambda cell: cell.file_stem):
        is_selected = not methods or cell.key.method in methods
        images = find_images(folder, cell)
        if images and is_selected and cell.key.clip in by_name:
            kept.append(KeptCell(cell, images, by_name[cell.key.clip].first(len(images))))
    if not kept:
        keys = [images.cell.key for images in list_images(folder)]
        stored_methods, stored_clips = {key.method for key in keys}, {key.clip for key in keys}
        raise KeptImagesError(
            f"{folder} has no images of {', '.join(methods) or 'any method'} on "
            f"{', '.join(by_name)}; it has {', '.join(sorted(stored_methods))} on "
            f"{', '.join(sorted(stored_clips))}. `rlbench run --keep-images` makes images"
        )
    for cell, images, clip in kept:
        if (digest := clip.content(images.pool)) != images.clip_digest:
            raise KeptImagesError(
                f"the images of '{cell.key}' show a clip with digest {images.clip_digest}, but "
                f"{clip.folder} has {digest}, so its references may be others. Select the clip "
                "of the images, or repeat `rlbench run --keep-images`"
            )
    return kept
