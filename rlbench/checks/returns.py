"""What a method's functions must take and return, and how to correct each wrong return."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from rlbench.errors import PluginError

__all__ = [
    "Fault",
    "WrongReturnError",
    "describe_value",
    "find_density_fault",
    "find_return_fault",
    "find_signature_fault",
]

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
