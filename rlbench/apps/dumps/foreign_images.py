"""Rows of images made elsewhere: by an engine's filter, another library, a competitor's build.

A folder has a folder for each clip, or the frames of the only clip: one EXR, PFM or PNG a frame.
The rows are those of a run, but nothing of how the images came about can be checked: the hash of
the images stands in place of the code's, and each row says that budget and time are claims. The
images are kept (`cell_images`), so everything that looks at images shows them.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rlbench import registry
from rlbench.benchmark.cell_images import HALF_MAX, CellImages, KeptFrame
from rlbench.benchmark.cell_key import CellId, CellKey, check_no_overwrite
from rlbench.benchmark.clip_sources import StoredSource
from rlbench.benchmark.content_hash import header_facts, scoring_content
from rlbench.benchmark.looks import record_looks
from rlbench.benchmark.results import IMAGES_PREFIX, Row
from rlbench.benchmark.runner import CellStore
from rlbench.benchmark.scoring import (
    BLACK,
    add_counts,
    buffers_of_truth,
    count_rows,
    make_ground_truth,
    results_of_images,
    row_template,
    score_frames,
    with_value,
)
from rlbench.clips.image_files import read_exr
from rlbench.clips.linear_images import ENCODINGS, LooseImageError, read_linear
from rlbench.clips.stored import open_clip
from rlbench.errors import RlbenchError, SourceError
from rlbench.run import FrameResult
from rlbench.system import code_hash
from rlbench.system.folder_lock import locked_folder

COUNT_FILES = (".exr", ".npy")
COUNTS = (("counts",), ("*",))
EXCESS = 1e-3  # share of the budget that counts may exceed it by: rounding
TIMES = ("plan_ms", "allocate_ms", "denoise_ms", "inference_ms")
NAME = re.compile(r"[A-Za-z0-9][\w.+-]*(/[\w.+-]+)?", re.ASCII)
CLAIMED_TIME = "not verified: the time is claimed"
UNCLAIMED_TIME = "no time was claimed: rlbench score --ms"
UNKNOWN_COUNTS = "the samples of each pixel are not known: rlbench score --samples"


class ForeignImagesError(RlbenchError, ValueError):
    """Images from elsewhere that are missing, cannot be read, or contradict the claim."""


@dataclass(frozen=True)
class Claim:
    """What is claimed of images that were made elsewhere."""

    name: str  # of the rows
    spp: float  # samples per pixel that each frame was made of
    ms: float | None = None  # time of a frame without its samples; None: not claimed
    device: str = ""  # that `ms` was measured on; empty for the device of the other rows
    is_exposed: bool = False  # is linear radiance in units where display white is 1?


@dataclass(frozen=True)
class ForeignClip:
    """The files with the images of one clip, in the order of its frames."""

    clip: StoredSource
    images: tuple[Path, ...]
    counts: tuple[Path, ...] = ()  # samples of each pixel; empty where they are not known

    @property
    def encoding(self) -> str:
        """How the files are read."""
        return ENCODINGS[self.images[0].suffix.lower()]


@dataclass(frozen=True)
class ScoredClip:
    """What became of a clip."""

    name: str
    psnr: float  # dB, mean over frames; nan without a score
    is_cached: bool  # were the rows there already?
    remarks: tuple[str, ...]


def check_name(name: str) -> None:
    """Raise ForeignImagesError for a name that no row may have, or that an installed method has."""
    if not NAME.fullmatch(name):
        raise ForeignImagesError(
            f"the name '{name}' has characters that a row cannot have; use letters, digits and "
            "._+-, with at most one / between a name and its variant"
        )
    try:
        registry.find_method(name)
    except registry.PluginError:
        return
    raise ForeignImagesError(
        f"'{name}' is a method of this suite, whose rows are measured and not claimed; use "
        f"another name, such as {name}-theirs"
    )


def check_budget(spp: float, clips: Sequence[StoredSource]) -> None:
    """Raise ForeignImagesError for a budget that a clip has not the samples for."""
    for clip in clips:
        if spp > clip.header.pool_spp:
            raise ForeignImagesError(
                f"--spp {spp:g}: clip '{clip.header.name}' stores {clip.header.pool_spp} samples "
                "per pixel, so no image was made of more of them. Give the number that was used"
            )


def find_foreign_images(
    folder: Path, clips: Sequence[StoredSource], counts_folder: Path | None = None
) -> list[ForeignClip]:
    """The images of each clip in `folder`, and the sample counts in a folder of the same layout.

    Raises ForeignImagesError, which says what is missing.
    """
    found = []
    for clip in clips:
        images = _frame_files(_folder_of(clip, folder, len(clips)), ENCODINGS, clip)
        counts: tuple[Path, ...] = ()
        if counts_folder:
            counts = _frame_files(_folder_of(clip, counts_folder, len(clips)), COUNT_FILES, clip)
        found.append(ForeignClip(clip, images, counts))
    return found


def _folder_of(clip: StoredSource, folder: Path, clips: int) -> Path:
    name = clip.header.name
    if (folder / name).is_dir():
        return folder / name
    if clips == 1 and folder.is_dir():
        return folder
    problem = "does not exist" if not folder.is_dir() else f"has no folder '{name}'"
    raise ForeignImagesError(
        f"{folder} {problem}. It needs a folder for each of the {clips} clips, named as the clip; "
        "select clips with --scenes"
    )


def _frame_files(folder: Path, suffixes: Any, clip: StoredSource) -> tuple[Path, ...]:
    """The files of a folder, one for each frame of the clip, ordered by their numbers."""
    files = [each for each in sorted(folder.iterdir()) if not each.name.startswith(".")]
    files = [each for each in files if each.suffix.lower() in suffixes]
    found = sorted({each.suffix.lower() for each in files})
    if len(found) != 1:
        raise ForeignImagesError(
            f"{folder} holds {' and '.join(found) or 'no images'}; expected one kind of "
            f"{', '.join(suffixes)}, one file for each frame"
        )
    numbers = _numbers(folder, files)
    expected, first = clip.header.frames, min(numbers)
    missing = sorted(set(range(first, first + expected)) - set(numbers))
    if missing or len(files) != expected:
        named = f"; missing: {', '.join(map(str, missing[:8]))}" * bool(missing)
        raise ForeignImagesError(
            f"{folder} holds {len(files)} images, numbered {first} to {max(numbers)}; clip "
            f"'{clip.header.name}' has {expected} frames{named}"
        )
    return tuple(file for _, file in sorted(zip(numbers, files, strict=True)))


def _numbers(folder: Path, files: Sequence[Path]) -> list[int]:
    """The number of each file: the last one in the names that differs in all of them."""
    digits = [[int(word) for word in re.findall(r"\d+", file.stem)] for file in files]
    if len({len(each) for each in digits}) == 1:
        for column in reversed(list(zip(*digits, strict=True))):
            if len(set(column)) == len(files):
                return list(column)
    raise ForeignImagesError(
        f"the files of {folder} are not numbered by frame: {', '.join(f.name for f in files[:4])}; "
        "expected one file a frame, such as 0000.exr, 0001.exr"
    )


def score_foreign_images(
    claim: Claim,
    clips: Sequence[ForeignClip],
    out: Path,
    on_frame: Callable[[], None] = lambda: None,
) -> list[ScoredClip]:
    """Score the images of each clip and write rows and images into the results folder `out`.

    A clip whose rows are there, of the same images, claim and metrics, is not scored again; other
    rows of the same name, clip and budget are replaced. Raises ForeignImagesError for images or
    counts that cannot be used, CellsError where rows of another preset would be lost, and
    FolderInUseError where another process writes to `out`.
    """
    check_name(claim.name)
    with locked_folder(out):
        store = CellStore(out)
        return [_score_clip(claim, each, store, on_frame) for each in clips]


def _score_clip(
    claim: Claim, images: ForeignClip, store: CellStore, on_frame: Callable[[], None]
) -> ScoredClip:
    header = images.clip.header
    template, cell = _identify(claim, images)
    check_no_overwrite(cell, store.slots)
    rows, remarks = store.rows(cell, with_images=True), list[str]()
    if is_cached := rows is not None:
        for _ in images.images:
            on_frame()
    else:
        record_looks(store.folder, [(cell.key, template.code_hash)])
        rows, kept, remarks = _score(claim, images, template, on_frame)
        store.write(cell, rows, kept)
    scores = [row.value for row in rows if row.metric == "psnr" and math.isfinite(row.value)]
    psnr = fmean(scores) if scores else math.nan
    return ScoredClip(header.name, psnr, is_cached, tuple(remarks))


def _identify(claim: Claim, images: ForeignClip) -> tuple[Row, CellId]:
    """A row without a number, and the identity of the cell."""
    header = images.clip.header
    key = CellKey(claim.name, header.name, claim.spp, 0, "", header.preset)
    hashed, counted = _hash_files(images.images), _hash_files(images.counts)
    content = (
        *(hashed, counted, images.encoding, tuple(asdict(claim).values())),
        *(images.clip.content(header.pools[0]), *header_facts(header)),
        *(scoring_content(), code_hash.code_hash([__name__], core=()), torch.__version__),
    )
    content_hash = sha256(repr(content).encode()).hexdigest()[:16]
    first, last = images.images[0].name, images.images[-1].name
    config = {
        "verified": False,
        "files": f"{first} to {last}",
        "encoding": images.encoding,
        "samples": counted or "claimed",
        **({} if claim.ms is None else {"claimed_ms": claim.ms, "claimed_on": claim.device}),
    }
    code = f"{IMAGES_PREFIX}{hashed}"
    template = row_template(key, header, content_hash[:12], code, config=json.dumps(config))
    return template, CellId(key, content_hash)


def _hash_files(files: Sequence[Path]) -> str:
    """Hash of the content of files in their order; empty for none."""
    digests = [sha256(file.read_bytes()).hexdigest() for file in files]
    return sha256(" ".join(digests).encode()).hexdigest()[:16] if files else ""


def _score(
    claim: Claim, images: ForeignClip, template: Row, on_frame: Callable[[], None]
) -> tuple[list[Row], CellImages, list[str]]:
    """The rows of a clip, its images as they are kept, and what was unusual."""
    header, pool = images.clip.header, images.clip.header.pools[0]
    every_metric = list(registry.load_run_metrics().values())
    metrics = [each for each in every_metric if images.counts or "counts" not in each.needs]
    inputs = buffers_of_truth(metrics) & set(header.buffers)
    clip = open_clip(images.clip.folder, inputs, max_samples=1, pool=pool)
    spent = "counted by their maker" if images.counts else "claimed"
    note = f"not verified: images made elsewhere ({images.encoding}), {claim.spp:g} spp as {spent}"
    frames, rows, remarks = list[KeptFrame](), list[Row](), list[str]()
    pixels = torch.zeros(1, dtype=torch.long)

    def truth(frame: Any) -> Any:
        return make_ground_truth(metrics[0], frame)

    results = results_of_images(clip, _read_frames(claim, images))
    for result, scored in score_frames(template, metrics, results, header, truth, header.pool_spp):
        rows += [replace(row, note="; ".join(filter(None, (note, row.note)))) for row in scored]
        remarks += _find_unusual(claim, images, result)
        if any(row.note == BLACK for row in scored):
            remarks.append(f"frame {result.frame.index}: {BLACK}")
        frames.append(KeptFrame.of(result))
        pixels = add_counts(pixels, result.samples.counts) if images.counts else pixels
        on_frame()
    clip_row = replace(template, mean_spp=fmean({r.frame: r.mean_spp for r in rows}.values()))
    rows += count_rows(template, pixels) if images.counts else []
    rows += [
        with_value(clip_row, each.name, math.nan, each.convention, UNKNOWN_COUNTS)
        for each in every_metric
        if each not in metrics
    ]
    rows += _time_rows(claim, clip_row)
    kept = CellImages(pool, clip.digest, header.pool_spp, frames)
    return rows, kept, remarks


def _time_rows(claim: Claim, template: Row) -> Iterator[Row]:
    """The claimed time as that of the whole inference; a frame's time needs that of a sample."""
    row = replace(template, unit="ms", direction="lower", device=claim.device)
    for name in TIMES:
        is_whole = name in ("denoise_ms", "inference_ms")
        value = math.nan if claim.ms is None else claim.ms * is_whole
        note = UNCLAIMED_TIME if claim.ms is None else CLAIMED_TIME
        yield with_value(row, name, value, "as claimed, of the whole denoiser", note)


def _find_unusual(claim: Claim, images: ForeignClip, result: FrameResult) -> Iterator[str]:
    """Pixels that are not finite, in words. Raises ForeignImagesError for more than the budget."""
    file = images.images[result.frame.index]
    if count := int((~result.image.isfinite()).any(1).sum()):
        yield f"{file}: {count} pixels are NaN or infinite, and count as the largest error"
    mean = float(result.samples.counts.double().mean())
    if mean > claim.spp * (1 + EXCESS):
        raise ForeignImagesError(
            f"{images.counts[result.frame.index]}: {mean:.4g} samples per pixel, and --spp "
            f"{claim.spp:g} was claimed. Score it at --spp {math.ceil(100 * mean) / 100:g}"
        )
    if mean < claim.spp * (1 - EXCESS):
        yield f"{images.counts[result.frame.index]}: {mean:.4g} of {claim.spp:g} claimed spp"


def _read_frames(claim: Claim, images: ForeignClip) -> Iterator[tuple[Tensor, Tensor]]:
    """Image [3 h w], exposed, and sample counts [h w] of each frame; claimed ones are uniform."""
    header = images.clip.header
    size = header.height, header.width
    for index, file in enumerate(images.images):
        pixels = _read_image(file, size)
        if file.suffix.lower() != ".png" and not claim.is_exposed:
            pixels = pixels * header.exposure
        counts = torch.full(size, claim.spp, dtype=torch.float64)
        if images.counts:
            counts = _read_counts(images.counts[index], size)
        yield pixels, counts


def _read_image(file: Path, size: tuple[int, int]) -> Tensor:
    """The image [3 h w]: linear radiance, of a PNG that of its display values."""
    try:
        pixels = read_linear(file)
    except LooseImageError as error:
        raise ForeignImagesError(str(error)) from error
    if pixels.shape != (*size, 3):
        h, w, channels = pixels.shape
        raise ForeignImagesError(
            f"{file} has {w} x {h} pixels of {channels} channels, the clip {size[1]} x {size[0]} "
            "of 3. Images are scored at the size of the clip's reference"
        )
    return torch.from_numpy(pixels).movedim(-1, 0).contiguous()


def _read_counts(file: Path, size: tuple[int, int]) -> Tensor:
    """Samples of each pixel [h w], whole numbers."""
    try:
        is_exr = file.suffix.lower() == ".exr"
        counts: NDArray[Any] = np.asarray(
            read_exr(file, COUNTS)[..., 0] if is_exr else np.load(file)
        )
    except (SourceError, ValueError, OSError) as error:
        raise ForeignImagesError(f"{file} cannot be read: {error}") from error
    if counts.shape != size:
        raise ForeignImagesError(
            f"{file} has shape {list(counts.shape)}, the clip's images {list(size)}"
        )
    if not (np.isfinite(counts) & (counts >= 0) & (counts == np.floor(counts))).all():
        raise ForeignImagesError(f"{file}: counts must be whole numbers from 0 on")
    return torch.from_numpy(np.asarray(counts.clip(max=HALF_MAX), np.int64))
