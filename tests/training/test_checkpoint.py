"""Checkpoints: small ones in one file, large ones in shards; never half of one."""

import json

import numpy as np
import pytest

from tryon_jax.training import checkpoint
from tryon_jax.training.checkpoint import load_checkpoint, save_checkpoint

LIMIT = 20_000


def leaves(seed: int = 0) -> list[np.ndarray]:
    """A scalar, an empty array, integers, and one leaf that is larger than a shard."""
    rng = np.random.default_rng(seed)
    return [
        np.array(7 + seed, np.int32),
        np.zeros((0, 3), np.float32),
        rng.integers(0, 9, 50).astype(np.int32),
        rng.normal(size=(90, 101)).astype(np.float32),
        *(rng.normal(size=300).astype(np.float32) for _ in range(20)),
    ]


def assert_same(found, expected) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_nothing_saved_is_nothing_loaded(tmp_path):
    assert load_checkpoint(tmp_path) is None


@pytest.mark.parametrize("limit", [LIMIT, 10_000_000])
def test_what_was_saved_is_loaded(tmp_path, limit):
    for seed in (0, 1, 2):
        save_checkpoint(tmp_path, leaves(seed), {"step": seed, "curve": [{"loss": 0.1}]}, limit)
        found, progress = load_checkpoint(tmp_path)
        assert_same(found, leaves(seed))
        assert progress == {"step": seed, "curve": [{"loss": 0.1}]}
    assert (tmp_path / "checkpoint.npz").exists() == (limit > LIMIT)


def test_no_file_is_larger_than_asked(tmp_path):
    save_checkpoint(tmp_path, leaves(), {}, LIMIT)
    shards = list((tmp_path / "checkpoint").glob("*.safetensors"))
    total = sum(leaf.nbytes for leaf in leaves())
    assert all(path.stat().st_size <= LIMIT for path in shards)
    assert len(shards) <= 1.5 * total / LIMIT + 1


def test_old_shards_are_deleted(tmp_path):
    for seed in range(4):
        save_checkpoint(tmp_path, leaves(seed), {}, LIMIT)
    listed = {s["file"] for s in json.loads((tmp_path / "checkpoint" / "index.json").read_text())["shards"]}
    assert {path.name for path in (tmp_path / "checkpoint").iterdir()} == {*listed, "index.json"}


@pytest.mark.parametrize("writes", [0, 1, 2])
def test_interrupted_while_writing_keeps_the_one_before(tmp_path, monkeypatch, writes):
    save_checkpoint(tmp_path, leaves(0), {"step": 0}, LIMIT)
    done = 0
    write = checkpoint.write_bytes

    def stop(path, data):
        nonlocal done
        if done == writes:
            raise KeyboardInterrupt
        done += 1
        write(path, data)

    monkeypatch.setattr(checkpoint, "write_bytes", stop)
    with pytest.raises(KeyboardInterrupt):
        save_checkpoint(tmp_path, leaves(1), {"step": 1}, LIMIT)
    monkeypatch.undo()
    found, progress = load_checkpoint(tmp_path)
    assert_same(found, leaves(0))
    assert progress == {"step": 0}
    save_checkpoint(tmp_path, leaves(2), {"step": 2}, LIMIT)
    assert_same(load_checkpoint(tmp_path)[0], leaves(2))


def test_a_single_file_from_before_gives_way_to_shards(tmp_path):
    save_checkpoint(tmp_path, leaves(0), {"step": 0}, 10_000_000)
    save_checkpoint(tmp_path, leaves(1), {"step": 1}, LIMIT)
    assert not (tmp_path / "checkpoint.npz").exists()
    assert load_checkpoint(tmp_path)[1] == {"step": 1}


def test_a_damaged_shard_is_named(tmp_path):
    save_checkpoint(tmp_path, leaves(), {}, LIMIT)
    shard = sorted((tmp_path / "checkpoint").glob("*.safetensors"))[1]
    data = bytearray(shard.read_bytes())
    data[-1] ^= 1
    shard.write_bytes(data)
    with pytest.raises(ValueError, match=f"damaged.*{shard.name}"):
        load_checkpoint(tmp_path)
    shard.unlink()
    with pytest.raises(ValueError, match="damaged"):
        load_checkpoint(tmp_path)
