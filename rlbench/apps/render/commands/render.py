"""The command render: clips of a preset, or of a scene file by the tracer that reads it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rlbench.cli import options
from rlbench.cli.arguments import (
    Definition,
    PixelSize,
    Seeds,
    parse_definition,
    parse_seeds,
    parse_size,
    split_names,
)
from rlbench.cli.config_file import refuse_typed
from rlbench.cli.options import CLIPS, fill, flag, number, option
from rlbench.errors import OptionError

if TYPE_CHECKING:
    from rlbench.apps.render.user.clip import UserSceneOptions
    from rlbench.clips.presets import Preset
    from rlbench.parallel.executor import Executor

OF_PRESETS = (
    "scenes", "takes", "radiance_cap", "buffers", "remeasure_sample_time", "digests", "motion"
)  # fmt: skip
OF_FILES = ("camera", "frames", "exposure", "skip_missing", "define", "tracer", "sky", "out")
SCENE_FILE, PRESET_SCENES = "Of your own FILE", "Of a preset"  # titles of groups of options
PBRT = (
    "scene file {file}: neither Mitsuba nor Cycles reads pbrt. Convert it to Mitsuba's XML: "
    "github.com/lahagemann/pbr_scene_converter does so for pbrt-v3, and no converter of pbrt-v4 is "
    "known to us. Scenes of benedikt-bitterli.me/resources are also offered as Mitsuba files"
)


def render(
    context: typer.Context,
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE",
            help="a scene of your own: .xml (Mitsuba), .py, .gltf, .glb, .blend, .usd, .fbx, .obj; "
            "or the name of one by others (rlbench scenes)",
        ),
    ] = None,
    preset: options.Preset = "mini",
    size: Annotated[
        PixelSize | None,
        option(
            CLIPS,
            "in pixels; default: that of the preset, or the film's shape with as many pixels",
            value="WIDTHxHEIGHT",
            parse=parse_size,
        ),
    ] = None,
    scenes: options.Scenes = None,
    seeds: Annotated[
        Seeds | None,
        option(
            CLIPS,
            "seeds of generated scenes, 0:40 or 3,7, default: as in the preset; of FILE: a clip "
            "for each random path of --camera wander, default: 0",
            value="SEEDS",
            parse=parse_seeds,
        ),
    ] = None,
    camera: Annotated[
        str | None,
        option(
            SCENE_FILE,
            "own, orbit, dolly, still, wander (random), or a JSON file of matrices",
            value="PATH",
        ),
    ] = None,
    frames: Annotated[
        int | None, option(SCENE_FILE, "default: as in the preset, or the matrices", min=1)
    ] = None,
    limit_frames: Annotated[
        int | None,
        option(
            CLIPS,
            "render only the first frames of each clip; a later call without it renders the others",
            min=1,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        option(
            SCENE_FILE,
            "the clip's folder; default: one in the cache",
            value="FOLDER",
            file_okay=False,
        ),
    ] = None,
    engine: options.Engine = "local",
    exposure: Annotated[
        float | None,
        number(SCENE_FILE, "maps radiance to display white at 1; default: estimated", "FACTOR"),
    ] = None,
    skip_missing: Annotated[
        bool,
        flag(
            SCENE_FILE,
            "--skip-missing",
            "leave out shapes whose file is missing, and make such textures grey",
        ),
    ] = False,
    define: Annotated[
        list[Definition] | None,
        option(
            SCENE_FILE,
            "parameter of the scene or tracer; can be repeated",
            "--define",
            "-D",
            value="NAME=VALUE",
            parse=parse_definition,
        ),
    ] = None,
    tracer: Annotated[
        Literal["mitsuba", "cycles"] | None,
        option(SCENE_FILE, "default: the one that reads the file"),
    ] = None,
    sky: Annotated[
        str | None,
        option(
            SCENE_FILE,
            "add light: a radiance such as 1, sun, or a .hdr or .exr environment map",
            value="SKY",
        ),
    ] = None,
    takes: options.Takes = None,
    radiance_cap: Annotated[
        float | None,
        number(
            PRESET_SCENES,
            "scale brighter samples down to this multiple of display white",
            "RADIANCE",
        ),
    ] = None,
    buffers: Annotated[
        list[str] | None,
        option(
            PRESET_SCENES,
            "more G-buffer buffers a,b: object, albedo_first, normal_psr, ...",
            value="NAMES",
        ),
    ] = None,
    remeasure_sample_time: Annotated[
        bool,
        flag(
            PRESET_SCENES,
            "--remeasure-sample-time",
            "also measure the time of a sample and a G-buffer again, on an idle machine",
        ),
    ] = False,
    digests: Annotated[
        bool,
        flag(
            PRESET_SCENES,
            "--digests",
            "print the name of each clip and the hash of its pixels, not its folder",
        ),
    ] = False,
    motion: Annotated[
        bool,
        flag(
            PRESET_SCENES,
            "--motion",
            "also print the motion of each clip and of all, in pixels a frame: median and 95 %",
        ),
    ] = False,
) -> None:
    """Render the clips of a preset, or of your own scene file.

    Those of a preset that are missing are rendered, and lie in the cache. A killed rendering
    resumes, and a changed scene file is rendered again. docs/how-to/add-a-scene.md describes
    cameras, moving shapes, and what each tracer supports.

    Examples:

    \b
      rlbench render
      rlbench render --preset train --seeds 0:40
      rlbench render --scenes city,hall-cut --preset standard
      rlbench render --preset real --limit-frames 2
      rlbench render --preset development --size 640x360 --motion
      rlbench render --radiance-cap 64
      rlbench render --buffers object,normal_psr
      rlbench render --preset standard --engine ray=auto
      rlbench render --preset standard --remeasure-sample-time
      rlbench render --preset unseen --digests
      rlbench render kitchen/scene.xml --camera dolly --frames 20 --size 320x192
      rlbench render kitchen/scene.xml --camera wander --seeds 0:20 --out clips/kitchen
      rlbench render mine.py --camera path.json --out clips/mine
      rlbench render room.glb --camera wander --sky 1
      rlbench render atrium.blend --frames 20 -D max_bounces=6
      rlbench render classroom --camera wander -D max_depth=5
    """
    if file is not None and not file.exists():
        file, sky = _find_in_collection(file, sky)
    _refuse_options_of_the_other(context, file)
    from rlbench.parallel.engines import open_executor
    from rlbench.system.paths import cache_folder, check_writable

    check_writable(*((out, "--out") if out else (cache_folder(), "RLBENCH_CACHE")))
    with open_executor(engine) as executor:
        if file is None:
            from rlbench.apps.render.jobs.render_clips import render_preset_clips

            folders = render_preset_clips(
                split_names(scenes),
                preset,
                radiance_cap,
                seeds,
                split_names(buffers),
                executor,
                takes=takes,
                size=size,
                limit_frames=limit_frames,
            )
            for each in folders:
                times = _remeasure(each) if remeasure_sample_time else ""
                moves = _motion([each]) if motion else ""
                typer.echo(f"{_digest(each) if digests else each}{times}{moves}")
            if motion:
                typer.echo(f"all {len(folders)} clips{_motion(folders)}")
            return
        from rlbench.apps.render.user.clip import UserSceneOptions
        from rlbench.clips.presets import get_preset

        scene = fill(
            UserSceneOptions,
            locals(),
            camera=camera or "",
            parameters=tuple(define or ()),
            seed=seeds[0] if seeds else None,
            sky=sky or "",
        )
        for clip in _each_seed(scene, seeds or Seeds(())):
            typer.echo(_render_clip(clip, get_preset(preset, size), tracer, executor))


def _find_in_collection(name: Path, sky: str | None) -> tuple[Path, str | None]:
    """The file of a scene by others, and the sky that it needs; other names stay.

    Raises SceneError where the scene is not on this machine.
    """
    from rlbench.apps.render.scenes.collection.catalog import load_catalog, locate

    if str(name) not in load_catalog():
        return name, sky
    located = locate(str(name))
    return located.scene, sky or located.entry.sky


def _refuse_options_of_the_other(context: typer.Context, file: Path | None) -> None:
    """Raise OptionError for options of scene files without one, and of presets with one."""
    if file is not None and not file.is_file():
        raise typer.BadParameter(
            f"there is no scene file '{file}', and `rlbench scenes` lists no such scene. Scenes "
            "of a preset are named by --scenes",
            param_hint="'FILE'",
        )
    refuse_typed(
        context, *((OF_FILES, "a scene FILE") if file is None else (OF_PRESETS, "presets"))
    )


def _digest(folder: Path) -> str:
    """The clip's name and the first 12 digits of its content hash, as on model cards."""
    from rlbench.clips.stored import open_clip

    clip = open_clip(folder)
    return f"{clip.name} {clip.digest[:12]}"


def _motion(folders: list[Path]) -> str:
    """The motion of clips in words."""
    from rlbench.clips.motion import measure_motion

    median, high = measure_motion(folders)
    return f"  motion in pixels a frame: median {median:.1f}, 95 % {high:.1f}"


def _remeasure(folder: Path) -> str:
    """Measure the times of a clip's tracer again; returns them as text, with the former one."""
    from rlbench.apps.render.jobs.render_clips import remeasure_sample_ms
    from rlbench.clips.header import read_header

    before_ms = read_header(folder).sample_ms
    after = remeasure_sample_ms(folder)
    spread = f"p5 {after.sample_p5_ms:.1f}, p95 {after.sample_p95_ms:.1f}"
    return (
        f"  a sample per pixel takes {after.sample_ms:.1f} ms ({spread}), before {before_ms:.1f} "
        f"ms; a G-buffer {after.gbuffer_ms:.1f} ms"
    )


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


def _render_clip(
    scene: UserSceneOptions, preset: Preset, tracer: str | None, executor: Executor
) -> Path:
    """The clip folder of a scene file, after rendering the missing frames.

    Raises OptionError if the tracer does not read the file, or not with this executor.
    """
    from rlbench.apps.render.cycles.clip import ensure_cycles
    from rlbench.apps.render.user.clip import ensure_user_clip
    from rlbench.parallel.executor import LOCAL

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
    from rlbench.apps.render.cycles.scene_file import FORMATS
    from rlbench.apps.render.gltf.document import FORMATS as GLTF

    formats = {"mitsuba": (".xml", ".py", *GLTF), "cycles": FORMATS}
    if file.suffix.lower() == ".pbrt":
        raise OptionError(PBRT.format(file=file))
    readers = [name for name, suffixes in formats.items() if file.suffix.lower() in suffixes]
    supported = "; ".join(f"{name} reads {', '.join(formats[name])}" for name in formats)
    if not readers:
        raise OptionError(f"scene file {file}: no tracer reads it. {supported}")
    if tracer not in (None, *readers):
        raise OptionError(f"--tracer {tracer} does not read {file.name}. {supported}")
    return tracer or readers[0]
