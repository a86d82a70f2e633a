"""The simulation of the garment that is shown, in the background, with progress and cancel."""

import threading
import time
from collections.abc import Callable

import numpy as np

from tryon_jax.garment import placement
from tryon_jax.physics.cloth import build_cloth
from tryon_jax.physics.dressing import Equilibrium, Obstacle, dress, follow
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.physics.solver import SolverSettings
from tryon_jax.types import Body
from tryon_jax.viewer.wardrobe import Look, Surface

STEPS = 6
"""Body shapes on the straight way from the mean body to the one that is asked for."""


class Simulation:
    """Runs in a thread of its own and calls back from it."""

    def __init__(
        self,
        body: Body,
        look: Look,
        on_step: Callable[[float, Surface], None],
        on_end: Callable[[str], None],
    ) -> None:
        self._body = body
        self._look = look
        self._on_step = on_step
        self._on_end = on_end
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it is still at work."""
        return self._thread.is_alive()

    def cancel(self) -> None:
        """Stop after the body shape that is being computed."""
        self._cancelled.set()

    def join(self, seconds: float | None = None) -> None:
        """Wait for the end."""
        self._thread.join(seconds)

    def _run(self) -> None:
        try:
            self._on_end(self._simulate())
        except (ValueError, FloatingPointError) as error:
            self._on_end(f"the simulation failed: {error}")

    def _simulate(self) -> str:
        start = time.perf_counter()
        mesh, wish = self._look.mesh, self._look.wish
        fabric = load_fabric(wish.fabric)
        cloth = build_cloth(mesh.faces, mesh.uv, mesh.faces_uv, mesh.num_vertices)
        settings, equilibrium = SolverSettings(), Equilibrium()
        obstacle = Obstacle(self._body)
        target = np.asarray(wish.betas, float)
        drape = dress(placement(mesh), cloth, fabric, obstacle, settings, equilibrium, [0.0] * len(target))
        for step in range(1, STEPS + 1):
            self._on_step(step / (STEPS + 1), Surface(drape.vertices, mesh.faces))
            if self._cancelled.is_set():
                return "cancelled"
            drape = follow(drape, target * step / STEPS, cloth, fabric, obstacle, settings, equilibrium)
        self._on_step(1.0, Surface(drape.vertices, mesh.faces))
        apart = np.linalg.norm(drape.vertices - self._look.layers["drape"].vertices, axis=1)
        seconds = time.perf_counter() - start
        return f"simulated in {seconds:.1f} s; the learned drape is {1000 * apart.mean():.1f} mm away on average"
