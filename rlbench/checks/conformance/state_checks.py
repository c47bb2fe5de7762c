"""Claims of memory: what a method remembers is its state, all of it, and of this clip alone."""

from __future__ import annotations

from itertools import chain, zip_longest

import torch
from torch import Tensor

from rlbench.checks.conformance import clips as worlds
from rlbench.checks.conformance.interface_checks import unsound
from rlbench.checks.conformance.method_under_test import MethodUnderTest
from rlbench.checks.conformance.recording import RecordingMethod, same
from rlbench.checks.conformance.replay import Replayed, ReplayFromCopy
from rlbench.checks.result import Finding, moot, wrong
from rlbench.run import run_clip

CLOSE = 1e-3  # relative and absolute: convolutions add in another order for another batch, and
# float32 goes through some 20 of them


def repeats(subject: MethodUnderTest) -> Finding | None:
    """Randomness is seeded by what the method is given."""
    again = subject.run(subject.world())
    if all(map(same, subject.default_run.images, again.images)):
        return None
    return wrong(f"images differ by up to {_apart(subject.default_run.images, again.images):g}")


def alone(subject: MethodUnderTest) -> Finding | None:
    """Another clip that is shown in between is not seen."""
    clips = [subject.small(seed) for seed in (worlds.SEED, worlds.OTHER)]
    wanted = [subject.run(clip).images for clip in clips]
    turns = zip_longest(*(subject.begun(clip)[0] for clip in clips))
    found = [shown.image for shown in chain.from_iterable(turns)]
    if all(same(image, wanted[i % 2][i // 2]) for i, image in enumerate(found)):
        return None
    return wrong("frames of one clip change what is shown of the other")


def batch(subject: MethodUnderTest) -> Finding | None:
    """Each clip alone is given the counts of the pair, since a density's last bit decides them."""
    pair = subject.world(n=2)
    both = subject.run(pair)
    for i in range(2):
        watched = RecordingMethod(subject.method)
        replayed = Replayed(watched, [counts[i : i + 1] for counts in both.watched.counts])
        single = worlds.clip_of([worlds.only(frame, i) for frame in pair])
        apart = [shown.image for shown in run_clip(replayed, single, subject.budget)]
        wished = [each[i : i + 1] for each in both.watched.densities]
        for what, together, each in (
            ("images", [image[i : i + 1] for image in both.images], apart),
            ("densities", wished, watched.densities),
        ):
            if not all(map(_close, together, each)):
                far = _apart(together, each)
                told = f"{what} of clip {i} of 2 differ by up to {far:g} from those of it alone"
                return wrong(told)
    return None


def static(subject: MethodUnderTest) -> Finding | None:
    """Its view has no motion, and `view.motion` is None."""
    why = unsound(subject.run(subject.small(static=True)).shown)
    return wrong(why) if why else None


def cut(subject: MethodUnderTest) -> Finding | None:
    """All motion leads outside: what is shown is what a first frame would be."""
    *before, last = subject.small()
    first = worlds.cut(last)
    after = subject.run(worlds.clip_of([*before, first]))
    fresh = subject.run(worlds.clip_of([first]))
    if same(after.images[-1], fresh.images[0]):
        return None
    far = _apart(after.images[-1:], fresh.images)
    return wrong(f"its first image differs by up to {far:g} with another shot before it")


def temporal(subject: MethodUnderTest) -> Finding | None:
    """Without memory the order of frames is nothing."""
    if subject.traits.temporal:
        return moot("it declares that it remembers")
    last = worlds.clip_of([subject.default_run.shown[-1].frame])
    if same(subject.run(last).images[0], subject.default_run.images[-1]):
        return None
    return wrong("an image depends on the frames before it")


def replay(subject: MethodUnderTest) -> Finding | None:
    """Stress tests swap, corrupt and reset the state; latency takes it again."""
    rewound = ReplayFromCopy(RecordingMethod(subject.method))
    try:
        list(run_clip(rewound, subject.small(), subject.budget))
    except Exception as error:  # of copying, for it ran before
        return wrong(f"{type(error).__name__}: {error}", error)
    told = f"{' and '.join(sorted(rewound.changed))} of one frame, asked for again, differ"
    return wrong(told) if rewound.changed else None


def _close(one: Tensor, two: Tensor) -> bool:
    if one.shape != two.shape:
        return False
    return torch.allclose(one.double(), two.double(), rtol=CLOSE, atol=CLOSE, equal_nan=True)


def _apart(some: list[Tensor], others: list[Tensor]) -> float:
    """The largest difference, NaN where shapes differ."""
    pairs = list(zip(some, others, strict=True))
    if any(one.shape != two.shape for one, two in pairs):
        return float("nan")
    return max(float((one - two).abs().max()) for one, two in pairs)
