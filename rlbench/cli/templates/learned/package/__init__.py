"""The method `$name`: what it is and needs. Importing this module does not import torch."""

from rlbench import Family, Traits, Variant

__all__ = ["FAMILY", "TRAITS"]

TRAITS = Traits(inputs=frozenset({"albedo", "normal"}))

FAMILY = Family(
    name="$name",
    title="A small network predicts a kernel per pixel",
    paper="Author year, title",
    licence="MIT",
    variants={"": Variant("Is a small network enough?", TRAITS, pretrained=False)},
    build=f"{__name__}.method:build",
    train=f"{__name__}.training:training_task",
)
