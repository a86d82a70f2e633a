"""What is wrong with a drape, on drapes of which it is known: the flat pattern, stretched, and a garment swallowed."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from experiments.paper import qualitative
from experiments.shared.record import read_result
from tests.experiments.known_data import FABRICS
from tests.experiments.tiny_garments import AREA
from tryon_jax.garment import load_manifest, remesh
from tryon_jax.tryon import config_space

STRETCH = 1.1


@pytest.mark.slow
def test_strain_and_penetration_of_known_drapes(known, tmp_path, monkeypatch):
    # Meshed as coarsely as the model's other garments.
    manifest = replace(load_manifest(), target_area=AREA)
    monkeypatch.setattr(qualitative, "load_manifest", lambda: manifest)
    mesh = remesh(config_space(known.model.config), manifest.design("unseen-tank"), AREA, seed=555)
    flat = np.column_stack([STRETCH * mesh.uv[mesh.vertex_uv], np.zeros(mesh.num_vertices)]) + [[0.0, 3.0, 0.0]]
    belly = np.broadcast_to(np.array([0.0, 0.1, 0.02]), flat.shape)

    def drape(_model, garment, betas, fabric):
        assert fabric == FABRICS[0]
        assert len(betas) == 2
        padded = jnp.zeros((2, garment.graph.num_nodes, 3))
        return padded.at[:, : len(flat)].set(np.stack([flat, belly]).astype(np.float32))

    sheets = []
    monkeypatch.setattr(qualitative, "drape", drape)
    monkeypatch.setattr(qualitative, "contact_sheet", lambda _path, items, **_: sheets.append(items))
    config = qualitative.Config(
        run=known.run, out=tmp_path, designs=("unseen-tank",), betas=((0.0, 0.0), (0.5, 0.0)), fabric=FABRICS[0]
    )
    qualitative.main(config)
    record = read_result(tmp_path, "qualitative")
    assert record is not None
    above, inside = record["results"]["drapes"]
    assert above["area_strain_percent"] == pytest.approx(100 * (STRETCH**2 - 1), abs=0.1)
    assert (above["inside_percent"], above["deepest_mm"]) == (0.0, 0.0)
    assert inside["area_strain_percent"] == pytest.approx(-100.0)
    assert inside["inside_percent"] == 100.0
    # No point of the belly is deeper than half its width.
    assert 20 < inside["deepest_mm"] < 200
    assert len(sheets[0]) == 2


def test_a_topology_that_was_trained_on_is_refused(known, tmp_path):
    with pytest.raises(ValueError, match="seed 0 is a training topology"):
        qualitative.main(qualitative.Config(run=known.run, out=tmp_path, seed=0))
