"""Parameter stores: round trip, and a clear word about every file that does not fit."""

import json
import struct

import jax
import numpy as np
import pytest

from tryon_jax.nets import UNetConfig, init_unet
from tryon_jax.nets.store import (
    compare_records,
    config_record,
    hash_arrays,
    load_store,
    read_record,
    save_store,
    tree_names,
)


@pytest.fixture
def saved(tmp_path):
    net = init_unet(jax.random.key(0), UNetConfig(widths=(3, 4)), 2)
    path = tmp_path / "net.safetensors"
    save_store(path, {"net": net, "scale": np.float32(0.5)}, {"units": {"length": "m"}})
    return path, {"net": net, "scale": np.float32(0.5)}


def test_round_trip(saved):
    path, tree = saved
    assert read_record(path) == {"units": {"length": "m"}}
    names = tree_names(tree)
    assert "net.encoder.0.1.weight" in names
    arrays = load_store(path, names)
    assert list(arrays) == list(names)
    assert all(np.array_equal(arrays[n], names[n]) for n in names)
    assert [p.name for p in path.parent.iterdir()] == ["net.safetensors"]


def test_weights_may_be_stored_in_half_precision(saved, tmp_path):
    path, tree = saved
    half = tmp_path / "half.safetensors"
    save_store(half, tree, {}, half=True)
    assert half.stat().st_size < path.stat().st_size
    names = tree_names(tree)
    arrays = load_store(half, names)
    for name, wanted in names.items():
        assert arrays[name].dtype == wanted.dtype
        exact = ".weight" not in name
        np.testing.assert_allclose(arrays[name], wanted, rtol=0 if exact else 1e-3, atol=0 if exact else 1e-6)
    # Positions are never rounded.
    positions = {"center": np.full((4, 3), 0.1234567, np.float32)}
    save_store(half, positions, {}, half=True)
    assert np.array_equal(load_store(half, positions)["center"], positions["center"])


def test_differences_are_listed(saved):
    path, tree = saved
    other = tree_names({"net": init_unet(jax.random.key(0), UNetConfig(widths=(3, 5)), 2), "offset": np.float32(0)})
    with pytest.raises(ValueError, match="does not fit the model") as error:
        load_store(path, other)
    text = str(error.value)
    assert "net.decoder.0.0.weight is float32[2, 7, 3], not float32[2, 8, 3]" in text
    assert "offset is missing" in text
    assert "scale is not part of the model" in text
    wrong = tree_names(tree) | {"scale": np.float64(0.5)}
    with pytest.raises(ValueError, match=r"scale is float32\[\], not float64\[\]"):
        load_store(path, wrong)


def test_values_that_are_not_finite_are_refused(tmp_path):
    path = tmp_path / "bad.safetensors"
    save_store(path, {"a": np.array([1.0, np.nan])}, {})
    with pytest.raises(ValueError, match="a holds values that are not finite"):
        load_store(path, {"a": np.zeros(2)})


def test_files_that_are_no_stores(tmp_path, saved):
    path, tree = saved
    for content in (b"", b"not a store at all, just text", struct.pack("<Q", 1 << 60), struct.pack("<Q", 4) + b"nope"):
        bad = tmp_path / "bad.safetensors"
        bad.write_bytes(content)
        with pytest.raises(ValueError, match="is not a safetensors file"):
            read_record(bad)
    header = json.dumps({"__metadata__": {"schema": "other/7"}}).encode()
    bad.write_bytes(struct.pack("<Q", len(header)) + header)
    with pytest.raises(ValueError, match="schema 'other/7'"):
        read_record(bad)
    bad.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ValueError, match="is damaged"):
        load_store(bad, tree_names(tree))
    with pytest.raises(FileNotFoundError, match=r"gone\.safetensors"):
        read_record(tmp_path / "gone.safetensors")


def test_records_are_compared_field_by_field():
    found = {"config": {"order": 2, "widths": [1]}, "body": {"hash": "a"}}
    wanted = {"config": {"order": 3, "widths": [1]}, "body": {"hash": "b"}}
    assert compare_records(found, wanted) == ["config.order: 2, not 3", "body.hash: 'a', not 'b'"]
    assert compare_records(found, found) == []


def test_config_record_is_json():
    record = config_record(UNetConfig(widths=(3, 4)))
    assert record["widths"] == [3, 4]
    assert json.loads(json.dumps(record)) == record


def test_hash_sees_values_shapes_and_types():
    a = np.arange(6.0)
    hashes = {hash_arrays(a), hash_arrays(a + 1e-9), hash_arrays(a.reshape(2, 3)), hash_arrays(a.astype(np.float32))}
    assert len(hashes) == 4
    assert hash_arrays(a) == hash_arrays(a.copy())
