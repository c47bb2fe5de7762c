"""Two forms of one computation: with questions on a CPU, and without where frames are recorded."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from baselines.accumulate.density import mix_with_uniform
from rlbench import registry
from rlbench.benchmark.listing import list_installed
from rlbench.checks.conformance import MethodUnderTest, run_check
from rlbench.checks.frame_edits import edit_radiance
from rlbench.checks.stress import bad_pixel
from rlbench.checks.stress.bad_pixel import plant_in_buffer, plant_in_samples
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Frame, GBuffer, Size, StoredPool
from rlbench.method import Method
from rlbench.ops.asking import may_ask
from rlbench.ops.nested_tensors import read_leaves, replace_leaves
from rlbench.ops.recording import Fused, RecordedFunction
from rlbench.questions import Questions
from rlbench.recorded_method import RecordedMethod
from rlbench.run import run_frame
from rlbench.sampling import BudgetError, _divide, allocate_counts
from rlbench.sanitize import sanitize_frame
from rlbench.wrappers import HalfPrecision
from tests.checks.stress.broken_methods import verdicts
from tests.conftest import install_plugin
from tests.tapes import Tapes, plain, tensors_of, unasked

SIZE = Size(2, 36, 44)
CPU = torch.device("cpu")
ROWS = [
    *("accumulate/tuned", "dasr", "eaw", "eaw/still", "imcd", "mean", "nppd", "nppd/history"),
    *("ntas", "ntas/history", "oidn", "oidn/filled", "ours", "ours/latent", "ours/paper", "svgf"),
]
RECORDABLE = [
    name
    for name in registry.expand(["all/*"])
    if not registry.get_variant(name).traits.eager_reason
]
QUICK = ("accumulate/tuned", "dasr", "ntas/history", "ours", "svgf")  # of those, in every run


def firefly(radiance: Tensor) -> Tensor:
    if radiance.ndim < 5:
        return radiance
    radiance = radiance.clone()
    radiance[..., 11, 17] = 60000.0
    radiance[:, 0, :, 30, 40] = 9000.0
    return radiance


def hard_frames() -> list[Frame]:
    """Invalid values, fireflies in one image of the batch, and a cut."""
    frames = list(procedural_clip(3, SIZE, frames=4, cut=3))
    for name, value in (("albedo", math.nan), ("depth", -1.0), ("motion", math.inf)):
        frames[1] = plant_in_buffer(frames[1], name, value, 3, 4)
    frames[1] = plant_in_samples(plant_in_samples(frames[1], math.nan, 6, 8), -5.0, 20, 30)
    frames[2] = edit_radiance(frames[2], firefly)
    return frames


def without_questions(frame: Frame) -> Frame:
    assert isinstance(frame.pool, StoredPool)
    buffers = {name: unasked(buffer) for name, buffer in frame.gbuffer.buffers.items()}
    pool = StoredPool(unasked(frame.pool.radiance), frame.pool.rounding_seeds)
    return replace(frame, gbuffer=GBuffer(buffers, frame.gbuffer.static), pool=pool)


def run_beside(recorded: RecordedMethod, method: Method, frames: list[Frame], spp: float):
    """Counts and image of each frame, of both from the state of the method; all frames twice."""
    for _ in range(2):
        state = method.start(frames[0].pool.size)
        for frame in frames:
            valid = sanitize_frame(frame, method.traits.inputs)
            with torch.inference_mode():
                samples, image, _ = run_frame(recorded, valid, state, spp)
                expected, expected_image, state = run_frame(method, valid, state, spp)
            yield plain(samples.counts), expected.counts, plain(image), expected_image


def test_a_cpu_may_ask_and_a_subclass_of_tensor_may_not():
    mask = torch.tensor([True])
    assert may_ask(mask)
    assert not may_ask(unasked(mask))
    assert not may_ask(~unasked(mask))


def test_a_pytorch_for_cuda_without_a_driver_is_not_asked_what_it_captures(monkeypatch):
    """What PyPI installs on Linux, on a machine without a GPU."""

    def fail():
        raise RuntimeError("CUDA driver version is insufficient for CUDA runtime version")

    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "is_initialized", lambda: False)
    monkeypatch.setattr(torch.cuda, "is_current_stream_capturing", fail)
    assert may_ask(torch.tensor([True]))


@pytest.mark.parametrize("name", ROWS)
@pytest.mark.parametrize("spp", [0.4, pytest.param(2.0, marks=pytest.mark.slow)])
def test_a_frame_without_questions_has_the_same_counts_image_and_repairs(name, spp):
    """Of each frame, from the same state: invalid values, empty pixels, fireflies and a cut."""
    variant = registry.get_variant(name)
    method, traits = registry.load_method(name, CPU), variant.traits
    spp, state = traits.nearest_spp(spp), method.start(SIZE)
    for frame in hard_frames():
        asked = sanitize_frame(frame, traits.inputs)
        leaves = {path: unasked(leaf) for path, leaf in read_leaves(state)}
        with torch.inference_mode():
            mute = sanitize_frame(without_questions(frame), traits.inputs)
            samples, image, after = run_frame(method, mute, replace_leaves(state, leaves), spp)
            assert not mute.repairs
            mute.questions.answer()
            expected, expected_image, state = run_frame(method, asked, state, spp)
        assert mute.repairs == asked.repairs
        assert torch.equal(plain(samples.counts), expected.counts)
        # the suspects of fireflies alone are computed by other loops, within rounding
        torch.testing.assert_close(plain(image), expected_image, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n not in QUICK)) for n in ROWS]
)
def test_recorded_stages_return_what_the_method_returns_for_other_frames(name):
    """States are of two kinds at most: before the first frame, and later."""
    method, recorder = registry.load_method(name, CPU), Tapes()
    recorded, spp = RecordedMethod(method, recorder), method.traits.nearest_spp(0.5)
    for counts, others, image, expected in run_beside(recorded, method, hard_frames(), spp):
        assert (counts != others).float().mean() < 0.01
        torch.testing.assert_close(image, expected, rtol=1e-3, atol=1e-4)
    kinds = len(recorder.tapes) // 2
    assert kinds <= 2
    assert sum(tape.replays for tape in recorder.tapes) == 2 * (8 - kinds)


def test_recorded_stages_in_half_precision_return_what_the_method_returns_there():
    """The wrapper is outside: it casts for both, and what is recorded includes the casts."""
    method = registry.load_method("accumulate/tuned", CPU)
    recorded, halved = (
        HalfPrecision(each, CPU, torch.bfloat16)
        for each in (RecordedMethod(method, Tapes()), method)
    )
    for counts, others, image, expected in run_beside(recorded, halved, hard_frames(), 1.0):
        assert (counts != others).float().mean() < 0.01
        torch.testing.assert_close(image, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", ["svgf", pytest.param("ours", marks=pytest.mark.slow)])
def test_recorded_rows_have_the_stress_verdicts_of_plain_ones(name):
    method, recorder = registry.load_method(name, CPU), Tapes()
    recorded = RecordedMethod(method, recorder)
    assert verdicts(bad_pixel.SECTION, recorded) == verdicts(bad_pixel.SECTION, method)
    assert sum(tape.replays for tape in recorder.tapes)


class Reruns:
    """A recorder on a processor that runs a function again, and writes where it wrote at first."""

    hold = staticmethod(torch.clone)

    def record(self, function):
        returned = function()

        def replay():
            for old, new in zip(*map(tensors_of, (returned, function())), strict=True):
                old.copy_(new)

        return replay, returned


@pytest.mark.parametrize(
    ("name", "compiler"),
    [
        *(
            pytest.param(name, "eager", marks=[pytest.mark.slow] * (name != "oidn"))
            for name in RECORDABLE
        ),
        pytest.param("oidn", "inductor", marks=pytest.mark.slow),  # which needs a C++ compiler
    ],
)
def test_each_stage_is_one_graph_that_returns_what_the_method_returns(name, compiler):
    """In every row; a graph break is an error. A compiler that fuses rounds elsewhere."""
    method = registry.load_method(name, CPU)
    fused, spp = RecordedMethod(method, Fused(Reruns(), compiler)), method.traits.nearest_spp(2.0)
    frames = list(procedural_clip(3, Size(1, 36, 44), frames=4, cut=3))
    for counts, others, image, expected in run_beside(fused, method, frames, spp):
        assert torch.equal(counts, others)
        torch.testing.assert_close(image, expected, rtol=1e-4, atol=1e-4)


def test_what_plan_reprojects_is_recorded_once_and_denoise_alone_is_not_replayed():
    method, recorder = registry.load_method("accumulate/tuned", CPU), Tapes()
    frames = hard_frames()[:2]
    (first, second), state = [sanitize_frame(f, method.traits.inputs) for f in frames], None
    with torch.inference_mode():
        samples, _, state = run_frame(method, first, method.start(SIZE), 1.0)
        behind, alone = RecordedMethod(method, recorder), RecordedMethod(method, recorder)
        for recorded, plans in ((behind, True), (alone, False), (behind, True), (behind, False)):
            if plans:
                recorded.plan(second.gbuffer, samples, state)
            image, _ = recorded.denoise(second.gbuffer, samples, state)
            state = replace(state)  # another object, as in the next frame
    planned, shorter, longer = recorder.tapes
    assert len(shorter.operations) < 0.9 * len(longer.operations)
    assert [tape.replays for tape in recorder.tapes] == [1, 1, 0]
    torch.testing.assert_close(plain(image), method.denoise(second.gbuffer, samples, state)[0])


def test_a_recorded_function_holds_for_other_values_and_for_each_shape():
    recorder, generator = Tapes(), torch.Generator().manual_seed(0)
    recorded = RecordedFunction(_divide, recorder)
    for n, h, w in [(1, 9, 12), (2, 30, 41), (1, 9, 12), (2, 30, 41)]:
        density = torch.rand(n, h, w, generator=generator).double()
        low, high = (torch.full((n, h, w), each) for each in (0, 8))
        total, seeds = torch.full((n, 1, 1), h * w), torch.randint(99, (n,), generator=generator)
        counts = plain(recorded(density, total, low, high, seeds))
        assert torch.equal(counts, _divide(density, total, low, high, seeds))
    assert [tape.replays for tape in recorder.tapes] == [2, 2]


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_an_invalid_density_is_an_error_when_questions_are_answered(value):
    density, none = torch.ones(1, 1, 8, 9), torch.zeros(1, 1, 8, 9, dtype=torch.int64)
    density[..., 3, 4] = value
    with pytest.raises(BudgetError, match="finite|negative"):
        allocate_counts(density, 72, none, 8, (0,))
    questions = Questions()
    counts = allocate_counts(unasked(density), 72, unasked(none), 8, (0,), questions)
    assert int(plain(counts).sum()) == 72
    assert plain(counts).amin() >= 0
    with pytest.raises(BudgetError, match="finite|negative"):
        questions.answer()


def test_a_budget_that_does_not_fit_keeps_within_the_limits_until_the_error():
    none, questions = unasked(torch.zeros(1, 1, 8, 9, dtype=torch.int64)), Questions()
    counts = allocate_counts(unasked(torch.ones(1, 1, 8, 9)), 1000, none, 8, (0,), questions)
    assert plain(counts).amax() == 8
    with pytest.raises(BudgetError, match="a budget of 1000 samples for 72 pixels does not fit"):
        questions.answer()


@pytest.mark.parametrize("power", [0, 1, 16, 64])
@pytest.mark.parametrize("spp", [0.1, 1.0, 4.0, 7.9])
def test_the_budget_is_exact_without_questions(power, spp):
    density = torch.rand(2, 1, 45, 61, generator=torch.Generator().manual_seed(0)) ** power
    low, total = torch.zeros(2, 1, 45, 61, dtype=torch.int64), round(spp * 45 * 61)
    counts = plain(allocate_counts(unasked(density), total, unasked(low), 8, (0, 1)))
    assert counts.flatten(1).sum(1).tolist() == [total, total]
    assert counts.amin() >= 0
    assert counts.amax() <= 8


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_new_pixels_get_the_same_quantile_without_questions(share):
    generator = torch.Generator().manual_seed(1)
    rule, known = (torch.rand(2, 1, 24, 30, generator=generator) for _ in range(2))
    similarity = (known < share).float()
    expected = mix_with_uniform(rule, similarity)
    assert torch.equal(plain(mix_with_uniform(unasked(rule), unasked(similarity))), expected)


def test_the_list_marks_rows_that_cannot_be_recorded():
    rows = {row["name"]: row for row in list_installed("methods")["methods"]}
    eager = {name for name, row in rows.items() if not row.get("recordable", True)}
    assert eager == {name for name in rows if name.startswith("oidn-intel")}
    assert "library" in rows["oidn-intel"]["eager_reason"]


def test_a_question_is_named_with_its_line(tmp_path, monkeypatch):
    target = "tests.checks.conformance.broken_fixtures:FAMILY"
    install_plugin(tmp_path, monkeypatch, "methods", f"faulty = {target}")
    result = run_check(MethodUnderTest("faulty/asks for a value"), "recordable")
    assert "broken_fixtures.py:" in result.found
    assert "eager_reason" in result.remedy


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name for name in RECORDABLE if not registry.get_variant(name).traits.adaptive]
)
def test_a_plan_that_no_frame_calls_is_one_graph_too(name):
    """Rows that sample uniformly have one, and a frame of theirs skips it."""
    method = registry.load_method(name, CPU)
    (frame,) = procedural_clip(3, Size(1, 36, 44), frames=1)
    valid, state = sanitize_frame(frame, method.traits.inputs), method.start(Size(1, 36, 44))
    torch._dynamo.reset()
    with torch.no_grad():
        explained = torch._dynamo.explain(method.plan)(valid.gbuffer, frame.pool.empty(), state)
    assert explained.graph_break_count == 0, explained.break_reasons
