"""Frozen pytrees that travel between the rooms of the library.

Every array field states its shape with jaxtyping axis names. Fields marked `static` are part of the tree's
structure: changing one recompiles. Lengths are metres, angles radians, masses kilograms.
"""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, TypeAlias, dataclass_transform

import jax
import numpy as np
from jaxtyping import Float, Int

ArrayLike: TypeAlias = jax.Array | np.ndarray
Scalar: TypeAlias = float | Float[ArrayLike, ""]
"""A number that may be traced: a leaf of settings inside a jitted function."""
EXACT = jax.lax.Precision.HIGHEST
"""For products of positions: matrix units that round to ten bits would move a hand by half a millimetre."""


def static(**kwargs: Any) -> Any:
    """A dataclass field that belongs to the pytree's structure and not to its leaves."""
    return field(metadata={"static": True}, **kwargs)


@dataclass_transform(frozen_default=True, field_specifiers=(static, field))
def pytree(cls: type) -> type:
    """Make `cls` a frozen dataclass registered as a pytree; fields made by `static` become its metadata."""
    frozen = dataclass(frozen=True)(cls)
    fields = dataclasses.fields(frozen)
    meta = [f.name for f in fields if f.metadata.get("static")]
    data = [f.name for f in fields if not f.metadata.get("static")]
    return jax.tree_util.register_dataclass(frozen, data_fields=data, meta_fields=meta)


@pytree
class Body:
    """A parametric human body with SMPL's fields (Loper et al. 2015) in T-pose.

    Frame: y up, +z front, +x the body's left, origin at the pelvis joint of the mean shape and, for the embedded
    bodies, of every shape.
    """

    v_template: Float[ArrayLike, "V 3"]
    """Vertices of the mean shape, metres."""
    shapedirs: Float[ArrayLike, "V 3 B"]
    """Displacement of each vertex for one unit (standard deviation) of each beta, metres."""
    J_regressor: Float[ArrayLike, "J V"]
    """Joint positions as averages of vertices; rows sum to 1."""
    lbs_weights: Float[ArrayLike, "V J"]
    """Linear blend skinning weights; rows sum to 1."""
    faces: Int[ArrayLike, "F 3"]
    """Triangles, counter-clockwise seen from outside."""
    posedirs: Float[ArrayLike, "P V 3"] | None = None
    """Pose blend shapes, or None where the body has none (P = 9 (J - 1))."""
    parents: tuple[int, ...] = static(default=())
    """Parent joint of each joint, -1 for the root; a parent comes before its children."""
    joint_names: tuple[str, ...] = static(default=())
    """Names of the joints, SMPL's order."""
    name: str = static(default="body")
    """What messages and parameter stores call this body."""

    @property
    def num_betas(self) -> int:
        """Number of shape coefficients B."""
        return self.shapedirs.shape[-1]
