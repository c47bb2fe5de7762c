"""The command render-scene: a clip of a user's scene file, by the tracer that reads it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rlbench.cli import arguments, options
from rlbench.cli.arguments import Definition, PixelSize, Seeds
from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.parallel.executor import Executor
    from rlbench.render.presets import Preset
    from rlbench.render.user.clip import UserSceneOptions

__all__ = ["render_clip", "render_scene", "select_tracer"]

PBRT = (
    "scene file {file}: neither Mitsuba nor Cycles reads pbrt. Convert it to Mitsuba's XML: "
    "github.com/lahagemann/pbr_scene_converter does so for pbrt-v3, and no converter of pbrt-v4 is "
    "known to us. Scenes of benedikt-bitterli.me/resources are also offered as Mitsuba files"
)


def render_scene(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            exists=True,
            dir_okay=False,
            help="a scene: .xml (Mitsuba), .py, .blend, .usd, .glb, .gltf, .fbx, .obj",
        ),
    ],
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="PATH",
            help="own, orbit, dolly, still, wander (random), or a JSON file of matrices",
            rich_help_panel=options.RENDERING,
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="default: as in the preset, or the matrices",
            rich_help_panel=options.RENDERING,
        ),
    ] = None,
    size: Annotated[
        PixelSize | None,
        typer.Option(
            parser=arguments.parse_size,
            metavar="WIDTHxHEIGHT",
            help="in pixels; default: the film's shape, as many pixels as the preset",
            rich_help_panel=options.RENDERING,
        ),
    ] = None,
    exposure: Annotated[
        float | None,
        typer.Option(
            parser=arguments.parse_positive,
            metavar="FACTOR",
            help="maps radiance to display white at 1; default: estimated",
            rich_help_panel=options.RENDERING,
        ),
    ] = None,
    seeds: Annotated[
        Seeds | None,
        typer.Option(
            parser=arguments.parse_seeds,
            metavar="SEEDS",
            help="a clip for each random path of --camera wander, such as 0:20; default: 0",
            rich_help_panel=options.RENDERING,
        ),
    ] = None,
    skip_missing: Annotated[
        bool,
        typer.Option(
            "--skip-missing",
            help="leave out shapes whose file is missing, and make such textures grey",
            rich_help_panel=options.RENDERING,
        ),
    ] = False,
    define: Annotated[
        list[Definition] | None,
        typer.Option(
            "--define",
            "-D",
            parser=arguments.parse_definition,
            metavar="NAME=VALUE",
            help="parameter of the scene or tracer; can be repeated",
            rich_help_panel=options.RENDERING,
        ),
    ] = None,
    tracer: Annotated[
        Literal["mitsuba", "cycles"] | None,
        typer.Option(
            help="default: the one that reads the file", rich_help_panel=options.RENDERING
        ),
    ] = None,
    preset: options.Preset = "mini",
    engine: options.Engine = "local",
    ray_address: options.RayAddress = None,
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="the clip's folder; default: one in the cache",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
) -> None:
    """Render a clip of your own scene file.

    A killed rendering resumes, and a changed scene is rendered again. docs/how-to/add-a-scene.md
    describes cameras, moving shapes, and what each tracer supports.

    Examples:

    \b
      rlbench render-scene kitchen/scene.xml --camera dolly --frames 20 --size 320x192
      rlbench render-scene kitchen/scene.xml --camera wander --seeds 0:20 --out clips/kitchen
      rlbench render-scene mine.py --camera path.json --out clips/mine
      rlbench render-scene atrium.blend --frames 20 -D max_bounces=6
    """
    from rlbench.parallel.ray_executor import open_executor
    from rlbench.render.presets import get_preset
    from rlbench.render.user.clip import UserSceneOptions
    from rlbench.system.paths import cache_folder, check_writable

    check_writable(*((out, "--out") if out else (cache_folder(), "RLBENCH_CACHE")))
    scene = UserSceneOptions(
        file=file,
        camera=camera or "",
        frames=frames,
        size=size,
        exposure=exposure,
        parameters=tuple(define or ()),
        out=out,
        seed=seeds[0] if seeds else None,
        skip_missing=skip_missing,
    )
    with open_executor(engine, ray_address) as executor:
        for each in _each_seed(scene, seeds or Seeds(())):
            typer.echo(render_clip(each, get_preset(preset), tracer, executor))


def _each_seed(scene: UserSceneOptions, seeds: Seeds) -> list[UserSceneOptions]:
    """The options of each clip; several clips lie in folders within the given one."""
    from dataclasses import replace

    if len(seeds) < 2:
        return [scene]
    folder = scene.out
    return [
        replace(scene, seed=seed, out=folder and folder / f"{scene.camera}-{seed:03d}")
        for seed in seeds
    ]


def render_clip(
    scene: UserSceneOptions, preset: Preset, tracer: str | None, executor: Executor
) -> Path:
    """The clip folder of a scene file, after rendering the missing frames.

    Raises OptionError if the tracer does not read the file, or not with this executor.
    """
    from rlbench.parallel.executor import LOCAL
    from rlbench.render.cycles.clip import ensure_cycles
    from rlbench.render.user.clip import ensure_user_clip

    def on_message(message: str) -> None:
        typer.echo(message, err=True)

    if select_tracer(scene.file, tracer) == "mitsuba":
        return ensure_user_clip(scene, preset, on_message, executor)
    if scene.skip_missing:
        raise OptionError("--skip-missing is for Mitsuba XML files, and Cycles renders this one")
    if executor is not LOCAL:
        raise OptionError(
            "--engine ray cannot render with Cycles, which uses all cores by itself. Omit it"
        )
    return ensure_cycles(scene, preset, on_message)


def select_tracer(file: Path, tracer: str | None) -> str:
    """The requested tracer, or the one that reads the file's format.

    Raises OptionError if no tracer, or not the requested one, reads it.
    """
    from rlbench.render.cycles.scene_file import FORMATS

    formats = {"mitsuba": (".xml", ".py"), "cycles": FORMATS}
    if file.suffix.lower() == ".pbrt":
        raise OptionError(PBRT.format(file=file))
    readers = [name for name, suffixes in formats.items() if file.suffix.lower() in suffixes]
    supported = "; ".join(f"{name} reads {', '.join(formats[name])}" for name in formats)
    if not readers:
        raise OptionError(f"scene file {file}: no tracer reads it. {supported}")
    if tracer not in (None, *readers):
        raise OptionError(f"--tracer {tracer} does not read {file.name}. {supported}")
    return readers[0]
