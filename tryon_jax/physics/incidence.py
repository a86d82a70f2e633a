"""Which elements meet at each vertex and at each block of the system matrix, as indices to gather by.

Sums over elements are gathered, not scattered: vertices come last, and a padded row of indices adds up along vector
registers. Built on the host, once per mesh. An absent element is the last one, which must be padding: it adds nothing.
"""

from collections.abc import Sequence
from dataclasses import fields

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tryon_jax.types import ArrayLike, pytree

MIN_NEIGHBOURS = 9
"""Neighbours of a vertex that a row has room for: 6 in a regular mesh, up to 9 in those of φ; more where a mesh needs
them, in pairs."""
EDGE_HINGES = 5
"""Hinges that hold an edge: its own, and those of the other edges of its two faces."""


@pytree
class Incidence:
    """Elements of each of V vertices, of their S neighbours and of E edges; F faces and H hinges, padding included.

    Corner k of face f has the flat index k · F + f, as has its side from corner k to the next; corner k of hinge h has
    k · H + h.
    """

    neighbours: Int[ArrayLike, "S V"]
    """Neighbours of each vertex: columns of the blocks beside the diagonal. An empty slot names the vertex itself."""
    edges: Int[ArrayLike, "S V"]
    """The edge to each neighbour: e where the vertex is its start, E + e where it is its end."""
    faces: Int[ArrayLike, "A V"]
    """Corners of faces at each vertex."""
    hinges: Int[ArrayLike, "B V"]
    """Corners of hinges at each vertex."""
    sides: Int[ArrayLike, "P E"]
    """Sides of faces along each edge."""
    sides_back: Int[ArrayLike, "Q E"]
    """Sides of faces against each edge."""
    edge_hinges: Int[ArrayLike, "2 R E"]
    """Corners of hinges at each edge's start, and at its end. Opposite corners of a hinge share no edge."""


def pick(values: Float[Array, "*C N"], index: Int[ArrayLike, "..."]) -> Float[Array, "..."]:
    """The values at `index`, which must lie within them: shape [*C, *index.shape]."""
    return values.at[..., jnp.asarray(index)].get(mode="promise_in_bounds")


def gather(values: Float[Array, "*C N"], index: Int[ArrayLike, "M D"]) -> Float[Array, "*C D"]:
    """Sum over the M rows of `index` of the values that they name."""
    return jnp.asarray(sum(pick(values, row) for row in index))


def find_incidence(
    faces: Int[np.ndarray, "F 3"], hinges: Int[np.ndarray, "H 4"], size: int, num_faces: int, num_hinges: int
) -> Incidence:
    """Incidence of a mesh, on the host.

    Args:
        faces: Triangles.
        hinges: Edge and opposite vertices of each pair of faces.
        size: Number of vertices with padding.
        num_faces: Number of faces with padding, more than there are.
        num_hinges: Number of hinges with padding, more than there are; also that of edges.

    Raises:
        ValueError: There are too many edges.
    """
    corner = np.arange(3)[:, None] * num_faces + np.arange(len(faces))
    hinge = np.arange(4)[:, None] * num_hinges + np.arange(len(hinges))
    starts, ends = faces.T.ravel(), faces[:, [1, 2, 0]].T.ravel()
    # An edge starts at its vertex of lower index.
    keys = np.unique(np.minimum(starts, ends).astype(np.int64) * size + np.maximum(starts, ends))
    low, high = keys // size, keys % size
    # Edges are padded to the number of hinges: there are more of them only by the borders.
    absent_face, absent_hinge, absent_edge = num_faces - 1, num_hinges - 1, num_hinges - 1
    if len(keys) > absent_edge:
        raise ValueError(f"mesh with {len(keys)} edges does not fit its bucket of {num_hinges}")
    edge = np.arange(len(keys))
    both = np.concatenate([low, high])
    degree = int(np.bincount(both, minlength=1).max())
    slots = MIN_NEIGHBOURS + 2 * max(0, -(-(degree - MIN_NEIGHBOURS) // 2))
    neighbours = _lists(both, np.concatenate([high, low]), size, slots, -1)

    def along(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """The edge of each pair in the order of both; where it runs the other way, one that does not exist."""
        found = np.searchsorted(keys, first.astype(np.int64) * size + second)
        return np.where(first < second, found, num_hinges)

    pairs = [(i, j) for i in range(4) for j in range(4) if i != j and {i, j} != {2, 3}]
    first, second = np.array(pairs).T
    held = along(hinges.T[first].ravel(), hinges.T[second].ravel())
    tables = (
        np.where(neighbours < 0, np.arange(size), neighbours),
        _lists(both, np.concatenate([edge, num_hinges + edge]), size, slots, absent_edge),
        _lists(starts, corner.ravel(), size, slots, absent_face),
        _lists(hinges.T.ravel(), hinge.ravel(), size, 2 * slots, absent_hinge),
        _lists(along(starts, ends), corner.ravel(), num_hinges, 1, absent_face),
        _lists(along(ends, starts), corner.ravel(), num_hinges, 1, absent_face),
        np.stack([_lists(held, hinge[k].ravel(), num_hinges, EDGE_HINGES, absent_hinge) for k in (first, second)]),
    )
    return Incidence(*(jnp.asarray(table.astype(np.int32)) for table in tables))


def widen(incidence: Incidence, others: Sequence[Incidence], num_faces: int, num_hinges: int) -> Incidence:
    """The same with as many rows in each table as the longest of `others` has; nothing is in the new ones.

    Args:
        incidence: Of one mesh.
        others: Of others of the same size, or this one.
        num_faces: Number of faces with padding.
        num_hinges: Number of hinges with padding.
    """
    absent = {
        each.name: num_faces - 1 if each.name in ("faces", "sides", "sides_back") else num_hinges - 1
        for each in fields(incidence)
    }
    tables = {}
    for name, nothing in absent.items():
        table = np.asarray(getattr(incidence, name))
        missing = max(getattr(other, name).shape[-2] for other in others) - table.shape[-2]
        itself = np.arange(table.shape[-1]) if name == "neighbours" else nothing
        extra = np.broadcast_to(itself, (*table.shape[:-2], missing, table.shape[-1]))
        tables[name] = jnp.asarray(np.concatenate([table, extra.astype(np.int32)], axis=-2))
    return Incidence(**tables)


def _lists(places: np.ndarray, values: np.ndarray, size: int, least: int, absent: int) -> np.ndarray:
    """The values of each of `size` places down a column, at `least` rows of them; places beyond are left out."""
    order = np.argsort(places, kind="stable")
    order = order[places[order] < size]
    counts = np.bincount(places[order], minlength=size)
    rank = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
    table = np.full((max(least, int(counts.max())), size), absent)
    table[rank, places[order]] = values[order]
    return table
