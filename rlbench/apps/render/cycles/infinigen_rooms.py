"""Procedural rooms by Infinigen as clips: environment, generation, camera paths, rendering.

    python -m rlbench.apps.render.cycles.infinigen_rooms FOLDER --rooms LivingRoom:1,Kitchen:2

Infinigen (Raistrick et al. 2024, Infinigen Indoors: Photorealistic Indoor Scenes using Procedural
Generation) runs in a Python environment and a process of its own, and so does Blender. The worker
finds places for camera paths by ray casts: a floor below a ceiling, no surface near, depth in the
view. Finished rooms, camera paths and clips are kept, so an interrupted command resumes; a killed
generation of a room begins again.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from rlbench.apps.render.cycles import process
from rlbench.apps.render.cycles.clip import ensure_cycles
from rlbench.apps.render.cycles.process import convert_axes, run_worker, wander_job
from rlbench.apps.render.scene import SceneError
from rlbench.apps.render.user import camera_path
from rlbench.apps.render.user.clip import UserSceneOptions
from rlbench.clips.presets import Preset
from rlbench.errors import OptionError, RlbenchError
from rlbench.system import store
from rlbench.system.folder_lock import locked_folder

INFINIGEN = "infinigen==1.15.5"  # of PyPI: wheels for Python 3.11
REQUIREMENTS = (  # Infinigen's own, but for scikit-image, whose releases below 0.20 have no wheels
    *("bpy==4.2.0", "coacd", "gin_config>=0.5.0", "imageio<2.32.0", "matplotlib", "networkx"),
    *("numpy<2", "opencv-python<4.9.0", "pandas", "psutil", "scikit-image<0.23", "scipy"),
    *("scikit-learn<1.4.0", "shapely<=2.0.5", "tqdm", "trimesh<3.23.0", "OpenEXR", "submitit"),
    *("geomdl", "python-fcl", "rtree"),
)
KINDS = ("LivingRoom", "Kitchen", "Bedroom", "Bathroom", "DiningRoom")
SIX_ROOMS = "LivingRoom:1,Kitchen:2,Bedroom:3,Bathroom:4,DiningRoom:5,LivingRoom:6"
FOV = 65.0  # horizontal, degrees
PACE = (0.01, 0.04)  # metres per frame
TURN = 1.0  # degrees per frame, at most, to either side
ASIDE = 60.0  # degrees between the first view and the first step, at most
WALKS_PER_SEED = 1000
PITCH = (-12.0, 2.0)  # degrees above the horizon


class InfinigenError(RlbenchError, RuntimeError):
    """Infinigen cannot be installed, or generated no room."""


@dataclass(frozen=True)
class Room:
    """One room: what it is for, the seed that it is made from, and the folder of all rooms."""

    kind: str
    seed: int
    rooms_folder: Path

    @property
    def name(self) -> str:
        """Kind and seed, as in the names of files and clips."""
        return f"{self.kind.lower()}-{self.seed}"

    @property
    def folder(self) -> Path:
        """Where the room's files are."""
        return self.rooms_folder / self.name

    @property
    def blend(self) -> Path:
        """The finished scene."""
        return self.folder / f"{self.name}.blend"


def parse_rooms(text: str, folder: Path) -> list[Room]:
    """Rooms from `Kind:seed,Kind:seed`. Raises OptionError for unknown kinds and seeds.

    >>> [room.name for room in parse_rooms("Kitchen:2,bathroom:3", Path("rooms"))]
    ['kitchen-2', 'bathroom-3']
    """
    kinds = {kind.lower(): kind for kind in KINDS}
    rooms = []
    for item in text.split(","):
        kind, _, seed = item.strip().partition(":")
        if kind.lower() not in kinds or not seed.isascii() or not seed.isdigit():
            raise OptionError(
                f"--rooms: {item.strip()!r} is not a room. Write Kind:seed, such as Kitchen:2; "
                f"kinds are {', '.join(KINDS)}, seeds are whole numbers from 0"
            )
        rooms.append(Room(kinds[kind.lower()], int(seed), folder))
    return rooms


def ensure_environment(folder: Path, package: str, requirements: Sequence[str] = ()) -> Path:
    """The Python of a virtual environment with `package`, such as `infinigen==1.15.5`.

    It is created in `folder` if it is not there; pip writes to a log beside it. `requirements`
    replace those that the package names. Raises InfinigenError if there is no Python 3.11, or if
    pip fails.
    """
    python = folder / "bin" / "python"
    finished = folder / "installed.txt"
    if store.read_text(finished) == package:
        return python
    base = sys.executable if sys.version_info[:2] == (3, 11) else shutil.which("python3.11")
    if not base:
        raise InfinigenError(
            f"{package} needs Python 3.11, and there is no python3.11 on the PATH. Install it"
        )
    log = folder.with_suffix(".log")
    _run([base, "-m", "venv", str(folder)], log, f"creating {folder}")
    pip = [str(python), "-m", "pip", "install"]
    if requirements:
        _run([*pip, "--only-binary", ":all:", *requirements], log, f"requirements of {package}")
        pip.append("--no-deps")
    _run([*pip, package], log, f"pip install {package}")
    finished.write_text(package)
    return python


def generation_command(python: Path, room: Room, output: Path) -> list[str]:
    """The command by which Infinigen generates one room: no terrain outside, lamps are on."""
    return [
        *(str(python), "-m", "infinigen_examples.generate_indoors"),
        *("--seed", str(room.seed), "--task", "coarse", "--output_folder", str(output)),
        *("-g", "fast_solve.gin", "singleroom.gin"),
        *("-p", "compose_indoors.terrain_enabled=False", "compose_indoors.lights_off_chance=0"),
        f'restrict_solving.restrict_parent_rooms=["{room.kind}"]',
    ]


def generate_room(python: Path, room: Room) -> Path:
    """The .blend file of a room, after generating it if it does not exist.

    `python` has infinigen. Its output goes to `generate.log` in the room's folder. Raises
    InfinigenError if it fails, with the end of the log, and FolderInUseError if another process
    generates the same room.
    """
    if room.blend.is_file():
        return room.blend
    with locked_folder(room.folder):
        output = (room.folder / "unfinished").absolute()
        shutil.rmtree(output, ignore_errors=True)
        log = room.folder / "generate.log"
        command = generation_command(python, room, output)
        packages = python.parents[1] / "lib" / "python3.11" / "site-packages"
        # Infinigen's settings include files relative to the folder in which it runs
        _run(command, log, f"generating {room.name}", packages)
        scene = output / "scene.blend"
        if not scene.is_file():
            raise InfinigenError(f"generating {room.name} wrote no {scene}{process.log_tail(log)}")
        scene.replace(room.blend)
        shutil.rmtree(output)
    return room.blend


def render_room(room: Room, walks: int, frames: int, size: tuple[int, int], spp: int) -> list[Path]:
    """The clip folders of a generated room, one for each random camera path.

    `size` is height and width in pixels, `spp` the samples of each half of a reference. Clips lie
    in `clips`, beside the rooms. Raises the errors of `place_cameras` and `ensure_cycles`.
    """
    preset = Preset("infinigen", "rooms by Infinigen", size, frames, spp)
    clips = []
    for path in place_cameras(room.blend, room.folder, walks, frames, room.seed):
        out = room.rooms_folder / "clips" / f"{room.name}-{path.stem}"
        options = UserSceneOptions(room.blend, str(path), frames=frames, size=size, out=out)
        clips.append(ensure_cycles(options, preset, _report))
        _report(str(clips[-1]))
    return clips


def _run(command: Sequence[str], log: Path, task: str, folder: Path | None = None) -> None:
    """Run a command, in `folder` if given, and add its output to `log`.

    Raises InfinigenError, with the end of the log, if it fails.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("ab") as stream:
        code = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT, cwd=folder
        ).returncode
    if code:
        raise InfinigenError(f"{task} ended with exit code {code}{process.log_tail(log)}")


def main(arguments: Sequence[str] | None = None) -> None:
    """Generate and render rooms from the command line."""
    parser = argparse.ArgumentParser(description="Clips of procedural rooms by Infinigen.")
    parser.add_argument("folder", type=Path, help="for rooms, clips and environments")
    parser.add_argument("--rooms", default=SIX_ROOMS, help="Kind:seed,...; default: %(default)s")
    parser.add_argument("--rooms-only", action="store_true", help="generate rooms, render no clips")
    parser.add_argument("--walks", type=int, default=1, help="clips of each room")
    parser.add_argument("--frames", type=int, default=4, help="of each clip")
    parser.add_argument("--size", type=int, default=160, help="width and height in pixels")
    parser.add_argument("--spp", type=int, default=32, help="of each half of a reference")
    options = parser.parse_args(arguments)
    folder = options.folder.expanduser().absolute()
    size = (options.size, options.size)
    failures = []
    try:
        rooms = parse_rooms(options.rooms, folder)
        python = _prepare(folder, rooms, not options.rooms_only)
    except RlbenchError as error:
        raise SystemExit(f"error: {error}") from error
    for room in rooms:
        try:
            _report(str(generate_room(python, room)))
            if not options.rooms_only:
                render_room(room, options.walks, options.frames, size, options.spp)
        except RlbenchError as error:  # the other rooms can still be made
            _report(f"error: {room.name}: {error}")
            failures.append(room.name)
    if failures:
        raise SystemExit(f"{len(failures)} of {len(rooms)} rooms failed: {', '.join(failures)}")


def _prepare(folder: Path, rooms: list[Room], renders: bool) -> Path:
    """Create the environments that are needed; returns the Python of Infinigen's."""
    python = folder / "infinigen" / "bin" / "python"
    if not all(room.blend.is_file() for room in rooms):
        python = ensure_environment(folder / "infinigen", INFINIGEN, REQUIREMENTS)
    if renders and not process.bpy_version():
        bpy = f"bpy=={process.TESTED_BPY_VERSION}"
        os.environ[process.PYTHON_VARIABLE] = str(ensure_environment(folder / "cycles", bpy))
    return python


def _report(message: str) -> None:
    sys.stdout.write(message + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()


def walk(seed: int, frames: int) -> Float[Array, "frames 4 4"]:
    """A random walk of a camera, relative to the place and the heading at its start.

    Step and turn are the same in every frame, so that the camera moves along an arc. Matrices are
    camera-to-start in Blender's convention (the camera looks along -z, y is up); at the start, x is
    to the right, y ahead and z up, in metres.
    """
    chance = np.random.default_rng(seed)
    pace = chance.uniform(*PACE)
    turn, aside = (np.radians(chance.uniform(-most, most)) for most in (TURN, ASIDE))
    pitch = np.radians(chance.uniform(*PITCH))
    headings = turn * np.arange(frames)  # to the left
    steps = pace * np.column_stack([-np.sin(headings + aside), np.cos(headings + aside)])
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    matrices[1:, :2, 3] = np.cumsum(steps, 0)[:-1]
    for matrix, heading in zip(matrices, headings, strict=True):
        sine, cosine = np.sin(heading), np.cos(heading)
        ahead = np.array([-sine * np.cos(pitch), cosine * np.cos(pitch), np.sin(pitch)])
        right = np.array([cosine, sine, 0.0])
        matrix[:3, :3] = np.stack([right, np.cross(right, ahead), -ahead], 1)
    return matrices


def place_cameras(file: Path, folder: Path, count: int, frames: int, seed: int = 0) -> list[Path]:
    """Write `count` camera paths for a scene file to `folder`; returns the JSON files.

    Each is one for `rlbench render --camera`, named `walk0.json` and so on. They are kept if
    all exist and have `frames` matrices; more paths leave the first as they were. Raises SceneError
    if the scene has too few places to stand, and CyclesError if Blender is missing or failed.
    """
    files = [folder / f"walk{number}.json" for number in range(count)]
    if all(f.is_file() and len(camera_path.read_matrices(f)[0]) == frames for f in files):
        return files
    walks = [walk(WALKS_PER_SEED * seed + number, frames) for number in range(count)]
    for path, placed in zip(files, _place(file, walks, seed, folder / "cameras.log"), strict=True):
        matrices = [convert_axes(np.array(rows)).tolist() for rows in placed]
        store.write_text(path, json.dumps({"camera_to_world": matrices, "fov": FOV}))
    return files


def _place(
    file: Path, walks: list[Float[Array, "frames 4 4"]], seed: int, log: Path
) -> list[list[list[float]]]:
    """A camera-to-world path in Blender's convention for each walk."""
    found: list[list[list[float]]] = []
    reasons: dict[str, int] = {}
    for event in run_worker(wander_job(file, walks, FOV, seed), log):
        if event.get("event") == "placed":
            found, reasons = event["paths"], event["rejected"]
    if len(found) < len(walks):
        why = ", ".join(f"{count} times {reason}" for reason, count in reasons.items())
        raise SceneError(
            f"{file}: {len(found)} of {len(walks)} camera paths have a place ({why or 'no mesh'}). "
            "Ask for fewer or shorter paths, or write one by hand: docs/how-to/add-a-scene.md"
        )
    return found
