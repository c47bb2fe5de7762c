"""Which cells of some results lack images, and the command that makes them."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Sequence
from itertools import product
from pathlib import Path

from rlbench.benchmark import results
from rlbench.benchmark.cell_images import KeptImages, find_images
from rlbench.benchmark.row_name import RowName
from rlbench.errors import RlbenchError

__all__ = ["MissingImagesError", "find_all_images"]

MAX_NAMED = 6  # cells in a message


class MissingImagesError(RlbenchError, ValueError):
    """Cells whose images were not kept."""


def find_all_images(
    folder: Path, methods: Sequence[str], clips: Collection[str], target_spp: Sequence[float]
) -> list[KeptImages]:
    """The images of each method on each clip at each budget; of all seeds and devices.

    Raises MissingImagesError where a method, clip and budget has none.
    """
    wanted_cells = set(product(methods, clips, target_spp))
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
        raise MissingImagesError(_explain(folder, sorted(missing), presets))
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
    words = ["rlbench", "run", "-m", _join(name.method for name in names)]
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
