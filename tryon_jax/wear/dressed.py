"""A body with a garment on it: the result of a session."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.checks import check_choice
from tryon_jax.contact.push_out import PushedOut
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.contact.skin import Penetration, Skin
from tryon_jax.files.export import CLOTH, SKIN, Part, mesh_part, write_mesh
from tryon_jax.types import Body
from tryon_jax.wear.fit import Fit
from tryon_jax.wear.gate import Verdict
from tryon_jax.wear.prepared import PreparedGarment
from tryon_jax.wear.simulate import Simulated

PARTS = ("body", "garment")
"""What a mesh file may hold."""


@dataclass(frozen=True, eq=False)
class ShapedBody:
    """A body in one shape."""

    body: Body
    betas: Float[np.ndarray, " b"]
    """Of this body."""
    known_betas: Float[np.ndarray, " k"]
    """Of the networks' body: the same, or those of its shape nearest to another body."""
    vertices: Float[np.ndarray, "B 3"]
    """Metres."""
    measurements: Mapping[str, float] = field(default_factory=dict)
    """By the names of `body.measurements.MEASUREMENTS`, metres."""

    @property
    def faces(self) -> Int[np.ndarray, "G 3"]:
        """Triangles."""
        return np.asarray(self.body.faces)

    @cached_property
    def surface(self) -> ClosedSurface:
        """The skin to measure distances from; prepared when it is first asked for."""
        return ClosedSurface(self.vertices, self.faces)


@dataclass(frozen=True, eq=False)
class DressedBody:
    """A garment on a body; made by `Session.drape` and the steps after it."""

    body: ShapedBody
    garment: PreparedGarment
    fabric: str
    vertices: Float[np.ndarray, "V 3"]
    """Of the garment on the body, metres."""
    smooth: Float[np.ndarray, "V 3"]
    """After the smooth stage, metres."""
    fine: Float[np.ndarray, "V 3"]
    """After the fine stage, before any push out of the body, metres."""
    pushed: PushedOut | None = None
    """What the push out of the body did, where there was one."""
    fit: Fit | None = None
    """How it fits, where that was measured."""
    simulated: Simulated | None = None
    """What the simulator did, where it was asked."""
    verdict: Verdict | None = None
    """What the gate says, where it was asked."""
    arms: float = 0.0
    """Degrees that the arms are below the horizontal."""

    @property
    def faces(self) -> Int[np.ndarray, "F 3"]:
        """Triangles of the garment."""
        return self.garment.faces

    def penetration(self) -> Penetration:
        """What of the garment is inside the body; hands and feet are left out."""
        return Skin(self.body.body, self.body.surface).penetration(self.vertices, self.faces)

    def parts(self, colors: Float[np.ndarray, "V 3"] | None = None, names: Sequence[str] = PARTS) -> list[Part]:
        """Body and garment, for `files.export.write_mesh`.

        Args:
            colors: sRGB colour of each vertex of the garment in 0 to 1, such as a map of the fit.
            names: those of `PARTS` that are wanted.

        Raises:
            ValueError: there is no such part.
        """
        for name in names:
            check_choice("part", name, PARTS)
        every = [
            mesh_part("body", self.body.vertices, self.body.faces, material=SKIN),
            mesh_part(
                "garment",
                self.vertices,
                self.faces,
                material=CLOTH,
                uv=self.garment.uv,
                faces_uv=self.garment.faces_uv,
                colors=colors,
            ),
        ]
        return [part for part in every if part.name in names]

    def write(
        self,
        path: str | Path,
        colors: Float[np.ndarray, "V 3"] | None = None,
        *,
        parts: Sequence[str] = PARTS,
        gate: bool = True,
    ) -> None:
        """Write body and garment to a mesh file.

        Args:
            path: A file whose suffix names its format: .glb, .obj, .ply or .npz.
            colors: sRGB colour of each vertex of the garment in 0 to 1.
            parts: Those of `PARTS` that are wanted.
            gate: Whether to refuse what the gate refused (`wear.gate`).

        Raises:
            ValueError: The suffix is none of these, or there is no such part.
            Refused: The gate refused the drape.
        """
        if gate and self.verdict is not None:
            self.verdict.check(self.garment.label)
        write_mesh(path, self.parts(colors, parts))
