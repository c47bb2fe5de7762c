"""Recognize the dump of a known engine: a ready layout reads it, and no check fails."""

from __future__ import annotations

from pathlib import Path

from rlbench.checks.lint.checks import fit_depth
from rlbench.checks.lint.depth import check_depth
from rlbench.checks.lint.dump_arrays import import_arrays
from rlbench.checks.lint.motion import check_motion
from rlbench.checks.lint.normals import check_normals
from rlbench.checks.result import Verdict
from rlbench.clips.importers.layout import read_layout, ready_layouts
from rlbench.clips.importers.sequence import SourceError

__all__ = ["recognize_layout"]


def recognize_layout(source: Path) -> str | None:
    """The name of the ready layout that finds all its buffers in a dump; None if none does."""
    for name in ready_layouts():
        layout = read_layout(name)
        try:
            arrays = import_arrays(source, layout)
        except SourceError:
            continue
        if set(arrays.gbuffer) < {"albedo", "normal", "depth", "motion"} & set(layout.images):
            continue
        fits = fit_depth(arrays)
        results = [check_motion(arrays)] if "motion" in arrays.gbuffer else []
        results += [check_depth(arrays, fits)] if "depth" in arrays.gbuffer else []
        has_space = layout.normal is not None and layout.normal.space != "unknown"
        results += [check_normals(arrays, fits)] if has_space else []
        if all(result.verdict is not Verdict.FAILED for result in results):
            return name
    return None
