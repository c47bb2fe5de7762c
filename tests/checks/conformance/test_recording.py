"""RecordingMethod records what a method does and protects the caller from it."""

from __future__ import annotations

import pytest
import torch

from rlbench.checks.conformance.recording import RecordingMethod
from rlbench.checks.tensors import is_bit_equal, iterate_tensors
from rlbench.clips.procedural.clip import procedural_clip
from rlbench.frames import Size
from rlbench.run import run_clip
from tests.checks.conformance.broken_fixtures import Correct, WritesGBuffer, WritesSamples


def record(method) -> RecordingMethod:
    recording = RecordingMethod(method)
    list(run_clip(recording, procedural_clip(size=Size(1, 12, 16), frames=2), 1.0))
    return recording


def test_reads_densities_and_counts_are_recorded():
    recording = record(Correct())
    assert recording.buffers_read == {"albedo", "motion"}
    assert len(recording.densities) == len(recording.counts) == 2
    assert recording.modified == set()


@pytest.mark.parametrize(("kind", "name"), [(WritesSamples, "samples"), (WritesGBuffer, "albedo")])
def test_arguments_that_a_method_writes_to_are_recorded(kind, name):
    assert record(kind()).modified == {name}


def test_nan_is_bit_equal_to_nan_and_types_differ():
    nan = torch.tensor([1.0, torch.nan])
    assert is_bit_equal(nan, nan.clone())
    assert not is_bit_equal(nan, nan.double())


def test_tensors_of_a_nested_state_are_found():
    one, two = torch.zeros(1), torch.ones(1)
    assert [float(t) for t in iterate_tensors({"a": [one], "b": (two, "text")})] == [0.0, 1.0]
