"""What only a GPU can show: graphs of whole stages and of training steps, against plain runs."""

from __future__ import annotations

from statistics import fmean

import pytest
import torch

from rlbench import registry
from rlbench.backends import use_backend
from rlbench.checks.stress import bad_pixel, budgets, long_runs
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Clip, GBuffer, Reference, Size, StoredPool
from rlbench.metrics import psnr
from rlbench.ops.recording import CudaGraphs
from rlbench.recorded_method import RecordedMethod
from rlbench.run import run_clip
from rlbench.sampling import allocate_counts
from rlbench.system.half_precision import half_dtype
from rlbench.training import TrainingConfig
from rlbench.training.train_state import TrainState
from rlbench.wrappers import HalfPrecision
from tests.checks.stress.broken_methods import verdicts

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
GPU = torch.device("cuda")
ROWS = [
    name for name in registry.expand(["all"]) if not registry.get_variant(name).traits.eager_reason
]
FUSED = ("oidn", "accumulate/tuned", "ours", "svgf")  # each takes minutes to compile
SCORES = ("psnr", "psnr_debiased", "ssim", "ms_ssim", "relmse", "smape", "bias", "blotches")
TRAINED = (
    *("oidn/retrained", "accumulate/tuned", "ours/A2", "nppd", "imcd", "ntas", "dasr"),
    *("ours", "ours/A1", "ours/paper", "ours/paper-appo"),
)


def on_gpu(clip: Clip) -> InMemoryClip:
    frames = []
    for frame in clip:
        assert isinstance(frame.pool, StoredPool)
        buffers = {name: buffer.to(GPU) for name, buffer in frame.gbuffer.buffers.items()}
        halves = frame.reference.half_a.to(GPU), frame.reference.half_b.to(GPU)
        pool = StoredPool(frame.pool.radiance.to(GPU), frame.pool.rounding_seeds)
        gbuffer = GBuffer(buffers, frame.gbuffer.static)
        moved = {"gbuffer": gbuffer, "pool": pool, "reference": Reference(*halves)}
        frames.append(type(frame)(frame.index, **moved))
    return InMemoryClip(clip.name, clip.scene, clip.digest, frames)


def references(clip: Clip) -> list[torch.Tensor]:
    return [frame.reference.mean for frame in clip]


def compare_with_plain(name, backend):
    spp = registry.get_variant(name).traits.nearest_spp(1.0)
    clip = on_gpu(procedural_clip(3, Size(1, 96, 160), frames=6, cut=4))
    plain, recorded = (registry.load_method(name, GPU) for _ in range(2))
    recorded = use_backend(recorded, backend, GPU)
    for _ in range(2):
        pairs = zip(run_clip(plain, clip, spp), run_clip(recorded, clip, spp), strict=True)
        for one, other in pairs:
            assert torch.equal(one.samples.counts, other.samples.counts)
            torch.testing.assert_close(other.image, one.image, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", ROWS)
def test_recorded_frames_have_the_counts_and_images_of_plain_ones(name):
    compare_with_plain(name, "graph")


@pytest.mark.parametrize("name", FUSED)
def test_fused_frames_have_the_counts_and_images_of_plain_ones(name):
    compare_with_plain(name, "fused")


@pytest.mark.parametrize("name", [n for n in ROWS if registry.get_variant(n).learned])
def test_recorded_frames_in_half_precision_have_the_psnr_of_plain_ones(name):
    spp = registry.get_variant(name).traits.nearest_spp(1.0)
    clip = on_gpu(procedural_clip(3, Size(1, 96, 160), frames=4))
    plain, recorded = (registry.load_method(name, GPU) for _ in range(2))
    scores = []
    for each in (plain, use_backend(recorded, "graph", GPU)):
        method = HalfPrecision(each, GPU, half_dtype(GPU))
        images = [result.image for _ in range(2) for result in run_clip(method, clip, spp)]
        scores.append([psnr(*pair) for pair in zip(images, 2 * references(clip), strict=True)])
    assert fmean(scores[1]) == pytest.approx(fmean(scores[0]), abs=0.01)


@pytest.mark.parametrize("name", FUSED)
@pytest.mark.parametrize("section", [bad_pixel, budgets, long_runs], ids=lambda s: s.__name__)
def test_recorded_rows_have_the_stress_verdicts_of_plain_ones(section, name):
    method = registry.load_method(name, GPU)
    recorded = RecordedMethod(method)
    expected = verdicts(section.SECTION, method, device=GPU)
    assert verdicts(section.SECTION, recorded, device=GPU) == expected


def test_intels_library_runs_on_the_card_where_it_can():
    """In half precision there; without support it falls back to the processor."""
    pytest.importorskip("pyoidn")
    from baselines.oidn_intel.method import filter_device

    assert filter_device(GPU) == GPU
    clip = procedural_clip(3, Size(1, 96, 160), frames=2)
    here, there = (
        list(run_clip(registry.load_method("oidn-intel", device), each, 2.0))
        for device, each in ((torch.device("cpu"), clip), (GPU, on_gpu(clip)))
    )
    for one, other in zip(here, there, strict=True):
        difference = (other.image.cpu() - one.image).abs().mean()
        assert difference < 0.01 * one.image.abs().mean()


@pytest.mark.parametrize("name", SCORES)
def test_scores_are_those_of_a_processor(name):
    metric = registry.load_run_metrics()[name]
    (frame,) = procedural_clip(5, Size(2, 192, 192), frames=1)
    halves = frame.reference.half_a, frame.reference.half_b
    image = halves[0].lerp(halves[1].roll(1, -1), 0.5)
    here, there = (
        metric.score(metric.compare(image.to(each), *(half.to(each) for half in halves)))
        for each in ("cpu", GPU)
    )
    torch.testing.assert_close(there.cpu(), here, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("spp", [0.1, 1.0, 4.0])
def test_counts_are_those_of_a_processor(spp):
    density = torch.rand(2, 1, 90, 122, generator=torch.Generator().manual_seed(0)) ** 8
    low = torch.zeros(2, 1, 90, 122, dtype=torch.int64)
    total = round(spp * 90 * 122)
    for power in (1, 2):
        expected = allocate_counts(density**power, total, low, 8, (0, 1))
        found = allocate_counts((density**power).to(GPU), total, low.to(GPU), 8, (0, 1))
        assert (found.cpu() != expected).float().mean() < 1e-3  # shares are summed in another order


@pytest.mark.parametrize("name", TRAINED)
def test_recorded_steps_train_as_plain_ones_do(name):
    """Fifty sequences at two budgets; convolutions on a GPU sum in an order of their own."""
    losses = []
    for recorder in (None, CudaGraphs()):
        task = registry.training_task(name, GPU)
        state = TrainState(task, TrainingConfig(), "cuda", recorder)
        losses.append([])
        for seed in range(50):
            clip = on_gpu(procedural_clip(seed, Size(1, 64, 64), frames=6))
            state.train_sequence(clip, 1.0 + seed % 2, 1.0, 0.9)
            losses[-1].append(state.read_loss())
    assert losses[1] == pytest.approx(losses[0], rel=0.05, abs=0.01)
