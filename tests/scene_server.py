"""A small scene in a git repository, and a web server that serves it as GitHub does, with faults.

Ids and lists of files come from git itself, so they check what rlbench computes.
"""

from __future__ import annotations

import http.server
import json
import subprocess
import threading
from collections import Counter
from contextlib import suppress
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

from rlbench.apps.render.scenes.collection.catalog import pins_folder
from rlbench.apps.render.scenes.collection.pins import Pin, PinnedFile, format_pin

__all__ = ["FILES", "SceneServer", "found_files"]

OWNER = "wig42/rooms"
FOLDER = "scenes/attic"
FILES = {  # of the scene, by path
    "LICENSE.txt": b"free\n",
    "scene.xml": b"<scene version='3.0.0'/>\n",
    "models/Mesh000.obj": b"v 0 0 0\n" * 40_000,
    "textures/oak wall.png": bytes(range(256)),
}
OTHERS = {  # of the repository, not of the scene
    "README.md": b"rooms\n",
    "scenes/cellar/room.xml": b"<scene/>",
    "scenes/empty/a.gltf": b"{}",
    "scenes/empty/b.xml": b"<scene/>",
    "hut.blend": b"BLENDER",
    f"{FOLDER}/.DS_Store": b"x",
    f"{FOLDER}/TungstenRender.png": b"x",
    f"{FOLDER}/transient_scene.xml": b"<scene/>",
    f"{FOLDER}/attic_rand_scene0.xml": b"<scene/>",
}


class SceneServer:
    """A running server. `faults` are kinds of answers by path in the scene's folder, or `all`.

    A fault lasts; one that ends with `once` is given once.
    """

    def __init__(self, repository: Path) -> None:
        self.repository = repository
        for path, content in {**{f"{FOLDER}/{k}": v for k, v in FILES.items()}, **OTHERS}.items():
            (repository / path).parent.mkdir(parents=True, exist_ok=True)
            (repository / path).write_bytes(content)
        self.git("init", "--quiet")
        self.git("add", "--all")
        who = ("-c", "user.name=Wig", "-c", "user.email=wig@example.org")
        self.git(*who, "commit", "--quiet", "-m", "rooms")
        self.commit = self.git("rev-parse", "HEAD").strip()
        self.faults: dict[str, str] = {}
        self.cut: set[str] = set()  # trees whose recursive list is cut
        self.requests: Counter[str] = Counter()  # by path in the scene's folder
        self.listed: list[str] = []  # requests to the API
        self.released = threading.Event()  # ends answers that stall
        owner = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:  # noqa: N802
                owner.answer(self)

            def log_message(self, *words: object) -> None:
                pass

        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}"

    def git(self, *words: str) -> str:
        command = ["git", "-C", str(self.repository), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    def close(self) -> None:
        self.released.set()
        self._server.shutdown()
        self._server.server_close()

    def entries(self, tree: str, *options: str) -> list[dict[str, object]]:
        """A tree as GitHub lists it, by git."""
        entries = []
        for line in self.git("ls-tree", "-l", "-z", *options, tree).split("\0")[:-1]:
            (mode, kind, sha, size), path = line.partition("\t")[0].split(), line.partition("\t")[2]
            entry: dict[str, object] = {"path": path, "mode": mode, "type": kind, "sha": sha}
            entries.append({**entry, "size": int(size)} if kind == "blob" else entry)
        return entries

    def write_pin(self, *, without_sizes: bool = False, **changes: str) -> Path:
        """Pin the scene `attic` as a user does; `changes` are other blob ids, by path."""
        files = tuple(
            PinnedFile(
                path,
                changes.get(path, self.git("rev-parse", f"HEAD:{FOLDER}/{path}").strip()),
                None if without_sizes else len(FILES[path]),
            )
            for path in sorted(FILES)
        )
        pins_folder().mkdir(parents=True, exist_ok=True)
        file = pins_folder() / "attic.tsv"
        file.write_text(format_pin(Pin(OWNER, self.commit, FOLDER, files)))
        return file

    def answer(self, request: http.server.BaseHTTPRequestHandler) -> None:
        url = urlsplit(request.path)
        if url.path.startswith("/repos/"):
            self.list_tree(request, url.path, "recursive" in parse_qs(url.query))
            return
        path = unquote(url.path).removeprefix(f"/{OWNER}/{self.commit}/{FOLDER}/")
        self.requests[path] += 1
        fault = self.faults.get(path, self.faults.get("all", ""))
        if fault.endswith(" once"):
            del self.faults[path]
        file = self.repository / FOLDER / path
        if not file.is_file():
            fault = "404"
        content = b"" if fault == "404" else file.read_bytes()
        with suppress(ConnectionError):  # the other side gave up
            self.serve(request, content, fault.removesuffix(" once"))

    def serve(
        self, request: http.server.BaseHTTPRequestHandler, content: bytes, fault: str
    ) -> None:
        if fault.isdigit():
            request.send_error(int(fault))
            return
        if fault == "silent":
            request.connection.close()
            return
        request.send_response(200)
        request.send_header("Content-Length", str(len(content)))
        request.end_headers()
        if fault == "wrong":
            content = content[::-1]
        half = len(content) // 2
        request.wfile.write(content[:half])
        if fault == "stall":
            request.wfile.flush()
            self.released.wait(60)
        elif fault == "trickle":  # never ends, and never stays silent for long
            while not self.released.wait(0.05):
                request.wfile.write(b"v")
        elif fault != "truncated":
            request.wfile.write(content[half:])

    def list_tree(
        self, request: http.server.BaseHTTPRequestHandler, path: str, recursive: bool
    ) -> None:
        tree = path.rpartition("/")[2]
        self.listed.append(f"{tree}{'?recursive=1' * recursive}")
        if fault := self.faults.get("api"):
            request.send_response(int(fault))
            request.send_header("X-RateLimit-Reset", "1700000000")
            request.end_headers()
            return
        if not path.startswith(f"/repos/{OWNER}/git/trees/"):
            request.send_error(404)
            return
        tree_id = self.git("rev-parse", f"{tree}^{{tree}}").strip()
        entries = self.entries(tree, *(("-r", "-t") if recursive else ()))
        is_cut = recursive and tree_id in self.cut
        answer = {"sha": tree, "tree": entries[: 1 if is_cut else None], "truncated": is_cut}
        content = json.dumps(answer).encode()
        request.send_response(200)
        request.send_header("Content-Length", str(len(content)))
        request.end_headers()
        request.wfile.write(content)


def found_files(folder: Path) -> dict[str, bytes]:
    """The files of a folder by path, hidden ones too."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
