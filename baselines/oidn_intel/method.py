"""Intel's library through pyoidn: one frame from the mean of the samples, albedo and normal."""

from __future__ import annotations

import ctypes
import weakref
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.oidn.sparse import FilledHoles
from baselines.oidn_intel import FAMILY, TRAITS
from rlbench.errors import RlbenchError
from rlbench.family import Traits
from rlbench.frames import GBuffer, Samples, Size
from rlbench.ops.fireflies import mean_without_fireflies

CPU = torch.device("cpu")
IMAGES = ("color", "albedo", "normal", "output")


class LibraryError(RlbenchError, RuntimeError):
    """An error that Open Image Denoise reports, or a missing part of it."""


@dataclass(frozen=True)
class FilterSettings:
    """Settings of the library's ray-tracing filter for HDR colour with albedo and normal."""

    quality: str = "high"  # high, balanced, fast
    clean_aux: bool = False  # OIDN's cleanAux: albedo and normal are free of noise
    weights: bytes = b""  # a TZA file that replaces Intel's weights


class Filter:
    """The library's filter for images of one size, on a number of CPU threads or on a GPU.

    Not thread-safe: it holds the image buffers that the library reads and writes.
    """

    def __init__(
        self, settings: FilterSettings, h: int, w: int, threads: int, device: torch.device = CPU
    ) -> None:
        """Build the library's network. Raises LibraryError, e.g. for weights that are not a TZA.

        On a CUDA device the images lie in its memory, and PyTorch's current stream runs the filter.
        """
        import pyoidn  # an optional dependency that listing methods does not need

        with torch.inference_mode(False):  # else they could not be overwritten outside of it
            self._images = {name: torch.zeros(h, w, 3, device=device) for name in IMAGES}
        self._weights = settings.weights  # the library does not copy them
        self._device = pyoidn.Device.from_torch(device)
        weakref.finalize(self, self._device.release)
        if device.type == "cpu":
            self._device.set_int("numThreads", threads)
            self._device.set_bool("setAffinity", False)  # torch does not pin threads either
        self._device.commit()
        self._check()

        self._filter = pyoidn.Filter(self._device, pyoidn.OIDN_FILTER_TYPE_RT)
        weakref.finalize(self, self._filter.release)
        for name, image in self._images.items():
            self._filter.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
        self._filter.set_bool("hdr", True)
        self._filter.set_bool("cleanAux", settings.clean_aux)
        self._filter.set_quality(getattr(pyoidn, f"OIDN_QUALITY_{settings.quality.upper()}"))
        if self._weights:
            _set_weights(self._filter, self._weights)
        self._filter.commit()
        self._check()

    def __call__(
        self,
        colour: Float[Tensor, "3 h w"],
        albedo: Float[Tensor, "3 h w"],
        normal: Float[Tensor, "3 h w"],
    ) -> Float[Tensor, "3 h w"]:
        """The denoised image, linear radiance, on the device of `colour`.

        `colour` is linear radiance, albedo in [0, 1], normals in [-1, 1]. The library estimates the
        exposure itself. Tensors on another device are copied to that of the filter and back.
        """
        for name, image in zip(IMAGES, (colour, albedo, normal), strict=False):
            self._images[name].copy_(image.movedim(0, 2))
        self._filter.execute()
        self._check()
        output = self._images["output"]
        return output.movedim(2, 0).to(colour.device, copy=True).contiguous()

    def _check(self) -> None:
        if message := self._device.get_error():
            raise LibraryError(f"Open Image Denoise: {message}")


def filter_device(device: torch.device) -> torch.device:
    """The device on which the library denoises tensors of `device`: it, or the CPU."""
    import pyoidn

    is_supported = device.type == "cuda" and pyoidn.Device.is_cuda_available(device.index or 0)
    return device if is_supported else CPU


def library_version() -> str:
    """Version of the library inside pyoidn, for example "2.5.1"."""
    import pyoidn

    with pyoidn.Device(pyoidn.OIDN_DEVICE_TYPE_CPU) as device:
        return ".".join(
            str(device.get_int(f"version{part}")) for part in ("Major", "Minor", "Patch")
        )


def _set_weights(filter_: Any, weights: bytes) -> None:
    """Set the filter's data "weights", for which pyoidn has no function; the bytes are shared."""
    from pyoidn import capi

    folder = Path(capi.__file__).parent / "oidn"
    name = capi.wrap_dylib("OpenImageDenoise")
    (path,) = (p for p in (folder / "lib" / name, folder / "bin" / name) if p.exists())
    set_data = ctypes.CDLL(str(path)).oidnSetSharedFilterData  # the library that pyoidn loaded
    set_data.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p, ctypes.c_size_t)
    set_data.restype = None
    handle = int(capi.oidn_ffi.cast("uintptr_t", filter_._filter))
    set_data(handle, b"weights", weights, len(weights))


get_filter = lru_cache(maxsize=4)(Filter)  # building a filter takes as long as running it


@dataclass(frozen=True)
class Config:
    """What distinguishes the variants."""

    quality: str = "high"  # the library's default
    clean_aux: bool = False  # OIDN's cleanAux: albedo and normal are free of noise
    fills_holes: bool = False  # light of the neighbourhood where no sample is
    library_version: str = ""  # its version, which the results record


BASE = Config()
VARIANTS = {
    "": BASE,
    "balanced": replace(BASE, quality="balanced"),  # does it cost accuracy?
    "fast": replace(BASE, quality="fast"),  # does a smaller network cost accuracy?
    "filled": replace(BASE, fills_holes=True),  # does it work below 1 spp?
    "clean": replace(BASE, clean_aux=True),  # does declaring clean features help?
}


@dataclass(frozen=True)
class OidnIntel:
    """Open Image Denoise (Afra 2019): Intel's library, its ray-tracing filter and its weights.

    HDR colour with albedo and normal; uniform sampling, frames are independent. It runs on the CPU
    with as many threads as torch, or on the GPU of the tensors, where the library computes in half
    precision (never run: no GPU was at hand). Where it does not support a GPU, tensors are copied
    to the CPU and back. Differs from `baselines.oidn`: the library pads images with zeros to a
    multiple of 16, and processes large images in overlapping tiles. Fireflies are limited before
    the library sees them (rlbench.ops.limit_fireflies).
    """

    config: Config
    traits: Traits = TRAITS

    def start(self, size: Size) -> None:
        """No state: frames are independent."""

    def plan(self, gbuffer: GBuffer, samples: Samples, state: None) -> Float[Tensor, "n 1 h w"]:
        """Uniform density."""
        return torch.ones_like(gbuffer.albedo[:, :1])

    def denoise(
        self, gbuffer: GBuffer, samples: Samples, state: None
    ) -> tuple[Float[Tensor, "n 3 h w"], None]:
        """The image in linear radiance; the clips of a batch one after another."""
        noisy = mean_without_fireflies(samples.radiance, samples.counts)
        settings = FilterSettings(self.config.quality, self.config.clean_aux)
        threads, device = torch.get_num_threads(), filter_device(noisy.device)
        run_filter = get_filter(settings, *noisy.shape[-2:], threads, device)
        inputs = zip(noisy, gbuffer.albedo.clamp(0, 1), gbuffer.normal.clamp(-1, 1), strict=True)
        return torch.stack([run_filter(*clip_inputs) for clip_inputs in inputs]), None


def build(variant: str, device: torch.device, weights: str | None) -> OidnIntel | FilledHoles:
    """The library with the settings of `variant` and its own weights."""
    method = OidnIntel(replace(VARIANTS[variant], library_version=library_version()))
    if method.config.fills_holes:
        return FilledHoles(method, FAMILY.variants[variant].traits)
    return method
