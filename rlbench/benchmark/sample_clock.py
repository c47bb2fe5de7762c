"""What times a sample on this machine: the path tracer of an installed app, or nothing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from rlbench.errors import RlbenchError
from rlbench.registry import apps

if TYPE_CHECKING:
    from jaxtyping import Int
    from torch import Tensor


class NoClockError(RlbenchError, LookupError):
    """No installed app times samples on this machine."""


class SampleClock(Protocol):
    """Times samples by a path tracer; `App.clock` names what makes one, without arguments."""

    MODULES: tuple[str, ...]  # whose code decides the times

    def describe(self) -> str:
        """The tracer and its threads, on which its times depend."""

    def describe_code(self, scene: str) -> str:
        """Hash of the code of the tracer and of an installed scene."""

    def measure_sample_ms(self, scene: str, height: int, width: int, pool: str) -> float:
        """Milliseconds of one sample per pixel of a pool, in an installed scene."""

    def measure_again(self, folder: Path) -> None:
        """Measure the time of a sample of a clip, and write it into its header.

        Raises RlbenchError for a clip of another machine or of a scene that is not here.
        """

    def check_scene(self, folder: Path) -> None:
        """Raise an error if the scene of a clip is not here, as the clip was rendered from it."""

    def open_scene(self, folder: Path) -> None:
        """Open the scene of a clip in place of the one before. Raises errors as `check_scene`."""

    def measure_scatter(self, folder: Path, counts: Int[Tensor, "1 1 h w"]) -> float:
        """Time of a sample at these counts over that of a sample of a full frame at 1 spp.

        The clip's scene is the open one, or is opened. Raises an error where no pixel has a sample.
        """


def clock_modules() -> tuple[str, ...]:
    """The modules whose code decides the times of the clock of this machine; empty without one."""
    return next((maker.MODULES for maker in apps.load_parts("clock")), ())


def open_clock() -> SampleClock:
    """The clock of this machine. Raises NoClockError where no app has one."""
    makers = apps.load_parts("clock")
    if not makers:
        raise NoClockError("no installed app times samples here")
    clock: SampleClock = makers[0]()
    return clock
