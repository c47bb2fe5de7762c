"""The commands pack and download: clips as archives, and back."""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rlbench.cli import arguments, options
from rlbench.errors import OptionError
from rlbench.registry.near_names import unknown_name

if TYPE_CHECKING:
    from rlbench.clips.mirrors import ClipArchive

__all__ = ["download", "pack", "rendered_clips"]


def pack(
    preset: options.Preset = "mini",
    scenes: options.Scenes = None,
    out: Annotated[
        Path,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="folder for the archives and clips.toml, which lists them",
            rich_help_panel=options.OUTPUT,
        ),
    ] = Path("clips"),
) -> None:
    """Pack the rendered clips of a preset, for a mirror.

    Equal clips give equal archives. A folder of them on any web server is a mirror.

    Examples:

    \b
      rlbench pack --preset mini --out mirror/
      rlbench pack --preset standard --scenes city,hall
    """
    from rlbench.cli import console
    from rlbench.clips.archive import clip_digests, pack_clip
    from rlbench.clips.mirrors import INDEX, ClipArchive, file_hash, write_registry
    from rlbench.system.paths import check_writable

    check_writable(out)
    folders = rendered_clips(preset, arguments.split_names(scenes))
    archives = []
    with console.counting("packing", len(folders)) as advance:
        for folder in folders:
            file = out / f"{preset}-{folder.name}.tar"
            pack_clip(folder, file)
            size, digests = file.stat().st_size, clip_digests(folder)
            entry = ClipArchive(preset, folder.name, file.name, file_hash(file), size, digests)
            archives.append(entry)
            advance()
    write_registry(out / INDEX, archives)
    total = sum(each.bytes for each in archives) / 1e6
    typer.echo(f"{out}: {len(archives)} clips of {preset}, {total:.0f} MB, listed in {out / INDEX}")


def download(
    preset: options.Preset = "mini",
    scenes: options.Scenes = None,
    mirror: Annotated[
        str,
        typer.Option(
            metavar="URL|FOLDER",
            help="where the archives of rlbench pack are; default: the mirrors of the registry",
            rich_help_panel=options.CLIPS,
        ),
    ] = "",
    registry: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False,
            metavar="FILE",
            help="a registry of your own; default: the one that ships",
            rich_help_panel=options.CLIPS,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            file_okay=False,
            metavar="FOLDER",
            help="folder for the clips; default: the cache, where rlbench run finds them",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
) -> None:
    """Download the clips of a preset instead of rendering them.

    Archives are checked by SHA-256, and clips by the digest of their content. Clips that are there
    stay. Nobody has to download: rlbench render and rlbench run make the same clips.

    Examples:

    \b
      rlbench download --preset mini
      rlbench download --preset mini --mirror https://example.org/rlbench
      rlbench download --preset mini --mirror mirror/ --out clips/
    """
    from rlbench.clips.archive import unpack_clip
    from rlbench.clips.mirrors import fetch
    from rlbench.render.presets import get_preset
    from rlbench.system import paths
    from rlbench.system.paths import check_writable

    get_preset(preset)
    target = out or paths.clips_folder() / preset
    check_writable(target, "--out" if out else "RLBENCH_CACHE")
    with tempfile.TemporaryDirectory() as temporary:
        archives = _archives(preset, mirror, registry, Path(temporary))
    due = _missing(archives, arguments.split_names(scenes), target)
    if out is None:
        _check_shipped(preset, due)
    target.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target, prefix=".download-") as temporary:
        for archive in due:
            with _progress(archive) as bar:
                file = fetch(archive, Path(temporary), bar)
            unpack_clip(file, target / archive.clip, archive.digests)
            file.unlink()
            typer.echo(f"{target / archive.clip}")


def rendered_clips(preset: str, names: Collection[str] = ()) -> list[Path]:
    """The finished clips of a preset in the cache, or those that are named; nothing is rendered.

    Raises OptionError where there is none, and UnknownPresetError.
    """
    from rlbench.clips.stored import find_clips, read_header
    from rlbench.render.presets import get_preset
    from rlbench.system import paths

    folder = paths.clips_folder() / get_preset(preset).name
    found = find_clips(folder) if folder.is_dir() else []
    by_name = {path: {path.name, read_header(path).scene} for path in found}
    known = set().union(*by_name.values())
    if not found:
        raise OptionError(
            f"the cache has no clip of {preset}. Render them: rlbench render --preset {preset}"
        )
    if missing := [name for name in names if name not in known]:
        problem = f"the cache has no clip {', '.join(missing)} of {preset}"
        raise OptionError(
            f"{unknown_name(problem, missing[0], sorted(known))} "
            f"To render clips: rlbench render --preset {preset}"
        )
    return [path for path in found if not names or by_name[path] & set(names)]


def _archives(preset: str, mirror: str, registry: Path | None, folder: Path) -> list[ClipArchive]:
    """The archives of a preset on a mirror, or in a registry."""
    from rlbench.clips.mirrors import SHIPPED, mirror_registry, read_registry

    if mirror and registry:
        raise OptionError("--mirror has a registry of its own. Omit --registry, or --mirror")
    found = mirror_registry(mirror, folder) if mirror else read_registry(registry or SHIPPED)
    archives = [each for each in found if each.preset == preset and each.urls]
    if archives:
        return archives
    if mirror or registry:
        presets = ", ".join(sorted({each.preset for each in found})) or "nothing"
        raise OptionError(f"{mirror or registry} has no clips of {preset}; it has {presets}")
    raise OptionError(
        f"no mirror of {preset} is known, so rendering is the only source: rlbench render --preset "
        f"{preset}. If you know a mirror, name it with --mirror"
    )


def _missing(archives: list[ClipArchive], names: list[str], target: Path) -> list[ClipArchive]:
    """The archives of the clips to download; says which are there already."""
    from rlbench.clips.archive import clip_digests
    from rlbench.clips.header import FILE

    clips = {each.clip for each in archives}
    if unknown := sorted(set(names) - clips):
        problem = f"there is no clip {', '.join(unknown)} to download"
        raise OptionError(unknown_name(problem, unknown[0], sorted(clips)))
    due = []
    for archive in archives:
        folder = target / archive.clip
        if names and archive.clip not in names:
            continue
        if not folder.exists():
            due.append(archive)
            continue
        is_same = (folder / FILE).is_file() and archive.digests.items() <= clip_digests(
            folder
        ).items()
        if not is_same:
            raise OptionError(
                f"{folder} exists, unfinished or with other pixels. Move it away, or choose "
                "another --out"
            )
        typer.echo(f"{folder} is there already", err=True)
    return due


def _check_shipped(preset: str, archives: list[ClipArchive]) -> None:
    """Refuse clips for the cache that are not those on which shipped scores were measured."""
    from rlbench.benchmark.submission.machine_checks import DIGITS, shipped_digests

    listed = shipped_digests(preset)
    other = [
        archive.clip
        for archive in archives
        if archive.digests.get("path", "")[:DIGITS] != listed.get(archive.clip, "")
    ]
    if listed and other:
        raise OptionError(
            f"{', '.join(other)} of this mirror has other pixels than the clips of the shipped "
            f"baseline. Render {preset}, or keep the clips apart with --out and --clips"
        )


@contextmanager
def _progress(archive: ClipArchive) -> Iterator[object]:
    """A bar of bytes with the interface that pooch expects."""
    from rich.progress import BarColumn, DownloadColumn, TextColumn

    from rlbench.system.progress import LoggedProgress

    class Bar:
        total = archive.bytes

        def update(self, count: int) -> None:
            bar.advance(task, count)

        def reset(self) -> None:
            bar.reset(task)

        def close(self) -> None:
            pass

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn())
    with LoggedProgress(*columns) as bar:
        task = bar.add_task(archive.clip, total=archive.bytes)
        yield Bar()
