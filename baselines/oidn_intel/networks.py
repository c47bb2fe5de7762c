"""Intel's networks as ours: read out of the library, which holds them as TZA files."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import torch

from baselines.oidn import tza
from baselines.oidn.method import INPUTS, Oidn
from baselines.oidn_intel.library import Filter, LibraryError, Settings, version
from rlbench.frames import GBuffer, Samples
from rlbench.ops.unet import BASE_WIDTHS, FAST_WIDTHS, UNet, UNetWidths

QUALITIES = {
    BASE_WIDTHS: "high",
    FAST_WIDTHS: "fast",
}  # of the library, by the network that it takes for it
LONGEST = 8_000_000  # bytes of a network in the library, at most
SIDE = 64  # pixels of the image by which a network is known
ALIKE = 0.02  # relative difference, more than half floats make; other networks differ by 0.19


def inside() -> list[Mapping[str, tza.Array]]:
    """All networks that are built into the library that pyoidn brings. Raises LibraryError."""
    try:
        import pyoidn  # an extra
    except ImportError as error:
        raise LibraryError(
            "Intel's weights are in pyoidn, which is not installed: pip install pyoidn"
        ) from error
    core = min(Path(pyoidn.__file__).parent.glob("oidn/*/*OpenImageDenoise_core*"))
    held, magic = core.read_bytes(), struct.pack("<HBB", tza.MAGIC, *tza.VERSION)
    begins = [i for i in range(0, len(held), tza.ALIGNED) if held.startswith(magic, i)]
    return [tza.read(held[i : i + LONGEST]) for i in begins]


@cache
def network(widths: UNetWidths = BASE_WIDTHS) -> UNet:
    """Intel's network of a size, for HDR colour with albedo and normal; do not train it in place.

    Several have that size: it is the one whose image of some noise is the library's. Raises
    LibraryError where none is, or where the extra `oidn` is not installed.
    """
    made = UNet(INPUTS, widths=widths).eval().requires_grad_(False)
    wanted = {name: tuple(tensor.shape) for name, tensor in made.state_dict().items()}
    fitting = [n for n in inside() if {k: v.shape for k, v in n.items()} == wanted]
    for held in fitting:
        made.load_state_dict({k: torch.from_numpy(v.astype(np.float32)) for k, v in held.items()})
        if _difference(made, QUALITIES[widths]) < ALIKE:
            return made
    raise LibraryError(
        f"none of the {len(fitting)} networks of {sum(map(np.prod, wanted.values()))} weights in "
        "the library makes the library's image; the layout of pyoidn may be new"
    )


def origin() -> str:
    """What the card of weights says that started from these."""
    return f"Intel's weights of Open Image Denoise {version()}, Apache-2.0"


def _difference(made: UNet, quality: str) -> float:
    generator = torch.Generator().manual_seed(0)
    colour, albedo, normal = torch.rand(3, 1, 3, SIDE, SIDE, generator=generator)
    gbuffer = GBuffer({"albedo": albedo, "normal": 2 * normal - 1})
    samples = Samples(colour[:, None], torch.ones(1, 1, SIDE, SIDE, dtype=torch.int64))
    image, _ = Oidn(made).denoise(gbuffer, samples, None)
    run = Filter(Settings(quality), SIDE, SIDE, threads=1)
    library = run(colour[0], albedo[0], 2 * normal[0] - 1)
    return float((image[0] - library).abs().mean() / library.abs().mean())
