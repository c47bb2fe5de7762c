"""What apps add to the benchmark: commands, engines, pools, a renderer, a clock, and so on.

An app is a package that imports the benchmark, and that the benchmark does not import. It registers
one record in the group `rlbench.apps`:

    [project.entry-points."rlbench.apps"]
    view = "rlbench.apps.view:APP"

Without an app, its commands are not listed, and what it adds is an error that names what is needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from rlbench.errors import PluginError
from rlbench.registry.discovery import list_entries, resolve
from rlbench.registry.lookup import load_or_explain

GROUP = "apps"


class CommandEntry(NamedTuple):
    """Where a command is, and what the help and an interrupted one say."""

    target: str  # module:function
    group: str  # of the help, one of rlbench.cli.commands.GROUPS
    kept: str = ""  # what an interrupted one leaves; {out} is its folder
    resumes: bool = True  # True if the same command continues from what was kept


@dataclass(frozen=True)
class App:
    """What an app adds. A target is `module:name`, and is imported when it is used."""

    commands: Mapping[str, CommandEntry] = field(default_factory=dict)  # of the shell, by name
    # values of --engine; a target takes an address or None and returns an Executor with `close`
    engines: Mapping[str, str] = field(default_factory=dict)
    # values of --pool; a target takes a clip folder and returns a StoredSource
    pools: Mapping[str, str] = field(default_factory=dict)
    renderer: str = ""  # a rlbench.clips.rendering.PresetRenderer
    clock: str = ""  # makes a rlbench.benchmark.sample_clock.SampleClock
    machine_checks: str = ""  # yields the further results of `rlbench doctor`
    scene_template: str = ""  # the folder, a Path, that `rlbench new --scene` fills
    cache_entries: str = ""  # takes the cache folder and yields CacheEntry for further files


def load_apps() -> dict[str, App]:
    """The records of all installed apps by name. Raises PluginError where one cannot be imported.

    >>> "render" in load_apps()["render"].commands
    True
    """
    return {name: load_or_explain(GROUP, name) for name in list_entries(GROUP)}


def merge_parts(part: str) -> dict[str, Any]:
    """The `commands`, `engines` or `pools` of all apps. Raises PluginError where two share a name.

    >>> list(merge_parts("pools"))
    ['live']
    """
    merged: dict[str, Any] = {}
    for app, record in load_apps().items():
        added: Mapping[str, Any] = getattr(record, part)
        if twice := sorted(added.keys() & merged.keys()):
            raise PluginError(f"two apps have {part} called '{twice[0]}'; one of them is '{app}'")
        merged |= added
    return merged


def load_parts(part: str) -> list[Any]:
    """What the apps that have a `renderer`, `clock` or the like name there, imported."""
    targets = [getattr(record, part) for record in load_apps().values()]
    return [resolve(target) for target in targets if target]
