"""Random numbers that depend on pixel, sample, frame, stream and seed only."""

from __future__ import annotations

import hashlib
import struct
from functools import cache
from typing import Any

__all__ = ["STREAMS", "make_sampler", "stream_key"]

STREAMS = ("input", "pilot", "referenceA", "referenceB", "restir")


def stream_key(stream: str, time: float, seed: int) -> tuple[int, int]:
    """Two 32-bit numbers for one stream of one frame; no two streams share them.

    `time` is in frames and may be fractional. Raises LookupError for an unknown stream.
    """
    if stream not in STREAMS:
        raise LookupError(f"no sample stream '{stream}'; available: {', '.join(STREAMS)}")
    text = f"{stream} {seed} {float(time)!r}".encode()
    return struct.unpack("<II", hashlib.blake2b(text, digest_size=8).digest())


def make_sampler(pixels: Any, samples: Any, key: Any) -> Any:
    """A Mitsuba sampler for a wavefront whose lanes are `pixels` and `samples` (mi.UInt32).

    `key` holds the two numbers of `stream_key`, opaque to the compiler. Mitsuba's own `independent`
    sampler is keyed by the lane, so a sample's value would change with the wavefront around it.
    """
    return _sampler_class()(pixels, samples, key)


@cache
def _sampler_class() -> type:
    import mitsuba as mi  # the class can be defined only after a variant is set

    class KeyedSampler(mi.Sampler):
        """A PCG32 for each lane; two rounds of TEA give its sequence and its initial state.

        TEA (Wheeler and Needham 1994) maps 64 bits to 64 bits one to one, so no two (pixel, sample)
        pairs of a frame start alike.
        """

        def __init__(self, pixels: Any, samples: Any, key: Any) -> None:
            super().__init__(mi.Properties())
            self.lanes = len(pixels)
            high, low = mi.sample_tea_32(pixels, samples)
            sequence = (mi.UInt64(high) << 32) | mi.UInt64(low)
            high, low = mi.sample_tea_32(high ^ key[0], low ^ key[1])
            generator: Any = mi.PCG32
            self.rng = generator()
            self.rng.seed((mi.UInt64(high) << 32) | mi.UInt64(low), sequence)

        def next_1d(self, active: Any = True) -> Any:
            return self.rng.next_float32(active)

        def next_2d(self, active: Any = True) -> Any:
            first = self.rng.next_float32(active)
            return mi.Point2f(first, self.rng.next_float32(active))

        def wavefront_size(self) -> int:
            return self.lanes

        def schedule_state(self) -> None:
            import drjit as dr

            dr.schedule(self.rng.state, self.rng.inc)

        def traverse(self, callback: Any) -> None:
            callback.put("rng", self.rng, mi.ParamFlags.NonDifferentiable)

    return KeyedSampler
