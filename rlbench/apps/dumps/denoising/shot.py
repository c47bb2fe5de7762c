"""Denoise the frames of a shot in order, and resume: mean images in, copies of their files out.

`record.py` tells which frames are finished. A method's state is written every 8
frames; a killed command begins at the last state, and without a state from the first frame, so that
its images are those of a command that was not killed.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from rlbench.apps.dumps.denoising.files import NoisySequence
from rlbench.apps.dumps.denoising.passes import DenoisedParts, denoise_parts
from rlbench.apps.dumps.denoising.record import (
    Files,
    Record,
    Settings,
    WrittenFrame,
    claim_frames,
    read_record,
)
from rlbench.denoise import DenoiseError
from rlbench.method import Method, State
from rlbench.ops.nested_tensors import read_leaves, replace_leaves
from rlbench.system.folder_lock import locked_folder
from rlbench.system.paths import atomic_write

__all__ = ["DenoisingSummary", "denoise_sequence"]

STATE_PERIOD = 8  # frames between two states on the disk


@dataclass
class DenoisingSummary:
    """What happened to the frames of one shot."""

    written: int = 0  # frames
    kept: int = 0  # frames that were there
    repairs: Counter[str] = field(default_factory=Counter)  # invalid pixels, by image
    notes: list[str] = field(default_factory=list)

    def count(self, repairs: Mapping[str, int]) -> None:
        """Add a written frame."""
        self.written += 1
        self.repairs.update(repairs)


def denoise_sequence(
    noisy: NoisySequence,
    method: Method,
    label: str,
    out: Path,
    *,
    exposure: float | None = None,
    device: torch.device | str = "cpu",
    on_frame: Callable[[], None] = lambda: None,
) -> DenoisingSummary:
    """Write the denoised frames that `out` lacks, or whose source changed; one frame in memory.

    `label` names the method and its weights. A method with a memory also writes all frames after
    the first that it lacks. Calls `on_frame` once for each frame that is read or there already.

    Raises DenoiseError where `out` holds frames of other settings, files that something else wrote,
    or the source; SourceError for files that cannot be read, FolderInUseError, and WriteError.
    """
    if out.resolve() == noisy.source.resolve():
        raise DenoiseError(f"{out} holds the noisy frames, which are never replaced; give another")
    with locked_folder(out, noisy.piece):
        shot = _Shot(noisy, method, out, device)
        summary = DenoisingSummary()
        record = shot.open_record(label, exposure, summary.notes)
        unfinished = [i for i in range(len(noisy)) if not shot.is_finished(record, i)]
        states: Mapping[str, State] = {}
        start = len(noisy)
        if unfinished and method.traits.temporal:
            start, states = shot.restore(record, unfinished[0])
            unfinished = list(range(unfinished[0], len(noisy)))
        shot.forget(record, unfinished)
        summary.kept = len(noisy) - noisy.start - sum(i >= noisy.start for i in unfinished)
        for index in range(len(noisy)):
            if index in unfinished or index >= start:
                source = Files.read(noisy.sources(index))
                found = shot.denoise(index, states, record.settings.exposure)
                states = found.states
                if index in unfinished:
                    images = None
                    if index >= noisy.start:
                        images = Files.read([noisy.write(index, out, found)])
                        summary.count(found.repairs)
                    record.frames[shot.key(index)] = WrittenFrame(source, images)
                    record.write(shot.record_file)
                if method.traits.temporal and not (index + 1) % STATE_PERIOD:
                    _save(states, shot.describe(record, index + 1), shot.state_file)
            on_frame()
        shot.state_file.unlink(missing_ok=True)
        return summary


@dataclass(frozen=True)
class _Shot:
    """A shot, the method that denoises it, and its files in the folder of images."""

    noisy: NoisySequence
    method: Method
    out: Path
    device: torch.device | str

    @property
    def record_file(self) -> Path:
        return self.out / f"{self.noisy.name}{self.noisy.piece}.denoise.json"

    @property
    def state_file(self) -> Path:
        return self.out / f"{self.noisy.name}{self.noisy.piece}.denoise-state.safetensors"

    def denoise(self, index: int, states: Mapping[str, State], exposure: float) -> DenoisedParts:
        """The images of a frame."""
        frame, parts = self.noisy.read(index), self.noisy.read_parts(index)
        return denoise_parts(self.method, frame, parts, states, exposure, self.device)

    def key(self, index: int) -> str:
        """The name of a frame in the record; frames before a piece have no image."""
        path = self.noisy.output(index, self.out).relative_to(self.out)
        return path.as_posix() if index >= self.noisy.start else f"before the piece: {path}"

    def open_record(self, label: str, exposure: float | None, notes: list[str]) -> Record:
        """The record with all frames of the shot. Raises DenoiseError (see `denoise_sequence`)."""
        noisy, before = self.noisy, None
        outputs = {self.key(i): [noisy.output(i, self.out)] for i in range(noisy.start, len(noisy))}
        known = self._read_other_pieces()
        if self.record_file.is_file():
            before, note = read_record(self.record_file)
            notes += [note] if note else []
            known |= before.frames if before else dict.fromkeys(outputs, WrittenFrame())
        exposure = exposure or (before.settings.exposure if before else None)
        settings = Settings(
            method=label,
            exposure=exposure or noisy.estimate_exposure(),
            spp=noisy.spp or "as the files say",
            static=noisy.is_static,
            also=", ".join(each.name for each in noisy.passes),
            first_frame=noisy.sequence.numbers[0] if self.method.traits.temporal else None,
            layout=sha256(noisy.sequence.convention.encode()).hexdigest()[:16],
        )
        if before and before.settings != settings:
            old, new = (dataclasses.asdict(each) for each in (before.settings, settings))
            key = next(key for key in new if new[key] != old[key])
            raise DenoiseError(
                f"{self.out} holds frames of '{noisy.name}' with the {key.replace('_', ' ')} "
                f"{old[key]!r}, now it is {new[key]!r}; write to another --out, or remove "
                f"{self.record_file.name} and the frames"
            )
        record = Record(settings, claim_frames(known, outputs, self.out))
        record.write(self.record_file)
        return record

    def _read_other_pieces(self) -> dict[str, WrittenFrame]:
        """The images of other pieces of the shot, or of the whole, which may be replaced."""
        known = dict[str, WrittenFrame]()
        name = re.compile(rf"{re.escape(self.noisy.name)}(\.\d+-\d+)?\.denoise\.json")
        for file in sorted(each for each in self.out.iterdir() if name.fullmatch(each.name)):
            if file != self.record_file and (record := read_record(file)[0]):
                known |= {
                    key: WrittenFrame(images=frame.images) for key, frame in record.frames.items()
                }
        return known

    def is_finished(self, record: Record, index: int) -> bool:
        """Whether a frame was written, and neither its sources nor its image changed."""
        frame = record.frames.get(self.key(index))
        if not frame or not frame.source or not frame.source.are_still(self.noisy.sources(index)):
            return False
        if index < self.noisy.start:
            return True
        return bool(frame.images and frame.images.are_still([self.noisy.output(index, self.out)]))

    def forget(self, record: Record, unfinished: list[int]) -> None:
        """Mark frames as not written, so that a killed command writes all of them."""
        if unfinished:
            record.frames |= {self.key(index): WrittenFrame() for index in unfinished}
            record.write(self.record_file)

    def describe(self, record: Record, following: int) -> dict[str, Any]:
        """What a state on the disk belongs to."""
        return {"next": following, **dataclasses.asdict(record.settings)}

    def restore(self, record: Record, first: int) -> tuple[int, Mapping[str, State]]:
        """The frame to begin with, `first` or one before it, and the states before that frame.

        Without a state of these settings, or where the method's state has another structure now,
        that is the first frame of the shot, and a state of frames that changed is removed.
        """
        with (
            suppress(OSError, SafetensorError, LookupError, ValueError),
            safe_open(self.state_file, "pt", str(self.device)) as stored,
        ):
            words = stored.metadata()
            before = json.loads(words["settings"])
            start = before["next"]
            if before == self.describe(record, start) and start <= first:
                leaves = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
                like = self.denoise(start - 1, {}, record.settings.exposure).states
                leaves |= json.loads(words["numbers"])
                if all(_is_alike(leaf, leaves.get(path)) for path, leaf in read_leaves(like)):
                    return start, replace_leaves(like, leaves)
        self.state_file.unlink(missing_ok=True)
        return 0, {}


def _save(states: Mapping[str, State], settings: Mapping[str, Any], file: Path) -> None:
    """Write states; those of parts that are unknown are not written."""
    with suppress(TypeError):
        leaves = dict(read_leaves(states))
        tensors = {
            path: leaf.cpu().clone(memory_format=torch.contiguous_format)
            for path, leaf in leaves.items()
            if isinstance(leaf, torch.Tensor)
        }
        numbers = {path: leaf for path, leaf in leaves.items() if path not in tensors}
        words = {"numbers": json.dumps(numbers), "settings": json.dumps(settings)}
        with atomic_write(file) as path:
            save_file(tensors, path, words)


def _is_alike(leaf: Any, other: Any) -> bool:
    """Whether one leaf of a state can take the place of another."""
    if not isinstance(leaf, torch.Tensor):
        return type(leaf) is type(other)
    is_tensor = isinstance(other, torch.Tensor)
    return is_tensor and leaf.shape == other.shape and leaf.dtype == other.dtype
