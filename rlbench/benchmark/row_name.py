"""Names of rows in the results, `family/variant@label`: parsed and printed here only."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BF16", "COMPILERS", "CROSSVAL", "RESERVED_LABELS", "TILES", "RowName", "RowOptions"]

BF16 = "bf16"  # label of rows whose networks ran in bfloat16
COMPILERS = ("openvino", "compile")  # backends, labels of rows whose networks they ran
TILES = "tiles"  # label of rows whose unchanged tiles were kept from the last image
CROSSVAL = "crossval"  # label of rows whose weights were trained without the row's scene
RESERVED_LABELS = (BF16, TILES, CROSSVAL, *COMPILERS)  # labels that no weights may have


@dataclass(frozen=True)
class RowOptions:
    """What a label says: the options of `rlbench run` that measured a row."""

    backend: str = "eager"  # that ran the networks
    bf16: bool = False
    skip_tiles: bool = False
    weights: str = ""  # the rest: a name of weights, or crossval; empty for shipped weights


@dataclass(frozen=True)
class RowName:
    """A method and the label of its weights or precision; without a label, pretrained weights.

    >>> RowName.parse("ours/A2@seed3")
    RowName(family='ours', variant='A2', label='seed3')
    >>> str(RowName("ours", label="bf16"))
    'ours@bf16'
    """

    family: str
    variant: str = ""  # empty for the family's main variant
    label: str = ""  # backend, bf16, tiles and a name of weights or crossval, joined by -

    @classmethod
    def parse(cls, text: str) -> RowName:
        """The parts of a name that was printed by `str`."""
        method, _, label = text.partition("@")
        family, _, variant = method.partition("/")
        return cls(family, variant, label)

    @property
    def method(self) -> str:
        """The method as on the command line: `family` or `family/variant`."""
        return f"{self.family}/{self.variant}" if self.variant else self.family

    @property
    def options(self) -> RowOptions:
        """What the label says, part by part in the order in which a run writes them.

        >>> RowName.parse("ours@openvino-bf16-seed3").options
        RowOptions(backend='openvino', bf16=True, skip_tiles=False, weights='seed3')
        """
        words = self.label.split("-")

        def take(*known: str) -> str:
            return words.pop(0) if words and words[0] in known else ""

        backend, bf16, tiles = take(*COMPILERS), take(BF16), take(TILES)
        return RowOptions(backend or "eager", bool(bf16), bool(tiles), "-".join(words))

    def __str__(self) -> str:
        """The name as it stands in the results."""
        return f"{self.method}@{self.label}" if self.label else self.method
