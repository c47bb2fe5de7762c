"""Clips rendered by Mitsuba and Cycles: presets, scenes by name and by file, live samples."""

from rlbench.cli.commands import FRAMES
from rlbench.registry.apps import App, CommandEntry

_HERE = "rlbench.apps.render"
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
    cache_entries=f"{_HERE}.cache_entries:find_entries",
)
