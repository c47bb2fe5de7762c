"""Export weights as a tensor archive (TZA) for Intel's library, and read such files.

    python -m baselines.oidn.tza tuned.tza
    python -m baselines.oidn.tza mine.tza --weights runs/oidn-retrained/retrained.safetensors

A TZA file is little-endian and consists of a header of 12 bytes (0x41D7, version 2.0, offset of the
table); each tensor's values, aligned to 64 bytes; and the table with one entry per tensor: name,
shape, one letter per dimension, one letter for the type, offset of the values. The layout is that
of the training toolkit of Open Image Denoise 2 (Afra 2019), whose layer names we share. Its tools
also write other types; the library accepts weights in half floats only.
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
from baselines.oidn.method import INPUT_CHANNELS, VARIANTS
from rlbench.errors import RlbenchError
from rlbench.ops.unet import UNet
from rlbench.weights import WeightsError, load_into, read_card

MAGIC, VERSION = 0x41D7, (2, 0)
HEADER = struct.Struct("<HBBQ")  # magic, major and minor version, offset of the table
ALIGNMENT = 64  # bytes
LAYOUTS = {1: b"x", 4: b"oihw"}  # by number of dimensions: a bias, or a convolution's weights
HALF, HALF_TYPE = np.dtype("<f2"), b"h"

Array = Float16[np.ndarray, "..."]


class TzaError(RlbenchError, ValueError):
    """A file that is not a valid TZA, or tensors that TZA cannot represent."""


def encode(tensors: Mapping[str, Array]) -> bytes:
    """The TZA file of weights (4 dimensions) and biases (1 dimension) in float16.

    Raises TzaError for other types and shapes.

    >>> decode(encode({"bias": np.array([1, 2], np.float16)}))
    {'bias': array([1., 2.], dtype=float16)}
    """
    values = bytearray(HEADER.size)
    table = bytearray(struct.pack("<I", len(tensors)))
    for name, tensor in tensors.items():
        ndim = tensor.ndim
        if tensor.dtype != np.float16 or ndim not in LAYOUTS:
            raise TzaError(
                f"'{name}' is {ndim}-dimensional {tensor.dtype}; TZA needs 1 or 4 dimensions and "
                "float16. Convert the tensor"
            )
        _align(values)
        encoded_name = name.encode()
        table += struct.pack(f"<H{len(encoded_name)}sB", len(encoded_name), encoded_name, ndim)
        table += struct.pack(f"<{ndim}I", *tensor.shape) + LAYOUTS[ndim] + HALF_TYPE
        table += struct.pack("<Q", len(values))
        values += np.ascontiguousarray(tensor, HALF).tobytes()
    _align(values)
    HEADER.pack_into(values, 0, MAGIC, *VERSION, len(values))
    return bytes(values + table)


def decode(content: bytes) -> dict[str, Array]:
    """The tensors of a TZA file by name, in the order of its table. Raises TzaError."""
    try:
        return _decode(content)
    except (struct.error, UnicodeDecodeError) as error:
        raise TzaError(f"the TZA file is truncated or damaged: {error}") from error


def export(weights: Path) -> bytes:
    """The TZA file of a weights file of a row `oidn` or `oidn/...`, with its half floats unchanged.

    Raises WeightsError if the file is missing, changed, or belongs to another network.
    """
    variant = read_card(weights).name.partition("/")[2]
    config = VARIANTS.get(variant, VARIANTS[""])  # `load_into` rejects weights of other methods
    network = UNet(INPUT_CHANNELS, widths=config.widths)
    load_into(network, weights)
    return encode({name: tensor.numpy() for name, tensor in network.half().state_dict().items()})


def main(arguments: Sequence[str] | None = None) -> None:
    """Write a TZA file as given on the command line."""
    pretrained = Path(__file__).parent / "cards" / FAMILY.weights_file("tuned")
    description = "Export weights as a TZA file for oidnDenoise -w or the filter data 'weights'."
    parser = argparse.ArgumentParser("baselines.oidn.tza", description=description)
    parser.add_argument("out", type=Path, help="TZA file to write")
    parser.add_argument(
        "--weights", type=Path, default=pretrained, help="weights file; default: oidn/tuned"
    )
    options = parser.parse_args(arguments)
    try:
        options.out.write_bytes(export(options.weights))
    except (WeightsError, OSError) as error:
        parser.error(str(error))


def _align(values: bytearray) -> None:
    values += bytes(-len(values) % ALIGNMENT)


def _decode(content: bytes) -> dict[str, Array]:
    magic, major, _, offset = HEADER.unpack_from(content)
    if (magic, major) != (MAGIC, VERSION[0]):
        raise TzaError(f"not a TZA file of version 2: it begins with {content[:4].hex(' ')}")
    tensors = {}
    (count,) = struct.unpack_from("<I", content, offset)
    offset += 4
    for _ in range(count):
        (length,) = struct.unpack_from("<H", content, offset)
        name, ndim = struct.unpack_from(f"<{length}sB", content, offset + 2)
        offset += 2 + length + 1
        *shape, _, type_letter, begin = struct.unpack_from(f"<{ndim}I{ndim}scQ", content, offset)
        offset += 4 * ndim + ndim + 1 + 8
        size = math.prod(shape)
        if type_letter != HALF_TYPE:
            raise TzaError(
                f"'{name.decode()}' has values of type {type_letter!r}; only half floats are read"
            )
        if (end := begin + size * HALF.itemsize) > len(content):
            raise TzaError(
                f"'{name.decode()}' ends at byte {end}, but the file has {len(content)} bytes"
            )
        values = np.frombuffer(content, HALF, count=size, offset=begin)
        tensors[name.decode()] = values.reshape(shape)
    return tensors


if __name__ == "__main__":
    main()
