"""Put a run's weights into the package, in half precision where that changes no drape by 0.2 mm.

Weights that tear a garment on any body of a wide range are refused: mean errors do not show one collapsed collar. Where
edges are stretched, the simulator says beside them how much of that is the body's doing.

python -m tools.ship_weights runs/small
python -m tools.ship_weights runs/fabrics small-fabrics
python -m tools.ship_weights runs/paper-form paper-form
"""

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from tryon_jax.garment import Design
from tryon_jax.metrics import edge_strain
from tryon_jax.nets.store import read_record
from tryon_jax.physics.fabric_numbers import fabric_numbers
from tryon_jax.physics.fabrics import fabric_names, load_fabric
from tryon_jax.training.collisions import random_betas
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import (
    Garment,
    TryOnModel,
    config_space,
    drape,
    load_model,
    prepare,
    save_model,
)
from tryon_jax.tryon.model_file import SHARED
from tryon_jax.tryon.shared_fine import add_shared_fine, save_shared_fine
from tryon_jax.wear.session import Session

LIMIT = 2e-4
"""Metres."""
SIMULATED = 8
"""Of the garments that are stretched most."""
DIGITS = 7
"""Of the mantissa."""
TORN = 1.0
"""Strain of an edge, against its length in the flat pattern, from which weights are refused."""
STRETCHED = 0.5
"""Strain that no garment should reach: how many do is told."""
RANDOM_DESIGNS = 200
"""Random designs, each in a topology of its own on four random bodies, that weights must drape untorn."""
DESIGNS = ("tank", "tshirt", "sweater", "dress", "maxi-dress")
SHAPES = np.array([[0.0, 0.0], [2.5, 0.5], [-2.5, -0.5], [0.5, 1.8], [-0.5, -1.8]], np.float32)
MODELS = Path("tryon_jax/data/models")
TOGETHER = 74
"""Bodies of one call, as many as `bodies_all_over_the_range`; fewer are filled up, so that one program drapes all."""
_BY_NUMBERS = " by numbers"
_by_name, _by_numbers = jax.jit(drape, static_argnames="fabric"), jax.jit(drape)


Fabrics = Mapping[str, str | Float[np.ndarray, " F"]]
"""What to drape in: by name, or by numbers."""


def fabrics_of(model: TryOnModel, by_numbers: Sequence[str] | None = None) -> Fabrics:
    """The fabrics of the networks of single ones, and others by their numbers, all embedded ones by default."""
    names = fabric_names() if by_numbers is None else by_numbers
    shared = names if model.config.shared_fabrics else ()
    numbers = {f"{name}{_BY_NUMBERS}": np.asarray(fabric_numbers(load_fabric(name))) for name in shared}
    return {name: name for name in model.config.fabrics} | numbers


def drape_bodies(
    model: TryOnModel, garment: Garment, betas: Float[np.ndarray, "B b"], fabric: str | Float[np.ndarray, " F"]
) -> jax.Array:
    """Drapes of a garment on at most `TOGETHER` bodies."""
    run = _by_name if isinstance(fabric, str) else _by_numbers
    filled = np.concatenate([betas, np.broadcast_to(betas[:1], (TOGETHER - len(betas), betas.shape[1]))])
    return run(model, garment, filled, fabric=fabric)[: len(betas)]


def largest_change(one: TryOnModel, other: TryOnModel) -> float:
    """Largest distance between the drapes of two models over designs, shapes and fabrics, metres."""
    worst = 0.0
    shapes = SHAPES[:, : one.config.num_betas]
    for design in DESIGNS:
        garment = prepare(one, design)
        for fabric in fabrics_of(one).values():
            difference = garment.unpad(drape_bodies(one, garment, shapes, fabric)) - garment.unpad(
                drape_bodies(other, garment, shapes, fabric)
            )
            worst = max(worst, float(np.linalg.norm(difference, axis=-1).max()))
    return worst


class Case(NamedTuple):
    """One drape."""

    design: Design
    seed: int
    """Of the topology."""
    fabric: str
    betas: tuple[float, ...]


class Tear(NamedTuple):
    """The most stretched edge of some drapes."""

    strain: float
    """Against its length in the flat pattern."""
    where: str
    """Design, topology, fabric and betas."""
    case: Case | None = None


def bodies_all_over_the_range() -> Float[np.ndarray, "74 2"]:
    """Betas on three ellipses, 15 degrees apart, and near the ends of the build axis."""
    angles = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    rings = [r * np.stack([3 * np.cos(angles), 2 * np.sin(angles)], 1) for r in (0.5, 0.8, 0.95)]
    return np.concatenate([*rings, [[0.5, 1.8], [-0.5, -1.8]]]).astype(np.float32)


def largest_strain(
    session: Session, design: Design, seed: int, betas: Float[np.ndarray, "B b"], fabrics: Fabrics | None = None
) -> Tear:
    """The most stretched edge of a design in one topology, over bodies and fabrics, by default all.

    In a session of one size all designs share their compiled drapes.
    """
    model, prepared = session.model, session.prepare(design, seed=seed)
    garment, pattern = prepared.garment, (prepared.faces, prepared.uv, prepared.faces_uv)
    found = []
    for name, fabric in (fabrics or fabrics_of(model)).items():
        drapes = garment.unpad(drape_bodies(model, garment, betas, fabric))
        strains = [float(edge_strain(row, *pattern).max()) for row in drapes]
        k = int(np.argmax(strains))
        case = Case(design, seed, name.removesuffix(_BY_NUMBERS), tuple(map(float, betas[k])))
        found.append(Tear(strains[k], f"{design}, topology {seed}, {name}, betas {betas[k]}", case))
    return max(found, key=lambda tear: tear.strain)


def simulated_strain(session: Session, case: Case) -> float | None:
    """The most stretched edge of the same drape by the simulator, dressed by itself; None where it finds no rest.

    A garment that is too tight for a body is stretched by it, not by the networks.
    """
    prepared = session.prepare(case.design, seed=case.seed)
    try:
        dressed = session.simulate(prepared, case.betas, fabric=case.fabric)
    except ValueError:
        return None
    return float(edge_strain(dressed.vertices, prepared.faces, prepared.uv, prepared.faces_uv).max())


def random_tears(session: Session, count: int, seed: int = 0, fabrics: Fabrics | None = None) -> Iterator[Tear]:
    """The most stretched edge of each of `count` random designs, in a topology of its own, on four random bodies."""
    rng, config = np.random.default_rng(seed), session.model.config
    for k, design in enumerate(config_space(config).sample(count, seed)):
        yield largest_strain(session, design, 10_000 + k, random_betas(rng, 4, config.beta_ranges), fabrics)


def fewer_digits(model: TryOnModel) -> TryOnModel:
    """The model with the networks that start from kriged drapes in `DIGITS` binary digits, which compress better.

    They add a millimetre or two to a drape, so a hundredth of that does not count.
    """

    def rounded(weights: jax.Array) -> np.ndarray:
        mantissa, exponent = np.frexp(np.asarray(weights))
        return np.ldexp(np.round(mantissa * 2**DIGITS) / 2**DIGITS, exponent).astype(np.float32)

    fine = {f: replace(model.fine[f], net=jax.tree.map(rounded, model.fine[f].net)) for f in model.kriging}
    return replace(model, fine=model.fine | fine)


def main(run: Path, name: str = "small") -> None:
    """Write tryon_jax/data/models/NAME.safetensors.

    Raises:
        ValueError: the weights tear a garment.
    """
    source = model_path(run)
    model, record = load_model(source), read_record(source)["training"]
    space, session = config_space(model.config), Session(model, one_size=True)
    tears = [largest_strain(session, space.preset(design), 0, bodies_all_over_the_range()) for design in DESIGNS]
    tears += tqdm(random_tears(session, RANDOM_DESIGNS), total=RANDOM_DESIGNS, desc="random designs")
    torn = [tear for tear in tears if tear.strain >= TORN]
    stretched = [tear for tear in sorted(tears, key=lambda t: -t.strain) if tear.strain >= STRETCHED]
    worst = max(tears, key=lambda tear: tear.strain)
    print(
        f"edges stretch by {worst.strain:.2f} at most ({worst.where}); of {len(tears)} garments {len(stretched)} "
        f"by {STRETCHED} or more, {len(torn)} are torn"
    )
    for tear in stretched[:SIMULATED]:
        simulated = None if tear.case is None else simulated_strain(session, tear.case)
        beside = "no rest is found" if simulated is None else f"{simulated:.2f}"
        print(f"{tear.strain:.2f}, simulated {beside}: {tear.where}")
    if torn:
        raise ValueError(
            f"{source} tears {len(torn)} garments, the first: {torn[0].where}, strain {torn[0].strain:.2f}"
        )
    # The R_fine of all fabrics lies beside the model whose R_mean and R_smooth it has.
    save = save_shared_fine if name.endswith(SHARED) else save_model
    smaller = fewer_digits(model)
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / "half.safetensors"
        save(trial, smaller, record, half=True)
        change = largest_change(model, add_shared_fine(model, trial) if name.endswith(SHARED) else load_model(trial))
    half = change < LIMIT
    path = MODELS / f"{name}.safetensors"
    save(path, smaller if half else model, record, half=half)
    print(f"half precision moves vertices by {1e3 * change:.3f} mm at most: {'used' if half else 'not used'}")
    print(f"wrote {path}, {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit("usage: python -m tools.ship_weights RUN [NAME]")
    main(Path(sys.argv[1]), *sys.argv[2:])
