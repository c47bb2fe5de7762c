"""Clips: sequences of frames with G-buffer, sample pools and reference, on disk or in memory.

A clip folder holds four or more EXR files per frame and a clip.toml. Any renderer can write one:

>>> import tempfile
>>> from pathlib import Path
>>> import numpy as np
>>> from rlbench.clips import Header, verify, write_frame, write_header
>>> folder = Path(tempfile.mkdtemp()) / "gradient"
>>> image = np.linspace(0, 1, 8 * 8 * 3).reshape(8, 8, 3)  # h w c, linear radiance
>>> pool = np.stack([image, image])  # s h w 3, independent 1-spp images
>>> write_frame(folder, 0, {"albedo": image}, {"path": pool}, image, image)
>>> header = Header(
...     name="gradient", scene="gradient", sampler="numpy", height=8, width=8, frames=1,
...     pool_spp=2, reference_spp=(64,), buffers=("albedo",),
... )
>>> write_header(folder, header)
>>> verify(folder)
[]

`open_clip` reads it. Names are imported when they are first used, so torch is not imported before.
"""

from typing import TYPE_CHECKING

__all__ = [
    "ClipError",
    "Header",
    "InMemoryClip",
    "StoredClip",
    "open_clip",
    "procedural_clip",
    "read_header",
    "verify",
    "write_frame",
    "write_header",
]

if TYPE_CHECKING:
    from rlbench.clips.frame_files import write_frame
    from rlbench.clips.header import ClipError, Header, read_header, write_header
    from rlbench.clips.in_memory import InMemoryClip
    from rlbench.clips.procedural.clip import procedural_clip
    from rlbench.clips.stored import StoredClip, open_clip, verify
else:
    import lazy_loader

    __getattr__, __dir__, _ = lazy_loader.attach(
        __name__,
        submod_attrs={
            "frame_files": ["write_frame"],
            "header": ["ClipError", "Header", "read_header", "write_header"],
            "in_memory": ["InMemoryClip"],
            "procedural.clip": ["procedural_clip"],
            "stored": ["StoredClip", "open_clip", "verify"],
        },
    )
