"""Write Intel's weights out of the library as the weights files of `oidn` and `oidn/fast`.

    python -m baselines.oidn_intel.extract baselines/oidn/cards

This makes the files that ship with rlbench. The library holds half floats, as weights files do, so
the values are unchanged; only the format is another.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from baselines.oidn import FAMILY
from baselines.oidn.method import VARIANTS
from baselines.oidn_intel.library import LibraryError
from baselines.oidn_intel.networks import load_network, weights_origin
from rlbench.weights import ModelCard, save

__all__ = ["extract", "main"]

COMMAND = "python -m baselines.oidn_intel.extract baselines/oidn/cards"
NOTE = "Intel's values, copied from the library's TZA format to safetensors; not trained here"


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
    save(network, file, ModelCard(name, command=COMMAND, origin=weights_origin(), note=NOTE))
    return file


if __name__ == "__main__":
    main()
