"""What several methods have in common: first images, kept light, exposure, training."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from baselines.oidn.equal_start import EqualStart
from rlbench import registry
from rlbench.checks.frame_edits import edit_radiance, to_clip
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Samples, Size
from rlbench.method import Method
from rlbench.ops.demodulation import demodulation_albedo, filtered_albedo
from rlbench.run import run_clip
from rlbench.training import TrainingConfig, train
from rlbench.weights import digest
from tests.baselines.noise import SMALL, counts_of_halves, half_noisy, noisy_clip, one_sample
from tests.baselines.test_families import edit_tensors
from tests.conftest import write_noise

SAMPLER_STAGE = 0.4  # fraction of a training of `dasr`


def load(name: str) -> Method:
    if name.startswith("oidn-intel"):
        pytest.importorskip("pyoidn", reason="the extra oidn is not installed")
    return registry.load_method(name)


@pytest.mark.parametrize(
    ("name", "expected", "spp"),
    [
        *(("ntas/intel", "oidn", spp) for spp in (1.0, 4.0)),
        *(("dasr/intel", "oidn", spp) for spp in (1.0, 4.0)),
        *((name, "oidn/tuned", 2.0) for name in ("accumulate", "accumulate/contrast")),
        ("oidn/filled", "oidn/tuned", 2.0),
    ],
)
def test_the_first_image_is_that_of_the_denoiser(name: str, expected: str, spp: float) -> None:
    if name.endswith("/intel"):  # before training
        networks = registry.training_task(name).networks.requires_grad_(False)
        method: Method = EqualStart(networks, registry.get_variant(name).traits)
    else:
        method = load(name)
    clip = procedural_clip(5, Size(1, 48, 64), 1)
    first, second = (next(run_clip(each, clip, spp)).image for each in (method, load(expected)))
    # log transfer and back costs a few units in the last place
    torch.testing.assert_close(first, second, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("age", [0, 1], ids=["without history", "with history"])
@pytest.mark.parametrize("name", ["imcd", "ntas"])
def test_constant_irradiance_stays_constant(name: str, age: int) -> None:
    """Kernels sum to one on every level, with and without history."""
    gbuffer, method = noisy_clip().frames[0].gbuffer, registry.load_method(name, weights="random")
    lit = 0.7 * demodulation_albedo(filtered_albedo(gbuffer.albedo))
    start = edit_tensors(method.start(SMALL), lambda part: torch.full_like(part, 0.7))
    image, state = method.denoise(gbuffer, one_sample(lit), start._replace(age=age))
    # float32 sums of 242 weights, five levels, and one division by reflectance
    expected = torch.full_like(state.denoised, 0.7)
    torch.testing.assert_close(state.denoised, expected, rtol=1e-5, atol=0)
    torch.testing.assert_close(image, lit, rtol=1e-5, atol=0)


@pytest.mark.parametrize("gain", [2.0**-5, 3.0, 2.0**7])
@pytest.mark.parametrize("name", ["nppd", "oidn", "oidn-intel"])
def test_the_image_scales_with_the_radiance(name: str, gain: float) -> None:
    method, clip = load(name), procedural_clip(3, Size(1, 32, 48), 2)
    bright = to_clip(edit_radiance(frame, lambda part: gain * part) for frame in clip)
    for plain, scaled in zip(*(run_clip(method, c, 2.0) for c in (clip, bright)), strict=True):
        assert plain.image.max() > plain.image.min()
        # exposure in float32, then a logarithm and an exponential with 16 nats between 0 and 1
        torch.testing.assert_close(scaled.image / gain, plain.image, rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -1.0, 0.0])
@pytest.mark.parametrize("name", ["oidn", "oidn-intel"])
def test_radiance_that_is_invalid_everywhere_gives_a_finite_image(name: str, bad: float) -> None:
    (frame,) = procedural_clip(3, Size(1, 32, 48), 1)
    samples = Samples(torch.full((1, 8, 3, 32, 48), bad), torch.full((1, 1, 32, 48), 8))
    image, _ = load(name).denoise(frame.gbuffer, samples, None)
    assert torch.isfinite(image).all()


class Identity(nn.Module):
    """A denoiser that returns its input colour."""

    def forward(self, features: Tensor) -> Tensor:
        return features[:, :3]


@pytest.mark.parametrize(("name", "frames", "rate"), [("dasr", 1, 1e-3), ("ntas", 2, 5e-4)])
def test_the_sampler_learns_where_noise_is(name: str, frames: int, rate: float) -> None:
    task = registry.training_task(name)
    if name.startswith("dasr"):
        task.networks.denoiser = Identity()
    task.on_progress(SAMPLER_STAGE)
    optimizer = torch.optim.Adam(task.networks.parameters(), rate)
    for seed in range(15):
        for loss in task.losses(half_noisy(seed, frames), 3.0):
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
    *_, result = run_clip(task.method, half_noisy(99, frames), 3.0)
    left, right = counts_of_halves(result.samples.counts)
    assert left > 2 * right  # 3 and 3 before, 5 and 1 at best


class KilledError(Exception):
    """Stands for a killed process."""


@pytest.mark.parametrize(
    ("name", "config", "kill_after"),
    [
        # stages of 5 frames, 1, and 6; one sequence after the first checkpoint
        ("dasr", TrainingConfig(frames=12, crop=16, sequence_length=1, eval_interval=4), 5),
        # value and delayed sampler are in checkpoints; the weights file loads without them
        pytest.param(
            "ours/paper-appo",
            TrainingConfig(frames=9, crop=16, sequence_length=3, eval_interval=3),
            1,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_killed_training_ends_as_an_undisturbed_one(
    name: str, config: TrainingConfig, kill_after: int, tmp_path: Path
) -> None:
    clip = write_noise(tmp_path / "clips" / "noise", frames=config.sequence_length, h=32, w=32)

    def run(folder: str, kill_after: int | None = None) -> Path:
        def report(progress, loss) -> None:
            if progress.sequences == kill_after:
                raise KilledError

        train(name, [clip], [clip], tmp_path / folder, config, on_progress=report)
        return tmp_path / folder / f"{name.rpartition('/')[2]}.safetensors"

    with pytest.raises(KilledError):
        run("killed", kill_after)
    resumed, undisturbed = run("killed"), run("undisturbed")
    assert digest(resumed) == digest(undisturbed)
    registry.load_method(name, weights=str(resumed))
