"""Our weights as Intel's library reads them: tensor archives (TZA), written and read.

    python -m baselines.oidn.tza oidn.tza
    python -m baselines.oidn.tza small.tza --weights runs/oidn-small/small.safetensors

A TZA file, all little-endian: a header of 12 bytes (0x41D7, version 2.0, where the table begins);
each tensor's values from a multiple of 64 bytes on; and the table, one entry a tensor: name, shape,
a letter for each dimension, a letter for the type, where its values begin. The layout is that of
the training toolkit of Open Image Denoise 2 (Afra 2019), whose layer names are ours too. Its tools
also write other types; half floats are all that the library takes for weights.
"""

from __future__ import annotations

import argparse
import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float16

from baselines.oidn import FAMILY
from baselines.oidn.method import INPUTS, VARIANTS
from rlbench.errors import RlbenchError
from rlbench.ops.unet import UNet
from rlbench.weights import WeightsError, load_into, read_card

MAGIC, VERSION = 0x41D7, (2, 0)
HEADER = struct.Struct("<HBBQ")  # magic, version, where the table begins
ALIGNED = 64  # bytes
LAYOUTS = {1: b"x", 4: b"oihw"}  # by number of dimensions: a bias, and a convolution's weights
HALF, TYPE = np.dtype("<f2"), b"h"

Array = Float16[np.ndarray, "..."]


class TzaError(RlbenchError, ValueError):
    """A file that is no TZA, or tensors that one cannot hold."""


def write(tensors: Mapping[str, Array]) -> bytes:
    """A TZA file of weights (4 dimensions) and biases (1), all half floats. Raises TzaError."""
    values = bytearray(HEADER.size)
    table = bytearray(struct.pack("<I", len(tensors)))
    for name, tensor in tensors.items():
        ndim = tensor.ndim
        if tensor.dtype != np.float16 or ndim not in LAYOUTS:
            raise TzaError(f"'{name}' is {ndim}-dimensional {tensor.dtype}, wanted 1 or 4, float16")
        _align(values)
        told = name.encode()
        table += struct.pack(f"<H{len(told)}sB", len(told), told, ndim)
        table += struct.pack(f"<{ndim}I", *tensor.shape) + LAYOUTS[ndim] + TYPE
        table += struct.pack("<Q", len(values))
        values += np.ascontiguousarray(tensor, HALF).tobytes()
    _align(values)
    HEADER.pack_into(values, 0, MAGIC, *VERSION, len(values))
    return bytes(values + table)


def read(content: bytes) -> dict[str, Array]:
    """The tensors of a TZA file by name, in the order of its table. Raises TzaError."""
    try:
        return _read(content)
    except (struct.error, UnicodeDecodeError) as error:
        raise TzaError(f"the file is cut off or damaged: {error}") from error


def export(weights: Path) -> bytes:
    """The TZA file of a weights file of `oidn` or `oidn/small`, half floats as they are in it.

    Raises WeightsError for weights that are missing, changed, or those of another network.
    """
    variant = read_card(weights).name.partition("/")[2]
    config = VARIANTS.get(variant, VARIANTS[""])  # of a stranger's weights `load_into` will tell
    network = UNet(INPUTS, widths=config.widths)
    load_into(network, weights)
    return write({name: tensor.numpy() for name, tensor in network.half().state_dict().items()})


def main(asked: Sequence[str] | None = None) -> None:
    """Write the TZA file that the command line asks for."""
    shipped = Path(__file__).parent / "cards" / FAMILY.weights_file("")
    about = "Write our weights as a TZA file, for oidnDenoise -w or a filter's data 'weights'."
    parser = argparse.ArgumentParser("baselines.oidn.tza", description=about)
    parser.add_argument("out", type=Path, help="the TZA file to write")
    parser.add_argument("--weights", type=Path, default=shipped, help="default: those shipped")
    told = parser.parse_args(asked)
    try:
        told.out.write_bytes(export(told.weights))
    except (WeightsError, OSError) as error:
        parser.error(str(error))


def _align(values: bytearray) -> None:
    values += bytes(-len(values) % ALIGNED)


def _read(content: bytes) -> dict[str, Array]:
    magic, major, _, place = HEADER.unpack_from(content)
    if (magic, major) != (MAGIC, VERSION[0]):
        raise TzaError(f"no TZA file of version 2: it begins with {content[:4].hex(' ')}")
    tensors = {}
    (count,) = struct.unpack_from("<I", content, place)
    place += 4
    for _ in range(count):
        (length,) = struct.unpack_from("<H", content, place)
        name, ndim = struct.unpack_from(f"<{length}sB", content, place + 2)
        place += 2 + length + 1
        *shape, _, letter, begin = struct.unpack_from(f"<{ndim}I{ndim}scQ", content, place)
        place += 4 * ndim + ndim + 1 + 8
        size = math.prod(shape)
        if letter != TYPE:
            raise TzaError(f"'{name.decode()}' has values of type {letter!r}, not half floats")
        if (end := begin + size * HALF.itemsize) > len(content):
            raise TzaError(f"'{name.decode()}' ends at byte {end} of {len(content)}")
        found = np.frombuffer(content, HALF, count=size, offset=begin)
        tensors[name.decode()] = found.reshape(shape)
    return tensors


if __name__ == "__main__":
    main()
