"""Clips rendered by Mitsuba and Cycles: presets, scenes by name and by file, live samples.

What a package with a scene imports, when it is first used:

    >>> from rlbench.apps.render import Camera
    >>> Camera(origin=(0, -4, 2), target=(0, 0, 0)).fov
    60.0
"""

from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader

from rlbench.cli.commands import FRAMES
from rlbench.registry.apps import App, CommandEntry

if TYPE_CHECKING:
    from rlbench.apps.render.scene import Camera, Mesh, Scene, Take

__all__ = ["APP", "Camera", "Mesh", "Scene", "Take"]

__getattr__, __dir__, _ = lazy_loader.attach(
    __name__, submod_attrs={"scene": ["Camera", "Mesh", "Scene", "Take"]}
)

_HERE = "rlbench.apps.render"
SCENE_TEMPLATE = Path(__file__).parent / "templates" / "scene"
APP = App(
    commands={
        "render": CommandEntry(
            f"{_HERE}.commands.render:render", FRAMES, "finished frames are kept"
        ),
        "scenes": CommandEntry(
            f"{_HERE}.commands.scenes:scenes", FRAMES, "complete files are kept"
        ),
    },
    pools={"live": f"{_HERE}.live_source:open_live_source"},
    renderer=f"{_HERE}.jobs.render_clips:render_preset_clips",
    clock=f"{_HERE}.clock:TracerClock",
    machine_checks=f"{_HERE}.machine_checks:check_tracers",
    scene_template=f"{_HERE}:SCENE_TEMPLATE",
    cache_entries=f"{_HERE}.cache_entries:find_entries",
)
