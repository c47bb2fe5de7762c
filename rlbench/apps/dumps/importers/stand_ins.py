"""What replaces a buffer that a source does not have: a constant, or motion by optical flow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.dumps.importers.sequence import ImportedFrame, ImportedSequence
from rlbench.checks.frame_edits import STAND_INS
from rlbench.errors import SourceError
from rlbench.frames import BUFFERS


def add_stand_ins(sequence: ImportedSequence, missing_motion: str = "zero") -> ImportedSequence:
    """The sequence with all four buffers, so that every method runs on it.

    `missing_motion` is "zero" or "flow", which is estimated from albedo. `limitations` name each
    buffer that was added. Raises SourceError where there is no albedo for optical flow.
    """
    missing = [name for name in BUFFERS if name not in sequence.buffers]
    has_flow = "motion" in missing and missing_motion == "flow"
    if has_flow and "albedo" in missing:
        raise SourceError(
            f"clip '{sequence.name}': missing_motion is 'flow', which needs albedo, and there is "
            "none; use 'zero'"
        )

    def read(number: int, samples: int) -> ImportedFrame:
        frame = sequence.read(number, samples)
        gbuffer = dict(frame.gbuffer)
        for name in missing:
            value = np.array(STAND_INS[name], np.float32)
            gbuffer[name] = np.broadcast_to(value, (*frame.half_a.shape[:2], len(value)))
        if has_flow and number > sequence.numbers[0]:
            before = sequence.read(number - 1, 1).gbuffer["albedo"]
            gbuffer["motion"] = estimate_motion(gbuffer["albedo"], before)
        return frame._replace(gbuffer=gbuffer)

    named = tuple("flow" if has_flow and name == "motion" else f"no {name}" for name in missing)
    return replace(
        sequence,
        read=read if missing else sequence.read,
        buffers=tuple(name for name in BUFFERS if name in {*sequence.buffers, *missing}),
        limitations=(*sequence.limitations, *named),
        convention=sequence.convention + (f" {missing_motion}" if missing else ""),
    )


def estimate_motion(
    current: Float[Array, "h w 3"], previous: Float[Array, "h w 3"]
) -> Float[Array, "h w 2"]:
    """Motion in pixels from each pixel to its position in the previous image, x right, y down.

    Optical flow of the mean channel by TV-L1 (Zach, Pock, Bischof 2007), from scikit-image.
    """
    from skimage.registration import optical_flow_tvl1

    images = (np.asarray(image, np.float32).mean(-1) for image in (current, previous))
    down, right = optical_flow_tvl1(*images)
    return np.stack((right, down), -1)
