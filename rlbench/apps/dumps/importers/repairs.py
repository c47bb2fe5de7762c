"""Values of an imported frame that no clip may hold: found, named, or repaired and counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rlbench.apps.dumps.importers.sequence import ImportedFrame
from rlbench.clips.frame_files import is_no_reference, nonfinite_mask
from rlbench.clips.image_files import Pixels
from rlbench.errors import SourceError
from rlbench.ops.sanitize import RULES, sanitize_radiance

ADDED = ("specular", "emission", "albedo")  # what radiance is made of, too


@dataclass
class Findings:
    """What was unusual in the frames of a clip, counted while they were imported."""

    counts: Counter[str] = field(default_factory=Counter)
    places: dict[str, str] = field(default_factory=dict)  # the first frame of each kind

    def add(self, number: int, counts: Mapping[str, int]) -> None:
        """Add the counts of one frame of the source."""
        for kind, count in counts.items():
            if count:
                self.counts[kind] += count
                self.places.setdefault(kind, f"first in frame {number}")

    def lines(self) -> list[str]:
        """A sentence about each kind."""
        found, lines = self.counts, []
        if images := found["empty images"]:
            lines.append(
                f"{images} images do not fill their display window: {found['empty pixels']} pixels "
                f"are empty, {self.places['empty images']}"
            )
        if images := found["cut images"]:
            lines.append(
                f"{images} images have overscan: {found['cut pixels']} pixels outside the display "
                f"window are cut, {self.places['cut images']}"
            )
        if images := found["outside images"]:
            lines.append(
                f"{images} images have colours outside Rec. 709: a channel of "
                f"{found['outside pixels']} pixels became 0, {self.places['outside images']}"
            )
        for kind, count in found.items():
            verb, _, name = kind.partition(" ")
            if verb == "broken":
                instead = "point outside the image" if name == "motion" else "became background"
                lines.append(
                    f"{count} pixels of {name} are NaN or infinite, and {instead}, "
                    f"{self.places[kind]}; --sanitize takes the {name} of a neighbour"
                )
            elif verb == "repaired":
                lines.append(f"{count} pixels of {name} were repaired, {self.places[kind]}")
        return lines


def check_finite(clip: str, number: int, frame: ImportedFrame) -> None:
    """Raise SourceError for NaN or infinity in frame `number`; the message names the file."""
    samples = {("radiance", slot): image for slot, image in enumerate(frame.pool)}
    halves = {("reference", 0): frame.half_a, ("reference", 1): frame.half_b}
    buffers = {(name, 0): image for name, image in frame.gbuffer.items()}
    for (name, slot), image in (samples | halves | buffers).items():
        mask = nonfinite_mask(name, np.asarray(image))
        is_absent = name == "reference" and name not in frame.files and is_no_reference(image)
        if is_absent or not mask.any():
            continue
        row, column = np.argwhere(mask)[0][:2]
        sources = (name, *ADDED) if name == "radiance" else (name, "albedo")
        where = next((f"{frame.files[each]}: " for each in sources if each in frame.files), "")
        label = f"sample {slot}" if name == "radiance" else name
        raise SourceError(
            f"{where}{int(mask.sum())} values of {label} in frame {number} of clip '{clip}' are "
            f"NaN or infinite, the first at x {column}, y {row}. Render the frame again, or import "
            "with --sanitize, which repairs and counts such pixels"
        )


def repair_frame(frame: ImportedFrame) -> ImportedFrame:
    """The frame with valid values, by the rules of `rlbench.ops.sanitize`; repairs are counted.

    A buffer takes a neighbour's value. Radiance becomes black where any channel is not finite, and
    0 where it is negative; it is not exposed yet, so no firefly is clipped.
    """
    counts = Counter(frame.counts)

    def repair_buffer(name: str, image: Pixels) -> Pixels:
        broken = frame.broken.get(name)
        values = _channels_first(image if broken is None else np.where(broken, np.nan, image))
        valid = RULES[name](values[None])[0]
        counts[f"repaired {name}"] += int((valid != values).any(0).sum())
        return _channels_last(valid)

    def repair_radiance(name: str, image: Pixels) -> Pixels:
        if name == "reference" and is_no_reference(image):
            return image
        values = _channels_first(image)
        wrong = ~(values.isfinite() & (values >= 0)).all(-3, keepdim=True)
        counts[f"repaired {name}"] += int(wrong.sum())
        return _channels_last(torch.where(wrong, sanitize_radiance(values), values))

    gbuffer = {name: repair_buffer(name, image) for name, image in frame.gbuffer.items()}
    pool = repair_radiance("radiance", frame.pool)
    half_a = repair_radiance("reference", frame.half_a)
    is_one = frame.half_b is frame.half_a
    half_b = half_a if is_one else repair_radiance("reference", frame.half_b)
    return frame._replace(
        gbuffer=gbuffer, pool=pool, half_a=half_a, half_b=half_b, broken={}, counts=counts
    )


def _channels_first(image: Pixels) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(image, np.float32)).movedim(-1, -3)


def _channels_last(image: Tensor) -> NDArray[np.floating]:
    return np.ascontiguousarray(image.movedim(-3, -1).numpy())
