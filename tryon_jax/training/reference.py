"""A convention that selects one of many equilibria, so that folds agree between designs, meshes and bodies.

Cloth with friction rests in many ways, and rounding, the mesh and the way of dressing choose between them by chance.
Here the mean design alone is dressed, once for each fabric. Every design starts on the mean body from that drape, moved
by the change of R_mean, and comes to rest; it is then followed along straight rays of body shapes. Other meshes of a
design start at each body from the drape of its first mesh, read through the flat pattern, and come to rest. So a label
is a function of design, body and fabric, and nearly independent of the mesh.
"""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tryon_jax.garment import Design, DesignSpace, dense_template
from tryon_jax.garment.dense import DenseTemplate
from tryon_jax.garment.pattern_map import PatternMap, map_patterns, pattern_arrays
from tryon_jax.nets.mlp import MeanDrape, apply_mean_drape
from tryon_jax.training.dataset import load_arrays, save_arrays


class Start(NamedTuple):
    """Where a garment begins to settle, without padding."""

    vertices: Float[np.ndarray, "V 3"]
    """Metres."""
    slip: Float[np.ndarray, "V 3"]
    """Elastic slip of friction, metres."""


def store_guess(path: Path, mean: MeanDrape) -> MeanDrape:
    """R_mean as a dataset keeps it, so that all its drapes start from one guess; written where there is none."""
    leaves, structure = jax.tree.flatten(mean)
    if not path.exists():
        save_arrays(path, {f"array_{k}": np.asarray(leaf) for k, leaf in enumerate(leaves)})
    stored = load_arrays(path)
    return jax.tree.unflatten(structure, [jnp.asarray(stored[f"array_{k}"]) for k in range(len(leaves))])


def reference_mesh(space: DesignSpace, design: Design, num_vertices: int) -> DenseTemplate:
    """The mesh of a design whose connectivity all designs share.

    Args:
        space: The design's space.
        design: The design.
        num_vertices: Vertices of the mesh.
    """
    return dense_template(space, design, num_vertices)


def start_from_reference(
    space: DesignSpace,
    mean: MeanDrape,
    design: Design,
    mesh: Mapping[str, np.ndarray],
    reference: Start,
) -> Start:
    """Where a design's first mesh starts on the mean body: the mean design's drape plus the change of R_mean.

    Args:
        space: The design space.
        mean: R_mean, as a guess of how drapes change with the design.
        design: The design.
        mesh: Its mesh as it is stored: faces, uv, faces_uv, template_vertices, template_weights.
        reference: The drape of the mean design on its `reference_mesh`.
    """
    count = len(reference.vertices)
    onto = map_patterns(mesh, pattern_arrays(reference_mesh(space, design, count).mesh))
    before = onto(_onto_template(space, count)(_template(mean, space.mean_design)[None]))[0]
    after = np.einsum("vk,vkc->vc", mesh["template_weights"], _template(mean, design)[mesh["template_vertices"]])
    stacked = onto(np.stack([reference.vertices, reference.slip]))
    return Start(stacked[0] + after - before, stacked[1])


def start_from_mesh(here: Mapping[str, np.ndarray], there: Mapping[str, np.ndarray], drape: Start) -> Start:
    """Where another mesh of a design starts: at the drape of its first mesh, at the same places of the fabric.

    Args:
        here: The mesh that starts: faces, uv, faces_uv.
        there: The mesh that is draped.
        drape: Of `there`.
    """
    return Start(*map_patterns(here, there)(np.stack([drape.vertices, drape.slip])))


@functools.lru_cache(maxsize=1)
def _onto_template(space: DesignSpace, num_vertices: int) -> PatternMap:
    """Where the vertices of the mean design's `reference_mesh` lie on its template."""
    middle = reference_mesh(space, space.mean_design, num_vertices)
    return map_patterns(pattern_arrays(middle.mesh), pattern_arrays(middle.template))


def _template(mean: MeanDrape, design: Design) -> Float[np.ndarray, "T 3"]:
    return np.asarray(apply_mean_drape(mean, jnp.asarray(design.values, jnp.float32)), np.float64)
