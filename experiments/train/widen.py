"""Begin a run with a trained model whose networks are made wider: the same drapes at first, then trained further."""

from dataclasses import dataclass, replace
from pathlib import Path

import jax

from tryon_jax.nets.store import read_record
from tryon_jax.nets.unet import count_parameters
from tryon_jax.nets.widen import widen_unet
from tryon_jax.training.run_folder import model_path
from tryon_jax.tryon import Stage, load_model, save_model


@dataclass(frozen=True)
class Config:
    """What is made wider, and by how much."""

    model: Path
    """The trained model, a safetensors file."""
    run: Path
    """Folder of the new run."""
    smooth: tuple[int, ...]
    """Features at each level of R_smooth, finest first."""
    fine: tuple[int, ...]
    """The same for R_fine of every fabric."""
    seed: int = 0
    """Of the weights of added features."""


def main(config: Config) -> None:
    """Write RUN/model.safetensors.

    Raises:
        FileExistsError: the run has a model already.
    """
    target = model_path(config.run)
    if target.exists():
        raise FileExistsError(f"{str(target)!r} exists: a wider network begins a run of its own")
    model, record = load_model(config.model), read_record(config.model).get("training", {})
    keys = iter(jax.random.split(jax.random.key(config.seed), 1 + len(model.fine)))

    # One program for each size of network: op by op, every shape of a weight would have several of its own.
    grow = jax.jit(widen_unet, static_argnums=2)

    def widen(stage: Stage, widths: tuple[int, ...]) -> Stage:
        return replace(stage, net=grow(next(keys), stage.net, tuple(widths)))

    before = count_parameters((model.smooth, model.fine))
    smooth = widen(model.smooth, config.smooth)
    fine = {fabric: widen(stage, config.fine) for fabric, stage in model.fine.items()}
    # Each R_fine of a model that has kriged drapes is of the one size; without, of the other.
    size = "kriged_fine" if model.kriging else "fine"
    wider = replace(getattr(model.config, size), widths=tuple(config.fine))
    sizes = replace(model.config, smooth=smooth.net.config, **{size: wider})
    model = replace(model, smooth=smooth, fine=fine, config=sizes)
    save_model(target, model, record)
    print(f"{before:,} parameters of R_smooth and R_fine became {count_parameters((smooth, fine)):,}: {target}")
