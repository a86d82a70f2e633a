"""Shared by the checks of the simulator: their options, and one compiled solver for all scenes of a size."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from experiments.shared.record import RESULTS
from tryon_jax.physics.fabrics import fabric_names
from tryon_jax.physics.state import SolverSettings

STATIC = SolverSettings(retention=0.9)
"""Steps to equilibrium: velocities are damped by a tenth per step."""
DYNAMIC = dataclasses.replace(STATIC, retention=1.0)
"""Motion without damping but the integrator's own."""

Found: TypeAlias = dict[str, Any]
"""What a check found: `about`, `rows` of a table, a `note`, and `curves` for the plot."""


@dataclass(frozen=True)
class Config:
    """What to check."""

    out: Path = RESULTS
    """Folder of the record and its plots."""
    reference: Path | None = None
    """Folder with forces and an equilibrium computed by ARCSim (forces_gray-interlock_noise.npz, tube2016.npz,
    torso.npz, tubepin_gi_t5.npz); without it these two checks are left out."""
    only: tuple[str, ...] = ()
    """Names of checks to run anew, keeping what the record says of the others; all by default."""
    fabrics: tuple[str, ...] = ()
    """Fabrics of the textile tests; all ten by default."""
    edge: float = 0.011
    """Mesh size of the drape test, metres."""

    def fabric_names(self) -> tuple[str, ...]:
        """Fabrics of the textile tests."""
        return self.fabrics or fabric_names()
