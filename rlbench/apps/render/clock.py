"""The clock of this machine: what a sample costs by the path tracer that is used here."""

from __future__ import annotations

from pathlib import Path

from jaxtyping import Int
from torch import Tensor

from rlbench import registry
from rlbench.apps.render.jobs.extra_pools import pool_sample_ms
from rlbench.apps.render.jobs.live_pool import open_wavefronts, scatter_factor, scene_of_folder
from rlbench.apps.render.jobs.render_clips import remeasure_sample_ms
from rlbench.apps.render.mitsuba.open_tracer import describe_tracer, sample_ms
from rlbench.apps.render.mitsuba.tracer import Tracer
from rlbench.system import code_hash


class TracerClock:
    """A `rlbench.benchmark.sample_clock.SampleClock`; one scene is open at a time."""

    MODULES = ("rlbench.apps.render.jobs.live_pool", "rlbench.apps.render.mitsuba.tracer")

    def __init__(self) -> None:
        """Open no scene yet."""
        self._open: tuple[Path, Tracer] | None = None

    def describe(self) -> str:
        """Variant and threads of the tracer."""
        return describe_tracer()

    def describe_code(self, scene: str) -> str:
        """Hash of the code of a scene and of the tracer."""
        target = registry.list_entries("scenes")[scene].target.partition(":")[0]
        return code_hash.code_hash(code_hash.import_closure(target), core=["rlbench.apps.render"])

    def measure_sample_ms(self, scene: str, height: int, width: int, pool: str) -> float:
        """Milliseconds of one sample per pixel of a pool, in an installed scene."""
        size = registry.load_plugin("scenes", scene)(), height, width
        return float(sample_ms(*size) if pool == "path" else pool_sample_ms(*size, pool))

    def measure_again(self, folder: Path) -> None:
        """Measure the time of a sample of a clip, and write it into its header."""
        remeasure_sample_ms(folder)

    def check_scene(self, folder: Path) -> None:
        """Raise ClipError or LookupError if the scene is not here, as the clip was rendered."""
        scene_of_folder(folder)

    def open_scene(self, folder: Path) -> None:
        """Open the scene of a clip, unless it is open. Raises errors as `open_wavefronts`."""
        self._open_tracer(folder)

    def measure_scatter(self, folder: Path, counts: Int[Tensor, "1 1 h w"]) -> float:
        """Time of a sample at these counts over that of a full frame; see `scatter_factor`."""
        return scatter_factor(self._open_tracer(folder), counts)

    def _open_tracer(self, folder: Path) -> Tracer:
        if self._open is None or self._open[0] != folder:
            self._open = None  # closes the scene before the next one is opened
            self._open = folder, open_wavefronts(folder)
        return self._open[1]
