"""A room as a Mitsuba XML file, and helpers to render and to refuse it."""

import json

import numpy as np
import pytest

from rlbench.apps.render.scene import SceneError
from rlbench.apps.render.user.clip import ensure_user_clip
from rlbench.clips.presets import Preset
from rlbench.clips.stored import open_clip

H, W, FOV = 32, 48, 60.0
PRESET = Preset("test", "tests", (H, W), frames=3, reference_spp=2, pool_spp=2)
RADIUS = 0.8
BODY = f"""
<default name="max_depth" value="5"/>
<integrator type="path"><integer name="maxDepth" value="$max_depth"/></integrator>
<sensor type="perspective">
  <float name="fov" value="{FOV}"/>
  <transform name="toWorld">
    <lookat origin="0, 1.2, 4" target="0, 0.8, 0" up="0, 1, 0"/>
  </transform>
  <sampler type="sobol"><integer name="sampleCount" value="64"/></sampler>
  <film type="ldrfilm"><integer name="width" value="1200"/><integer name="height" value="800"/>
    <rfilter type="tent"/></film>
</sensor>
<bsdf type="twosided" id="Wood"><bsdf type="diffuse">
  <texture name="reflectance" type="bitmap">
    <string name="filename" value="textures/wood.png"/></texture></bsdf></bsdf>
<bsdf type="roughconductor" id="Gold">
  <string name="material" value="Au"/><float name="alpha" value="0.2"/></bsdf>
<shape type="rectangle" id="Floor">
  <transform name="toWorld"><rotate x="1" angle="-90"/><scale value="9"/></transform>
  <ref id="Wood"/></shape>
<shape type="sphere" id="Ball"><point name="center" x="0" y="{RADIUS}" z="0"/>
  <float name="radius" value="{RADIUS}"/><ref id="Gold"/></shape>
<shape type="cube"><transform name="toWorld"><scale value="0.3"/>
  <translate x="1.5" y="0.3" z="0.5"/></transform></shape>
<shape type="rectangle" id="Lamp">
  <transform name="toWorld"><rotate x="1" angle="90"/><translate y="4"/></transform>
  <emitter type="area"><rgb name="radiance" value="17, 12, 4"/></emitter></shape>
<shape type="obj" id="Flag"><string name="filename" value="flag.obj"/><ref id="Wood"/></shape>
"""
HOOK = """SCENE = "scene.xml"

def moving(time, rest):
    return {"Flag": rest["Flag"] + [0, 0.1 * time, 0]}
"""


def document(folder, body=BODY, version="0.6.0"):
    """A scene in the style of Bitterli's: named scene.xml, with textures in a folder, camelCase."""
    import mitsuba as mi

    (folder / "textures").mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(0).integers(50, 200, (8, 8, 3), np.uint8)
    mi.Bitmap(pixels).write(str(folder / "textures/wood.png"))
    (folder / "flag.obj").write_text("v 1 0 -1\nv 2 0 -1\nv 1.5 1 -1\nf 1 2 3\n")
    file = folder / "scene.xml"
    file.write_text(f'<scene version="{version}">{body}</scene>')
    return file


def look_at(origin, target):
    """The camera-to-world matrix, derived independently: columns left, up, forward, position."""
    forward = np.subtract(target, origin) / np.linalg.norm(np.subtract(target, origin))
    left = np.cross([0, 1, 0], forward) / np.linalg.norm(np.cross([0, 1, 0], forward))
    return np.vstack([np.stack([left, np.cross(forward, left), forward, origin], 1), [0, 0, 0, 1]])


def flown(folder, matrices, fov=FOV):
    file = folder / "path.json"
    file.write_text(json.dumps({"camera_to_world": np.array(matrices).tolist(), "fov": fov}))
    return str(file)


PASSING = [look_at([0.3 * i, 1.2 + 0.1 * i, 4 - 0.1 * i], [0, 0.8, 0]) for i in range(3)]


def check_refused(options, match):
    """Rendering raises SceneError with a matching message, and writes nothing."""
    with pytest.raises(SceneError, match=match):
        ensure_user_clip(options, PRESET)
    folder = options.out or options.file.parent.parent / "cache" / "clips"
    assert not folder.exists()


def contents(folder):
    return {file.name: file.read_bytes() for file in sorted(folder.glob("*.exr"))}


def buffer(clip, name, index):
    return open_clip(clip).frame(index).gbuffer.buffers[name][0].permute(1, 2, 0).double().numpy()
