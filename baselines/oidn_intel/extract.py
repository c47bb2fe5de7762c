"""Intel's networks, read from the library, which contains them as TZA files.

    python -m baselines.oidn_intel.extract baselines/oidn/cards

This makes the weights files of `oidn` and `oidn/fast` that ship with rlbench. The library holds
half floats, as weights files do, so the values are unchanged; only the format is another.
"""

from __future__ import annotations

import argparse
import struct
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import torch

from baselines.oidn import FAMILY, tza
from baselines.oidn.method import INPUT_CHANNELS, VARIANTS, Oidn
from baselines.oidn_intel.method import Filter, FilterSettings, LibraryError, library_version
from rlbench.frames import GBuffer, Samples
from rlbench.ops.unet import UNet
from rlbench.ops.unet_widths import BASE_WIDTHS, FAST_WIDTHS, UNetWidths
from rlbench.weights import ModelCard, save

COMMAND = "python -m baselines.oidn_intel.extract baselines/oidn/cards"
NOTE = "Intel's values, copied from the library's TZA format to safetensors; not trained here"
QUALITIES = {
    BASE_WIDTHS: "high",
    FAST_WIDTHS: "fast",
}  # the library's quality that uses each network
MAX_TZA_BYTES = 8_000_000  # upper bound of a network's size in the library
TEST_SIDE = 64  # pixels; side of the image that identifies a network
MAX_DIFFERENCE = 0.02  # relative; half floats cause less, and other networks differ by 0.19


def extract(folder: Path) -> list[Path]:
    """Write the weights and cards of the rows with Intel's weights; returns the weights files.

    Raises LibraryError if pyoidn is not installed, or if it has no network of that size.
    """
    names = {key: name for key, name in zip(FAMILY.variants, FAMILY.method_names(), strict=True)}
    intel = [key for key, variant in FAMILY.variants.items() if variant.trained_by]
    return [_extract(key, names[key], folder / FAMILY.weights_file(key)) for key in intel]


def main(arguments: Sequence[str] | None = None) -> None:
    """Extract the weights as given on the command line."""
    parser = argparse.ArgumentParser("baselines.oidn_intel.extract", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder for the weights and their cards")
    options = parser.parse_args(arguments)
    try:
        for file in extract(options.folder):
            print(file)  # noqa: T201 - the command's output
    except (LibraryError, OSError) as error:
        parser.error(str(error))


def _extract(variant: str, name: str, file: Path) -> Path:
    network = load_network(VARIANTS[variant].widths)
    origin = f"Intel's weights of Open Image Denoise {library_version()}, Apache-2.0"
    save(network, file, ModelCard(name, command=COMMAND, origin=origin, note=NOTE))
    return file


def read_library_networks() -> list[Mapping[str, tza.Array]]:
    """All networks inside pyoidn's library, as tensors by name.

    Raises LibraryError if pyoidn is not installed.
    """
    try:
        import pyoidn  # an optional dependency
    except ImportError as error:
        raise LibraryError(
            "Intel's weights are part of pyoidn, which is not installed: pip install pyoidn"
        ) from error
    core = min(Path(pyoidn.__file__).parent.glob("oidn/*/*OpenImageDenoise_core*"))
    content, magic = core.read_bytes(), struct.pack("<HBB", tza.MAGIC, *tza.VERSION)
    offsets = [i for i in range(0, len(content), tza.ALIGNMENT) if content.startswith(magic, i)]
    return [tza.decode(content[i : i + MAX_TZA_BYTES]) for i in offsets]


@cache
def load_network(widths: UNetWidths = BASE_WIDTHS) -> UNet:
    """Intel's network with these widths, for HDR colour with albedo and normal.

    The library contains several networks of equal size; this is the one that gives the library's
    own image for random input. The result is cached, so do not train it in place. Raises
    LibraryError if no network matches, or if the extra `oidn` is not installed.
    """
    unet = UNet(INPUT_CHANNELS, widths=widths).eval().requires_grad_(False)
    shapes = {name: tuple(tensor.shape) for name, tensor in unet.state_dict().items()}
    candidates = [
        tensors
        for tensors in read_library_networks()
        if {name: tensor.shape for name, tensor in tensors.items()} == shapes
    ]
    for tensors in candidates:
        unet.load_state_dict(
            {name: torch.from_numpy(t.astype(np.float32)) for name, t in tensors.items()}
        )
        if _relative_difference(unet, QUALITIES[widths]) < MAX_DIFFERENCE:
            return unet
    raise LibraryError(
        f"looked for Intel's network of {sum(map(np.prod, shapes.values()))} weights; the library "
        f"has {len(candidates)} of that size, and none gives the library's image. This version of "
        "pyoidn may store its networks differently: try an earlier version"
    )


def _relative_difference(unet: UNet, quality: str) -> float:
    """Mean difference between the images of `unet` and of the library, relative to the latter."""
    generator = torch.Generator().manual_seed(0)
    colour, albedo, normal = torch.rand(3, 1, 3, TEST_SIDE, TEST_SIDE, generator=generator)
    gbuffer = GBuffer({"albedo": albedo, "normal": 2 * normal - 1})
    samples = Samples(colour[:, None], torch.ones(1, 1, TEST_SIDE, TEST_SIDE, dtype=torch.int64))
    image, _ = Oidn(unet).denoise(gbuffer, samples, None)
    run_filter = Filter(FilterSettings(quality), TEST_SIDE, TEST_SIDE, threads=1)
    library_image = run_filter(colour[0], albedo[0], 2 * normal[0] - 1)
    return float((image[0] - library_image).abs().mean() / library_image.abs().mean())


if __name__ == "__main__":
    main()
