"""The files of the tracers in the cache: kernels, probes, frames, and scenes by others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rlbench.apps.render.scenes.collection.catalog import CREDITS, load_catalog
from rlbench.benchmark.cache_entries import CacheEntry, group_files

RENDERING = "the next rendering"


def find_entries(cache: Path) -> Iterator[CacheEntry]:
    """The entries of a cache folder; without those of clips."""
    for each in sorted(cache.glob("drjit-*")):
        kernels = (*each.glob("*.bin"), *each.glob("sweep.stamp"))
        yield group_files("kernels", each, kernels, RENDERING)
    yield group_files("probes", cache, cache.glob("cuda.json"), RENDERING)
    contact, cycles = cache / "contact", cache / "cycles"
    yield group_files("contact sheet", contact, contact.glob("*.npy"), "make contact")
    scenes = [*cycles.glob("*.json"), *cycles.glob("*.log"), *cycles.glob("*/open.log")]
    yield group_files("Blender scenes", cycles, scenes, "rlbench render")
    yield from _collection_entries(cache / "scenes")


def _collection_entries(folder: Path) -> Iterator[CacheEntry]:
    """Downloaded scenes and pins; a link leads to files of the user, which are not the cache's."""
    yield group_files(
        "pins of scenes", folder / "pins", folder.glob("pins/*.tsv"), "rlbench scenes pin"
    )
    for name, scene in load_catalog().items() if folder.is_dir() else ():
        own = folder / name
        known = (own / path for path in (*(file.path for file in scene.files), CREDITS))
        found = () if own.is_symlink() else (path for path in known if path.is_file())
        yield group_files("scenes by others", own, found, "rlbench scenes get")
