"""Scenes by others: who made them, which files they have, and what of them is on this machine."""

from __future__ import annotations

import hashlib
import logging
import os
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from rlbench.apps.render.scene import SceneError
from rlbench.apps.render.scenes.collection.pins import SCENE_FILE, Pin, PinnedFile, read_pin
from rlbench.clips.presets import PRESETS
from rlbench.registry.near_names import unknown_name
from rlbench.system import documents, paths

_logger = logging.getLogger(__name__)

CATALOG = Path(__file__).parent / "catalog.toml"
SHIPPED_PINS = CATALOG.parent / "pins"
MIRROR_VARIABLE = "RLBENCH_SCENES"
CREDITS = "CREDITS.md"  # beside the files of a downloaded scene
LICENCES = {
    "CC0 1.0": "https://creativecommons.org/publicdomain/zero/1.0/",
    "CC BY 3.0": "https://creativecommons.org/licenses/by/3.0/",
    "CC BY 4.0": "https://creativecommons.org/licenses/by/4.0/",
}
UNKNOWN_LICENCE = "unknown: see the folder's LICENSE.txt"


@dataclass(frozen=True)
class StartCamera:
    """The camera of a scene whose file has none. The world is z up."""

    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float  # horizontal, degrees


@dataclass(frozen=True, kw_only=True)
class CollectionScene:
    """A scene by others."""

    name: str
    title: str
    author: str
    licence: str  # a key of LICENCES, or words
    source: str  # address of the original
    shows: str = ""  # what it has that others lack
    repository: str = ""  # OWNER/REPOSITORY on GitHub
    commit: str = ""  # 40 hex digits
    folder: str = ""  # in the repository
    files: tuple[PinnedFile, ...] = ()  # empty: not pinned
    main: str = SCENE_FILE  # the file of the scene, in its folder
    sky: str = ""  # what `rlbench render --sky` adds
    camera: StartCamera | None = None

    @property
    def presets(self) -> tuple[str, ...]:
        """The presets whose clips show it."""
        return tuple(
            preset.name
            for preset in PRESETS.values()
            if any(self.name in (clip, clip.rpartition("-")[0]) for clip in preset.scenes)
        )

    @property
    def bytes(self) -> int:
        """Size of the pinned files, of those whose size is known."""
        return sum(file.bytes or 0 for file in self.files)


@dataclass(frozen=True)
class LocatedScene:
    """A scene on this machine, whole or in part."""

    entry: CollectionScene
    scene: Path  # of the scene's file, mostly scene.xml
    missing: tuple[str, ...]  # pinned files that are absent or of another size, as in scene.xml


def load_catalog() -> dict[str, CollectionScene]:
    """All scenes by name: those that ship, then those that the user pinned.

    A pin of the user, in the folder `scenes/pins` of the cache, adds files to a scene that ships
    without a pin, or a scene of its own. A file that is not a pin is set aside.
    """
    document = documents.read_toml(CATALOG)
    listed = {
        name: documents.decode({"name": name, **table}, CollectionScene)
        for name, table in document.items()
    }
    pins = _read_own_pins() | {file.stem: read_pin(file) for file in SHIPPED_PINS.glob("*.tsv")}
    own_scenes = {name: _of_pin(name, pin) for name, pin in pins.items() if name not in listed}
    return {
        name: replace(entry, **vars(pins[name])) if name in pins else entry
        for name, entry in (listed | own_scenes).items()
    }


def _read_own_pins() -> dict[str, Pin]:
    """The pins that the user made; a damaged one is renamed to NAME.tsv.damaged, with a note."""
    pins = {}
    for file in sorted(pins_folder().glob("*.tsv")):
        try:
            pins[file.stem] = read_pin(file)
        except SceneError as error:
            with suppress(OSError):  # of a read-only cache
                file.replace(file.with_name(f"{file.name}.damaged"))
            _logger.warning("%s. It was set aside as %s.damaged", error, file.name)
    return pins


def find_scene(name: str) -> CollectionScene:
    """The scene of this name. Raises SceneError, which names the nearest one, where none has it."""
    catalog = load_catalog()
    if name not in catalog:
        raise SceneError(unknown_name(f"no scene '{name}' in the collection", name, catalog))
    return catalog[name]


def find_located(entry: CollectionScene) -> LocatedScene | None:
    """Where a scene lies: in the mirror that RLBENCH_SCENES names, or downloaded; None if nowhere.

    Where both have it, the one that misses fewer files, the mirror first. Files are compared by
    existence and size, not by content.
    """
    found = [
        LocatedScene(entry, folder / entry.main, _missing_files(entry, folder))
        for folder in _folders(entry.name)
        if (folder / entry.main).is_file()
    ]
    return min(found, key=lambda each: len(each.missing), default=None)


def locate(name: str) -> LocatedScene:
    """Where a scene lies, as `find_located`, by its name.

    Raises SceneError for an unknown name and for a scene that lies nowhere.
    """
    entry = find_scene(name)
    if located := find_located(entry):
        return located
    get = f"rlbench scenes get {name}"
    command = f"`{get}`" if entry.files else f"`rlbench scenes pin {name}`, then `{get}`"
    raise SceneError(
        f"scene {name} lies in none of {', '.join(map(str, _folders(name)))}: run {command}, or "
        f"set {MIRROR_VARIABLE} to a folder that has {name}/{entry.main}"
    )


def digest(located: LocatedScene) -> str:
    """Hash of the files that are there, by their pin: 16 hex digits.

    No file is read, so a file that was edited is not noticed. A scene without a pin counts with the
    content of its scene.xml.
    """
    missing = set(located.missing)
    lines = [f"{file.path} {file.blob}" for file in located.entry.files if file.path not in missing]
    if not located.entry.files:
        lines = [hashlib.sha256(located.scene.read_bytes()).hexdigest()]
    return hashlib.sha256("\n".join(sorted(lines)).encode()).hexdigest()[:16]


def describe_state(entry: CollectionScene, located: LocatedScene | None) -> str:
    """What of a scene is here: complete, partial: N files missing, not downloaded, not pinned."""
    if not entry.files:
        return "not pinned"
    if located is None:
        return "not downloaded"
    missing = len(located.missing)
    return f"partial: {missing} file{'s' * (missing > 1)} missing" if missing else "complete"


def credit(entry: CollectionScene) -> str:
    """Who made a scene, under which licence, and where its files are from, as Markdown."""
    licence = entry.licence
    licence += f" ({LICENCES[licence]})" if licence in LICENCES else ""
    return (
        f"# {entry.title}\n\n"
        f"By {entry.author}. Licence: {licence}. Original: {entry.source}\n\n"
        f"The files are unchanged copies from https://github.com/{entry.repository}/tree/"
        f"{entry.commit}/{entry.folder}\n"
    )


def mirror_folder() -> Path | None:
    """The folder of scenes that the variable RLBENCH_SCENES names, if it is set."""
    folder = os.environ.get(MIRROR_VARIABLE)
    return Path(folder).expanduser() if folder else None


def pins_folder() -> Path:
    """The folder of pins that the user made."""
    return paths.scenes_folder() / "pins"


def own_pin_file(name: str) -> Path:
    """The file for a pin of the user. Raises SceneError for a scene that ships with a pin."""
    if (SHIPPED_PINS / f"{name}.tsv").exists():
        raise SceneError(f"scene {name} is pinned already. To write another pin: --out FILE")
    return pins_folder() / f"{name}.tsv"


def place_of(entry: CollectionScene) -> str:
    """Where a scene's files come from, as OWNER/REPOSITORY@COMMIT:FOLDER."""
    return f"{entry.repository}@{entry.commit}:{entry.folder}"


def _of_pin(name: str, pin: Pin) -> CollectionScene:
    """A scene of the user's own, of which only the pin is known."""
    source = f"https://github.com/{pin.repository}"
    return CollectionScene(
        name=name, title=name, author="unknown", licence=UNKNOWN_LICENCE, source=source
    )


def _folders(name: str) -> list[Path]:
    """Where a scene may lie, in the order of preference."""
    return [base / name for base in (mirror_folder(), paths.scenes_folder()) if base]


def _missing_files(entry: CollectionScene, folder: Path) -> tuple[str, ...]:
    return tuple(file.path for file in entry.files if not _is_there(file, folder / file.path))


def _is_there(file: PinnedFile, path: Path) -> bool:
    """True if there is a file of the pinned size."""
    try:
        size = path.stat().st_size
    except OSError:
        return False
    return path.is_file() and file.bytes in (None, size)
