"""The command denoise: frames of a renderer become images, by any row, on files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rlbench.apps.dumps.denoising import UNKNOWN_SPP, WARM_UP
from rlbench.cli import options
from rlbench.cli.methods import load_plugins
from rlbench.cli.options import CLIPS, METHODS, complete_methods, number, option

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch

    from rlbench.apps.dumps.denoising.files import NoisySequence
    from rlbench.method import Method

DEFAULT_METHOD = "accumulate/intel"  # of frames with motion vectors
DEFAULT_ALONE = "oidn"  # of one image, and of frames that do not belong together
LARGE = 2**31  # bytes of memory that are worth a note

Images = Annotated[
    str | None,
    option(CLIPS, "its files, where they are not in those of SEQUENCE", value="FILES"),
]


def denoise(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SEQUENCE",
            help="a folder of frames, one image, or a pattern of names such as color.####.exr",
        ),
    ],
    out: Annotated[
        Path, option(None, "folder of the images", "--out", "-o", value="FOLDER", file_okay=False)
    ],
    method: Annotated[
        str | None,
        option(
            METHODS,
            f"the row; default: {DEFAULT_METHOD}, or {DEFAULT_ALONE} for one image and for frames "
            "without motion vectors or with gaps",
            "--method",
            "-m",
            value="NAME",
            complete=complete_methods,
        ),
    ] = None,
    albedo: Images = None,
    normal: Images = None,
    also: Annotated[
        str | None,
        option(
            CLIPS,
            "passes or light groups of the same files, which add up to the image: Emit,Volume or "
            "LIGHT*COLOUR; Blender's DiffDir finds its DiffCol",
            value="PASS,...",
        ),
    ] = None,
    frames: Annotated[
        str | None, option(CLIPS, "frames before END; default: all", value="FIRST:END")
    ] = None,
    warm_up: Annotated[
        int,
        option(
            CLIPS,
            "frames before FIRST that fill the memory, and are not written",
            value="N",
            min=0,
        ),
    ] = WARM_UP,
    spp: Annotated[
        float | None,
        option(
            CLIPS,
            "samples per pixel of each image; default: as its file says, else "
            f"{UNKNOWN_SPP:g} is taken",
            value="SPP",
            min=1.0,
        ),
    ] = None,
    layout: Annotated[
        str,
        option(
            CLIPS,
            "blender, falcor, unreal, mitsuba, oidn or a TOML file, as in rlbench import; "
            "default: Blender's passes where files have them, else R, G, B",
            "--layout",
            "--format",
            value="NAME|FILE",
        ),
    ] = "",
    depth: Images = None,
    motion: Annotated[
        str | None,
        option(
            CLIPS,
            "its files: pixels to the frame before, x right, y down (others: --layout)",
            value="FILES",
        ),
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
    weights: options.Weights = options.SHIPPED,
    backend: Annotated[
        options.BackendName | None,
        option(
            METHODS,
            "what runs networks, as in rlbench run; default: auto on a GPU, eager on a processor",
        ),
    ] = None,
    device: options.Device = "auto",
) -> None:
    """Denoise an animation or one image that another renderer wrote.

    The images keep the names, headers and all other channels of SEQUENCE: denoised radiance takes
    the place of the noisy one. Rows with a memory need motion vectors and follow them from frame to
    frame. Rows that place samples take those that are there. A killed command resumes: a frame is
    done again if its source changed. Memory is that of one frame. FILES are a file, a folder or a
    pattern of names; FILES:LAYER reads one layer of them.

    Examples:

    \b
      rlbench denoise render/ -o denoised/
      rlbench denoise color.exr --albedo albedo.exr --normal normal.exr -o denoised/
      rlbench denoise color.####.exr --albedo albedo.####.exr --normal normal.####.exr -o denoised/
      rlbench denoise render/ --frames 120:240 -o denoised/
      rlbench denoise render/ --also DiffDir,DiffInd,GlossDir,GlossInd,Emit,Env -o denoised/
      rlbench denoise render/ --backend openvino -o denoised/
      rlbench denoise render/ -m accumulate/tuned --layout engine.toml --spp 4 -o denoised/
    """
    load_plugins(plugin)
    from rlbench import registry
    from rlbench.apps.dumps.denoising.shot import denoise_sequence
    from rlbench.apps.dumps.importers.sequence import parse_frame_range
    from rlbench.backends import EAGER, use_backend
    from rlbench.benchmark.clock import SystemClock
    from rlbench.benchmark.planning import select_device
    from rlbench.cli import console
    from rlbench.system.paths import check_writable

    check_writable(out)
    chosen = select_device(device)
    images = {"albedo": albedo, "normal": normal, "depth": depth, "motion": motion}
    method, shots = _find(
        method,
        source,
        layout,
        others={name: each for name, each in images.items() if each},
        spp=spp,
        frames=parse_frame_range(frames) if frames else None,
        warm_up=warm_up,
        layer=layer,
        is_static=static,
        passes=[name.strip() for name in also.split(",")] if also else (),
    )
    label = f"{method} with {weights.file}" if weights.file else method
    loaded = registry.load_method(method, chosen, weights.file)
    if (runs_by := _choose_backend(method, backend, chosen)) != EAGER:
        loaded, label = use_backend(loaded, runs_by, chosen), f"{label} on {runs_by}"
    for note in (*_notes(method, shots[0]), *_check_memory(method, loaded, shots)):
        typer.echo(f"note: {note}")
    clock = SystemClock(chosen)
    began = clock.wall_ms()
    with console.counting("denoising", sum(map(len, shots))) as on_frame:
        summaries = [
            denoise_sequence(
                shot, loaded, label, out, exposure=exposure, device=chosen, on_frame=on_frame
            )
            for shot in shots
        ]
    seconds = (clock.wall_ms() - began) / 1e3
    for shot, summary in zip(shots, summaries, strict=True):
        count = f"{summary.written} frame{'s' * (summary.written != 1)}"
        typer.echo(
            f"{out}: '{shot.name}', {count} denoised by {label}, {summary.kept} were there before"
        )
        for note in (*summary.notes, *shot.notes):
            typer.echo(f"  {note}")
        for image, pixels in sorted(summary.repairs.items()):
            typer.echo(f"  {image}: {pixels} invalid pixels were replaced")
    if written := sum(summary.written for summary in summaries):
        typer.echo(f"{written / seconds:.2g} frames a second, with reading and writing files")


def _choose_backend(method: str, backend: str | None, device: torch.device) -> str:
    """The backend that the row uses where this one is asked for, or none is."""
    from rlbench import registry
    from rlbench.backends import AUTO, EAGER, applicable_backend, select_backend

    name = backend or (AUTO if device.type == "cuda" else EAGER)
    return applicable_backend(select_backend(name, device), registry.get_variant(method))


def _find(
    method: str | None, source: str, layout: str, **selection: Any
) -> tuple[str, list[NoisySequence]]:
    """The row, by default one that suits the files, and the shots."""
    from rlbench import registry
    from rlbench.apps.dumps.denoising.files import GapError, NoMotionError, find_noisy_sequences
    from rlbench.denoise import check_denoises_means

    def find(name: str) -> list[NoisySequence]:
        check_denoises_means(name)
        traits = registry.get_variant(name).traits
        return find_noisy_sequences(
            source,
            layout,
            needs_motion="motion" in traits.inputs,
            has_memory=traits.temporal,
            **selection,
        )

    if method:
        return method, find(method)
    try:
        shots = find(DEFAULT_METHOD)
    except (GapError, NoMotionError) as error:
        typer.echo(f"note: each frame is denoised on its own, by {DEFAULT_ALONE}: {error}")
        return DEFAULT_ALONE, find(DEFAULT_ALONE)
    if all(len(shot) == 1 for shot in shots):
        return DEFAULT_ALONE, find(DEFAULT_ALONE)
    return DEFAULT_METHOD, shots


def _check_memory(name: str, method: Method, shots: Sequence[NoisySequence]) -> list[str]:
    """How much memory large frames take. Raises DenoiseError where there is not enough."""
    from rlbench.denoise import DenoiseError, estimate_memory
    from rlbench.system.memory import available_memory

    sizes = [(shot.sequence.height, shot.sequence.width) for shot in shots]
    h, w = max(sizes, key=lambda size: size[0] * size[1])
    needed, free = estimate_memory(method, h, w), available_memory()
    need = f"frames of {w}x{h} take about {needed / 2**30:.1f} GB of memory by {name}"
    if free is not None and needed > free:
        hint = f"; -m {DEFAULT_ALONE} works in tiles" * method.traits.temporal
        raise DenoiseError(f"{need}, and {free / 2**30:.1f} GB are free{hint}")
    return [need] if needed > LARGE else []


def _notes(method: str, shot: NoisySequence) -> list[str]:
    """What a user should know of a row on the images of a shot."""
    from rlbench import registry
    from rlbench.denoise import MAX_SLOTS

    variant, spp = registry.get_variant(method), shot.read_spp(0)
    notes = []
    if shot.start:
        notes.append(f"{shot.start} frames before the first fill the memory (--warm-up)")
    if variant.traits.temporal and len(shot) > 1 and not (shot.spp or shot.find_spp(0)):
        notes.append(f"samples per pixel are not known, {spp:g} are taken (--spp)")
    if variant.traits.adaptive:
        notes.append(f"{method} places samples; here it takes the same number in every pixel")
    trained = registry.get_variant(variant.weights_from or method)
    if variant.learned and not trained.trained_by and spp > MAX_SLOTS:
        notes.append(
            f"{method} was trained up to {MAX_SLOTS} spp, and these are {spp:g}; "
            "accumulate/intel has the weights of Open Image Denoise, which saw all"
        )
    return notes
