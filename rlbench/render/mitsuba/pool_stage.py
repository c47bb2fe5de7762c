"""A tracer's scene as a pool's plugin sees it, moved from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rlbench.render.mitsuba import load
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.wavefront import WavefrontTracer


@dataclass
class PoolStage:
    """A scene at the tracer's present time; see `rlbench.pools.Stage`."""

    tracer: WavefrontTracer
    stream: str  # of random numbers
    _motion: tuple[float, Any, Any] | None = field(default=None, repr=False)

    @property
    def height(self) -> int:
        """Of the image, in pixels."""
        return self.tracer.height

    @property
    def width(self) -> int:
        """Of the image, in pixels."""
        return self.tracer.width

    @property
    def scene(self) -> Any:
        """The Mitsuba scene, as it is now."""
        return self.tracer.mi_scene

    @property
    def depth(self) -> int:
        """Longest light path, in edges."""
        return self.tracer.scene.depth

    def rays(self, x: Any, y: Any) -> Any:
        """The camera's rays through places on the film (mi.Float)."""
        return self.tracer.rays(x, y)

    def numbers(self, pixels: Any, samples: Any) -> Any:
        """A sampler for lanes of pixels and samples (mi.UInt32)."""
        return self.tracer.make_sampler(pixels, samples, self.stream)

    def motion(self) -> tuple[Any, Any]:
        """Of every pixel: pixels to where the same was one frame earlier, x and y."""
        import mitsuba as mi

        if self._motion is None or self._motion[0] != self.tracer.time:
            found = np.zeros((self.height, self.width, 2), np.float32)
            if not self.tracer.scene.static:
                found = render_gbuffer(self.tracer, ("motion",))["motion"]
            x, y = (load.upload(mi.Float, found[..., axis]) for axis in range(2))
            self._motion = self.tracer.time, x, y
        return self._motion[1:]
