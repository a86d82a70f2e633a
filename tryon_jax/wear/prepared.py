"""A garment that is ready to drape, with the pattern that its fit is measured by."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from tryon_jax.garment import Design, GarmentMesh, placement
from tryon_jax.mesh.loaded_garment import LoadedGarment
from tryon_jax.mesh.stretch_limit import rest_edges, rest_lengths
from tryon_jax.tryon import Garment, TryOnModel, prepare, prepare_mesh
from tryon_jax.wear.fit import pattern_of
from tryon_jax.wear.own import OwnGarment
from tryon_jax.wear.simulate import Pattern


@dataclass(frozen=True, eq=False)
class PreparedGarment:
    """A garment that is ready to drape; made by `Session.prepare`."""

    garment: Garment
    faces: Int[np.ndarray, "F 3"]
    uv: Float[np.ndarray, "U 2"]
    """The pattern, metres."""
    faces_uv: Int[np.ndarray, "F 3"]
    """Entry of `uv` of every face corner."""
    label: str
    """What it is, in words."""
    mesh: GarmentMesh | None = None
    """What was cut from a design; None for a mesh of the user's own."""
    has_pattern: bool = True
    """False for a mesh whose `uv` is only its triangles laid flat one by one."""
    near: "PreparedGarment | None" = None
    """The garment of a near design whose triangles and hierarchy it has; None where it was made anew."""
    repairs: tuple[str, ...] = ()
    """What was found and changed in a mesh of the user's own, one sentence each."""

    @property
    def design(self) -> Design | None:
        """The design, where it was made from one."""
        return None if self.mesh is None else self.mesh.design

    @property
    def pattern(self) -> Pattern:
        """Mesh and rest shape."""
        return Pattern(self.faces, self.uv, self.faces_uv)

    @cached_property
    def rest_edges(self) -> tuple[Int[np.ndarray, "E 2"], Float[np.ndarray, " E"]]:
        """Edges, and the length that each is measured against, metres: see `mesh.stretch_limit`."""
        mean = self.garment.mean_vertices
        return rest_edges(self.faces, rest_lengths(self.faces, self.uv, self.faces_uv, mean), len(mean))

    def start(self) -> Float[np.ndarray, "V 3"]:
        """Where a simulation begins, metres: flat panels round the body, or the user's mesh on the mean body."""
        return self.garment.mean_vertices if self.mesh is None else placement(self.mesh)


def prepared_design(model: TryOnModel, mesh: GarmentMesh, bucket: int | None = None) -> PreparedGarment:
    """The garment of a mesh that `remesh` made.

    Args:
        model: Networks and body.
        mesh: From `remesh`.
        bucket: Nodes to pad to, see `build_graph`.
    """
    garment = prepare_mesh(model, mesh, bucket=bucket)
    return PreparedGarment(garment, mesh.faces, mesh.uv, mesh.faces_uv, str(mesh.design), mesh)


def prepared_near(model: TryOnModel, mesh: GarmentMesh, near: PreparedGarment) -> PreparedGarment:
    """The garment of a mesh that was moved from that of a near design.

    Args:
        model: Networks and body.
        mesh: From `garment.near_design.mesh_of_near_design`.
        near: The garment of the mesh that was moved.
    """
    garment = prepare_mesh(model, mesh, near=near.garment)
    return PreparedGarment(garment, near.faces, mesh.uv, near.faces_uv, str(mesh.design), mesh, near=near)


def prepared_own(model: TryOnModel, own: LoadedGarment | OwnGarment, label: str) -> PreparedGarment:
    """The garment of a user's mesh, as it hangs on the mean body.

    Args:
        model: Networks and body.
        own: The mesh on the mean body.
        label: What to call it.

    Raises:
        ValueError: The mesh is not near the mean body.
    """
    if isinstance(own, OwnGarment):
        garment, pattern = prepare(model, mesh=own.loaded), own.pattern
        return PreparedGarment(
            garment,
            pattern.faces,
            pattern.uv,
            pattern.faces_uv,
            label,
            has_pattern=own.has_pattern,
            repairs=own.remarks,
        )
    loaded = own
    garment = prepare(model, mesh=loaded)
    uv, faces_uv = loaded.texture()
    pattern, corners = pattern_of(garment.mean_vertices, garment.faces, uv, faces_uv)
    return PreparedGarment(
        garment,
        garment.faces,
        pattern,
        corners,
        label,
        has_pattern=pattern is uv,
        repairs=loaded.repairs,
    )
