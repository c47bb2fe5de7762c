"""Whether a device computes in bfloat16 by instructions of its own, or emulates it at a loss."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rlbench.errors import OptionError

if TYPE_CHECKING:
    import torch

X86_FLAGS = ("avx512_bf16", "amx_bf16")  # either suffices; names of torch.cpu.get_capabilities
ARM_FLAGS = ("bf16", "sve_bf16")


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


def require_native_bf16(device: torch.device | str) -> None:
    """Raise OptionError where bfloat16 would be emulated on this device."""
    if reason := emulation_reason(device):
        raise OptionError(
            f"--bf16 on device {device}: {reason}, which is slower than float32. Run without "
            "--bf16, or on a processor with AVX512-BF16, AMX-BF16 or ARM BF16, or on a CUDA device "
            "of compute capability 8.0 or above"
        )


def describe_bf16(device: torch.device | str) -> str:
    """What a device can do in bfloat16, in words."""
    if reason := emulation_reason(device):
        return f"{reason}; --bf16 is refused"
    by = f" by {', '.join(_processor_flags())}" if str(device) == "cpu" else ""
    return f"native{by}; --bf16 can be used"


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
