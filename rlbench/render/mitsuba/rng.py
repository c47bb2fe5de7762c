"""Random numbers that depend on pixel, sample, frame, stream and seed, and on nothing else."""

from __future__ import annotations

import hashlib
import struct
from functools import cache
from typing import Any

STREAMS = ("input", "pilot", "referenceA", "referenceB", "restir")


def stream_key(stream: str, time: float, seed: int) -> tuple[int, int]:
    """Two 32-bit numbers for a stream of a frame; those of different streams never agree.

    `time` is the frame, or a moment between frames. Raises LookupError for an unknown stream.
    """
    if stream not in STREAMS:
        raise LookupError(f"no sample stream '{stream}'; there are: {', '.join(STREAMS)}")
    words = f"{stream} {seed} {float(time)!r}".encode()
    return struct.unpack("<II", hashlib.blake2b(words, digest_size=8).digest())


def make_sampler(pixels: Any, samples: Any, salt: Any) -> Any:
    """A Mitsuba sampler for one wavefront, lane by lane of `pixels` and `samples` (mi.UInt32).

    `salt` holds the two numbers of `key`, opaque to the compiler. Mitsuba's own `independent`
    sampler is keyed by the lane, so there a sample's value changes with the wavefront around it.
    """
    return _sampler_class()(pixels, samples, salt)


@cache
def _sampler_class() -> type:
    import mitsuba as mi  # a variant must be running before the class can be made

    class Keyed(mi.Sampler):
        """A PCG32 for each lane; position and sequence come from two rounds of TEA.

        TEA (Wheeler, Needham 1994) maps 64 bits to 64 one to one, so that two (pixel, sample)
        pairs of one frame never start alike.
        """

        def __init__(self, pixels: Any, samples: Any, salt: Any) -> None:
            super().__init__(mi.Properties())
            self.lanes = len(pixels)
            high, low = mi.sample_tea_32(pixels, samples)
            sequence = (mi.UInt64(high) << 32) | mi.UInt64(low)
            high, low = mi.sample_tea_32(high ^ salt[0], low ^ salt[1])
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

    return Keyed
