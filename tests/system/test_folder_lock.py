"""One process writes to a folder; the lock ends with its owner, however that ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from rlbench.system.folder_lock import LOCK_FILE, FolderInUseError, locked_folder

OWNER = """
import sys, time
from pathlib import Path
from rlbench.system.folder_lock import locked_folder
with locked_folder(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


def test_a_lock_is_held_once_and_leaves_nothing(tmp_path):
    with locked_folder(tmp_path / "r"):
        who = f"process {os.getpid()} on "
        with pytest.raises(FolderInUseError, match=who), locked_folder(tmp_path / "r"):
            pass
        with locked_folder(tmp_path / "other"):
            pass
    assert list((tmp_path / "r").iterdir()) == []
    with locked_folder(tmp_path / "r"):
        pass


def test_the_lock_of_a_killed_process_is_free(tmp_path):
    owner = subprocess.Popen([sys.executable, "-c", OWNER, tmp_path], stdout=subprocess.PIPE)
    assert owner.stdout is not None
    assert owner.stdout.readline() == b"locked\n"
    with pytest.raises(FolderInUseError, match=f"process {owner.pid} on "), locked_folder(tmp_path):
        pass
    owner.send_signal(signal.SIGKILL)
    owner.wait()
    assert (tmp_path / LOCK_FILE).exists()
    with locked_folder(tmp_path):
        pass
    assert not (tmp_path / LOCK_FILE).exists()
