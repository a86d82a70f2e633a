"""The collision step of a training run: each R_fine trained further against collisions, without any simulation."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tryon_jax.checks import check_range
from tryon_jax.nets import store
from tryon_jax.training.all_fabrics import load_all_fabrics
from tryon_jax.training.batches import BatchSource, StageBatch
from tryon_jax.training.checkpoint import load_checkpoint
from tryon_jax.training.collisions import CollisionBatch, CollisionOptions, CollisionTask, draw_collisions, make_pool
from tryon_jax.training.loop import train_loop
from tryon_jax.training.recipes import fit_fabrics, load_fine_sets
from tryon_jax.training.run_folder import model_path
from tryon_jax.training.stage_fit import all_shapes_at_once, stage_config
from tryon_jax.training.stage_loss import StageWeights
from tryon_jax.training.stage_options import StageOptions
from tryon_jax.tryon import Stage, TryOnModel, load_model


def fit_collisions(
    run: Path,
    fabrics: Sequence[str],
    options: CollisionOptions,
    root: Path | None = None,
    pool: Executor | None = None,
    fabric_root: Path | None = None,
) -> TryOnModel:
    """Fine-tune R_fine of each fabric against collisions; R_smooth and R_fine must be trained.

    Args:
        run: Folder of the run.
        fabrics: Whose R_fine.
        options: See `CollisionOptions`.
        root: Folder of the dataset that `options.replay` reads; without it no simulation is read.
        pool: Trains the fabrics side by side; without it one follows the other.
        fabric_root: Of an R_fine of all fabrics: folder of the dataset of many fabrics, which is replayed too.

    Raises:
        ValueError: `options.replay` is no share below 1, or asked for without a dataset.
    """
    check_range("replay", options.replay, 0.0, 0.9)
    if options.replay and root is None:
        raise ValueError(f"replay = {options.replay} needs the folder of a dataset")
    return fit_fabrics(run, fabrics, pool, _train_collisions, "collisions", run, options, root, fabric_root)


def _train_collisions(
    fabric: str, run: Path, options: CollisionOptions, root: Path | None, fabric_root: Path | None
) -> tuple[Stage, dict[str, Any]] | None:
    model = load_model(model_path(run))
    training = store.read_record(model_path(run)).get("training", {})
    folder = run / f"collisions-{fabric}"
    earlier = training.get(folder.name)
    saved = load_checkpoint(folder)
    if earlier and saved and saved[1]["step"] == earlier["steps"] and earlier["options"] == asdict(options):
        # Done already: measured again, its result would be its own start.
        return None
    task = CollisionTask(model, fabric, options)
    pool = make_pool(model, options.pool, options.loop.seed)
    held = make_pool(model, options.held_out, options.loop.seed + 1)

    replayed: dict[str, Any] = {}
    source = None
    if options.replay and root is not None:
        if fabric_root is None:
            sets, replayed["dataset"] = load_fine_sets(model, root, fabric, StageOptions())
        else:
            sets, replayed["dataset"] = load_all_fabrics(model, root, fabric_root, StageOptions())
        source = BatchSource(sets, options.garments, options.shapes)

    def draw(rng: np.random.Generator) -> CollisionBatch | StageBatch:
        if source is not None and rng.random() < options.replay:
            return source.draw(rng)
        return draw_collisions(pool, options, model.config.beta_ranges, rng, task.start)

    def evaluate(weights: StageWeights) -> float:
        return 100 * task.inside_share(weights, held, options.loop.seed)

    identity = {
        "stage": "collisions",
        "fabric": fabric,
        "options": asdict(options),
        "config": stage_config(model.config, "collisions"),
        "before": training.get(f"fine-{fabric}", {}),
        **replayed,
    }
    start = StageWeights(task.start.net)
    before = [task.inside_share(start, garments, options.loop.seed) for garments in (pool, held)]
    loop = all_shapes_at_once(options.loop, model.config, options.shapes)
    result = train_loop(start, task.loss, draw, evaluate, folder, loop, identity, folder.name)
    after = [task.inside_share(result.params, garments, options.loop.seed) for garments in (pool, held)]
    record = {
        "inside_training_percent": [100 * before[0], 100 * after[0]],
        "inside_held_out_percent": [100 * before[1], 100 * after[1]],
        "steps": result.curve[-1]["step"],
        "seconds": round(result.seconds),
        "options": asdict(options),
        **replayed,
        **({"continues": earlier} if earlier else {}),
    }
    return result.params.of(task.start), record
