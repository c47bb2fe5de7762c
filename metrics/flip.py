"""FLIP and HDR-FLIP, by NVIDIA's package `flip-evaluator`, in a child process with a time limit.

The package ends the process where it cannot score an image, for example HDR-FLIP of a black
reference, so it runs in a child that is started again. The child imports neither torch nor this
process's main module.
"""

from __future__ import annotations

import atexit
import math
import os
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Literal

from metrics.metric import Comparison, Metric

__all__ = ["FLIP", "HDR_FLIP", "PIXELS_PER_DEGREE", "FlipError", "FlipProcess", "FlipRefusedError"]

Tensor = Any  # torch.Tensor
Array = Any  # numpy.ndarray
Range = Literal["LDR", "HDR"]

# 0.7 m from a display of 3840 pixels on 0.7 m, the viewing conditions of the paper
PIXELS_PER_DEGREE = 0.7 * 3840 / 0.7 * math.pi / 180
TIME_LIMIT_S = 120.0  # of one image; a 4K pair takes some seconds
REFUSED = 255  # exit code of the child where the package calls exit(-1)
HALF_MAX = 65504.0  # largest half float, the brightest value in a clip's EXR files


class FlipError(RuntimeError):
    """The package raised an error, or the child process crashed or took too long."""


class FlipRefusedError(FlipError):
    """The package ended the child process, because it cannot score this pair of images."""


@dataclass
class FlipProcess:
    """A child process that scores pairs of images; it is started when it is first needed."""

    time_limit_s: float = TIME_LIMIT_S
    _child: subprocess.Popen[bytes] | None = None
    _pipe: Connection | None = None

    def mean_error(self, reference: Array, image: Array, dynamic_range: Range) -> float:
        """Mean FLIP error of [h w 3] float32 images. Raises FlipError, and its FlipRefusedError."""
        what = f"{dynamic_range} images of {image.shape[1]}x{image.shape[0]} pixels"
        pipe = self._pipe or self._start()
        try:
            pipe.send((reference, image, dynamic_range))
            if pipe.poll(self.time_limit_s):
                answer = pipe.recv()
                if isinstance(answer, str):
                    raise FlipError(f"flip-evaluator failed on {what}: {answer}")
                return float(answer)
        except (EOFError, ConnectionError) as error:
            code = self._child.wait() if self._child else None
            self.stop()
            if code == REFUSED:
                raise FlipRefusedError(
                    f"flip-evaluator refused {what}: exit code {code}"
                ) from error
            raise FlipError(f"flip-evaluator crashed on {what}: exit code {code}") from error
        except BaseException:
            self.stop()
            raise
        self.stop()
        raise FlipError(f"flip-evaluator took more than {self.time_limit_s:g} s for {what}")

    def stop(self) -> None:
        """End the child process, if it runs."""
        if self._child:
            self._child.kill()
            self._child.wait()
        if self._pipe:
            self._pipe.close()
        self._child = self._pipe = None

    def _start(self) -> Connection:
        pipe, far_end = Pipe()
        serve = "import sys; from metrics.flip import serve; serve(int(sys.argv[1]))"
        with far_end:  # the child has a copy; when that is closed, `recv` is an EOFError
            command = [sys.executable, "-c", serve, str(far_end.fileno())]
            environment = {**os.environ, "OMP_WAIT_POLICY": "passive"}  # leaves cores to others
            self._child = subprocess.Popen(
                command,
                env=environment,
                pass_fds=[far_end.fileno()],
                stdout=subprocess.DEVNULL,
            )
        self._pipe = pipe
        return pipe


def serve(descriptor: int) -> None:
    """Score the pairs that arrive at a pipe until it is closed: the child's main function."""
    import flip_evaluator

    pipe = Connection(descriptor)
    while True:
        try:
            reference, image, dynamic_range = pipe.recv()
        except (EOFError, KeyboardInterrupt):
            return
        parameters = {"ppd": PIXELS_PER_DEGREE}
        try:
            scored = flip_evaluator.evaluate(
                reference, image, dynamic_range, applyMagma=False, parameters=parameters
            )
        except Exception as error:  # the text is raised where the score was asked for
            pipe.send(f"{type(error).__name__}: {error}")
        else:
            pipe.send(scored[1])


@cache
def _shared_process() -> FlipProcess:
    process = FlipProcess()
    atexit.register(process.stop)
    return process


def flip(comparison: Comparison) -> Tensor:
    """Mean FLIP error of clipped sRGB, [n] in [0, 1]; lower is better, 0 for equal images.

    Andersson et al. 2020, FLIP: A Difference Evaluator for Alternating Images. The colour error of
    two images filtered by the eye's contrast sensitivity, raised where edges and points differ.

    >>> import torch
    >>> reference = torch.rand(1, 3, 16, 16)
    >>> flip(Comparison.of(reference, reference, reference))
    tensor([0.])

    Raises FlipError.
    """
    return _score(comparison.display_image, comparison.display_reference, "LDR")


def hdr_flip(comparison: Comparison) -> Tensor:
    """Mean HDR-FLIP error of linear radiance, [n] in [0, 1]; lower is better, 0 for equal images.

    Andersson et al. 2021, Visualizing Errors in Rendered High Dynamic Range Images: the largest
    FLIP error of each pixel over exposures from the reference's brightest to its median luminance.
    NaN where the package finds no exposures, as of a black reference. Negative radiance counts as
    0. A pixel that is not finite has the largest error: black or the largest half float, whichever
    is further from the reference on the display.

    Raises FlipError.
    """
    references = comparison.reference.clamp(0, HALF_MAX)
    worst = (comparison.display_reference < 0.5).to(references.dtype) * HALF_MAX
    images = comparison.image.clamp(0, HALF_MAX).where(~comparison.nonfinite_mask, worst)
    return _score(images, references, "HDR")


def _score(images: Tensor, references: Tensor, dynamic_range: Range) -> Tensor:
    """Mean errors [n] of [n 3 h w] images; NaN for a pair that the package refuses."""
    errors = []
    for pair in zip(_arrays(references), _arrays(images), strict=True):
        try:
            errors.append(_shared_process().mean_error(*pair, dynamic_range))
        except FlipRefusedError:
            errors.append(math.nan)
    return images.new_tensor(errors)


def _arrays(images: Tensor) -> list[Array]:
    return list(images.movedim(1, -1).float().cpu().contiguous().numpy())


_VIEWING = (
    f"{PIXELS_PER_DEGREE:.2f} pixels per degree (0.7 m from 3840 pixels on 0.7 m), mean over pixels"
)
FLIP = Metric(
    name="flip",
    unit="",
    direction="lower",
    convention=f"FLIP of clipped sRGB in float; {_VIEWING}",
    score=flip,
    source="Andersson et al. 2020",
    requires=("flip-evaluator",),
    scored_by_run=False,
)
HDR_FLIP = Metric(
    name="hdr_flip",
    unit="",
    direction="lower",
    convention="HDR-FLIP of linear radiance, tone mapper ACES, exposures from the reference; "
    f"undefined for a black one; {_VIEWING}",
    score=hdr_flip,
    source="Andersson et al. 2021",
    requires=("flip-evaluator",),
    scored_by_run=False,
)
