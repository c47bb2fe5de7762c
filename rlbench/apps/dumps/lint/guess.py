"""Guess the layout of a dump: a ready one that reads it, or names and the readings that fit best.

Names say what the images are. The files are imported in memory as if they kept the conventions of a
clip; the checks of a clip then say which other reading fits better, and by how much.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from rlbench.apps.dumps.importers.file_pattern import match_pattern
from rlbench.apps.dumps.importers.jitter import read_offsets
from rlbench.apps.dumps.importers.layout import (
    Camera,
    Layout,
    decode_layout,
    read_layout,
    ready_layouts,
)
from rlbench.apps.dumps.importers.limits import list_files
from rlbench.apps.dumps.lint.checks import fit_depth
from rlbench.apps.dumps.lint.clip_arrays import ClipArrays, import_arrays
from rlbench.apps.dumps.lint.dump_names import find_named_images, list_unclaimed
from rlbench.apps.dumps.lint.edges import (
    MAX_GAMMA,
    MIN_PAIRS,
    STORED,
    colour_slopes,
    correlate_orientations,
    misoriented,
)
from rlbench.apps.dumps.lint.geometry import VIEW_DEPTH, check_depth, check_normals
from rlbench.apps.dumps.lint.jitter import find_jitter_fault, frame_disagreements
from rlbench.apps.dumps.lint.motion import (
    FORMAT_V1,
    MARGIN_OPPOSITE,
    MIN_EXPLAINED,
    check_motion,
    format_share,
    rank_conventions,
)
from rlbench.apps.dumps.lint.radiance import local_mean, ratio_of_sums
from rlbench.checks.result import Verdict
from rlbench.errors import SourceError
from rlbench.system.documents import to_toml

SURE, LIKELY = 0.1, 0.03  # leads over the next reading
TO_PREVIOUS = FORMAT_V1.direction
PERIODS = (8, 16, 32)  # of the jitter of engines
Y_AXES: tuple[Literal["down", "up"], ...] = ("down", "up")
MAX_JITTER_ERROR = 0.4  # of the jitter's change that a sequence does not explain
MIN_EDGES = 16  # pixels of partial alpha that decide how colours are stored
MEANS = 0.4  # of the noise that a mean of two loses: less is lost by chance
DEMODULATED = 0.5  # of the deviation from the reference that is left after a product with albedo
FLIPS = {
    "upside down": "vertical",
    "mirrored left to right": "horizontal",
    "rotated by 180 degrees": "both",
}
KINDS = {  # of depth: the reading, and the word of a layout
    VIEW_DEPTH: "view",
    "distance to the camera": "distance",
    "inverse depth 1 / z": "inverse",
    "z-buffer (0 near, 1 far)": "z-buffer",
}
Tables = dict[str, Any]


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


class Guess(NamedTuple):
    """A guessed layout, and for each table how sure it is and why."""

    tables: Tables
    reasons: dict[str, str]


def guess_layout(source: Path) -> Guess:
    """The layout of a dump of EXR files, as far as names and readings show it.

    Raises SourceError where no radiance or no frame is found.
    """
    tables: Tables = {name: image.to_table() for name, image in find_named_images(source).items()}
    emission = tables.pop("emission", None)
    reasons = {name: "by its names" + _hint(name, tables) for name in tables}
    for name, reason in (_read_counts(source, tables) | _read_dashes(source, tables)).items():
        reasons[name] += f"; {reason}"
    for name, reason in _read_alpha(source, tables).items():
        reasons[name] += f"; {reason}"
    steps: list[Callable[[ClipArrays, Tables], dict[str, str]]] = [
        _read_background,
        _read_flips,
        _read_encodings,
        _read_depth,
        _read_motion,
        _read_handedness,
        _read_normal_space,
        _read_demodulation,
    ]
    for step in steps:  # each sees what those before it found
        arrays = import_arrays(source, decode_layout(tables, "guess"))
        for name, reason in step(arrays, tables).items():
            reasons[name] += f"; {reason}"
    for name, reason in _read_jitter(source, tables).items():
        reasons[name] = f"{reasons[name]}; {reason}" if name in reasons else reason
    if emission and tables["radiance"].get("demodulated"):  # other radiance holds it already
        tables["emission"] = emission
        reasons["emission"] = "by its names; added, because a product with albedo lacks it"
    return Guess(tables, reasons)


def _hint(name: str, tables: Tables) -> str:
    """What the names alone say of an image."""
    if name == "radiance" and "reference" not in tables:
        return "; no image looks like a reference, so nothing can be scored"
    if name == "depth" and "devicez" in str(tables["depth"]).lower():
        return (
            "; DeviceZ is a z-buffer, in engines a reversed one: write kind = 'reversed z-buffer' "
            "and near, the distance of the near plane"
        )
    return ""


def format_guess(guess: Guess) -> str:
    """A TOML document with the reasons as comments."""
    lines = ["# Guessed by rlbench lint --guess: correct what it is not sure of."]
    for name, table in guess.tables.items():
        comment = "\n".join(f"# {reason}" for reason in guess.reasons[name].split("; "))
        lines.append(f"\n{comment}\n{to_toml({name: table}).strip()}")
    return "\n".join(lines) + "\n"


def format_unclaimed(source: Path, layout: Layout) -> str:
    """Comments that list the channels which the layout does not read; empty where none is."""
    lines = list_unclaimed(source, layout)
    lines += [
        f"{path.relative_to(source)}: the jitter of the camera? Write [camera] with jitter = this "
        "file, x and y of each frame on a line"
        for path in list_files(source)
        if "jitter" in path.name.lower() and layout.camera is None
    ]
    head = "\n# Not read:\n" if lines else ""
    return head + "".join(f"# {line}\n" for line in lines)


def _read_counts(source: Path, tables: Tables) -> dict[str, str]:
    """Keys of the layout that say whether images are means of the first samples or single samples.

    Of two samples both are as noisy; a mean of two varies half as much as the first of them.
    """
    pattern = tables["radiance"]["files"]
    if "{spp}" not in pattern or "{sample}" in pattern:
        return {}
    paths = (path.relative_to(source) for path in list_files(source))
    counts = {key.spp for path in paths if (key := match_pattern(pattern, path))}
    numbered = {
        name: {**table, "files": table["files"].replace("{spp}", "{sample}")}
        for name, table in tables.items()
        if name != "reference"
    }
    found = "names count spp"
    if 0 in counts:
        tables.update(numbered)
        return {"radiance": "likely: separate samples, because they are numbered from 0"}
    if counts >= {1, 2}:
        arrays = import_arrays(source, decode_layout({**tables, **numbered}, "guess"))
        value, error = _lost_noise(arrays.pools["path"])
        found = f"the second loses {value:.2f} +- {error:.2f} of the noise that a mean loses"
        if value < MEANS:
            tables.update(numbered)
            return {"radiance": f"{_sureness(MEANS - value)}: separate samples, because {found}"}
    tables["radiance"]["samples"] = "accumulated"
    return {"radiance": f"means of the first samples, because {found}"}


def _lost_noise(pool: Float[Tensor, "t s 3 h w"]) -> tuple[float, float]:
    """Variance of the first image minus that of the second, over that of their difference.

    0 for two samples, and 1 for a sample and its mean with another one; with a standard error.
    Nothing is compared with the reference, which may be flipped, or other light.
    """
    level = local_mean(pool.mean(1))[:, None]
    bounded = pool / (pool + level)
    first, *others = (image - local_mean(image) for image in bounded.unbind(1))
    if not others:
        return 1.0, 0.0
    second = others[0]
    return ratio_of_sums(first.square() - second.square(), (first - second).square())


def _read_alpha(source: Path, tables: Tables) -> dict[str, str]:
    """Keys of the layout that say whether colours are multiplied by alpha, where it is partial.

    A pixel of alpha a between a surface F and what is behind it, B, is a F + (1 - a) B if colours
    are multiplied (or alpha is a mask beside a whole image), and F if they are not.
    """
    reasons = {}
    stored = import_arrays(source, decode_layout(tables, "guess"))
    for name in {"reference", "radiance"} & tables.keys():
        changed = {**tables, name: {**tables[name], "alpha": "straight"}}
        try:
            arrays = import_arrays(source, decode_layout(changed, "guess"))
        except SourceError:  # it has no channel A
            continue
        colour, product = (
            (each.reference if name == "reference" else each.pools["path"].mean(1)).mean(1, True)
            for each in (stored, arrays)
        )
        found = colour > 0
        alpha = (product / colour.where(found, 1.0)).where(found, 0.0)
        surface, behind = (
            local_mean(colour * mask) / local_mean(mask.float()).clamp_min(1e-6)
            for mask in (found & (alpha > 0.999), alpha < 0.001)
        )
        edge = found & (alpha > 0.05) & (alpha < 0.95) & (surface > 0)
        over = (alpha * surface + (1 - alpha) * behind).clamp_min(1e-9)
        errors = [
            float((colour / model.clamp_min(1e-9))[edge].log().abs().median())
            for model in (surface, over)
        ]
        hidden = float((found & (alpha < 0.001)).float().mean())
        if int(edge.sum()) >= MIN_EDGES and errors[0] < 0.5 * errors[1]:
            tables[name]["alpha"] = "straight"
            factors = " against ".join(f"{math.exp(error):.2f}" for error in errors)
            reasons[name] = f"likely: not multiplied by alpha, edges differ by {factors}"
        elif hidden > 0:
            reasons[name] = f"{hidden:.0%} of the pixels have colour at alpha 0, which is kept"
    return reasons


def _read_dashes(source: Path, tables: Tables) -> dict[str, str]:
    """Remarks on a - before all frame numbers, read as a dash: it could be a sign."""
    found = {name: table["files"] for name, table in tables.items() if "-{frame}" in table["files"]}
    return {
        name: f"unsure: the - before frames is read as a dash; write {files.replace('-{', '{')} if "
        "they are negative"
        for name, files in found.items()
    }


def _read_background(arrays: ClipArrays, tables: Tables) -> dict[str, str]:
    """A far value or 0 in place of infinity; a sign that is negative."""
    if "depth" not in arrays.gbuffer:
        return {}
    depth = arrays.gbuffer["depth"]
    finite = depth[depth.isfinite()]
    reasons = []
    if float((finite < 0).float().mean()) > 0.5:
        tables["depth"]["scale"] = -1.0
        reasons.append("sure: nearly all values are negative")
    if float((finite == 0).float().mean()) > 0:
        tables["depth"]["background"] = 0.0
        reasons.append("likely: 0 is background")
    largest = float(finite.abs().max()) if len(finite) else 0.0
    share = float((finite.abs() == largest).float().mean()) if len(finite) else 0.0
    if largest > 1 and share > 1e-3 and largest > 4 * float(finite.abs().median()):
        tables["depth"]["far"] = math.copysign(largest * 0.999, float(finite.median()))
        reasons.append(f"likely: the largest value, {largest:.3g}, fills {share:.1%} of the pixels")
    return {"depth": "; ".join(reasons)} if reasons else {}


def _read_flips(arrays: ClipArrays, tables: Tables) -> dict[str, str]:
    correlations = correlate_orientations(arrays)
    reasons = {}
    for name, way in misoriented(correlations).items():
        table = "radiance" if name.startswith("pool") else name
        lead = correlations[name][way] - correlations[name][STORED]
        tables[table]["flip"] = FLIPS[way]
        reasons[table] = (
            f"{_sureness(lead)}: {way}, edges correlate by {lead:.2f} more than as it is"
        )
    return reasons


def _read_encodings(arrays: ClipArrays, tables: Tables) -> dict[str, str]:
    reasons = {}
    if "normal" in arrays.gbuffer and float(arrays.gbuffer["normal"].min()) >= 0:
        tables["normal"]["encoded"] = True
        reasons["normal"] = "likely: encoded as (n + 1) / 2, because no component is negative"
    slopes = colour_slopes(arrays)
    if len(slopes) >= MIN_PAIRS and (gamma := float(slopes.median())) > MAX_GAMMA:
        tables["albedo"]["encoding"] = "srgb"
        reasons["albedo"] = f"likely: colours of radiance vary as those of albedo ^ {gamma:.2f}"
    return reasons


def _read_depth(arrays: ClipArrays, tables: Tables) -> dict[str, str]:
    fits = {kind: fit for kind, fit in fit_depth(arrays).items() if kind in KINDS}
    if len(fits) < 2:
        return {}
    first, second = sorted(fits.values(), key=lambda fit: fit.residual)[:2]
    lead = 1 - first.residual / max(second.residual, 1e-9)
    tables["depth"]["kind"] = KINDS[first.kind]
    fov = math.degrees(2 * math.atan(0.5 / first.focal))
    if first.kind.startswith("distance"):
        tables["depth"]["fov"] = round(fov, 1)
    if first.kind.startswith("z-buffer"):
        tables["depth"]["near"] = 1.0
    angles = (
        f"{math.degrees(first.residual):.1f} against {math.degrees(second.residual):.1f} degrees"
    )
    reason = f"{_sureness(lead)}: {first.kind} fits the normals within {angles} as {second.kind}"
    return {"depth": f"{reason}; field of view about {fov:.0f} degrees"}


def _read_motion(arrays: ClipArrays, tables: Tables) -> dict[str, str]:
    if "motion" not in arrays.gbuffer or len(arrays) < 2:
        return {}
    reasons = []
    middle = float(arrays.gbuffer["motion"].median())
    if 0.4 < middle < 0.6 and float(arrays.gbuffer["motion"].min()) >= 0:
        tables["motion"]["offset"] = 0.5
        shifted = {**arrays.gbuffer, "motion": arrays.gbuffer["motion"] - 0.5}
        arrays = ClipArrays(arrays.header, shifted, arrays.pools, arrays.half_a, arrays.half_b)
        reasons.append("likely: 0.5 is not motion")
    shares = dict(rank_conventions(arrays))
    best = next(iter(shares))
    if shares[best] < MIN_EXPLAINED:
        found = f"no convention explains more than {format_share(shares[best])} of the change"
        return {"motion": f"unknown: {found}"}
    if shares[best] - shares.get(best.opposite, -math.inf) < MARGIN_OPPOSITE:
        best = max(best, best.opposite, key=lambda each: each.direction == TO_PREVIOUS)
    best.write_to(tables["motion"])
    other = next(each for each in shares if each not in (best, best.opposite))
    share, next_share = shares[best], shares[other]
    reasons.append(
        f"{_sureness(share - next_share)}: {best} explains {format_share(share)} of the change "
        f"between frames, next best {format_share(next_share)} as {other}"
    )
    return {"motion": "; ".join(reasons)}


def _read_jitter(source: Path, tables: Tables) -> dict[str, str]:
    """The table `camera` of the layout, if motion contains the jitter of a Halton sequence."""
    layout = decode_layout(tables, "guess")
    arrays = import_arrays(source, layout)
    if "motion" not in arrays.gbuffer or not find_jitter_fault(arrays):
        return {}
    indices, changes = [], []
    for start in (0, *(period - 1 for period in PERIODS if arrays.header.frames > period)):
        part = import_arrays(source, layout, start) if start else arrays
        found, _ = frame_disagreements(part, list(range(1, len(part))))
        indices += [start + t for t in range(1, len(part))]
        changes += [-found]
    measured = torch.cat(changes)
    cameras = [
        Camera(jitter=f"halton {period}", first=first, scale=scale, y=y)
        for period, scale, y in product(PERIODS, (1.0, -1.0), Y_AXES)
        for first in range(period)
    ]

    def error(camera: Camera) -> float:
        offset = read_offsets(camera, source)
        expected = [[a - b for a, b in zip(offset(i), offset(i - 1), strict=True)] for i in indices]
        return float((measured - torch.tensor(expected)).norm() / measured.norm())

    best = min(cameras, key=error)
    if (left := error(best)) > MAX_JITTER_ERROR:
        return {
            "motion": "unsure: it seems to contain the jitter of the camera, of no Halton sequence "
            "of bases 2 and 3; write jittered = true, and [camera] with jitter = a file of offsets"
        }
    tables["motion"]["jittered"] = True
    tables["camera"] = {
        key: value for key, value in asdict(best).items() if value != getattr(Camera, key, None)
    }
    reason = (
        f"likely: motion differs by the change of this jitter from the reference, within {left:.0%}"
    )
    return {"motion": "likely: contains the jitter of [camera]", "camera": reason}


def _read_handedness(arrays: ClipArrays, tables: Tables) -> dict[str, str]:
    if "normal" not in arrays.gbuffer:
        return {}
    result = check_normals(arrays, fit_depth(arrays))
    if result.verdict is Verdict.FAILED and result.found.startswith("mirrored"):
        tables["normal"]["axes"] = ["x", "-y", "z"]  # negating another one only rotates the world
        return {"normal": "likely: mirrored, as in a left-handed world"}
    return {}


def _read_normal_space(arrays: ClipArrays, tables: Tables) -> dict[str, str]:
    if "normal" not in arrays.gbuffer:
        return {}
    result = check_normals(arrays, fit_depth(arrays))
    if result.verdict is Verdict.FAILED and result.found.startswith("in camera space"):
        tables["normal"]["space"] = "view"
        return {"normal": f"sure: {result.found}; add `camera`, a file of matrices, to rotate them"}
    return {
        "normal": f"{'likely' if result.verdict is Verdict.PASSED else 'unsure'}: {result.found}"
    }


def _read_demodulation(arrays: ClipArrays, tables: Tables) -> dict[str, str]:
    """Keys of the layout, if albedo times the mean of the samples is nearer to the reference."""
    if "albedo" not in arrays.gbuffer or "reference" not in tables:
        return {}
    mean, reference = local_mean(arrays.pools["path"].mean(1)), local_mean(arrays.reference)
    errors = [
        float((image / reference).log().abs().median())
        for image in (mean, local_mean(arrays.pools["path"].mean(1) * arrays.gbuffer["albedo"]))
    ]
    if errors[1] > DEMODULATED * errors[0]:
        return {}
    tables["radiance"]["demodulated"] = True
    factors = [f"{math.exp(error):.2f}" for error in errors]
    found = f"differ from the reference by a factor of {factors[1]} after a product with albedo"
    return {"radiance": f"likely: demodulated, samples {found}, of {factors[0]} before"}


def _sureness(lead: float) -> str:
    return "sure" if lead > SURE else "likely" if lead > LIKELY else "unsure"
