"""TZA files: Intel's library reads ours, we read Intel's, and both give the same image."""

from __future__ import annotations

import struct
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from baselines.oidn import method, tza
from baselines.oidn.method import INPUT_CHANNELS, VARIANTS, Oidn, build
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Samples, Size
from rlbench.ops.unet import UNet
from rlbench.run import FrameResult, run_clip
from rlbench.weights import load_into, read_card

CPU = torch.device("cpu")
CARDS = sorted((Path(tza.__file__).parent / "cards").glob("*.safetensors"))
SHIPPED = Path(tza.__file__).parent / "cards" / "oidn.safetensors"
PARAMETERS = {"": 919_811, "fast": 320_035}
UNPADDED = Size(1, 64, 96)  # multiples of 16 need no padding
CPU_INFO = Path("/proc/cpuinfo")

# both in float32, sums in another order; the transfer function maps up to 16 nats to [0, 1]
CLOSE = {"rtol": 1e-4, "atol": 1e-5}

cards = pytest.mark.parametrize("weights", CARDS, ids=lambda path: path.stem)
float32_library = pytest.mark.skipif(
    CPU_INFO.exists() and "amx_fp16" in CPU_INFO.read_text(),
    reason="on a processor with AMX-FP16 the library computes in half precision",
)


@cache
def noisy(size: Size = UNPADDED) -> InMemoryClip:
    return procedural_clip(3, size, frames=1)


def run_ours(method: Oidn, size: Size = UNPADDED) -> FrameResult:
    (result,) = run_clip(method, noisy(size), 2.0)
    assert result.image.std() > 0.1  # not a constant image
    return result


def run_intel(result: FrameResult, quality: str = "high", weights: bytes = b"") -> torch.Tensor:
    """The image of Intel's library for the same mean, albedo and normal."""
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.method import Filter, FilterSettings

    _, _, h, w = result.image.shape
    run_filter = Filter(FilterSettings(quality, weights=weights), h, w, threads=1)
    gbuffer = result.frame.gbuffer
    return run_filter(result.samples.mean[0], gbuffer.albedo[0], gbuffer.normal[0]).unsqueeze(0)


def variant_of(weights: Path) -> str:
    return read_card(weights).name.partition("/")[2]


def count_weights(tensors: dict[str, np.ndarray]) -> int:
    return sum(tensor.size for tensor in tensors.values())


@cards
@pytest.mark.parametrize("quality", ["high", "balanced", "fast"])
@float32_library
def test_intels_library_with_weights_of_a_row_gives_the_image_of_that_row(weights, quality):
    result = run_ours(build(variant_of(weights), CPU, None))
    image = run_intel(result, quality, tza.export(weights))
    torch.testing.assert_close(image, result.image, **CLOSE)


@pytest.mark.parametrize("gain", [1e-6, 1.0, 1e3])
@float32_library
def test_black_tiles_and_bright_emitters_get_intels_exposure(gain):
    """Black tiles do not count in the exposure; an emitter is in the logarithmic range."""
    radiance = noisy().frames[0].pool.radiance[:, :2] * gain
    radiance[..., :33, :40] = 0
    radiance[..., 40:44, 60:64] = 60 * gain
    (frame,) = noisy().frames
    samples = Samples(radiance, torch.full((1, 1, UNPADDED.h, UNPADDED.w), 2))
    image, _ = build("", CPU, None).denoise(frame.gbuffer, samples, None)
    assert image.max() > 20 * gain
    intel_image = run_intel(FrameResult(frame, samples, image, {}), "high", tza.export(SHIPPED))
    torch.testing.assert_close(intel_image / gain, image / gain, **CLOSE)


@float32_library
def test_at_odd_sizes_only_the_padding_differs(monkeypatch):
    """Intel's library pads with zeros where we repeat the border."""
    oidn, odd = build("", CPU, None), Size(1, 45, 70)
    result = run_ours(oidn, odd)
    intel_image = run_intel(result, "high", tza.export(SHIPPED))
    assert not torch.allclose(intel_image, result.image, **CLOSE)

    def pad_with_zeros(image: torch.Tensor, multiple: int) -> torch.Tensor:
        h, w = image.shape[-2:]
        return F.pad(image, (0, -w % multiple, 0, -h % multiple))

    monkeypatch.setattr(method, "pad", pad_with_zeros)
    torch.testing.assert_close(intel_image, run_ours(oidn, odd).image, **CLOSE)


@cards
def test_decoding_returns_the_encoded_tensors_bit_for_bit(weights):
    network = UNet(INPUT_CHANNELS, widths=VARIANTS[variant_of(weights)].widths)
    load_into(network, weights)
    decoded = tza.decode(tza.export(weights))
    assert list(decoded) == list(network.state_dict())
    for name, tensor in network.half().state_dict().items():
        assert decoded[name].dtype == np.float16
        assert decoded[name].tobytes() == tensor.numpy().tobytes()


def test_the_file_has_the_length_of_intels_file():
    assert len(tza.export(SHIPPED)) == 1_841_160  # rt_hdr_alb_nrm.tza of oidn-weights


def test_the_bytes_follow_the_format():
    content = tza.encode({"a": np.array([1, 2], np.float16)})
    header = bytes.fromhex("d741 0200 8000000000000000") + bytes(52)
    values = bytes.fromhex("003c 0040") + bytes(60)
    table = bytes.fromhex("01000000 0100 61 01 02000000 78 68 4000000000000000")
    assert content == header + values + table


@pytest.mark.parametrize("tensor", [np.zeros(3, "f4"), np.zeros((2, 2), "f2"), np.zeros(3, int)])
def test_unsupported_shapes_and_types_are_rejected(tensor):
    with pytest.raises(tza.TzaError, match="'odd' is"):
        tza.encode({"odd": tensor})


@pytest.mark.parametrize(
    ("damage", "found"),
    [
        *((lambda content, end=end: content[:end], ".") for end in (0, 11, 64, 90, 131, 149)),
        (lambda content: content[:-8] + struct.pack("<Q", 10**6), "ends at byte 1000004"),
        (lambda content: content.replace(b"xh", b"xf"), "type b'f'"),
        (lambda content: b"PK\x03\x04" + content, "begins with 50 4b 03 04"),
    ],
)
def test_truncated_and_other_content_is_rejected(damage, found):
    content = tza.encode({"a": np.array([1, 2], np.float16)})
    with pytest.raises(tza.TzaError, match=found):
        tza.decode(damage(content))


def test_the_command_writes_the_file(tmp_path):
    tza.main([str(tmp_path / "tuned.tza")])
    assert count_weights(tza.decode((tmp_path / "tuned.tza").read_bytes())) == PARAMETERS[""]


def test_the_command_reports_a_missing_weights_file(tmp_path, capsys):
    with pytest.raises(SystemExit):
        tza.main([str(tmp_path / "x.tza"), "--weights", str(tmp_path / "none.safetensors")])
    assert "none.safetensors is missing" in capsys.readouterr().err
