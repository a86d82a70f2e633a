"""Draping a catalogue: many garments on many bodies, as independent blocks that any number of processes may work on.

    ROOT/catalogue.json               what was asked for; a folder belongs to one catalogue
    ROOT/<garment>/garment.npz        faces, design parameters and the drape on the mean body
    ROOT/<garment>/<block>.npz        vertices [B, V, 3] in metres and the betas [B, b] of a block of bodies

Garments and bodies are drawn by number from a seed: each is the same however many there are and whoever drapes it.
"""

import functools
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice, check_range
from tryon_jax.files.atomic import write_text
from tryon_jax.garment import Design
from tryon_jax.training.dataset import save_arrays
from tryon_jax.tryon import Garment, TryOnModel, config_space, drape, load_model, load_pretrained, prepare


@dataclass(frozen=True)
class CatalogueConfig:
    """What a catalogue holds."""

    model: str = "small"
    """A pretrained model's name, or the path of a safetensors file."""
    fabric: str = "gray-interlock"
    garments: int = 100
    """Random designs of the model's design space."""
    bodies: int = 256
    """Random body shapes, the same for all garments."""
    block: int = 64
    """Bodies in a file."""
    seed: int = 0


def open_catalogue(root: Path, config: CatalogueConfig) -> list[tuple[str, int, int]]:
    """Create the folder, or check that it belongs to the same catalogue, and list the blocks that are missing.

    Returns:
        Arguments of `drape_block` for each missing block, garment by garment.

    Raises:
        ValueError: a number is out of range, the fabric is unknown, or the folder belongs to another catalogue.
    """
    check_range("garments", config.garments, 1, 10**9)
    check_range("bodies", config.bodies, 1, 10**9)
    check_range("block", config.block, 1, 4096)
    check_choice("fabric", config.fabric, _load(config.model).fine)
    path, wanted = root / "catalogue.json", asdict(config)
    if not path.exists():
        write_text(path, json.dumps(wanted, indent=1) + "\n")
    found = json.loads(path.read_text(encoding="utf-8"))
    different = [f"{k} = {found.get(k)!r} (asked for {wanted[k]!r})" for k in wanted if found.get(k) != wanted[k]]
    if different:
        raise ValueError(f"{str(root)!r} holds another catalogue: {', '.join(different)}; choose another folder")
    blocks = [(str(root), g, b) for g in range(config.garments) for b in range(-(-config.bodies // config.block))]
    return [block for block in blocks if not block_path(*block).exists()]


def block_path(root: str, garment: int, block: int) -> Path:
    """File of one block."""
    return Path(root) / f"{garment:06d}" / f"{block:05d}.npz"


def drape_block(root: str, garment: int, block: int) -> str:
    """Drape one block of bodies unless its file exists; returns a line for the log ("" if there was nothing to do)."""
    path = block_path(root, garment, block)
    if path.exists():
        return ""
    config = CatalogueConfig(**json.loads((Path(root) / "catalogue.json").read_text(encoding="utf-8")))
    model, prepared = _prepared(config, garment)
    first = block * config.block
    count = min(config.block, config.bodies - first)
    # The last block is filled up with its own bodies: one shape of batch is compiled for each bucket.
    numbers = first + np.arange(config.block) % count
    betas = catalogue_betas(config.seed, numbers, model.config.beta_ranges)
    vertices = prepared.unpad(_drape(model, prepared, betas, fabric=config.fabric))[:count]
    mesh = path.parent / "garment.npz"
    if not mesh.exists():
        assert prepared.design is not None
        arrays = {"faces": prepared.faces, "design": np.asarray(prepared.design), "mean": prepared.mean_vertices}
        save_arrays(mesh, arrays)
    save_arrays(path, {"vertices": vertices, "betas": betas[:count]})
    return f"garment {garment}, block {block}: {count} bodies, {prepared.num_vertices} vertices"


def catalogue_design(model: TryOnModel, seed: int, garment: int) -> Design:
    """Design of a garment by its number, evenly spread over the design space."""
    space = config_space(model.config)
    share = np.random.default_rng((seed, 0, garment)).random(len(space.names))
    return space.from_values(space.minimum + share * (space.maximum - space.minimum))


def catalogue_betas(seed: int, numbers: np.ndarray, extent: tuple[float, ...]) -> Float[np.ndarray, "B b"]:
    """Betas of bodies by their numbers, evenly spread over an ellipse with the half axes `extent`."""
    rows = []
    for number in numbers:
        rng = np.random.default_rng((seed, 1, int(number)))
        direction = rng.normal(size=len(extent))
        rows.append(direction / np.linalg.norm(direction) * rng.random() ** (1 / len(extent)))
    return (np.array(rows) * np.array(extent)[None]).astype(np.float32)


_drape = jax.jit(drape, static_argnames="fabric")


@functools.lru_cache(maxsize=1)
def _load(model: str) -> TryOnModel:
    return load_model(model) if model.endswith(".safetensors") else load_pretrained(model)


@functools.lru_cache(maxsize=4)
def _prepared(config: CatalogueConfig, garment: int) -> tuple[TryOnModel, Garment]:
    model = _load(config.model)
    return model, prepare(model, catalogue_design(model, config.seed, garment), seed=garment)
