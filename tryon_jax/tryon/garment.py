"""A garment ready to drape: its graph, its relation to the design and, for a user's mesh, to the user's own
vertices."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tryon_jax.graph.build import GarmentGraph
from tryon_jax.graph.smoothing import HeatSmoother
from tryon_jax.types import ArrayLike, pytree


@pytree
class CarriedMesh:
    """A user's mesh, which moves with the evenly spaced mesh that the networks see; padded like everything else."""

    vertices: Float[ArrayLike, "*batch M 3"]
    """On the mean body, metres."""
    faces: Int[ArrayLike, "*batch G 3"]
    """Triangles, padded with (0, 0, 0)."""
    carriers: Int[ArrayLike, "*batch M 3"]
    """Vertices of the graph between which each vertex lies."""
    weights: Float[ArrayLike, "*batch M 3"]
    """Their barycentric weights."""
    num_vertices: Int[ArrayLike, "*batch"]


@pytree
class Garment:
    """A garment ready to drape, made by `prepare`; arrays are padded to the graph's size bucket.

    Stack garments of one bucket with `stack_garments` to map over them.
    """

    graph: GarmentGraph
    smoother: HeatSmoother
    """The smoothing that separates smooth from fine, in the metric of the mean drape."""
    design: Float[ArrayLike, "*batch P"] | None = None
    """Design parameters, metres; None for a mesh of the user's own."""
    template_vertices: Int[ArrayLike, "*batch N 3"] | None = None
    """Template vertices whose weighted mean is each vertex of M̄ (W of section 2); None as `design`."""
    template_weights: Float[ArrayLike, "*batch N 3"] | None = None
    own: CarriedMesh | None = None
    """The user's mesh where it is not the graph's: then `drape` returns its vertices, N being their padded number."""
    edges: Int[ArrayLike, "*batch E 2"] | None = None
    """Edges of the graph's mesh, padded with (0, 0)."""
    rest: Float[ArrayLike, "*batch E"] | None = None
    """Length of each in the flat pattern, or on the mean body where there is no pattern, metres; 1 for padding."""

    def __eq__(self, other: object) -> bool:
        """Identity: comparing arrays gives an array, not a truth value."""
        return self is other

    __hash__ = object.__hash__

    @property
    def num_vertices(self) -> int:
        """Number of real vertices V; host side, one garment."""
        return int(self.graph.num_vertices if self.own is None else self.own.num_vertices)

    @property
    def mask(self) -> Bool[Array, " N"]:
        """True for real vertices, false for padding, as `drape` returns them; one garment."""
        real = self.graph.num_vertices if self.own is None else self.own.num_vertices
        rows = self.graph.vertices if self.own is None else self.own.vertices
        return jnp.arange(rows.shape[-2]) < jnp.asarray(real)

    @property
    def body_vertices(self) -> Int[Array, " N"]:
        """The body vertex closest on the mean body to each vertex; for a user's own mesh, to the first of the graph's
        vertices that it lies between."""
        closest = jnp.asarray(self.graph.body_vertices)
        return closest if self.own is None else closest[jnp.asarray(self.own.carriers)[:, 0]]

    @property
    def faces(self) -> Int[np.ndarray, "F 3"]:
        """Triangles without padding; host side, one garment."""
        faces = np.asarray(self.graph.faces if self.own is None else self.own.faces)
        return faces[faces.any(axis=1)]

    @property
    def mean_vertices(self) -> Float[np.ndarray, "V 3"]:
        """M̄ without padding, metres; host side, one garment."""
        return self.unpad(self.graph.vertices if self.own is None else self.own.vertices)

    def unpad(self, vertices: Float[ArrayLike, "*batch N c"]) -> Float[np.ndarray, "*batch V c"]:
        """What `drape` returned, without the padded vertices; host side, one garment."""
        return np.asarray(vertices)[..., : self.num_vertices, :]

    def with_vertices(self, vertices: Float[Array, "N 3"]) -> "Garment":
        """The same garment with another M̄ (padded), for derivatives with respect to its vertices."""
        return dataclasses.replace(self, graph=dataclasses.replace(self.graph, vertices=vertices))


def array_shapes(garment: Garment) -> tuple[tuple[int, ...], ...]:
    """Shapes of a garment's arrays: garments of equal ones can be stacked.

    Those of one bucket nearly always have them; a mesh with a vertex of very many neighbours has longer tables.
    """
    return tuple(np.shape(leaf) for leaf in jax.tree.leaves(garment))


def stack_garments(garments: Sequence[Garment]) -> Garment:
    """Garments of one bucket with a leading axis, for `jax.vmap` over garments.

    Raises:
        ValueError: the garments are padded to different sizes.
    """
    sizes = sorted({g.graph.num_nodes for g in garments})
    if len(sizes) != 1 or len({jax.tree.structure(g) for g in garments}) != 1:
        raise ValueError(f"garments of different buckets cannot be stacked: {sizes}; prepare them with one `bucket`")
    if len({array_shapes(g) for g in garments}) != 1:
        raise ValueError("garments whose tables of neighbours differ in length cannot be stacked: see `array_shapes`")
    return jax.tree.map(lambda *arrays: np.stack([np.asarray(a) for a in arrays]), *garments)
