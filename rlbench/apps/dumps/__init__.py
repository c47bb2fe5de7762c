"""Frames of other renderers: imported, checked, exported, scored and denoised."""

from rlbench.cli.commands import FRAMES
from rlbench.registry.apps import App, CommandEntry

_COMMANDS = "rlbench.apps.dumps.commands"
_FRAMES_ARE_KEPT = "finished frames are kept in {out}"
APP = App(
    commands={
        "import": CommandEntry(f"{_COMMANDS}.import_:import_", FRAMES, _FRAMES_ARE_KEPT),
        "export": CommandEntry(f"{_COMMANDS}.export:export", FRAMES, _FRAMES_ARE_KEPT),
        "score": CommandEntry(
            f"{_COMMANDS}.score:score", FRAMES, "finished clips are kept in {out}"
        ),
        "denoise": CommandEntry(f"{_COMMANDS}.denoise:denoise", FRAMES, _FRAMES_ARE_KEPT),
        "lint": CommandEntry(f"{_COMMANDS}.lint:lint", FRAMES),
    }
)
