"""The simulation of the garment that is shown, in the background, with progress and cancel."""

import threading
import time
from collections.abc import Callable

import numpy as np

from tryon_jax.physics.cloth import build_cloth
from tryon_jax.physics.dressing import Drape, Equilibrium, Obstacle, dress, follow
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.physics.solver import SolverSettings
from tryon_jax.types import Body
from tryon_jax.viewer.page_model import Result, ShownMesh
from tryon_jax.wear.session import Session

SHAPES = 6
"""Body shapes on the straight way from the mean body to the one that is asked for."""
PIECE = 20
"""Steps between two reports of the progress; cancelling takes effect there."""
_DRESSING = 20
_SHAPE = 6
_REFINING = 200
"""Steps after which a refinement is about done, for the progress bar."""


class _Cancelled(Exception):
    """The visitor does not want to wait."""


class Simulation:
    """Runs in a thread of its own and calls back from it."""

    def __init__(
        self,
        body: Body,
        result: Result,
        on_step: Callable[[float, ShownMesh], None],
        on_end: Callable[[str], None],
        refine: Session | None = None,
    ) -> None:
        """Prepare a simulation; nothing runs yet.

        Args:
            body: The body that is dressed.
            result: The drape that the simulation starts from.
            on_step: Told the progress and what to show after some steps.
            on_end: Told in words how it ended.
            refine: Brings the learned drape to rest; without it the garment is dressed anew, from its panels.
        """
        self._refiner = refine
        self._body = body
        self._dressed = result.dressed
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
        """Stop after the steps that are being computed."""
        self._cancelled.set()

    def join(self, seconds: float | None = None) -> None:
        """Wait for the end."""
        self._thread.join(seconds)

    def _run(self) -> None:
        try:
            words = self._simulate() if self._refiner is None else self._refine(self._refiner)
        except _Cancelled:
            words = "cancelled"
        except Exception as error:  # Said in the page, whatever it was.
            words = f"the simulation failed: {error}"
        self._on_end(words)

    def _refine(self, session: Session) -> str:
        start = time.perf_counter()

        def progress(steps: int, _: float) -> None:
            if self._cancelled.is_set():
                raise _Cancelled
            self._on_step(min(1.0, steps / _REFINING), ShownMesh(self._dressed.vertices, self._dressed.faces))

        refined = session.refine(self._dressed, progress=progress)
        self._on_step(1.0, ShownMesh(refined.vertices, refined.faces))
        assert refined.simulated is not None
        return f"refined in {time.perf_counter() - start:.1f} s: {refined.simulated.words()}"

    def _simulate(self) -> str:
        start = time.perf_counter()
        garment = self._dressed.garment
        first = garment.start()
        fabric = load_fabric(self._dressed.fabric)
        cloth = build_cloth(garment.faces, garment.uv, garment.faces_uv, len(first))
        settings, goal, piece = SolverSettings(), Equilibrium(), Equilibrium(max_steps=PIECE)
        obstacle = Obstacle(self._body)
        target = np.asarray(self._dressed.body.betas, float)
        total = _DRESSING + _SHAPE * SHAPES
        drape = dress(first, cloth, fabric, obstacle, settings, goal, np.zeros_like(target).tolist(), PIECE)
        # The mean body first, then one shape after another; each in pieces, until it is at rest or its time is up.
        for shape in range(SHAPES + 1):
            pieces = _SHAPE if shape else _DRESSING
            before = _DRESSING + _SHAPE * (shape - 1) if shape else 0
            for number in range(pieces):
                if self._cancelled.is_set():
                    return "cancelled"
                self._tell(drape, (before + number) / total)
                if (shape and number == 0) or not drape.converged(goal):
                    drape = follow(drape, target * shape / SHAPES, cloth, fabric, obstacle, settings, piece)
                if drape.converged(goal):
                    break
            if not target.any():
                break
        self._tell(drape, 1.0)
        learned = self._dressed.fine
        apart = np.linalg.norm(drape.vertices - learned, axis=1)
        seconds = time.perf_counter() - start
        return f"simulated in {seconds:.1f} s; the learned drape is {1000 * apart.mean():.1f} mm away on average"

    def _tell(self, drape: Drape, share: float) -> None:
        self._on_step(share, ShownMesh(drape.vertices, self._dressed.faces))
