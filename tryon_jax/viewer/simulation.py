"""The simulation of the garment that is shown, in the background, with progress and cancel."""

import threading
import time
from collections.abc import Callable
from typing import Literal

import numpy as np

from tryon_jax.body import pose_body
from tryon_jax.body.stance import LOWEST, arms_pose
from tryon_jax.viewer.page_model import Result, ShownMesh
from tryon_jax.wear.session import Session
from tryon_jax.wear.stance import lower_arms

_DRESSING = 500
_REFINING = 200
"""Steps after which each is about done, for the progress bar."""


Kind = Literal["refine", "dress", "arms"]
"""Bring the drape to rest; dress the garment anew, from its panels; lower the arms under the drape."""


class _Cancelled(Exception):
    """The visitor does not want to wait."""


class Simulation:
    """Runs in a thread of its own and calls back from it."""

    def __init__(
        self,
        session: Session,
        result: Result,
        on_step: Callable[[float, ShownMesh, ShownMesh], None],
        on_end: Callable[[str], None],
        kind: Kind,
    ) -> None:
        """Start it.

        Args:
            session: What simulates.
            result: The drape that is shown.
            on_step: Told the progress, the garment and the body to show after some steps.
            on_end: Told in words how it ended.
            kind: What to do.
        """
        self._session = session
        self._dressed = result.dressed
        self._on_step = on_step
        self._on_end = on_end
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(kind,), daemon=True)
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

    def _run(self, kind: Kind) -> None:
        work = {"refine": self._refine, "dress": self._dress, "arms": self._lower_arms}
        try:
            words = work[kind]()
        except _Cancelled:
            words = "cancelled"
        except Exception as error:  # Said in the page, whatever it was.
            words = f"the simulation failed: {error}"
        self._on_end(words)

    def _refine(self) -> str:
        start = time.perf_counter()
        refined = self._session.refine(self._dressed, progress=self._teller(_REFINING))
        self._tell(1.0, refined.vertices)
        assert refined.simulated is not None
        return f"refined in {time.perf_counter() - start:.1f} s: {refined.simulated.words()}"

    def _lower_arms(self) -> str:
        start, shown = time.perf_counter(), self._dressed

        def progress(degrees: float, _: float, vertices: np.ndarray) -> None:
            self._stop_if_cancelled()
            pose = arms_pose(self._session.body, degrees).astype(np.float32)
            skin, _joints = pose_body(self._session.body, shown.body.betas, pose)
            self._tell(degrees / LOWEST, vertices, np.asarray(skin))

        standing = lower_arms(self._session, shown, LOWEST, progress=progress)
        self._tell(1.0, standing.vertices, standing.body.vertices)
        return f"arms {LOWEST:g} degrees lower after {time.perf_counter() - start:.1f} s"

    def _dress(self) -> str:
        start, shown = time.perf_counter(), self._dressed
        self._tell(0.0, shown.garment.start())
        simulated = self._session.simulate(
            shown.garment, shown.body.betas, fabric=shown.fabric, progress=self._teller(_DRESSING)
        )
        self._tell(1.0, simulated.vertices)
        apart = np.linalg.norm(simulated.vertices - shown.fine, axis=1)
        seconds = time.perf_counter() - start
        return f"simulated in {seconds:.1f} s; the learned drape is {1000 * apart.mean():.1f} mm away on average"

    def _teller(self, about: int) -> Callable[[int, float, np.ndarray], None]:
        """Shows where the cloth is after each piece of steps, of which there will be `about`."""

        def progress(steps: int, _: float, vertices: np.ndarray) -> None:
            self._stop_if_cancelled()
            self._tell(min(1.0, steps / about), vertices)

        return progress

    def _stop_if_cancelled(self) -> None:
        if self._cancelled.is_set():
            raise _Cancelled

    def _tell(self, share: float, vertices: np.ndarray, skin: np.ndarray | None = None) -> None:
        body = self._dressed.body
        shown = ShownMesh(body.vertices if skin is None else skin, body.faces)
        self._on_step(share, ShownMesh(vertices, self._dressed.faces), shown)
