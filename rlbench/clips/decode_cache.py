"""The decoded cache: an EXR is unpacked once, then read as memory-mapped arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rlbench.clips.exr import read_exr
from rlbench.clips.frame_files import channels, exr_path, not_finite
from rlbench.clips.header import ClipError, Header
from rlbench.system import code_hash, paths

Arrays = Mapping[str, NDArray[np.floating]]  # c h w, as precise as the file


@dataclass(frozen=True)
class DecodeCache:
    """Arrays of one clip folder, decoded when first asked for and then kept under the cache."""

    folder: Path
    header: Header
    digest: str

    def gbuffer(self, index: int, buffers: Sequence[str]) -> Arrays:
        """The view buffers of a frame, each [c h w]."""
        return self._arrays("view", index, buffers)

    def pool(self, kind: str, index: int, slots: Sequence[int]) -> list[NDArray[np.floating]]:
        """The stored samples `slots` of a frame, each [3 h w]."""
        names = [f"s{slot}" for slot in slots]
        return list(self._arrays(f"pool.{kind}", index, names).values())

    def reference(self, half: str, index: int) -> NDArray[np.floating]:
        """Half "A" or "B" of the reference of a frame, [3 h w]."""
        return self._arrays(f"reference{half}", index, ["rgb"])["rgb"]

    def _arrays(self, kind: str, index: int, names: Sequence[str]) -> Arrays:
        """Arrays by name; what the cache lacks is decoded from one opening of the file."""
        places = {name: self._place(kind, index, name) for name in names}
        missing = [name for name, path in places.items() if not path.exists()]
        if missing:
            fresh = decode(exr_path(self.folder, kind, index), missing, self.header)
            for name, array in fresh.items():
                with paths.replacing(places[name]) as temporary, temporary.open("wb") as file:
                    np.save(file, array)
        return {name: np.load(path, mmap_mode="r") for name, path in places.items()}

    def _place(self, kind: str, index: int, name: str) -> Path:
        return paths.decoded() / f"{self.digest}-{_reader()}" / kind / f"{name}.{index:04d}.npy"


@cache
def _reader() -> str:
    """Hash of the code that decodes: what another one left is not read."""
    return code_hash.code_hash(
        [__name__, "rlbench.clips.exr", "rlbench.clips.frame_files"], core=()
    )[:8]


def decode(path: Path, names: Sequence[str], header: Header) -> Arrays:
    """Arrays by name, each stacked from its channels, [c h w].

    Raises ClipError where the file is missing, broken, of another size or holds values that are
    not finite; depth may be +inf, which is background.
    """
    planes = iter(read_exr(path, channels(names), header.height, header.width))
    arrays = {n: np.stack([next(planes) for _ in channels([n])]) for n in names}
    for name, array in arrays.items():
        if count := int(not_finite(name, array).sum()):
            raise ClipError(
                f"{path}: {count} of {array.size} values of {name} are not finite; "
                "delete the file and run `rlbench render` to trace that frame again"
            )
    return arrays
