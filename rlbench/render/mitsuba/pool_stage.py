"""The scene of a tracer as the plugin of a sample pool sees it, moved from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rlbench.render.mitsuba import load
from rlbench.render.mitsuba.gbuffer import render_gbuffer
from rlbench.render.mitsuba.wavefront import WavefrontTracer

__all__ = ["PoolStage"]


@dataclass
class PoolStage:
    """A scene at the tracer's current time; implements `rlbench.pools.RenderContext`."""

    tracer: WavefrontTracer
    stream: str  # of random numbers
    _motion: tuple[float, Any, Any] | None = field(default=None, repr=False)

    @property
    def height(self) -> int:
        """Image height in pixels."""
        return self.tracer.height

    @property
    def width(self) -> int:
        """Image width in pixels."""
        return self.tracer.width

    @property
    def scene(self) -> Any:
        """The Mitsuba scene at the current time."""
        return self.tracer.mi_scene

    @property
    def max_depth(self) -> int:
        """Longest light path, in edges."""
        return self.tracer.scene.max_depth

    def camera_rays(self, x: Any, y: Any) -> Any:
        """The camera rays through film positions in pixels (mi.Float)."""
        return self.tracer.rays(x, y)

    def sampler(self, pixels: Any, samples: Any) -> Any:
        """A sampler whose lanes are pixels and samples (mi.UInt32)."""
        return self.tracer.make_sampler(pixels, samples, self.stream)

    def motion(self) -> tuple[Any, Any]:
        """Motion vectors x and y of every pixel (mi.Float): pixels to the previous position."""
        import mitsuba as mi

        if self._motion is None or self._motion[0] != self.tracer.time:
            motion = np.zeros((self.height, self.width, 2), np.float32)
            if not self.tracer.scene.static:
                motion = render_gbuffer(self.tracer, ("motion",))["motion"]
            x, y = (load.upload(mi.Float, motion[..., axis]) for axis in range(2))
            self._motion = self.tracer.time, x, y
        return self._motion[1:]
