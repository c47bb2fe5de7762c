"""The method `$name`: what it is and needs. Importing this module does not import torch."""

from rlbench import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(inputs=frozenset({"motion"}), adaptive=True, temporal=True)

FAMILY = Family(
    name="$name",
    title="Accumulate samples along the motion",
    paper="Author year, title",
    licence="MIT",
    variants={"": Variant("Do pixels with a short history need samples?", TRAITS, learned=False)},
    build=f"{__name__}.method:build",
)
