"""Options of the training of R_smooth and R_fine."""

from dataclasses import dataclass, field
from typing import Literal

from tryon_jax.training.loop import LoopOptions
from tryon_jax.training.stage_loss import Distance

FineInput = Literal["predicted", "smoothed"]


@dataclass(frozen=True)
class StageOptions:
    """Options of R_smooth's and R_fine's training."""

    loop: LoopOptions = field(
        default_factory=lambda: LoopOptions(steps=8000, optimiser="muon", learning_rate=1e-2, warmup=200)
    )
    garments: int = 4
    """Garments in a batch."""
    shapes: int = 16
    """Body shapes of each garment in a batch: with fields they share one pass of the network."""
    design_dropout: float = 0.1
    """Share of the garments in a batch whose nodes are not told the design, as those of a mesh without one."""
    designs: Literal["all", "paper"] = "all"
    """paper: the 19 training designs alone; all: the additional ones as well, where the dataset has them."""
    fresh: int = 0
    """Fresh topologies of each training garment that its simulated drapes are carried over to (see `carried`)."""
    fine_input: FineInput = "predicted"
    """What R_fine is trained on. predicted: M_smooth as R_smooth gives it, so that it also mends that network's errors;
    smoothed: the smoothed simulation (the paper)."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Arithmetic of the network while it is trained; weights, optimiser, losses and the result stay float32."""
    energy: float = 0.0
    """Weight of the cloth's energy in R_fine's loss (see `relative_energy`): keeps folds that ℓ² alone blurs."""
    edges: float = 0.0
    """Weight of the error of edges in the loss (see `edge_error`)."""
    normals: float = 0.0
    """Weight of the error of normals in the loss (see `normal_error`)."""
    distance: Distance = "plain"
    """Error that is minimised: the plain distance, or the squared one (see `displacement_error`)."""
    coefficients: Literal["principal", "trained"] = "principal"
    """Where the weights of the fields come from: the principal components of the drapes, before the network is trained
    (see `principal`), or training together with the network."""
