"""Scenes without end: further clips are rendered beside a training, and replace its first ones.

    rlbench train -m ours --preset train-hard,train-eventful --render-ahead 1000

Which clips a sequence is cut from depends on its number alone, so that a resumed training has the
same ones: where a clip is not there yet, the training waits.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, cycle, zip_longest
from pathlib import Path

from rlbench.clips.header import FILE
from rlbench.clips.in_memory import InMemoryClip
from rlbench.clips.presets import find_preset, get_preset
from rlbench.clips.stored import open_clip
from rlbench.errors import OptionError
from rlbench.system import paths
from rlbench.system.process_settings import end_with_parent
from rlbench.training.batches import Batches
from rlbench.training.task import TrainingConfig, TrainingError

FIRST_SEED = 10_000  # of further clips; no preset has a seed so high
POLL_SECONDS = 0.5
LOG = "render.log"  # in the folder of a run: what the second process prints


@dataclass(frozen=True)
class FurtherClips:
    """Clips of generated presets beside those that a training begins with."""

    presets: tuple[str, ...]  # that take turns
    count: int  # of the clips of all presets

    def __post_init__(self) -> None:
        """Raise OptionError for a preset whose clips have no seeds."""
        for preset in self.presets:
            known = find_preset(preset)
            if known is None or not known.seeds:
                raise OptionError(
                    f"--render-ahead {self.count} renders further seeds of presets of generated "
                    f"scenes, such as train or train-hard, and '{preset}' is none. To train on it "
                    "too, name it with --clips"
                )

    def seeds(self, preset: str) -> range:
        """The seeds of the scenes of a preset, in the order of their use."""
        turn = self.presets.index(preset)
        return range(FIRST_SEED, FIRST_SEED + len(range(turn, self.count, len(self.presets))))

    @property
    def folders(self) -> list[Path]:
        """Where they lie in the cache, in the order of their use."""
        names = (get_preset(each).clip_names(seeds=self.seeds(each)) for each in self.presets)
        turns = chain.from_iterable(zip_longest(*names))
        presets = zip(cycle(self.presets), filter(None, turns), strict=False)
        return [paths.clips_folder() / preset / name for preset, name in presets]

    @contextmanager
    def rendered_beside(self, log: Path) -> Iterator[Callable[[Path], None]]:
        """Render what is missing, each preset in a process; the returned function waits for a clip.

        It raises TrainingError if the process ended without it.
        """
        with log.open("a") as output, ExitStack() as stack:
            processes = {}
            for preset in filter(self.seeds, self.presets):
                process = subprocess.Popen(
                    _command(self, preset),
                    stdout=output,
                    stderr=output,
                    preexec_fn=end_with_parent(),
                )
                processes[preset] = stack.enter_context(process)
                stack.callback(process.terminate)
            yield partial(_wait, processes, log)


def _command(further: FurtherClips, preset: str) -> list[str]:
    """The command that renders further clips of a preset, one after the other."""
    seeds = further.seeds(preset)
    words = ["render", "--preset", preset, "--seeds", f"{seeds.start}:{seeds.stop}"]
    return [sys.executable, "-m", "rlbench", *words]


def _wait(processes: Mapping[str, subprocess.Popen[bytes]], log: Path, folder: Path) -> None:
    while not (folder / FILE).is_file():
        process = processes[folder.parent.name]
        if process.poll() is not None and not (folder / FILE).is_file():
            raise TrainingError(
                f"clip {folder.name} was not rendered: the process that renders ahead ended with "
                f"code {process.returncode}, see {log}. The same command resumes the training"
            )
        time.sleep(POLL_SECONDS)


@dataclass
class RenewedBatches:
    """Batches in which a further clip replaces the oldest one every `interval` sequences."""

    first: Batches
    further: Sequence[Path]  # clip folders
    interval: int
    wait: Callable[[Path], None]  # until a clip is there
    _current: Batches = field(init=False)

    def __post_init__(self) -> None:
        """Begin with the first clips."""
        self._current = self.first

    def sequence(self, index: int) -> InMemoryClip:
        """As `Batches.sequence`."""
        done = self._count(index)
        clips = [*self.first.clips, *self.further][done : done + len(self.first.clips)]
        if clips != list(self._current.clips):
            for folder in clips:
                self.wait(folder)
            self._current = self._current.with_clips(clips)
        return self._current.sequence(index)

    def digests(self, sequences: int) -> list[str]:
        """Name and hash of each further clip that could be drawn in the first sequences."""
        drawn = self.further[: self._count(sequences - 1)] if sequences else ()
        clips = (open_clip(folder, frozenset()) for folder in drawn)
        return [f"{clip.name} {clip.digest[:12]}" for clip in clips]

    def _count(self, index: int) -> int:
        """The number of further clips that have been in use when a sequence is cut."""
        return min(index // self.interval, len(self.further))


@contextmanager
def renew(
    batches: Batches, further: FurtherClips | None, config: TrainingConfig, folder: Path
) -> Iterator[RenewedBatches]:
    """Batches whose clips are replaced by further ones, evenly over a training.

    The processes that render them log into `folder`. Without further clips there is none.
    """
    if further is None:
        yield RenewedBatches(batches, (), 1, lambda clip: None)
        return
    folder.mkdir(parents=True, exist_ok=True)
    sequences = config.frames // (config.batch * config.sequence_length)
    with further.rendered_beside(folder / LOG) as wait:
        interval = max(1, sequences // (further.count + 1))
        yield RenewedBatches(batches, further.folders, interval, wait)
