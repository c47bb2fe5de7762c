"""A pin: the files of a public repository that make a scene, by commit, git blob id and size.

A pin is a text file. Its first line names repository, commit and folder; each further line is a
path in the repository, its git blob id and its size, separated by tabs. A size of "-" is not known.
"""

from __future__ import annotations

import fnmatch
import hashlib
import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from http.client import HTTPException
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import quote
from urllib.request import Request, urlopen

from rlbench.apps.render.scene import SceneError
from rlbench.registry.near_names import unknown_name

SCENE_FILE = "scene.xml"  # in the folder of a scene, unless its pin names another
# what rlbench render opens, in the order of preference where a folder has several
SUFFIXES = (".xml", ".gltf", ".glb", ".blend", ".usd", ".usda", ".usdc", ".usdz", ".fbx", ".obj")
NOT_NEEDED = (  # names of files that the repositories keep beside a scene, and that render nothing
    "TungstenRender.*",
    ".*",
    "transient*scene.xml",
    "*_rand_scene*.xml",
    "scene.exr",
)
API, API_VARIABLE = "https://api.github.com", "RLBENCH_SCENES_API"
TIMEOUT_S = 30.0
HEADER = "# repository {} commit {} folder {}: path, git blob id (SHA-1), bytes"
HEADER_PATTERN = re.compile(re.escape(HEADER).replace(r"\{\}", "(.+?)"))
MAIN = " scene "  # in the header, between the folder and a file other than scene.xml
ROOT = "."  # the folder of a scene at the top of its repository
PLACE = re.compile(r"([\w.-]+/[\w.-]+)@(\w+):(.+)")


@dataclass(frozen=True)
class PinnedFile:
    """One file of a scene."""

    path: str  # relative to the scene's folder, as in scene.xml
    blob: str  # git blob id, 40 hex digits
    bytes: int | None = None  # None: not known

    def __post_init__(self) -> None:
        """Raise ValueError for a path that leads outside the folder, and for a wrong blob id."""
        parts = PurePosixPath(self.path).parts
        if not parts or parts[0] == "/" or ".." in parts or "\\" in self.path:
            raise ValueError(f"'{self.path}' is not a path inside the scene's folder")
        if not re.fullmatch(r"[0-9a-f]{40}", self.blob):
            raise ValueError(f"'{self.blob}' is not a git blob id, which has 40 hex digits")


@dataclass(frozen=True)
class Pin:
    """Files at one commit of a repository."""

    repository: str  # OWNER/REPOSITORY on GitHub
    commit: str  # 40 hex digits
    folder: str  # of the scene, in the repository
    files: tuple[PinnedFile, ...] = ()
    main: str = SCENE_FILE  # the file of the scene, in the folder


def read_pin(file: Path) -> Pin:
    """Read a pin. Raises SceneError, which names the line, for a file that is none."""
    try:
        first, *lines = file.read_text(encoding="utf-8").splitlines() or [""]
    except ValueError as error:
        raise SceneError(f"{file} is not a pin of a scene: it is not text in UTF-8") from error
    found = HEADER_PATTERN.fullmatch(first)
    if found is None:
        raise SceneError(f"{file} is not a pin of a scene: its first line is not '{HEADER}'")
    repository, commit, place = found.groups()
    folder, _, main = place.rpartition(MAIN)
    if PurePosixPath(main).suffix.lower() not in SUFFIXES or not folder:
        folder, main = place, SCENE_FILE
    files = []
    for number, line in enumerate(lines, 2):
        try:
            path, blob, size = line.split("\t")
            relative = path.removeprefix(_prefix(folder))
            if relative == path and folder != ROOT:
                raise ValueError(f"'{path}' is not in the folder {folder}")
            files.append(PinnedFile(relative, blob, None if size == "-" else int(size)))
        except ValueError as error:
            raise SceneError(f"{file}, line {number}: {error}. Pin the scene again") from error
    return Pin(repository, commit, folder, tuple(files), main)


def format_pin(pinned: Pin) -> str:
    """The text of a pin."""
    main = "" if pinned.main == SCENE_FILE else f"{MAIN}{pinned.main}"
    lines = [HEADER.format(pinned.repository, pinned.commit, f"{pinned.folder}{main}")]
    for file in pinned.files:
        size = "-" if file.bytes is None else file.bytes
        lines.append(f"{_prefix(pinned.folder)}{file.path}\t{file.blob}\t{size}")
    return "\n".join([*lines, ""])


def _prefix(folder: str) -> str:
    """What paths in a repository begin with; nothing for files at its top."""
    return "" if folder == ROOT else f"{folder}/"


def blob_id(file: Path) -> str:
    """The id that git gives to the content of a file: SHA-1 of "blob SIZE", a zero byte, and it."""
    digest = hashlib.sha1(b"blob %d\0" % file.stat().st_size, usedforsecurity=False)
    with file.open("rb") as stream:
        while chunk := stream.read(2**20):
            digest.update(chunk)
    return digest.hexdigest()


def parse_place(text: str) -> tuple[str, str, str]:
    """Repository, commit and folder of OWNER/REPOSITORY@COMMIT:FOLDER; `.` is the top.

    FOLDER may end with the file of the scene: `rooms/attic/scene_day.xml`.

    >>> parse_place("wig42/scenes@" + "0" * 40 + ":rooms/attic/")[2]
    'rooms/attic'

    Raises SceneError for another form, and for a branch or a short commit id: they can move.
    """
    found = PLACE.fullmatch(text)
    if found is None or not found[3].strip("/ "):
        raise SceneError(f"'{text}' is not a place of a scene. Give OWNER/REPOSITORY@COMMIT:FOLDER")
    repository, commit, folder = found.groups()
    if not re.fullmatch(r"[0-9a-f]{40}", commit):
        raise SceneError(
            f"'{commit}' is not a full commit id. Give all 40 hex digits: names of branches and "
            "short ids may mean other files later"
        )
    return repository, commit, folder.strip("/") or ROOT


def pin(repository: str, commit: str, folder: str, *, address: str | None = None) -> str:
    """The text of a pin of all files in a folder of a public repository on GitHub.

    GitHub lists the files (REST API, git trees); none is downloaded. Renderings, hidden files and
    variants of the scene by these repositories are left out. `address` of the API; default: the
    variable RLBENCH_SCENES_API, else GitHub's.

    `folder` may end with the file of the scene. Otherwise that is scene.xml, or else the only file
    of a format that rlbench renders.

    Raises SceneError for a repository, commit or folder that does not exist, for a folder without
    a scene or with several, and where GitHub refuses or cannot be reached.
    """
    folder, main = _split_main(folder)
    base = (address or os.environ.get(API_VARIABLE) or API).rstrip("/")
    trees = f"{base}/repos/{quote(repository)}/git/trees"
    place = f"{repository}@{commit[:12]}"
    files = sorted(_list_files(trees, commit, folder, place), key=lambda file: file.path)
    main = _choose_main([file.path for file in files], main, f"{place}:{folder}")
    return format_pin(Pin(repository, commit, folder, tuple(files), main))


def _split_main(place: str) -> tuple[str, str]:
    """A folder, and the file of the scene if the place ends with one."""
    folder, _, name = place.rpartition("/")
    if PurePosixPath(name).suffix.lower() in SUFFIXES:
        return folder or ROOT, name
    return place, ""


def _choose_main(names: list[str], requested: str, place: str) -> str:
    """The file of the scene among the files of its folder."""
    top = [name for name in names if "/" not in name and Path(name).suffix.lower() in SUFFIXES]
    choices = [requested] if requested else [SCENE_FILE, "scene.gltf", "scene.glb"]
    found = [name for name in choices if name in top] or (top if not requested else [])
    if len(found) == 1 or found[:1] == [SCENE_FILE]:
        return found[0]
    listed = f"it has {', '.join(top)}" if top else "it has no file that rlbench renders"
    hint = f". Name one: {place}/{top[0]}" if top else ""
    raise SceneError(f"{place} has no {requested or SCENE_FILE}; {listed}{hint}")


def _list_files(trees: str, commit: str, folder: str, place: str) -> Iterator[PinnedFile]:
    """The needed files below a folder. Raises SceneError where there is no such folder."""
    entries = list(_walk(trees, commit, "" if folder == ROOT else folder, place))
    if not entries:
        level = _ask(f"{trees}/{commit}", place)["tree"]
        folders = [entry["path"] for entry in level if entry["type"] == "tree"]
        problem = f"{place} has no folder '{folder}'"
        raise SceneError(unknown_name(problem, folder, folders, "; folders at its top"))
    for path, entry in entries:
        name = path.rpartition("/")[2]
        if not any(fnmatch.fnmatchcase(name, pattern) for pattern in NOT_NEEDED):
            yield PinnedFile(path, entry["sha"], entry["size"])


def _walk(trees: str, tree: str, below: str, place: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """The blobs below the folder `below` of a tree, each with its path relative to that folder.

    GitHub cuts long lists: then each sub-tree that matters is listed by itself.
    """
    answer = _ask(f"{trees}/{tree}?recursive=1", place)
    prefix = f"{below}/" if below else ""
    if not answer.get("truncated"):
        for entry in answer["tree"]:
            if entry["type"] == "blob" and entry["path"].startswith(prefix):
                yield entry["path"].removeprefix(prefix), entry
        return
    head, _, rest = below.partition("/")
    for entry in _ask(f"{trees}/{tree}", place)["tree"]:
        if entry["type"] == "tree" and (not below or entry["path"] == head):
            inside = "" if below else f"{entry['path']}/"
            for path, blob in _walk(trees, entry["sha"], rest, place):
                yield f"{inside}{path}", blob
        elif entry["type"] == "blob" and not below:
            yield entry["path"], entry


def _ask(url: str, place: str) -> dict[str, Any]:
    """An answer of GitHub's API."""
    request = Request(url, headers={"User-Agent": "rlbench", "Accept": "application/json"})
    try:
        with urlopen(request, timeout=TIMEOUT_S) as response:
            answer = json.load(response)
    except HTTPError as error:
        raise SceneError(_explain_status(error, place)) from error
    except (URLError, OSError, HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        raise SceneError(f"{url} cannot be reached: {reason}. Is there a network?") from error
    except ValueError as error:
        raise SceneError(f"{url} answered no JSON. Is it GitHub's API?") from error
    if not isinstance(answer, dict) or not isinstance(answer.get("tree"), list):
        raise SceneError(f"{url} answered without a list of files. Is it GitHub's API?")
    return answer


def _explain_status(error: HTTPError, place: str) -> str:
    if error.code in (403, 429):
        reset = error.headers.get("X-RateLimit-Reset", "")
        when = "in an hour"
        if reset.isdigit():
            when = f"after {datetime.fromtimestamp(int(reset), UTC):%H:%M} UTC"
        return (
            f"GitHub refuses to list {place} (HTTP {error.code}): without an account it answers "
            f"60 requests an hour. Repeat the command {when}"
        )
    if error.code in (404, 422):
        return f"GitHub knows no {place} (HTTP {error.code}). Check the owner, the name, the commit"
    return f"GitHub cannot list {place} (HTTP {error.code} {error.reason}). Try again later"
