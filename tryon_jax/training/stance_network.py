"""Training R_stance on simulated descents of the arms: one network for all fabrics, added to a model.

It learns what a drape changes when the arms come down, carried back to the T-pose by the skinning that users get. The
weights of its fields are products of a function of (betas, stance) and one of the fabric's numbers, both principal
components of the simulated changes (see `principal` and `all_fabrics`).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from tryon_jax.body.pose import skinning_motion
from tryon_jax.body.stance import arms_pose
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.graph.skinning import garment_skinning
from tryon_jax.nets.config import STANCE_NET, stance_config
from tryon_jax.nets.unet import UNetConfig
from tryon_jax.physics.fabric_numbers import fabric_numbers
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.all_fabrics import principal_fabrics
from tryon_jax.training.descents import Descent, descent_files, load_descents
from tryon_jax.training.garments import prepare_simulated
from tryon_jax.training.plan import split_name
from tryon_jax.training.stage_fit import fit_stage
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.training.stage_sets import StageSet
from tryon_jax.tryon import Garment, TryOnModel, load_model
from tryon_jax.tryon.model import StanceNetwork
from tryon_jax.tryon.stance import init_stance, stance_code
from tryon_jax.tryon.stance_file import save_stance
from tryon_jax.types import Body

HELD_OUT = 22.5
"""Degrees of a stance on the way that no training sees."""
_motion = jax.jit(skinning_motion)


@dataclass(frozen=True)
class StanceOptions:
    """Of R_stance's training."""

    fabrics: tuple[str, ...]
    """That are trained on."""
    functions: int = 3
    """Fabric functions."""
    fields: int = 16
    net: UNetConfig = STANCE_NET
    stage: StageOptions = field(default_factory=StageOptions)


def fit_stance(roots: Sequence[Path], start: Path, run: Path, options: StanceOptions) -> StanceNetwork:
    """Train R_stance on the descents of some datasets and write RUN/stance.safetensors.

    Args:
        roots: Folders of datasets with descents; drapes of fabrics that are not trained on are not read.
        start: The model that it is for: its body, its garments, its skinning.
        run: Folder of the run.
        options: Of the training.

    Raises:
        ValueError: There are no descents that may be trained on.
    """
    model, manifest = load_model(start), load_manifest()
    sets: list[StageSet] = []
    for root in roots:
        sets += stance_sets(model, root, manifest, options.fabrics)
    if not any(s.train.any() for s in sets):
        raise ValueError(f"no descents to train on in {[str(root) for root in roots]}: `simulate_stances` makes them")
    functions = min(options.functions, len(options.fabrics))
    config = stance_config(
        model.config, options.fabrics, fabric_functions=functions, fields=options.fields, fine=options.net
    )
    network = init_stance(jax.random.key(options.stage.loop.seed), config, model.body)
    bound = replace(model, config=config)
    known = principal_fabrics(bound, _in_all_fabrics(sets, options.fabrics), config.fabric_functions)
    stage = replace(network.stage, fabrics=jax.tree.map(np.asarray, known))
    stage, record = fit_stage(bound, "fine", stage, sets, run / "stance", options.stage, _checksum(roots))
    network = StanceNetwork(stage, config)
    save_stance(run / "stance.safetensors", network, model.body, {"stance": record | {"fabrics": options.fabrics}})
    return network


def stance_sets(model: TryOnModel, root: Path, manifest: Manifest, fabrics: Sequence[str]) -> list[StageSet]:
    """Samples of the garments of a dataset whose arms were lowered and that may be trained on.

    Args:
        model: Its body, its R_mean and what its graphs are like.
        root: Folder of the dataset.
        manifest: Splits of designs and topologies.
        fabrics: Whose descents.
    """
    sets = []
    names = sorted({path.name.split("_")[0] for path in descent_files(root)})
    names = [name for name in names if manifest.split(*split_name(name)) == "training"]
    for name in tqdm(names, desc="descents", mininterval=2):
        garment = prepare_simulated(model, root, name)
        found = {fabric: load_descents(root, name, fabric) for fabric in fabrics}
        sets += [
            stance_set(model.body, garment, name, f, descents, manifest) for f, descents in found.items() if descents
        ]
    return sets


def stance_set(
    body: Body, garment: Garment, name: str, fabric: str, descents: Sequence[Descent], manifest: Manifest
) -> StageSet:
    """One garment in one fabric: T-pose drapes, and what they become, carried back to the T-pose.

    Args:
        body: The body.
        garment: The garment.
        name: <design label>-<topology seed>.
        fabric: Its fabric.
        descents: Of it.
        manifest: Which designs choose the weights.
    """
    skinning = garment_skinning(garment.mean_vertices, garment.faces, body)
    codes, starts, targets, known = [], [], [], []
    for descent in descents:
        for degrees, vertices, at_rest in zip(descent.degrees, descent.vertices, descent.at_rest, strict=True):
            codes.append(np.append(descent.betas, degrees))
            starts.append(descent.start)
            targets.append(carry_back(body, descent.betas, float(degrees), vertices, skinning))
            known.append(at_rest and not descent.test and degrees != HELD_OUT)
    table = np.array(codes, np.float32)
    fitted, chooses = np.array(known), split_name(name)[0] in manifest.validation
    train, validation = (np.zeros_like(fitted), fitted) if chooses else (fitted, np.zeros_like(fitted))
    size = garment.graph.num_nodes
    return StageSet(
        name,
        garment,
        np.asarray(stance_code(jnp.asarray(table[:, :-1]), jnp.asarray(table[:, -1]))),
        _padded(starts, size),
        _padded(targets, size),
        train,
        validation,
        numbers=np.asarray(fabric_numbers(load_fabric(fabric)), np.float32),
    )


def carry_back(
    body: Body,
    betas: Float[np.ndarray, " b"],
    degrees: float,
    vertices: Float[np.ndarray, "V 3"],
    skinning: Float[np.ndarray, "V J"],
) -> Float[np.ndarray, "V 3"]:
    """A drape of lowered arms where its skinning has it in T-pose, metres: the inverse of what `stand` does last.

    Args:
        body: The body.
        betas: Its shape.
        degrees: Of the arms below the horizontal.
        vertices: The drape, metres.
        skinning: Skinning weights of its vertices.
    """
    pose = arms_pose(body, degrees).astype(np.float32)
    linear, shift = _motion(body, betas.astype(np.float32), pose, skinning.astype(np.float32))
    moved = vertices.astype(np.float64) - np.asarray(shift, np.float64)
    return np.linalg.solve(np.asarray(linear, np.float64), moved[..., None])[..., 0]


def _in_all_fabrics(sets: Sequence[StageSet], fabrics: Sequence[str]) -> dict[str, list[StageSet]]:
    """Sets of the garments that were simulated in every trained fabric."""
    numbers = {fabric: np.asarray(fabric_numbers(load_fabric(fabric)), np.float32).tobytes() for fabric in fabrics}
    found: dict[str, dict[str, StageSet]] = {fabric: {} for fabric in fabrics}
    for s in sets:
        assert s.numbers is not None
        for fabric, key in numbers.items():
            if s.numbers.tobytes() == key and s.train.any():
                # The last dataset wins: it is the one of many fabrics.
                found[fabric][s.name] = s
    common = set.intersection(*[set(table) for table in found.values()])
    if not common:
        raise ValueError(f"no garment was simulated with lowered arms in every one of the fabrics {list(fabrics)}")
    return {fabric: [table[name] for name in sorted(common)] for fabric, table in found.items()}


def _padded(rows: Sequence[np.ndarray], size: int) -> Float[np.ndarray, "S N 3"]:
    stacked = np.asarray(rows, np.float32)
    return np.pad(stacked, ((0, 0), (0, size - stacked.shape[1]), (0, 0)))


def _checksum(roots: Sequence[Path]) -> str:
    """SHA-256 over the contents of all descents."""
    digest = hashlib.sha256()
    for root in roots:
        for path in descent_files(root):
            digest.update(f"{path.name}:".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
