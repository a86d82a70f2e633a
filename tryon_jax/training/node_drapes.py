"""Simulated drapes at the nodes of the template, where those of all designs can be compared (host side)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import jax
import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse.linalg import splu

from tryon_jax.garment.manifest import Manifest
from tryon_jax.garment.template import build_template
from tryon_jax.mesh.topology import unique_edges
from tryon_jax.nets.kriging import quadratic_element
from tryon_jax.training.garments import SimulatedGarment
from tryon_jax.training.stage_sets import split_validation
from tryon_jax.tryon import Garment, TryOnModel, config_space

ROUGHNESS = 1e-3
"""Weight of a field's roughness against its distance from the vertices: where few of them tell its nodes."""

Part = Literal["training", "validation"]
_quadratic_element = jax.jit(quadratic_element, static_argnums=1)


class NodeReader:
    """Reads values at the vertices of a garment as values at the nodes of the template."""

    def __init__(self, model: TryOnModel) -> None:
        space = config_space(model.config)
        self.num_vertices = model.config.template_vertices
        faces = build_template(space, space.mean_design, self.num_vertices).faces
        self.edges = unique_edges(faces, self.num_vertices)[0].astype(np.int32)
        self.num_nodes = self.num_vertices + len(self.edges)
        ends = np.concatenate([self.edges[:, 0], self.edges[:, 1]])
        middles = np.tile(self.num_vertices + np.arange(len(self.edges)), 2)
        shape = (self.num_nodes, self.num_nodes)
        halves = scipy.sparse.coo_array((np.ones(len(ends)), (ends, middles)), shape)
        joined = (halves + halves.T).tocsr()
        laplacian = scipy.sparse.diags_array(joined.sum(axis=1)) - joined
        self._roughness = ROUGHNESS * (laplacian @ laplacian)

    def operator(self, garment: Garment) -> scipy.sparse.csr_array:
        """From values at nodes to those at the vertices of a garment that was cut from a design."""
        count = garment.num_vertices
        # With the padding: a program for each bucket, not for each garment.
        found = _quadratic_element(self.edges, self.num_vertices, garment.template_vertices, garment.template_weights)
        nodes, shares = (np.asarray(array)[:count] for array in found)
        rows = np.repeat(np.arange(count), nodes.shape[1])
        entries = (shares.astype(np.float64).ravel(), (rows, nodes.ravel()))
        return scipy.sparse.csr_array(entries, (count, self.num_nodes))

    def __call__(self, garment: Garment, values: Float[np.ndarray, "S V 3"]) -> Float[np.ndarray, "S Q 3"]:
        """Values at nodes that give those at the vertices, by least squares.

        Args:
            garment: Cut from a design.
            values: At its vertices.
        """
        operator = self.operator(garment)
        solve = splu((operator.T @ operator + self._roughness).tocsc()).solve
        columns = values.transpose(1, 0, 2).reshape(values.shape[1], -1).astype(np.float64)
        found = solve(operator.T @ columns).reshape(self.num_nodes, len(values), 3)
        return found.transpose(1, 0, 2).astype(np.float32)


@dataclass(frozen=True, eq=False)
class NodeDrapes:
    """Training drapes of many garments in one fabric, as displacements from the mean drape at the template's nodes."""

    edges: Int[np.ndarray, "E 2"]
    """Of the template."""
    middle: Float[np.ndarray, " P"]
    half: Float[np.ndarray, " P"]
    """Middle and half range of each design parameter, metres."""
    extent: Float[np.ndarray, " b"]
    """Half axes of the body shapes, standard deviations."""
    fields: Float[np.ndarray, "S D"]
    """Displacements, metres: three at each node."""
    designs: Float[np.ndarray, "S P"]
    """In half ranges about the middle."""
    shapes: Float[np.ndarray, "S b"]
    """In half axes."""
    rows: dict[str, Int[np.ndarray, " R"]]
    """Samples of each garment."""

    def only(self, names: Sequence[str]) -> "NodeDrapes":
        """The drapes of some garments.

        Args:
            names: Those to keep, in any order.
        """
        kept = {name: rows for name, rows in self.rows.items() if name in set(names)}
        chosen = np.concatenate([np.zeros(0, np.int64), *kept.values()])
        ends = np.cumsum([0, *(len(rows) for rows in kept.values())])
        rows = {name: np.arange(ends[k], ends[k + 1]) for k, name in enumerate(kept)}
        arrays = {name: getattr(self, name)[chosen] for name in ("fields", "designs", "shapes")}
        return replace(self, rows=rows, **arrays)


def read_nodes(
    model: TryOnModel, samples: Sequence[SimulatedGarment], manifest: Manifest, fabric: str, part: Part = "training"
) -> NodeDrapes:
    """The drapes of all training shapes, or of those that choose between models (see `rows_of`).

    Args:
        model: Its template, design space and range of betas.
        samples: Simulated garments.
        manifest: Splits of designs and topologies.
        fabric: Whose drapes.
        part: Of the shapes.

    Raises:
        PermissionError: A garment's design or topology is for testing.
        ValueError: No garment has a drape to fit, or one was carried over and not simulated.
    """
    if carried := next((s.name for s in samples if s.source), None):
        raise ValueError(f"kriging is fitted to simulated garments, not to {carried!r}, which was carried over")
    reader, space = NodeReader(model), config_space(model.config)
    middle, half = space.middle, 0.5 * (space.maximum - space.minimum)
    extent = np.array(model.config.beta_ranges)
    rows: dict[str, Int[np.ndarray, " R"]] = {}
    fields, designs, shapes = [], [], []
    count = 0
    for s in samples:
        chosen = rows_of(s, manifest, fabric, part)
        if not len(chosen):
            continue
        rows[s.name] = count + np.arange(len(chosen))
        count += len(chosen)
        moved = s.drapes[fabric][chosen, : s.garment.num_vertices] - s.garment.mean_vertices[None]
        fields.append(reader(s.garment, moved).reshape(len(chosen), -1))
        designs.append(np.broadcast_to((np.asarray(s.garment.design) - middle) / half, (len(chosen), len(middle))))
        shapes.append(s.betas[chosen] / extent[None])
    if not count:
        raise ValueError(f"kriging needs at least one drape at rest in {fabric!r}")
    stacked, design_rows, shape_rows = (np.concatenate(p).astype(np.float32) for p in (fields, designs, shapes))
    return NodeDrapes(reader.edges, middle, half, extent, stacked, design_rows, shape_rows, rows)


def rows_of(
    samples: SimulatedGarment, manifest: Manifest, fabric: str, part: Part = "training"
) -> Int[np.ndarray, " R"]:
    """The samples of a garment that are fitted, or the good ones that choose between models.

    Drapes at rest are fitted whether they are good or not. Without those of garments that are too tight for a body
    nothing would be known there, and a process that knows nothing lets cloth hang as on the mean body.

    Args:
        samples: The garment.
        manifest: Splits of designs and topologies.
        fabric: Whose drapes.
        part: Of the shapes.
    """
    train, validation = split_validation(samples, manifest)
    good = samples.good[fabric]
    return np.flatnonzero(validation & good if part == "validation" else train & samples.resting.get(fabric, good))
