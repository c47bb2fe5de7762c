"""Each wrong return of a newcomer's method is named, with what was found and what to write."""

from __future__ import annotations

import re

import pytest
import torch

from rlbench import registry
from rlbench.checks.conformance import MethodUnderTest, Verdict, run_check, run_checks
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.returns import CheckedReturns, WrongReturnError
from rlbench.run import run_clip
from tests.checks.conformance.broken_fixtures import SIZE, SMALL_SIZE
from tests.conftest import write_plugin

UNIFORM = "return torch.ones_like(samples.counts, dtype=torch.float32)"
IMAGE = "return samples.mean * GAIN, None"
CLIP = procedural_clip(size=Size(1, 16, 24), frames=2)

DENOISE = {  # statement -> (check, part of what was found, part of the remedy)
    "return samples.mean": ("returns", "found a Tensor [1 3 64 96] of", "return image, state"),
    "return samples.mean, None, 1": ("returns", "(a Tensor [1 3 64 96] of", "return image, state"),
    "return samples.mean.numpy(), None": ("returns", "a ndarray [1 3 64 96]", "from_numpy(image)"),
    "return samples.mean[0], None": ("returns", "found a Tensor [3 64 96]", "image[None]"),
    "return samples.mean.permute(0, 2, 3, 1), None": ("returns", "[1 64 96 3]", "permute(0, 3, 1"),
    "return samples.mean[:, :1], None": ("returns", "found a Tensor [1 1 64 96] of", "blue"),
    "return samples.mean[:1], None": ("batch", "[2 3 h w] as a torch.Tensor, found a", "as in"),
    "return samples.mean[..., ::2, ::2], None": ("odd_size", "[1, 3, 10, 16]", "any size"),
    "return samples.mean.double(), None": ("image", "found torch.float64", "end with .float()"),
    "return samples.mean * float('nan'), None": ("image", "are NaN or infinite", "clamp divisors"),
    "return gbuffer.albedo, None": ("inputs", "(albedo), found none declared", "Traits(inputs="),
    "state = state or []; state.append(samples.mean); return samples.mean, state": (
        "in_place",
        "found changes in state",
        "return a new state",
    ),
    "return (samples.mean, 1) if state is None else samples.mean": (  # in a later frame alone
        "returns",
        "(image, state), found a Tensor",
        "return image, state",
    ),
}
PLAN = {
    "pass": ("density", "found None", "torch.ones_like(samples.mean[:, :1])"),
    "return samples.mean": ("density", f"[1 3 {SIZE.h} {SIZE.w}]", "density.mean(1, keepdim=True)"),
    "return samples.counts.numpy() + 1.0": ("density", "a ndarray [1 1 ", "from_numpy(density)"),
    "return samples.counts[0, 0]": ("density", f"[{SIZE.h} {SIZE.w}] of", "of shape [n 1 h w]"),
    "return samples.counts - 1.0": ("density", "values >= 0, found -1", "with .clamp_min(0)"),
    "return samples.counts / 0": ("density", "finite values, found 589", "clamp divisors in"),
    "return torch.rand(samples.counts.shape)": ("uniform", "values from", "Traits(adaptive=True)"),
}
BUILD = {
    "return None": ("of type NoneType, not a Method", "return a Method from `build`"),
    "return Scaled({'adaptive': True})": ("returned {'adaptive': True}", "return a Method"),
    "return type('Odd', (), {'traits': TRAITS, 'plan': Scaled.plan, 'start': Scaled.start})()": (
        "of type Odd, not a Method: it has no denoise",
        "return a Method",
    ),
    "return Scaled(1 / 0)": ("ZeroDivisionError: division by zero (novice.py:", "correct the line"),
}
ARGUMENTS = {  # what replaces a definition -> what the message says
    ("build(variant, device, weights)", "build(variant)"): "found build(variant)",
    ("start(self, size)", "start(self)"): "found start()",
    ("plan(self, gbuffer, samples, state)", "plan(self, samples)"): "found plan(samples)",
    ("denoise(self, gbuffer, samples, state)", "denoise(self)"): "found denoise()",
}


@pytest.fixture
def novice(tmp_path):
    """A method under test, with lines of a plugin's file replaced."""

    def write(old: str = "", new: str = "", **plugin: str) -> MethodUnderTest:
        file = write_plugin(tmp_path / "novice.py", "novice", **plugin)
        file.write_text(file.read_text().replace(old, new) if old else file.read_text())
        registry.use_plugin(file)
        return MethodUnderTest("novice", size=SIZE, small_size=SMALL_SIZE)

    return write


def failures(method: MethodUnderTest):
    results = run_checks(method)
    return {c.name: result for c, result in results if result.verdict is Verdict.FAILED}


@pytest.mark.parametrize("statement", DENOISE)
def test_a_wrong_return_of_denoise_is_named_with_its_remedy(novice, statement):
    check, found, remedy = DENOISE[statement]
    (name, result), *_ = failures(novice(body=statement)).items()
    assert name == check
    assert found in result.found
    assert remedy in result.remedy


@pytest.mark.parametrize("statement", PLAN)
def test_a_wrong_return_of_plan_is_named_with_its_remedy(novice, statement):
    check, found, remedy = PLAN[statement]
    method = novice(UNIFORM, statement)
    result = run_check(method, check)
    assert result.verdict is Verdict.FAILED
    assert found in result.found
    assert remedy in result.remedy
    assert run_check(method, "image").verdict is Verdict.PASSED  # it hides no other fault


@pytest.mark.parametrize("scale", ["samples.counts + 7", "1000 * torch.ones_like(samples.counts)"])
def test_counts_of_any_sum_are_a_density(novice, scale):
    assert not failures(novice(UNIFORM, f"return {scale}"))


@pytest.mark.parametrize("statement", BUILD)
def test_a_build_that_returns_no_method_or_raises_fails_alone(novice, statement):
    ((name, result),) = failures(novice(build=statement)).items()
    assert name == "built"
    assert BUILD[statement][0] in result.found
    assert result.remedy.startswith(BUILD[statement][1])


@pytest.mark.parametrize("change", ARGUMENTS)
def test_wrong_arguments_are_named_before_anything_is_called(novice, change):
    old, new = change
    result = run_check(novice(*change), "built" if "build" in old else "returns")
    assert ARGUMENTS[change] in result.found
    assert result.remedy == f"define `def {old}`"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("TRAITS, learned", "None, learned"),
        ('{"": Variant', '{"": TRAITS, "B0": Variant'),
        ('{"": Variant', '[TRAITS] or {"": Variant'),
    ],
)
def test_variants_and_traits_of_another_type_are_an_error_of_the_family(novice, old, new):
    with pytest.raises(registry.PluginError, match=r"of type \w+"):
        registry.get_variant(novice(old, new).name)


# a method with checked returns, in a benchmark

RETURNS = {  # what replaces a line -> the function, what was found and what to return
    (UNIFORM, "pass"): ("plan", "found None; return values >= 0"),
    (IMAGE, "return samples.mean"): ("denoise", "found a Tensor [1 3 16 24]"),
    (IMAGE, "return samples.mean[..., 1:], None"): ("denoise", "support any size"),
}


@pytest.mark.parametrize("change", RETURNS)
def test_a_wrong_return_says_what_was_found_and_what_to_return(tmp_path, novice, change):
    function, message = RETURNS[change]
    method = CheckedReturns(registry.load_method(novice(*change).name))
    with pytest.raises(WrongReturnError, match=f"^{function} .*{re.escape(message)}") as raised:
        list(run_clip(method, CLIP, 1.0))
    text = (tmp_path / "novice.py").read_text()
    number = text[: text.index(f"def {function}")].count("\n") + 1
    assert registry.failure_reason("novice", raised.value).endswith(f" (novice.py:{number})")


@pytest.mark.parametrize("name", ["mean", "accumulate/contrast"])
def test_the_images_are_those_of_the_method(name):
    method = registry.load_method(name)
    plain, checked = (
        [result.image for result in run_clip(each, CLIP, 1.5)]
        for each in (method, CheckedReturns(method))
    )
    assert all(map(torch.equal, plain, checked))
