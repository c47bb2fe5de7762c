"""What the scenes of the presets show, as plain data for pages; scenes are built, not rendered."""

from __future__ import annotations

import importlib
import inspect
from dataclasses import dataclass

from rlbench import registry
from rlbench.apps.render.scene import Scene
from rlbench.clips.presets import GENERATORS, PRESETS, TEST_SCENES

TAKE_FRAMES = 20  # of preset standard, which has all takes
SKIES = {
    "sunsky": "sun and sky",
    "constant": "a sky of one colour",
    "directional": "the sun, as a direction",
    "envmap": "an environment map",
}


@dataclass(frozen=True)
class TakeFacts:
    """A clip of a scene."""

    clip: str
    static: bool
    cuts: tuple[int, ...]
    light_changes: tuple[int, ...]


@dataclass(frozen=True)
class SceneFacts:
    """A scene of the presets: what it shows, what lights it, and its clips."""

    name: str
    title: str
    about: tuple[str, ...]  # paragraphs
    lights: tuple[str, ...]
    takes: tuple[TakeFacts, ...]
    triangles: int  # 0 for a generator of scenes
    presets: tuple[str, ...]
    licence: str


def scene_facts() -> list[SceneFacts]:
    """The test scenes, then the generators of scenes."""
    return [
        *(_scene_facts(name, registry.load_plugin("scenes", name)()) for name in TEST_SCENES),
        *(_generator_facts(name) for name in GENERATORS),
    ]


def _scene_facts(name: str, scene: Scene) -> SceneFacts:
    emitters = [mesh.name for mesh in scene.meshes if mesh.emission]
    lights = [SKIES.get(str(each["type"]), str(each["type"])) for each in scene.sky]
    lights += [f"meshes that glow: {', '.join(emitters)}"] if emitters else []
    main = TakeFacts(name, scene.static, scene.cuts, scene.light_changes(TAKE_FRAMES))
    takes = []
    for take in scene.takes:
        shot = scene.select_take(take.name)
        changes = shot.light_changes(TAKE_FRAMES)
        takes.append(TakeFacts(f"{name}-{take.name}", take.static, take.cuts, changes))
    return SceneFacts(
        name=name,
        title=scene.title,
        about=_paragraphs(name),
        lights=tuple(lights),
        takes=(main, *takes),
        triangles=sum(len(mesh.faces) for mesh in scene.meshes),
        presets=tuple(p.name for p in PRESETS.values() if name in p.scenes),
        licence=scene.licence,
    )


def _generator_facts(name: str) -> SceneFacts:
    presets = [p for p in PRESETS.values() if p.seeds and p.generator == name]
    seeds = [f"{p.name}: seeds {min(p.seeds)} to {max(p.seeds)}" for p in presets]
    return SceneFacts(
        name=name,
        title=f"{name.capitalize()} scenes, one for each seed",
        about=(*_paragraphs(name), *seeds),
        lights=("drawn from the seed",),
        takes=(),
        triangles=0,
        presets=tuple(preset.name for preset in presets),
        licence="Apache-2.0",
    )


def _paragraphs(name: str) -> tuple[str, ...]:
    """The paragraphs of the docstring of the module that makes a scene."""
    target = registry.list_entries("scenes")[name].target.partition(":")[0]
    text = inspect.getdoc(importlib.import_module(target)) or ""
    return tuple(" ".join(part.split()) for part in text.split("\n\n"))
