"""Downloads scenes: each file is verified by its git blob id before it has its name."""

from __future__ import annotations

import os
import re
import shutil
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from threading import Event
from typing import Literal
from urllib.error import HTTPError, URLError
from urllib.parse import quote
from urllib.request import Request, urlopen

from rlbench.apps.render.scene import SceneError
from rlbench.apps.render.scenes.collection.catalog import (
    CREDITS,
    CollectionScene,
    credit,
    find_scene,
    mirror_folder,
)
from rlbench.apps.render.scenes.collection.pins import PinnedFile, blob_id
from rlbench.system import paths
from rlbench.system.folder_lock import locked_folder
from rlbench.system.paths import atomic_write, check_writable
from rlbench.system.store import write_text

RAW, RAW_VARIABLE = "https://raw.githubusercontent.com", "RLBENCH_SCENES_URL"
THREADS, TRIES, PAUSE_S, TIMEOUT_S = 4, 3, 1.0, 20.0
CHUNK = 2**16  # bytes between two looks at Ctrl-C
GONE, REFUSED = (404, 410), (401, 403, 407, 429)  # HTTP status codes
UNFINISHED = re.compile(r"\.[0-9a-f]{32}\..+")  # what a killed `atomic_write` leaves
LISTED = 5  # files that an error names

Origin = Literal["kept", "copied", "downloaded"]


class DownloadError(SceneError):
    """Files of a scene that cannot be downloaded. Those that could be are kept."""


class UnreachableError(DownloadError):
    """A server that does not answer, or refuses everybody: no further file is worth a try."""


class _FileError(Exception):
    """Why one file cannot be had."""


class _PassingError(_FileError):
    """The same, where another try may help."""


class _StoppedError(Exception):
    """The download was given up meanwhile."""


@dataclass(frozen=True)
class Fetched:
    """What `get` did: numbers of files by their origin."""

    folder: Path  # of the scene
    downloaded: int
    copied: int  # from the mirror that RLBENCH_SCENES names
    kept: int  # were there already


@dataclass(frozen=True)
class _Server:
    """Where the files of a scene are downloaded from, and how patiently."""

    address: str  # of the scene's folder
    tries: int
    pause_s: float  # before the second try; doubles with each


def get(
    name: str,
    folder: Path | None = None,
    on_progress: Callable[[PinnedFile], None] | None = None,
    *,
    address: str | None = None,
    tries: int = TRIES,
    pause_s: float = PAUSE_S,
) -> Fetched:
    """Download the pinned files of a scene to `folder`/NAME, and write whom to credit.

    Files that are there and have the pinned content are kept, files of the mirror that
    RLBENCH_SCENES names are copied, and the others are downloaded in parallel from
    `address`/OWNER/REPOSITORY/COMMIT/PATH. After an error or Ctrl-C the finished files stay, and
    nothing half written does. `folder` defaults to the cache, where `locate` looks, and `address`
    to the variable RLBENCH_SCENES_URL, else to GitHub. `on_progress` is called after each file.

    Raises SceneError for an unknown scene and for one without a pin, UnreachableError once where no
    server answers, DownloadError after all other files where some cannot be had, and WriteError.
    """
    entry = find_scene(name)
    if not entry.files:
        raise SceneError(
            f"the files of scene {name} are not pinned yet. Pin them: rlbench scenes pin {name}"
        )
    target = (folder or paths.scenes_folder()) / name
    check_writable(target, "--out" if folder else "RLBENCH_CACHE")
    base = (address or os.environ.get(RAW_VARIABLE) or RAW).rstrip("/")
    place = quote(f"{entry.repository}/{entry.commit}/{entry.folder}")
    server = _Server(f"{base}/{place}", tries, pause_s)
    origins: Counter[Origin] = Counter()
    try:
        with locked_folder(target):
            _remove_unfinished(target)
            _fetch_all(entry, server, target, origins, on_progress or (lambda file: None))
    finally:
        if origins:  # the credit belongs to an incomplete scene too
            write_text(target / CREDITS, credit(entry))
        for path in sorted(target.rglob("*/"), reverse=True) + [target]:
            with suppress(OSError):
                path.rmdir()  # where nothing came
    return Fetched(target, origins["downloaded"], origins["copied"], origins["kept"])


def _fetch_all(
    entry: CollectionScene,
    server: _Server,
    target: Path,
    origins: Counter[Origin],
    on_progress: Callable[[PinnedFile], None],
) -> None:
    """Bring all files to their places, local ones first; counts them in `origins`."""
    mirror = mirror_folder()
    due = []
    for file in entry.files:
        if origin := _find_locally(file, target, mirror / entry.name if mirror else None):
            origins[origin] += 1
            on_progress(file)
        else:
            due.append(file)
    reasons: dict[str, str] = {}
    stop = Event()
    pool = ThreadPoolExecutor(THREADS)
    try:
        tasks = {pool.submit(_fetch, file, server, target, stop): file for file in due}
        for task in as_completed(tasks):
            try:
                task.result()
                origins["downloaded"] += 1
            except _FileError as error:
                reasons[tasks[task].path] = str(error)
            on_progress(tasks[task])
    except UnreachableError as error:
        raise UnreachableError(f"{error}. {_describe_kept(entry, origins.total())}") from error
    finally:  # after Ctrl-C too: wait until every thread has removed its unfinished file
        stop.set()
        pool.shutdown(cancel_futures=True)
    if reasons:
        lines = [f"{path}: {reasons[path]}" for path in sorted(reasons)[:LISTED]]
        lines += [f"and {len(reasons) - LISTED} more"] if len(reasons) > LISTED else []
        raise DownloadError(
            f"{len(reasons)} of {len(entry.files)} files of {entry.name} cannot be downloaded. "
            f"{'; '.join(lines)}. {_describe_kept(entry, origins.total())}"
        )


def _describe_kept(entry: CollectionScene, count: int) -> str:
    return (
        f"{count} of {len(entry.files)} files of {entry.name} are there and kept. Repeat the "
        f"command, or name another server by {RAW_VARIABLE} or a local mirror by RLBENCH_SCENES"
    )


def _find_locally(file: PinnedFile, target: Path, mirror: Path | None) -> Origin | None:
    """Keep a file that is in its place, or copy it from the mirror; None if neither has it."""
    path = target / file.path
    if _is_intact(path, file):
        return "kept"
    if mirror is None or not _is_intact(mirror / file.path, file):
        return None
    with atomic_write(path) as temporary:
        shutil.copyfile(mirror / file.path, temporary)
    return "copied"


def _fetch(file: PinnedFile, server: _Server, target: Path, stop: Event) -> None:
    """Download one file to its place, in several tries."""
    with atomic_write(target / file.path) as temporary:
        for attempt in range(1, server.tries + 1):
            if stop.is_set():
                raise _StoppedError
            try:
                _download(f"{server.address}/{quote(file.path)}", temporary, stop)
                _verify(temporary, file)
                return
            except (_PassingError, UnreachableError):
                if attempt == server.tries:
                    raise
                stop.wait(server.pause_s * 2 ** (attempt - 1))


def _download(url: str, path: Path, stop: Event) -> None:
    """Write what an address answers to a file."""
    try:
        response = urlopen(Request(url, headers={"User-Agent": "rlbench"}), timeout=TIMEOUT_S)
    except HTTPError as error:
        raise _explain_status(error, url) from error
    except URLError as error:
        raise UnreachableError(f"{url} cannot be reached: {error.reason}") from error
    except (OSError, HTTPException) as error:
        raise _PassingError(f"no answer from {url}: {error!r}") from error
    with response, path.open("wb") as stream:
        while not stop.is_set():
            try:
                chunk = response.read1(CHUNK)
            except (OSError, HTTPException) as error:
                raise _PassingError(f"the connection broke: {error!r}") from error
            if not chunk:
                return
            stream.write(chunk)
    raise _StoppedError


def _explain_status(error: HTTPError, url: str) -> Exception:
    status = f"HTTP {error.code} {error.reason}"
    if error.code in GONE:
        return _FileError(f"the file is gone at that commit ({status}, {url})")
    if error.code in REFUSED:
        return UnreachableError(f"the server refuses {url} ({status}): wait, or check the proxy")
    return _PassingError(f"the server failed ({status}, {url})")


def _verify(path: Path, file: PinnedFile) -> None:
    """Raise _PassingError unless a file has the pinned content."""
    size, blob = path.stat().st_size, blob_id(path)
    if blob == file.blob:
        return
    if file.bytes is not None and size < file.bytes:
        raise _PassingError(f"{size} of {file.bytes} bytes came")
    raise _PassingError(f"{size} bytes of git blob id {blob} came, expected {file.blob}")


def _is_intact(path: Path, file: PinnedFile) -> bool:
    """True if a file has the pinned content."""
    try:
        has_size = file.bytes in (None, path.stat().st_size)
        return has_size and path.is_file() and blob_id(path) == file.blob
    except OSError:
        return False


def _remove_unfinished(target: Path) -> None:
    """Remove what a killed download left; the lock of the folder says that no other one runs."""
    for path in target.rglob(".*"):
        if UNFINISHED.fullmatch(path.name) and path.is_file():
            path.unlink()
