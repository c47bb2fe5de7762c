"""What a method's functions must take and return, and how to correct each wrong return.

Without CheckedReturns, the page that runs a method (rlbench.run) stops where it first uses what was
returned, with an error that names no line of the method.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.errors import PluginError
from rlbench.frames import GBuffer, Samples
from rlbench.method import Method, State
from rlbench.registry.failure import point_at
from rlbench.wrappers import MethodWrapper

ARGUMENTS = {
    "build": ("variant", "device", "weights"),
    "start": ("size",),
    "plan": ("gbuffer", "samples", "state"),
    "denoise": ("gbuffer", "samples", "state"),
}
PAIR = "end `denoise` with `return image, state`, where state is None if nothing is remembered"
TO_TENSOR = "return a torch.Tensor, such as torch.from_numpy({}).to(samples.mean.device)"
DENSITY = (
    "return values >= 0 of shape [n 1 h w] from `plan`, such as "
    "torch.ones_like(samples.mean[:, :1]); their scale does not matter"
)


class Fault(NamedTuple):
    """What is wrong, and what to do about it."""

    found: str
    remedy: str


class WrongReturnError(PluginError):
    """A method that returned what no benchmark can use."""

    def __init__(self, found: str, remedy: str) -> None:
        """What was returned, and what to return instead, as in a Fault."""
        super().__init__(found, remedy)
        self.fault = Fault(found, remedy)

    def __str__(self) -> str:
        """Both in one line."""
        return "; ".join(self.fault)


@dataclass(frozen=True)
class CheckedReturns(MethodWrapper[Method]):
    """The wrapped method; types and shapes of its returns are checked, in a microsecond a frame.

    Values are not: a density is checked where samples are drawn, an image where it is scored.
    Raises WrongReturnError, which names the first line of the function.
    """

    def plan(self, gbuffer: GBuffer, samples: Samples, state: State) -> Float[Tensor, "n 1 h w"]:
        """The wrapped method's density, a tensor of a number per pixel."""
        density = super().plan(gbuffer, samples, state)
        if not isinstance(density, Tensor) or density.shape != samples.counts.shape:
            raise self._error("plan", find_density_fault(density, samples.counts.shape))
        return density

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: State
    ) -> tuple[Float[Tensor, "n 3 h w"], State]:
        """The wrapped method's image, a tensor of the size of the frame, and the next state."""
        returned = super().denoise(gbuffer, samples, state)
        n, _, c, h, w = samples.radiance.shape
        if fault := find_return_fault(returned, n):
            raise self._error("denoise", fault)
        image, state = returned
        if image.shape != (n, c, h, w):
            found = f"denoise must return an image [{n} {c} {h} {w}], found {describe_value(image)}"
            fault = Fault(found, "support any size: pad and crop as in rlbench.ops (pad, crop)")
            raise self._error("denoise", fault)
        return image, state

    def _error(self, name: str, fault: Fault | None) -> WrongReturnError:
        assert fault is not None  # the caller has found it too
        error = WrongReturnError(*fault)
        point_at(error, getattr(self.method, name))
        return error


def find_signature_fault(function: Callable[..., Any], name: str) -> Fault | None:
    """The fault of a function that cannot be called with its arguments, or None."""
    arguments = ARGUMENTS[name]
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # not written in Python, or no function: calling it says more
        return None
    try:
        signature.bind(*arguments)
    except TypeError:
        takes = ", ".join(arguments)
        itself = "" if name == "build" else "self, "
        return Fault(
            f"{name} must take ({takes}), found {name}{signature}",
            f"define `def {name}({itself}{takes})`",
        )
    return None


def find_return_fault(returned: Any, clips: int) -> Fault | None:
    """The fault of what `denoise` returned for a batch of `clips`, or None.

    Height, width and dtype of the image are left to the checks of sizes and of images.
    """
    if not (isinstance(returned, tuple) and len(returned) == 2):
        return Fault(f"denoise must return (image, state), found {describe_value(returned)}", PAIR)
    image, _ = returned
    expected = f"denoise must return an image [{clips} 3 h w] as a torch.Tensor"
    found = f"{expected}, found {describe_value(image)}"
    if not isinstance(image, Tensor):
        is_array = type(image).__module__ == "numpy"
        return Fault(found, TO_TENSOR.format("image") if is_array else PAIR)
    if image.ndim == 4 and image.shape[:2] == (clips, 3):
        return None
    if image.ndim == 3:
        return Fault(
            found, "keep the first dimension, which counts the clips of a batch: image[None]"
        )
    if image.ndim == 4 and image.shape[-1] == 3:
        return Fault(found, "put the channels before height and width: image.permute(0, 3, 1, 2)")
    return Fault(found, "return red, green and blue of each pixel, as in samples.mean")


def find_density_fault(density: Any, shape: tuple[int, ...]) -> Fault | None:
    """The fault of what `plan` returned for images of this shape [n 1 h w], or None."""
    expected = f"plan must return a density {_join(shape)} as a torch.Tensor"
    found = f"{expected}, found {describe_value(density)}"
    if not isinstance(density, Tensor):
        is_array = type(density).__module__ == "numpy"
        return Fault(found, TO_TENSOR.format("density") if is_array else DENSITY)
    if density.shape != shape:
        is_colour = density.ndim == 4 and density.shape[1] == 3
        one = "return one value per pixel: density.mean(1, keepdim=True)"
        return Fault(found, one if is_colour else DENSITY)
    if density.is_complex():
        return Fault(found, DENSITY)
    if invalid := int((~torch.isfinite(density)).sum()):
        return Fault(
            f"plan must return finite values, found {invalid} that are NaN or infinite",
            "clamp divisors in `plan`, e.g. x / y.clamp_min(1e-6)",
        )
    if (density < 0).any():
        return Fault(
            f"plan must return values >= 0, found {float(density.min()):g}",
            "end `plan` with .clamp_min(0)",
        )
    return None


def describe_value(value: Any) -> str:
    """The type of a value, with shape and dtype of an array, and the types in a tuple.

    >>> describe_value(torch.zeros(1, 3, 4, 5))
    'a Tensor [1 3 4 5] of torch.float32'
    >>> describe_value((torch.zeros(2), None, 3))
    'a tuple of 3 (a Tensor [2] of torch.float32, None, an int)'
    """
    if value is None:
        return "None"
    kind = type(value).__name__
    article = "an" if kind[0].lower() in "aeiou" else "a"
    if isinstance(value, tuple):
        return f"{article} {kind} of {len(value)} ({', '.join(map(describe_value, value))})"
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{article} {type(value).__name__} {_join(value.shape)} of {value.dtype}"
    return f"{article} {kind}"


def _join(shape: Any) -> str:
    return f"[{' '.join(map(str, shape))}]"
