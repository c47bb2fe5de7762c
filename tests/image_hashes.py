"""Hashes of images and counts of every row, to compare two versions of the code bit by bit.

    python -m tests.image_hashes > before.txt    # in each version, on one machine
    diff before.txt after.txt

The clip is procedural and has a cut; rows without shipped weights have random ones. A row that
cannot run has the reason in place of its hash.
"""

from __future__ import annotations

from collections.abc import Iterator
from hashlib import sha256

import torch

from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip

SPP = (1.0, 4.0)


def hash_rows(names: list[str]) -> Iterator[tuple[str, str]]:
    """The hash of each row."""
    clip = procedural_clip(3, Size(1, 64, 80), frames=4, cut=3)
    for name in names:
        digest = sha256()
        has_weights = registry.shipped_weights(name).is_file()
        is_random = registry.get_variant(name).learned and not has_weights
        try:
            method = registry.load_method(name, weights="random" if is_random else None)
            for spp in map(method.traits.nearest_spp, SPP):
                for result in run_clip(method, clip, spp):
                    digest.update(result.image.numpy().tobytes())
                    digest.update(result.samples.counts.numpy().tobytes())
        except Exception as error:
            yield name, repr(error)
        else:
            yield name, digest.hexdigest()[:16]


if __name__ == "__main__":
    torch.set_num_threads(1)
    for row in hash_rows(registry.expand(["all/*"])):
        print(*row)  # noqa: T201
