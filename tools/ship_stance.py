"""Put a run's R_stance into the package, in half precision where that changes no drape by 0.2 mm.

Weights that tear a garment on the way of the arms are refused, as `tools.ship_weights` refuses those of T-pose drapes.

python -m tools.ship_stance runs/stance
"""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from tools.ship_weights import LIMIT, MODELS, STRETCHED, TORN, Tear
from tryon_jax.body.stance import LOWEST
from tryon_jax.garment import Design
from tryon_jax.metrics import edge_strain
from tryon_jax.nets.store import read_record
from tryon_jax.training.collisions import random_betas
from tryon_jax.tryon import config_space, load_pretrained
from tryon_jax.tryon.model_file import STANCE
from tryon_jax.tryon.stance_file import add_stance, save_stance
from tryon_jax.wear.session import Session

DESIGNS = 50
"""Random designs, each in a topology of its own on four random bodies and in every fabric in turn."""
STANCES = (LOWEST / 2, LOWEST)
"""Degrees."""


def standing(
    session: Session, design: Design, seed: int, betas: Float[np.ndarray, "B b"], fabric: str
) -> tuple[list[Float[np.ndarray, "V 3"]], float]:
    """Drapes of a design on some bodies in each of `STANCES`, metres, and the largest strain of an edge in them.

    Args:
        session: What drapes.
        design: The design.
        seed: Of its topology.
        betas: Of each body.
        fabric: Name.
    """
    garment = session.prepare(design, seed=seed)
    drapes = [
        session.stand(dressed, degrees)[0]
        for dressed in session.drape_many(garment, [tuple(map(float, row)) for row in betas], fabric=fabric)
        for degrees in STANCES
    ]
    strains = [float(edge_strain(drape, garment.faces, garment.uv, garment.faces_uv).max()) for drape in drapes]
    return drapes, max(strains)


def main(run: Path) -> None:
    """Write tryon_jax/data/models/small-stance.safetensors.

    Raises:
        ValueError: the weights tear a garment.
    """
    source = run / "stance.safetensors"
    model = add_stance(replace(load_pretrained(), stance=None), source)
    session, rng = Session(model, one_size=True), np.random.default_rng(0)
    designs: Sequence[Design] = config_space(model.config).sample(DESIGNS, 0)
    bodies = [random_betas(rng, 4, model.config.beta_ranges) for _ in designs]
    tears, kept = [], []
    for k, design in enumerate(tqdm(designs, desc="random designs")):
        fabric = session.fabrics[k % len(session.fabrics)]
        drapes, strain = standing(session, design, 10_000 + k, bodies[k], fabric)
        tears.append(Tear(strain, f"{design} in {fabric}"))
        kept.append(drapes)
    stretched = sum(tear.strain >= STRETCHED for tear in tears)
    print(
        f"edges stretch by {max(tears).strain:.2f} at most ({max(tears).where}); of {len(tears)} garments {stretched} "
        f"by {STRETCHED} or more"
    )
    if max(tears).strain >= TORN:
        raise ValueError(f"{source} tears {max(tears).where}, strain {max(tears).strain:.2f}")
    network, record = model.stance, read_record(source)["training"]
    assert network is not None
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / "half.safetensors"
        save_stance(trial, network, model.body, record, half=True)
        halved = Session(add_stance(replace(model, stance=None), trial), one_size=True)
    change = 0.0
    for k, design in enumerate(designs[:5]):
        drapes, _ = standing(halved, design, 10_000 + k, bodies[k], session.fabrics[k % len(session.fabrics)])
        pairs = zip(kept[k], drapes, strict=True)
        change = max(change, *(float(np.linalg.norm(a - b, axis=1).max()) for a, b in pairs))
    half, path = change < LIMIT, MODELS / f"small{STANCE}.safetensors"
    save_stance(path, network, model.body, record, half=half)
    print(f"half precision moves vertices by {1e3 * change:.3f} mm at most: {'used' if half else 'not used'}")
    print(f"wrote {path}, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m tools.ship_stance RUN")
    main(Path(sys.argv[1]))
