"""Each wrong return of a newcomer's method is named, with what was found and what to write."""

from __future__ import annotations

import pytest
import torch

from rlbench import registry
from rlbench.checks.conformance import CHECKS, MethodUnderTest, Verdict, run_check, run_checks
from rlbench.checks.returns import find_density_fault
from tests.checks.conformance.broken_fixtures import SIZE, SMALL_SIZE
from tests.conftest import write_plugin

PAIR = "denoise must return (image, state), found"
IMAGE = "denoise must return an image [1 3 h w] as a torch.Tensor, found"
DENSITY = f"plan must return a density [1 1 {SIZE.h} {SIZE.w}] as a torch.Tensor, found"
COLOURS = f"[1 3 {SIZE.h} {SIZE.w}] of torch.float32"
UNIFORM = "return torch.ones_like(samples.counts, dtype=torch.float32)"

DENOISE = {  # statement -> (check, found, remedy)
    "return samples.mean": ("returns", f"{PAIR} a Tensor [1 3 64 96] of", "return image, state"),
    "samples.mean": ("returns", f"{PAIR} None", "where state is None if nothing is remembered"),
    "return samples.mean, None, 1": (
        "returns",
        f"{PAIR} a tuple of 3 (a Tensor [1 3 64 96] of torch.float32, None, an int)",
        "return image, state",
    ),
    "return [samples.mean, None]": ("returns", f"{PAIR} a list", "return image, state"),
    "return None, samples.mean": ("returns", f"{IMAGE} None", "return image, state"),
    "return samples.mean.numpy(), None": (
        "returns",
        f"{IMAGE} a ndarray [1 3 64 96] of float32",
        "torch.from_numpy(image).to(samples.mean.device)",
    ),
    "return samples.mean[0], None": ("returns", f"{IMAGE} a Tensor [3 64 96] of", "image[None]"),
    "return samples.mean.permute(0, 2, 3, 1), None": (
        "returns",
        f"{IMAGE} a Tensor [1 64 96 3] of torch.float32",
        "image.permute(0, 3, 1, 2)",
    ),
    "return samples.mean[:, :1], None": ("returns", f"{IMAGE} a Tensor [1 1 64 96] of", "blue"),
    "return samples.mean[..., ::2, ::2], None": (
        "odd_size",
        f"expected an image of shape [1, 3, {SIZE.h}, {SIZE.w}], found [1, 3, 10, 16] in frame 0",
        "support any size",
    ),
    "return samples.mean.double(), None": (
        "image",
        "expected torch.float32 [1, 3, 19, 31], found torch.float64 [1, 3, 19, 31] in frame 0",
        "end with .float()",
    ),
    "return (samples.mean * 255).byte(), None": ("image", "found torch.uint8", "end with .float()"),
    "return samples.radiance.sum(1) / samples.counts, None": (
        "image",
        "values that are NaN or infinite in frame 0",
        "clamp divisors, e.g. x / y.clamp_min(1e-6)",
    ),
    "return gbuffer.albedo, None": (
        "inputs",
        "expected the inputs that are read (albedo), found none declared",
        "declare Traits(inputs=frozenset({...})) with the buffers that are read",
    ),
}

PLAN = {
    "pass": ("density", f"{DENSITY} None", "torch.ones_like(samples.mean[:, :1])"),
    "return 1.0": ("density", f"{DENSITY} a float", "torch.ones_like(samples.mean[:, :1])"),
    "return torch.ones(1, 3, *samples.counts.shape[2:])": (
        "density",
        f"{DENSITY} a Tensor {COLOURS}",
        "density.mean(1, keepdim=True)",
    ),
    "return samples.counts.numpy() + 1.0": (
        "density",
        f"{DENSITY} a ndarray [1 1 {SIZE.h} {SIZE.w}] of float64",
        "torch.from_numpy(density)",
    ),
    "return torch.ones(samples.counts.shape[2:])": (
        "density",
        f"{DENSITY} a Tensor [{SIZE.h} {SIZE.w}]",
        "of shape [n 1 h w]",
    ),
    "return samples.counts - 1.0": ("density", "values >= 0, found -1", "with .clamp_min(0)"),
    "return samples.counts / 0": ("density", "finite values, found 589", "clamp divisors in"),
    "return torch.rand(samples.counts.shape)": (
        "uniform",
        "expected a constant density, found values from",
        "declare Traits(adaptive=True)",
    ),
}

BUILD = {
    "return None": "of type NoneType, not a Method: it has no traits, no start, no plan",
    "return Scaled({'adaptive': True})": "returned {'adaptive': True}",
    "return type('Odd', (), {'traits': TRAITS, 'plan': Scaled.plan, 'start': Scaled.start})()": (
        "returned an object of type Odd, not a Method: it has no denoise"
    ),
}


@pytest.fixture
def failures(tmp_path):
    """The checks that a plugin fails, by name."""

    def find(**plugin: str) -> dict[str, object]:
        registry.use_plugin(write_plugin(tmp_path / "novice.py", "novice", **plugin))
        results = run_checks(MethodUnderTest("novice", size=SIZE, small_size=SMALL_SIZE))
        return {c.name: result for c, result in results if result.verdict is Verdict.FAILED}

    return find


@pytest.mark.parametrize("statement", DENOISE)
def test_a_wrong_return_of_denoise_is_named_with_its_remedy(failures, statement):
    check, found, remedy = DENOISE[statement]
    (name, result), *_ = failures(body=statement).items()
    assert name == check
    assert found in result.found
    assert remedy in result.remedy


@pytest.mark.parametrize("statement", PLAN)
def test_a_wrong_return_of_plan_is_named_with_its_remedy(failures, tmp_path, statement):
    check, found, remedy = PLAN[statement]
    file = write_plugin(tmp_path / "novice.py", "novice")
    file.write_text(file.read_text().replace(UNIFORM, statement))
    registry.use_plugin(file)
    under_test = MethodUnderTest("novice", size=SIZE, small_size=SMALL_SIZE)
    result = run_check(under_test, check)
    assert result.verdict is Verdict.FAILED
    assert found in result.found
    assert remedy in result.remedy
    assert run_check(under_test, "image").verdict is Verdict.PASSED  # it hides no other fault


@pytest.mark.parametrize("scale", ["samples.counts + 7", "1000 * torch.ones_like(samples.counts)"])
def test_counts_of_any_sum_are_a_density(failures, tmp_path, scale):
    file = write_plugin(tmp_path / "novice.py", "novice")
    file.write_text(file.read_text().replace(UNIFORM, f"return {scale}"))
    registry.use_plugin(file)
    results = run_checks(MethodUnderTest("novice", size=SIZE, small_size=SMALL_SIZE))
    assert [c.name for c, r in results if r.verdict is Verdict.FAILED] == []


@pytest.mark.parametrize("statement", BUILD)
def test_a_wrong_return_of_build_is_named(failures, statement):
    found = failures(build=statement)
    assert list(found) == ["built"]
    assert BUILD[statement] in found["built"].found


@pytest.mark.parametrize(
    ("old", "new", "message", "remedy"),
    [
        (
            "def build(variant, device, weights)",
            "def build(variant)",
            "build must take (variant, device, weights), found build(variant)",
            "define `def build(variant, device, weights)`",
        ),
        (
            "def start(self, size)",
            "def start(self)",
            "start must take (size), found start()",
            "define `def start(self, size)`",
        ),
        (
            "def plan(self, gbuffer, samples, state)",
            "def plan(self, samples)",
            "plan must take (gbuffer, samples, state), found plan(samples)",
            "define `def plan(self, gbuffer, samples, state)`",
        ),
        (
            "def denoise(self, gbuffer, samples, state)",
            "def denoise(self, gbuffer, samples)",
            "denoise must take (gbuffer, samples, state), found denoise(gbuffer, samples)",
            "define `def denoise(self, gbuffer, samples, state)`",
        ),
    ],
)
def test_wrong_arguments_are_named_before_anything_is_called(tmp_path, old, new, message, remedy):
    file = write_plugin(tmp_path / "novice.py", "novice")
    file.write_text(file.read_text().replace(old, new))
    registry.use_plugin(file)
    check = "built" if "build" in old else "returns"
    result = run_check(MethodUnderTest("novice"), check)
    assert (result.found, result.remedy) == (message, remedy)


def test_a_state_that_is_changed_in_place_is_a_fault(failures):
    body = "state = state if isinstance(state, list) else []; state.append(samples.mean); "
    found = failures(body=f"{body}return samples.mean, state")
    assert "found changes in state" in found["in_place"].found
    assert found["in_place"].remedy.startswith("return a new state")


def test_a_return_that_is_wrong_in_a_later_frame_alone_is_named_as_well(failures):
    body = "return (samples.mean, 1) if state is None else samples.mean"
    assert failures(body=body)["returns"].found.startswith(PAIR)


@pytest.mark.parametrize("traits", ["{'adaptive': True}", "None"])
def test_traits_of_another_type_are_an_error_of_the_family(tmp_path, traits):
    file = write_plugin(tmp_path / "novice.py", "novice")
    file.write_text(file.read_text().replace("TRAITS, learned", f"{traits}, learned"))
    registry.use_plugin(file)
    with pytest.raises(registry.PluginError, match=r"has traits of type \w+; Traits\(...\) is"):
        registry.get_variant("novice")


@pytest.mark.parametrize(
    ("variants", "message"),
    [
        ('{"": TRAITS}', "variant '' of 'novice' is of type Traits; a Variant is expected"),
        ("[TRAITS]", "'novice' has variants of type list; a dictionary is expected"),
    ],
)
def test_variants_of_another_type_are_an_error_of_the_family(tmp_path, variants, message):
    file = write_plugin(tmp_path / "novice.py", "novice")
    head, _, tail = file.read_text().partition('    {"": Variant')
    file.write_text(f"{head}    {variants},\n{tail.partition('},')[2]}")
    registry.use_plugin(file)
    with pytest.raises(registry.PluginError, match=message):
        registry.get_variant("novice")


def test_a_valid_density_has_no_fault():
    assert find_density_fault(torch.ones(1, 1, 2, 3), (1, 1, 2, 3)) is None


def test_every_check_but_the_first_two_needs_correct_returns():
    needs = {name for name, check in CHECKS.items() if {"odd_size", "returns"} & {*check.requires}}
    assert set(CHECKS) - needs == {"built", "frozen", "returns"}


def test_an_image_that_is_not_finite_fails_one_check_alone(failures):
    found = failures(body="return samples.mean * float('nan'), None")
    assert list(found) == ["image"]


def test_a_build_that_raises_is_told_to_correct_its_line(failures):
    found = failures(build="return Scaled(1 / 0)")
    assert list(found) == ["built"]
    assert "ZeroDivisionError: division by zero (novice.py:" in found["built"].found
    assert found["built"].remedy.startswith("correct the line that raised")


def test_a_build_that_returns_no_method_is_told_to_return_one(failures):
    found = failures(build="return None")
    assert "returned an object of type NoneType, not a Method" in found["built"].found
    assert found["built"].remedy.startswith("return a Method from `build`")
