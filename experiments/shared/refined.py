"""Learned drapes after a few steps of the solver, as `tryon drape --refine STEPS` gives them."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from experiments.shared.evaluate import Stack
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.training.dataset import load_arrays, mesh_path
from tryon_jax.types import Body
from tryon_jax.wear.simulate import Pattern, Simulator


def stored_pattern(root: Path, name: str) -> Pattern:
    """Mesh and rest shape of a garment of a dataset."""
    arrays = load_arrays(mesh_path(root, name))
    return Pattern(arrays["faces"], arrays["uv"], arrays["faces_uv"])


class Refiner:
    """A fixed number of solver steps for every drape."""

    def __init__(self, body: Body, root: Path, steps: int) -> None:
        """Prepare the solver.

        Args:
            body: The body.
            root: Folder of the dataset whose garments are draped.
            steps: Of the solver.
        """
        self.steps, self._root, self._simulator = steps, root, Simulator(body)

    def __call__(self, name: str, fabric: str, betas: Float[np.ndarray, "S b"], drapes: Stack) -> Stack:
        """The drapes after the steps, metres.

        Args:
            name: Garment of the dataset.
            fabric: What it is made of.
            betas: Body of each drape.
            drapes: Where the solver starts.
        """
        pattern, cloth = stored_pattern(self._root, name), load_fabric(fabric)
        pairs = zip(drapes, betas, strict=True)
        return np.stack([self._simulator.refine(x, pattern, cloth, b, self.steps).vertices for x, b in pairs])
