"""The decode cache: damaged files are noticed and decoded again."""

from __future__ import annotations

import errno
from collections.abc import Callable
from io import BytesIO

import numpy as np
import pytest
import torch

from rlbench.clips import decode_cache, open_clip
from rlbench.clips.decode_cache import open_array, write_array
from rlbench.system import paths


def _old_file() -> bytes:
    np.save(content := BytesIO(), np.zeros((3, 5, 7), np.float32))
    return content.getvalue()  # as it was before there were checksums


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "zeros": lambda content: bytes(len(content)),
    "zeros for values": lambda content: content[:128] + bytes(len(content) - 148) + content[-20:],
    "a flipped bit": lambda content: content[:200] + bytes([content[200] ^ 1]) + content[201:],
    "cut": lambda content: content[:150],
    "a lost end": lambda content: content[:-1],
    "empty": lambda content: b"",
    "longer": lambda content: content + b"x",
    "without a checksum": lambda content: _old_file(),
}

OTHERS = {"shape": np.zeros((1, 1, 1), np.float16), "type": np.zeros((3, 5, 7))}


@pytest.mark.parametrize("kind", [*DAMAGE, *OTHERS])
def test_a_damaged_file_is_decoded_again(folder, kind):
    before = open_clip(folder).frame(1)
    files = sorted(paths.decoded_folder().rglob("*.npy"))
    assert files
    for path in files:
        if kind in OTHERS:
            write_array(path, OTHERS[kind])
        else:
            path.write_bytes(DAMAGE[kind](path.read_bytes()))
    after = open_clip(folder).frame(1)
    assert torch.equal(before.pool.radiance, after.pool.radiance)
    assert torch.equal(before.reference.half_a, after.reference.half_a)
    for name in ("depth", "albedo"):
        assert torch.equal(before.gbuffer.buffers[name], after.gbuffer.buffers[name])


def test_an_image_is_stored_in_its_own_type_whatever_is_decoded_with_it(folder):
    """Else two processes would replace each other's files by files of another size."""
    stored = []
    for inputs in ({"normal"}, {"normal", "depth"}):
        open_clip(folder, frozenset(inputs)).frame(0)
        (file,) = paths.decoded_folder().rglob("normal.0000.npy")
        stored.append(file.read_bytes())
        file.unlink()
        for depth in paths.decoded_folder().rglob("depth.0000.npy"):
            assert np.load(depth).dtype == np.float32
    assert stored[0] == stored[1]
    assert np.load(BytesIO(stored[0])).dtype == np.float16


def test_an_intact_file_is_hashed_once_per_process(folder, monkeypatch):
    open_clip(folder).frame(0)
    open_clip(folder).frame(0)
    monkeypatch.setattr(decode_cache, "_checksum", None)  # hashing would now be an error
    monkeypatch.setattr(decode_cache, "read_channels", None)  # and so would decoding
    open_clip(folder).frame(0)


def test_a_full_disk_leaves_no_file_and_says_so(folder, monkeypatch):
    def fail(*_args: object, **_options: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np.lib.format, "write_array", fail)
    with pytest.raises(paths.WriteError, match=r"npy cannot be written .*bytes free"):
        open_clip(folder).frame(0)
    assert [p for p in paths.decoded_folder().rglob("*") if "npy" in p.name] == []


def test_an_array_comes_back_as_a_memory_map(tmp_path):
    values = np.arange(24, dtype=np.float16).reshape(2, 3, 4)
    write_array(tmp_path / "a.npy", values)
    array = open_array(tmp_path / "a.npy", (2, 3, 4))
    assert isinstance(array, np.memmap)
    np.testing.assert_array_equal(array, values)
