"""The sky that `--sky` adds to a scene: white, the sun with a clear sky, or an environment map."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from rlbench.apps.render.scene import MitsubaDict, Scene, SceneError

MAPS = (".hdr", ".exr", ".pfm", ".rgbe")
SUN = (0.45, -0.6, 0.66)  # towards it, z up: at half height
Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # maps are y up


def add_sky(scene: Scene, sky: str) -> Scene:
    """`scene` with a further sky: a radiance such as `1` (or `white`), `sun`, or a map's file.

    Scenes are z up, but XML files are taken as y up; they get no sun. Raises SceneError for
    anything else.

    >>> from rlbench.apps.render.scene import Camera
    >>> scene = Scene("a", "a", (), lambda time: Camera((0, 0, 0), (0, 1, 0)))
    >>> add_sky(scene, "white").sky[0]["type"]
    'constant'
    """
    if scene.xml_file is None:
        return replace(scene, sky=(*scene.sky, _emitter(sky)))
    if sky == "sun":
        raise SceneError(
            "--sky sun is for scenes with z up. An XML file says itself where its sky is: add "
            '<emitter type="sunsky"/> to it'
        )
    return replace(scene, xml_file=replace(scene.xml_file, sky=_element(_emitter(sky))))


def describe_sky(sky: str) -> str:
    """What a sky depends on: its text, and the content of its file."""
    file = Path(sky)
    return f"{sky} {hashlib.blake2b(file.read_bytes()).hexdigest()}" if file.is_file() else sky


def radiance_of(sky: str) -> float | None:
    """The radiance of a white sky; None for any other."""
    try:
        radiance = 1.0 if sky == "white" else float(sky)
    except ValueError:
        return None
    if not 0 < radiance < math.inf:
        raise SceneError(f"--sky {sky}: a white sky has a finite radiance above 0, for example 1")
    return radiance


def _emitter(sky: str) -> MitsubaDict:
    radiance = radiance_of(sky)
    if radiance is not None:
        return {"type": "constant", "radiance": {"type": "rgb", "value": [radiance] * 3}}
    if sky == "sun":
        return {"type": "sunsky", "sun_direction": list(SUN)}
    if Path(sky).suffix.lower() in MAPS and Path(sky).is_file():
        return {"type": "envmap", "filename": str(Path(sky).absolute()), "to_world": Z_UP}
    raise SceneError(
        f"--sky {sky} is neither a radiance such as 1, nor white, nor sun, nor the file of an "
        f"environment map ({', '.join(MAPS)}) that exists"
    )


def _element(emitter: MitsubaDict) -> str:
    """An emitter of `_emitter` as an XML element, for y up."""
    if emitter["type"] == "envmap":
        inner = f'<string name="filename" value={quoteattr(emitter["filename"])}/>'
    else:
        inner = f'<rgb name="radiance" value="{" ".join(map(str, emitter["radiance"]["value"]))}"/>'
    return f'<emitter type="{emitter["type"]}">{inner}</emitter>'
