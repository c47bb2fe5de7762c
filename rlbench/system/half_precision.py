"""The half precision of a device, float16 or bfloat16, and whether bfloat16 is emulated there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rlbench.errors import OptionError

if TYPE_CHECKING:
    import torch

X86_FLAGS = ("avx512_bf16", "amx_bf16")  # either suffices; names of torch.cpu.get_capabilities
ARM_FLAGS = ("bf16", "sve_bf16")


def half_dtype(device: torch.device | str) -> torch.dtype:
    """The dtype in which networks run in half precision on this device.

    float16 keeps 11 bits of a value, bfloat16 8, so images in float16 are closer to those in
    float32 (docs/how-to/use-half-precision.md). Every GPU that PyTorch supports has float16; few
    processors have instructions for it, so a processor computes in bfloat16.
    """
    import torch

    return torch.float16 if torch.device(device).type == "cuda" else torch.bfloat16


def emulation_reason(device: torch.device | str) -> str:
    """Why bfloat16 on this device would be emulated, or an empty string where it is native.

    A processor needs AVX512-BF16, AMX-BF16 or the BF16 extension of ARM, a CUDA device compute
    capability 8.0. Devices of other kinds pass.
    """
    import torch

    device = torch.device(device)
    if device.type == "cpu":
        return _processor_reason()
    if device.type == "cuda":
        return _cuda_reason(device)
    return ""


def require_half(device: torch.device | str) -> None:
    """Raise OptionError where half precision would be emulated on this device."""
    import torch

    if half_dtype(device) == torch.bfloat16 and (reason := emulation_reason(device)):
        raise OptionError(
            f"--half on device {device}: {reason}, which is slower than float32. Run without "
            "--half, or on a processor with AVX512-BF16, AMX-BF16 or ARM BF16, or on a CUDA device"
        )


def describe_half(device: torch.device | str) -> str:
    """What a device can do in half precision, in words."""
    import torch

    reason = emulation_reason(device)
    if half_dtype(device) == torch.float16:
        return f"--half runs in float16; train --bf16: {reason or 'native bfloat16'}"
    if reason:
        return f"{reason}; --half is refused"
    by = f" by {', '.join(_processor_flags())}" if str(device) == "cpu" else ""
    return f"native bfloat16{by}; --half can be used"


def _processor_flags() -> list[str]:
    """The bfloat16 instructions of this processor.

    `torch.ops.mkldnn._is_mkldnn_bf16_supported` does not answer this: it is also true where oneDNN
    emulates bfloat16 with AVX-512.
    """
    import torch

    capabilities = torch.cpu.get_capabilities()
    is_x86 = "x86" in str(capabilities.get("architecture"))
    return [flag for flag in (X86_FLAGS if is_x86 else ARM_FLAGS) if capabilities.get(flag)]


def _processor_reason() -> str:
    if _processor_flags():
        return ""
    return "the processor has no bfloat16 instructions and would emulate bfloat16"


def _cuda_reason(device: torch.device) -> str:
    import torch

    with torch.cuda.device(device):
        if torch.cuda.is_bf16_supported(including_emulation=False):
            return ""
    major, minor = torch.cuda.get_device_capability(device)
    name = torch.cuda.get_device_name(device)
    return f"{name} has compute capability {major}.{minor} and would emulate bfloat16"
