"""Wrong returns are errors that say what to return, and whose function it was."""

from __future__ import annotations

import pytest
import torch

from rlbench import registry
from rlbench.checks.checked_returns import CheckedReturns
from rlbench.checks.returns import WrongReturnError
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip
from tests.conftest import write_plugin

UNIFORM = "return torch.ones_like(samples.counts, dtype=torch.float32)"
IMAGE = "return samples.mean * GAIN, None"
CLIP = procedural_clip(size=Size(1, 16, 24), frames=2)

RETURNS = {  # what replaces a line -> the function, what was found and what to return
    (UNIFORM, "pass"): ("plan", "found None; return values >= 0"),
    (UNIFORM, "return samples.mean"): ("plan", "[1 1 16 24] .*[1 3 16 24] of .*density.mean"),
    (IMAGE, "return samples.mean"): ("denoise", "(image, state), found a Tensor .*; end `denoise`"),
    (IMAGE, "return samples.mean.numpy(), None"): ("denoise", "found a ndarray .*from_numpy"),
    (IMAGE, "return samples.mean[..., 1:], None"): (
        "denoise",
        "[1 3 16 24], found a Tensor [1 3 16 23] of torch.float32; support any size",
    ),
}


@pytest.mark.parametrize("change", RETURNS)
def test_a_wrong_return_says_what_was_found_and_what_to_return(tmp_path, change):
    line, replacement = change
    function, message = RETURNS[change]
    file = write_plugin(tmp_path / "mine.py", "mine")
    text = file.read_text().replace(line, replacement)
    file.write_text(text)
    registry.use_plugin(file)
    method = CheckedReturns(registry.load_method("mine"))
    pattern = message.replace("[", r"\[").replace("(", r"\(").replace(")", r"\)")
    with pytest.raises(WrongReturnError, match=f"^{function} must return .*{pattern}") as raised:
        list(run_clip(method, CLIP, 1.0))
    number = text[: text.index(f"def {function}")].count("\n") + 1
    assert registry.failure_reason("mine", raised.value).endswith(f" (mine.py:{number})")


@pytest.mark.parametrize("name", ["mean", "accumulate/contrast"])
def test_the_images_are_those_of_the_method(name):
    method = registry.load_method(name)
    plain, checked = (
        [result.image for result in run_clip(each, CLIP, 1.5)]
        for each in (method, CheckedReturns(method))
    )
    assert all(map(torch.equal, plain, checked))
