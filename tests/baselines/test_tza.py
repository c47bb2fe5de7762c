"""TZA files: Intel reads ours, we read Intel's, and both give one image."""

from __future__ import annotations

import struct
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from baselines.oidn import method, tza
from baselines.oidn.method import INPUTS, VARIANTS, Oidn, build
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Samples, Size
from rlbench.ops.unet import UNet
from rlbench.run import FrameResult, run_clip
from rlbench.weights import load_into

CPU = torch.device("cpu")
CARDS = sorted((Path(tza.__file__).parent / "cards").glob("*.safetensors"))
SHIPPED = Path(tza.__file__).parent / "cards" / "oidn.safetensors"
PARAMETERS = {"": 919_811, "small": 320_035}
EVEN = Size(1, 64, 96)  # divides by 16: nothing is padded
INFO = Path("/proc/cpuinfo")

# both in float32, sums in another order; up to 16 nats between 0 and 1 of the transfer function
CLOSE = {"rtol": 1e-4, "atol": 1e-5}

cards = pytest.mark.parametrize("weights", CARDS, ids=lambda path: path.stem)
single = pytest.mark.skipif(
    INFO.exists() and "amx_fp16" in INFO.read_text(),
    reason="on a processor with AMX-FP16 the library computes in half precision",
)


@cache
def noisy(size: Size = EVEN) -> InMemoryClip:
    return procedural_clip(3, size, frames=1)


def ours(made: Oidn, size: Size = EVEN) -> FrameResult:
    (shown,) = run_clip(made, noisy(size), 2.0)
    assert shown.image.std() > 0.1  # there is something to compare
    return shown


def intels(shown: FrameResult, quality: str = "high", weights: bytes = b"") -> torch.Tensor:
    """What Intel's library makes of the same mean, albedo and normal."""
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.library import Filter, Settings

    _, _, h, w = shown.image.shape
    run = Filter(Settings(quality, weights=weights), h, w, threads=1)
    gbuffer = shown.frame.gbuffer
    return run(shown.samples.mean[0], gbuffer.albedo[0], gbuffer.normal[0]).unsqueeze(0)


def numbers(tensors: dict[str, np.ndarray]) -> int:
    return sum(tensor.size for tensor in tensors.values())


@cards
@pytest.mark.parametrize("quality", ["high", "balanced", "fast"])
@single
def test_intels_library_makes_of_our_weights_what_we_make_of_them(weights, quality):
    variant = weights.stem if weights.stem in VARIANTS else ""
    shown = ours(build(variant, CPU, None))
    image = intels(shown, quality, tza.export(weights))
    torch.testing.assert_close(image, shown.image, **CLOSE)


@pytest.mark.parametrize("gain", [1e-6, 1.0, 1e3])
@single
def test_black_tiles_and_glaring_lamps_are_exposed_as_intel_does(gain):
    """Black tiles say nothing of the exposure; a lamp lies where the transfer is logarithmic."""
    radiance = noisy().frames[0].pool.radiance[:, :2] * gain
    radiance[..., :33, :40] = 0
    radiance[..., 40:44, 60:64] = 60 * gain
    counts = torch.full((1, 1, EVEN.h, EVEN.w), 2)
    (frame,), samples = noisy().frames, Samples(radiance, counts)
    image, _ = build("", CPU, None).denoise(frame.gbuffer, samples, None)
    assert image.max() > 20 * gain
    found = intels(FrameResult(frame, samples, image), "high", tza.export(SHIPPED))
    torch.testing.assert_close(found / gain, image / gain, **CLOSE)


@single
def test_at_odd_sizes_the_border_is_the_only_difference(monkeypatch):
    """Intel's library sees zeros where we repeat the border."""
    made, odd = build("", CPU, None), Size(1, 45, 70)
    assert not torch.allclose(
        intels(ours(made, odd), "high", tza.export(SHIPPED)), ours(made, odd).image, **CLOSE
    )

    def zeros(image: torch.Tensor, to: int) -> torch.Tensor:
        h, w = image.shape[-2:]
        return F.pad(image, (0, -w % to, 0, -h % to))

    monkeypatch.setattr(method, "pad", zeros)
    shown = ours(made, odd)
    torch.testing.assert_close(intels(shown, "high", tza.export(SHIPPED)), shown.image, **CLOSE)


@pytest.mark.parametrize(("variant", "quality"), [("", "high"), ("small", "fast")])
@single
def test_our_network_with_intels_weights_shows_what_intels_library_shows(variant, quality):
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.networks import network

    shown = ours(Oidn(network(VARIANTS[variant].widths)))
    torch.testing.assert_close(intels(shown, quality), shown.image, **CLOSE)


def test_no_other_network_of_that_size_makes_the_librarys_image():
    """Of those that fit, the one that is taken is told by its image."""
    pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    from baselines.oidn_intel.networks import ALIKE, _difference, inside

    fitting = [held for held in inside() if numbers(held) == PARAMETERS[""]]
    made = UNet(INPUTS).eval().requires_grad_(False)
    found = []
    for held in fitting:
        made.load_state_dict({k: torch.from_numpy(v.astype(np.float32)) for k, v in held.items()})
        found.append(_difference(made, "high"))
    assert sum(difference < ALIKE for difference in found) == 1
    assert sorted(found)[1] > 4 * ALIKE


@cards
def test_reading_gives_what_was_written_bit_for_bit(weights):
    network = UNet(INPUTS, widths=VARIANTS[weights.stem if weights.stem in VARIANTS else ""].widths)
    load_into(network, weights)
    found = tza.read(tza.export(weights))
    assert list(found) == list(network.state_dict())
    for name, tensor in network.half().state_dict().items():
        assert found[name].dtype == np.float16
        assert found[name].tobytes() == tensor.numpy().tobytes()


@pytest.mark.parametrize("variant", PARAMETERS)
def test_untrained_networks_go_there_and_back(variant):
    made = build(variant, CPU, "random").network.state_dict()
    tensors = {name: tensor.half().numpy() for name, tensor in made.items()}
    found = tza.read(tza.write(tensors))
    assert numbers(found) == PARAMETERS[variant]
    assert {n: (t.shape, t.tobytes()) for n, t in found.items()} == {
        n: (t.shape, t.tobytes()) for n, t in tensors.items()
    }


def test_the_file_is_as_long_as_intels_own():
    assert len(tza.export(SHIPPED)) == 1_841_160  # rt_hdr_alb_nrm.tza of oidn-weights


def test_the_bytes_are_those_of_the_format():
    found = tza.write({"a": np.array([1, 2], np.float16)})
    header = bytes.fromhex("d741 0200 8000000000000000") + bytes(52)
    values = bytes.fromhex("003c 0040") + bytes(60)
    table = bytes.fromhex("01000000 0100 61 01 02000000 78 68 4000000000000000")
    assert found == header + values + table


@pytest.mark.parametrize("tensor", [np.zeros(3, "f4"), np.zeros((2, 2), "f2"), np.zeros(3, int)])
def test_what_the_format_cannot_hold_is_refused(tensor):
    with pytest.raises(tza.TzaError, match="'odd' is"):
        tza.write({"odd": tensor})


@pytest.mark.parametrize("kept", [0, 11, 64, 90, 131, 149])
def test_a_file_that_was_cut_off_is_refused(kept):
    whole = tza.write({"a": np.array([1, 2], np.float16)})
    with pytest.raises(tza.TzaError):
        tza.read(whole[:kept])


def test_values_that_lie_beyond_the_end_are_refused():
    whole = bytearray(tza.write({"a": np.array([1, 2], np.float16)}))
    struct.pack_into("<Q", whole, len(whole) - 8, 10**6)
    with pytest.raises(tza.TzaError, match="'a' ends at byte 1000004"):
        tza.read(bytes(whole))


def test_values_of_another_type_are_refused():
    whole = tza.write({"a": np.array([1, 2], np.float16)})
    with pytest.raises(tza.TzaError, match="'a' has values of type b'f'"):
        tza.read(whole.replace(b"xh", b"xf"))


def test_another_file_is_refused():
    with pytest.raises(tza.TzaError, match="begins with 50 4b 03 04"):
        tza.read(b"PK\x03\x04" + bytes(100))


def test_the_command_writes_the_file(tmp_path):
    tza.main([str(tmp_path / "ours.tza")])
    assert numbers(tza.read((tmp_path / "ours.tza").read_bytes())) == PARAMETERS[""]


def test_the_command_says_what_is_missing(tmp_path, capsys):
    with pytest.raises(SystemExit):
        tza.main([str(tmp_path / "x.tza"), "--weights", str(tmp_path / "none.safetensors")])
    assert "none.safetensors is missing" in capsys.readouterr().err
