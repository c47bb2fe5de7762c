"""All commands by name: those of the benchmark, and those that installed apps add."""

from __future__ import annotations

from rlbench.errors import PluginError
from rlbench.registry.apps import CommandEntry, merge_parts

MEASURE, LOOK, FRAMES = "Measure", "Look", "Your own frames and scenes"
METHOD, TRAINING, MACHINE = "Your own method", "Training", "This machine"
FURTHER = "Further commands"  # shown with --help-all alone
GROUPS = (MEASURE, LOOK, FRAMES, METHOD, TRAINING, MACHINE, FURTHER)  # in the order of the help
CORE = {
    "run": CommandEntry("rlbench.cli.run:run", MEASURE, "finished cells are kept in {out}"),
    "decide": CommandEntry("rlbench.cli.decide:decide", MEASURE),
    "compare": CommandEntry("rlbench.cli.compare:compare", MEASURE),
    "report": CommandEntry("rlbench.cli.report:report", MEASURE),
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
    added = merge_parts("commands")
    if twice := sorted(added.keys() & CORE.keys()):
        raise PluginError(f"an app has the command '{twice[0]}', which exists")
    commands = {**CORE, **added}
    return dict(sorted(commands.items(), key=lambda item: GROUPS.index(item[1].group)))
