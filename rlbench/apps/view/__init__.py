"""Results and their images: in a browser, as files, and as video."""

from rlbench.cli.commands import LOOK
from rlbench.registry.apps import App, CommandEntry

_COMMANDS = "rlbench.apps.view.commands"
APP = App(
    commands={
        "view": CommandEntry(f"{_COMMANDS}.view:view", LOOK),
        "images": CommandEntry(f"{_COMMANDS}.images:images", LOOK),
        "video": CommandEntry(
            f"{_COMMANDS}.video:video", LOOK, "complete videos are kept", resumes=False
        ),
    }
)
