"""Density: both ways agree where there is nothing to carry, and the verdict follows from the ratios."""

import numpy as np
import pytest

from experiments.beyond.density import _drape, draw, markdown, ratios
from tests.experiments.tiny_garments import AREA, FABRIC, tiny_model
from tryon_jax.garment import load_manifest, remesh
from tryon_jax.tryon import config_space


@pytest.mark.slow
def test_at_the_trained_density_the_mesh_carries_itself():
    model = tiny_model()
    space, design = config_space(model.config), load_manifest().design("tank")
    betas = np.array([[0.5, -0.5]], np.float32)
    mesh = remesh(space, design, AREA, seed=3)
    direct, carried = (_drape(model, mesh, way, betas, FABRIC) for way in ("direct", "carried"))
    np.testing.assert_allclose(direct, carried, atol=1e-5)


def results(direct, carried):
    def entry(way, factor, error):
        distances = dict.fromkeys(("trained_density_mm", "hausdorff_mm"), 1.0)
        return {"way": way, "factor": factor, "vertices": 9, "simulation_mm": error, **distances}

    entries = [entry("direct", f, e) for f, e in direct.items()] + [entry("carried", f, e) for f, e in carried.items()]
    return {"design": "tank", "fabric": FABRIC, "shapes": 2, "entries": entries}


def test_the_verdict_is_the_worst_density(tmp_path):
    found = results({0.5: 5.0, 1.0: 4.0, 8.0: 12.0}, {0.5: 4.4, 1.0: 4.0, 8.0: 4.8})
    assert ratios(found, "direct") == {0.5: 1.25, 1.0: 1.0, 8.0: 3.0}
    lines = "\n".join(markdown(found))
    assert "not supported (worst 3.00 at 8 ×)" in lines
    assert ": supported (worst 1.20 at 8 ×)" in lines
    draw(tmp_path / "density.png", found)
    assert (tmp_path / "density.png").exists()
