"""The command denoise: frames of a renderer become images, by any row, on files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench.cli import options
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import CLIPS, METHODS, complete_methods, number, option


def denoise(
    source: Annotated[
        Path,
        typer.Argument(metavar="SEQUENCE", exists=True, help="folder of frames, or one image"),
    ],
    out: Annotated[
        Path, option(None, "folder of the images", "--out", "-o", value="FOLDER", file_okay=False)
    ],
    method: Annotated[
        str,
        option(METHODS, "the row", "--method", "-m", value="NAME", complete=complete_methods),
    ] = "accumulate/intel",
    layout: Annotated[
        str,
        option(
            CLIPS,
            "blender, falcor, unreal, mitsuba, oidn or a TOML file, as in rlbench import",
            "--layout",
            "--format",
            value="NAME|FILE",
        ),
    ] = "blender",
    spp: Annotated[
        float | None,
        option(
            CLIPS,
            "samples per pixel of each image; default: as its file says",
            value="SPP",
            min=1.0,
        ),
    ] = None,
    frames: Annotated[
        str | None, option(CLIPS, "frames before END; default: all", value="FIRST:END")
    ] = None,
    static: Annotated[
        bool, options.flag(CLIPS, "--static", "nothing moves; no motion vectors are read")
    ] = False,
    layer: Annotated[
        str, option(CLIPS, "layer to read where files have several, as Blender's", value="NAME")
    ] = "",
    exposure: Annotated[
        float | None,
        number(
            CLIPS,
            "radiance times this is 1 at display white; default: chosen from up to 8 frames",
            "FACTOR",
        ),
    ] = None,
    plugin: options.Plugins = None,
    weights: options.Weights = None,
    device: options.Device = "auto",
) -> None:
    """Denoise an animation or one image that another renderer wrote.

    The images keep the names, headers and all other channels of SEQUENCE: denoised radiance takes
    the place of the noisy one. Rows with a memory need motion vectors and follow them from frame to
    frame. Rows that place samples take those that are there. A killed command resumes: a frame is
    done again if its source is newer. Memory is that of one frame.

    Examples:

    \b
      rlbench denoise render/ -o denoised/
      rlbench denoise render/ -m accumulate/tuned --layout engine.toml --spp 4 -o denoised/
      rlbench denoise still.exr -m oidn -o denoised/
    """
    load_plugins(plugin)
    from rlbench import registry
    from rlbench.benchmark.api import select_device
    from rlbench.cli import console
    from rlbench.clips.importers.sequence import parse_frame_range
    from rlbench.denoise import check_denoises_means
    from rlbench.denoise_files import denoise_sequence, find_noisy_sequences
    from rlbench.system.paths import check_writable

    check_denoises_means(method)
    check_writable(out)
    chosen = select_device(device)
    traits = registry.get_variant(method).traits
    shots = find_noisy_sequences(
        source,
        layout,
        spp=spp,
        frames=parse_frame_range(frames) if frames else None,
        layer=layer,
        needs_motion="motion" in traits.inputs,
        is_static=static,
    )
    file = weights.file if weights else None
    label = f"{method} with {file}" if file else method
    loaded = registry.load_method(method, chosen, file)
    for note in _notes(method, shots[0].read_spp(0)):
        typer.echo(f"note: {note}")
    with console.counting("denoising", sum(map(len, shots))) as on_frame:
        summaries = [
            denoise_sequence(
                shot, loaded, label, out, exposure=exposure, device=chosen, on_frame=on_frame
            )
            for shot in shots
        ]
    for shot, summary in zip(shots, summaries, strict=True):
        count = f"{summary.written} frame{'s' * (summary.written != 1)}"
        typer.echo(
            f"{out}: '{shot.name}', {count} denoised by {label}, {summary.kept} were there before"
        )
        for note in shot.notes:
            typer.echo(f"  {note}")
        for image, pixels in sorted(summary.repairs.items()):
            typer.echo(f"  {image}: {pixels} invalid pixels were replaced")


def _notes(method: str, spp: float) -> list[str]:
    """What a user should know of a row on images of so many samples per pixel."""
    from rlbench import registry
    from rlbench.denoise import MAX_SLOTS

    variant = registry.get_variant(method)
    notes = []
    if variant.traits.adaptive:
        notes.append(f"{method} places samples; here it takes the same number in every pixel")
    trained = registry.get_variant(variant.weights_from or method)
    if variant.learned and not trained.trained_by and spp > MAX_SLOTS:
        notes.append(
            f"{method} was trained up to {MAX_SLOTS} spp, and these are {spp:g}; "
            "accumulate/intel has the weights of Open Image Denoise, which saw all"
        )
    return notes
