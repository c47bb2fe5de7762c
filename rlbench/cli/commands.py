"""All commands: those of the benchmark, and those that installed apps add.

An app registers the entry point `NAME = "module:COMMANDS"` in the group `rlbench.commands`, where
COMMANDS maps each name to a `CommandEntry`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from rlbench import registry
from rlbench.errors import PluginError

MEASURE, LOOK, FRAMES = "Measure", "Look", "Your own frames and scenes"
METHOD, TRAINING, MACHINE, FURTHER = (
    "Your own method",
    "Training",
    "This machine",
    "Further commands",
)
GROUPS = (MEASURE, LOOK, FRAMES, METHOD, TRAINING, MACHINE, FURTHER)  # in the order of the help


class CommandEntry(NamedTuple):
    """Where a command is, and what the help and an interrupted one say."""

    target: str  # module:function
    group: str  # one of GROUPS; the last one is shown with --help-all alone
    kept: str = ""  # what an interrupted one leaves; {out} is its folder
    resumes: bool = True  # True if the same command continues from what was kept


CORE = {
    "run": CommandEntry("rlbench.cli.run:run", MEASURE, "finished cells are kept in {out}"),
    "decide": CommandEntry("rlbench.cli.decide:decide", MEASURE),
    "compare": CommandEntry("rlbench.cli.compare:compare", MEASURE),
    "report": CommandEntry("rlbench.cli.report:report", MEASURE),
    "render": CommandEntry("rlbench.cli.render:render", FRAMES, "finished frames are kept"),
    "scenes": CommandEntry("rlbench.cli.scenes:scenes", FRAMES, "complete files are kept"),
    "new": CommandEntry("rlbench.cli.new:new", METHOD),
    "check": CommandEntry("rlbench.cli.check:check", METHOD),
    "stress": CommandEntry(
        "rlbench.cli.stress:stress", METHOD, "finished sections are kept in {out}"
    ),
    "train": CommandEntry(
        "rlbench.cli.train:train",
        TRAINING,
        "clips are kept in the cache and checkpoints in {out}",
    ),
    "list": CommandEntry("rlbench.cli.list_:list_", MACHINE),
    "doctor": CommandEntry("rlbench.cli.doctor:doctor", MACHINE),
    "speed": CommandEntry("rlbench.cli.speed:speed", FURTHER),
    "evaluate": CommandEntry(
        "rlbench.cli.evaluate:evaluate", FURTHER, "finished scores are kept in {out}"
    ),
    "crossval": CommandEntry(
        "rlbench.cli.crossval:crossval",
        FURTHER,
        "finished cells and the checkpoints of trainings are kept in {out}",
    ),
    "regress": CommandEntry("rlbench.cli.regress:regress", FURTHER),
    "cache": CommandEntry("rlbench.cli.cache:cache", FURTHER),
}


def list_commands() -> dict[str, CommandEntry]:
    """All commands by name, in the order of the help.

    Raises PluginError where an app cannot be imported, or has a command that exists.
    """
    commands = dict(CORE)
    for app in registry.list_entries("commands"):
        added: Mapping[str, CommandEntry] = registry.load_or_explain("commands", app)
        if twice := sorted(added.keys() & commands.keys()):
            raise PluginError(f"the app '{app}' has the command '{twice[0]}', which exists")
        commands |= added
    return dict(sorted(commands.items(), key=lambda item: GROUPS.index(item[1].group)))
