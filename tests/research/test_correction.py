"""The learned correction of the density, scaled between the rule and itself."""

from __future__ import annotations

import pytest
import torch

from research import edit_weights
from research.correction import ScaledAction
from rlbench import registry
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.run import run_clip
from rlbench.weights import read_card


def images(method) -> list[torch.Tensor]:
    return [result.image for result in run_clip(method, procedural_clip(frames=3), spp=1.0)]


@pytest.mark.parametrize(("scale", "row"), [(0.0, "ours/by-rule"), (1.0, "ours")])
def test_the_ends_of_the_scale_are_the_rule_and_the_learned_density(scale, row):
    scaled = images(ScaledAction(registry.load_method("ours"), scale))
    assert torch.equal(torch.stack(scaled), torch.stack(images(registry.load_method(row))))


def test_a_scaled_sampler_halves_the_action_before_tanh_and_its_card_says_so(tmp_path):
    shipped = registry.shipped_weights("ours")
    edit_weights.main(["scale-sampler", str(shipped), str(tmp_path / "half.safetensors")])
    whole, half = (
        registry.load_method("ours", weights=str(path)).sampler
        for path in (shipped, tmp_path / "half.safetensors")
    )
    inputs = torch.randn(1, whole.tail.in_channels, 32, 32, generator=torch.Generator())
    # the file holds float16, whose rounding is 5e-4 of a weight
    assert half(inputs).atanh() == pytest.approx(0.5 * whole(inputs).atanh(), abs=1e-3)
    assert "multiplied by 0.5" in read_card(tmp_path / "half.safetensors").note
    oidn = str(registry.shipped_weights("oidn"))
    with pytest.raises(SystemExit):
        edit_weights.main(["scale-sampler", oidn, str(tmp_path / "none.safetensors")])


def test_before_training_the_image_is_that_of_open_image_denoise(tmp_path):
    file = tmp_path / "initial.safetensors"
    edit_weights.main(["initial-denoiser", str(registry.shipped_weights("ours/A2")), str(file)])
    clip = procedural_clip(frames=1)  # the first frame has no history
    first, *_ = run_clip(registry.load_method("ours/A2", weights=str(file)), clip, spp=4.0)
    oidn, *_ = run_clip(registry.load_method("oidn"), procedural_clip(frames=1), spp=4.0)
    # the file holds float16, whose rounding is 5e-4 of a weight
    assert torch.allclose(first.image, oidn.image, rtol=0.02, atol=0.01)
