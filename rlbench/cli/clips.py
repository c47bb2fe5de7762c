"""The commands that make clips of scenes, and that prove them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rlbench import errors
from rlbench.cli import arguments, user_scene
from rlbench.render.jobs import preset_clips

Scenes = Annotated[
    list[str] | None, typer.Option("--scenes", help="scenes or clips a,b; default every one")
]
Seeds = Annotated[
    str | None, typer.Option(help="generated scenes: 0:48 or 3,7; default the preset's")
]
Preset = Annotated[str, typer.Option(help="how large the clips are; see rlbench list presets")]
Takes = Annotated[
    str | None, typer.Option(help="main or all, of each scene; default the preset's choice")
]
Clips = Annotated[
    list[Path] | None, typer.Option(help="a clip folder, or one of such; instead of a preset")
]
Engine = Annotated[str, typer.Option(help="who does the work: local, or ray, many at a time")]
RayAddress = Annotated[
    str | None,
    typer.Option(help="a running Ray cluster: auto or host:port; else one of this machine"),
]


def render(
    scenes: Scenes = None,
    preset: Preset = "mini",
    takes: Takes = None,
    seeds: Seeds = None,
    cap: Annotated[
        float | None, typer.Option(help="dim every sample to so many times display white")
    ] = None,
    views: Annotated[
        list[str] | None,
        typer.Option("--views", help="more buffers a,b: object, albedo_first, ..."),
    ] = None,
    scene: Annotated[
        Path | None, typer.Option(help="your own: .xml (Mitsuba), .py, .blend, .usd, .glb, .fbx")
    ] = None,
    tracer: Annotated[
        str | None, typer.Option(help="mitsuba or cycles; default the one that reads the file")
    ] = None,
    camera: Annotated[
        str | None, typer.Option(help="own, orbit, dolly, still, or a JSON file")
    ] = None,
    frames: Annotated[int | None, typer.Option(min=1)] = None,
    size: Annotated[str | None, typer.Option(help="WxH, pixels")] = None,
    exposure: Annotated[float | None, typer.Option(help="radiance times this is shown")] = None,
    define: Annotated[list[str] | None, typer.Option("--define", "-D", help="name=value")] = None,
    out: Annotated[Path | None, typer.Option(help="the clip's folder")] = None,
    retime: Annotated[
        bool,
        typer.Option("--retime", help="and measure anew what a sample takes, on an idle machine"),
    ] = False,
    engine: Engine = "local",
    ray_address: RayAddress = None,
) -> None:
    """Render the clips of a preset that are not in the cache yet; a killed rendering goes on.

    With --scene it is one clip of a scene of yours, and only then are the options from --camera to
    --out of use: see docs/scenes.md. What they do not say is as in the preset.

    Examples:

      rlbench render

      rlbench render --preset train --seeds 0:48

      rlbench render --scenes city,hall-cut --preset standard

      rlbench render --cap 64

      rlbench render --views object,normal_psr

      rlbench render --scene kitchen/scene.xml --camera dolly --frames 20 --size 320x192

      rlbench render --scene mine.py --camera path.json --out clips/mine

      rlbench render --scene atrium.blend --frames 20 -D max_bounces=6

      rlbench render --preset standard --engine ray --ray-address auto

      rlbench render --preset standard --retime
    """
    from rlbench.parallel.ray_executor import open_executor

    own = (camera, frames, size, exposure, define, out, tracer)
    with open_executor(engine, ray_address) as workers:
        if scene or any(own):
            for option, value in (
                ("retime", retime),
                ("cap", cap),
                ("views", views),
                ("takes", takes),
            ):
                if value:
                    raise errors.OptionError(f"--{option} is of a preset's clips, not of --scene")
            given = scenes or (seeds and [seeds]) or None
            folders = [user_scene.own_scene(scene, given, preset, *own, workers)]
        else:
            chosen = arguments.seeds(seeds)
            folders = preset_clips.render_preset_clips(
                arguments.split(scenes or []),
                preset,
                cap,
                chosen,
                arguments.split(views or []),
                workers,
                takes=takes,
            )
    for folder in folders:
        typer.echo(f"{folder}{_retimed(folder) if retime else ''}")


def _retimed(folder: Path) -> str:
    """What a sample took before and takes now, in words."""
    from rlbench.clips.stored import read_header
    from rlbench.render.jobs.retime import remeasure_sample_ms

    before = read_header(folder).sample_ms
    return f"  a sample takes {remeasure_sample_ms(folder).sample_ms:.1f} ms, was {before:.1f} ms"


def lint(
    clips: Annotated[list[Path], typer.Argument(help="a clip folder, or one of such")],
    picture: Annotated[Path | None, typer.Option(help="a PNG to write; one for each clip")] = None,
    frames: Annotated[int, typer.Option(min=0, help="first frames to look at; 0 is all")] = 8,
) -> None:
    """Prove a clip's conventions: motion, depth, normals, albedo, samples, reference.

    Exit code 1 if a check fails.

    Examples:

      rlbench lint my_renders/atrium

      rlbench lint my_renders/ --picture lint.png --frames 0
    """
    from rlbench.checks.lint.run import lint_clips as examine
    from rlbench.clips.stored import find_clips

    folders = [folder for place in clips for folder in find_clips(place)]
    raise typer.Exit(0 if examine(folders, picture, frames) else 1)
