"""Samples on the outlines of panels, and the sewing of triangulated panels into one surface."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import connected_components

from tryon_jax.garment import curves
from tryon_jax.garment.design import Design
from tryon_jax.garment.layout import Layout, Panel
from tryon_jax.garment.mesh import SewnMesh
from tryon_jax.mesh.topology import inspect_topology

Counts = Mapping[str, int]
"""Number of segments on each edge of a layout."""


def edge_counts(layout: Layout, drawn: Mapping[str, np.ndarray], spacing: float) -> dict[str, int]:
    """Segments on each edge at about `spacing` metres, at least one.

    The two edges of a seam get the same number, from their mean length: rounding each by itself would let seams
    disagree by one sample.

    Args:
        layout: The layout.
        drawn: Polyline of each edge by name, metres.
        spacing: Wanted distance between samples, metres.

    Returns:
        Number of segments by edge.
    """
    counts = {name: max(1, round(curves.length(line) / spacing)) for name, line in drawn.items()}
    for (_, first), (_, second) in layout.seams.values():
        mean = (curves.length(drawn[first]) + curves.length(drawn[second])) / 2
        counts[first] = counts[second] = max(1, round(mean / spacing))
    return counts


@dataclass(frozen=True)
class SampledOutline:
    """Samples on the outline of one panel."""

    points: Float[np.ndarray, "B 2"]
    """Counter-clockwise, metres; the first point is not repeated."""
    edges: Mapping[str, Int[np.ndarray, " _"]]
    """For each edge the indices of its samples in the direction of its drawing, both ends included."""


def sample_outline(panel: Panel, drawn: Mapping[str, np.ndarray], counts: Counts) -> SampledOutline:
    """Equally spaced samples on every edge of a panel.

    Args:
        panel: The panel.
        drawn: Polyline of each edge by name, metres.
        counts: Number of segments by edge.

    Returns:
        Samples counter-clockwise in UV, with the indices of each edge.
    """
    points, edges, start = [], {}, 0
    total = sum(counts[edge] for edge, _ in panel.outline)
    for edge, forward in panel.outline:
        samples = curves.resample_polyline(drawn[edge], counts[edge])
        index = np.arange(start, start + counts[edge] + 1) % total
        points.append((samples if forward else samples[::-1])[:-1])
        edges[edge] = index if forward else index[::-1]
        start += counts[edge]
    return SampledOutline(np.concatenate(points), edges)


def seam_samples(
    layout: Layout, outlines: Sequence[SampledOutline], start: Int[np.ndarray, " P"]
) -> dict[str, Int[np.ndarray, "_ 2"]]:
    """The pairs of outline samples that each seam joins, from end to end; panel k's samples begin at start[k].

    Args:
        layout: The layout.
        outlines: Samples of each panel.
        start: Index of each panel's first sample.

    Returns:
        Pairs of indices by seam.

    Raises:
        ValueError: where the two edges of a seam have different numbers of samples.
    """
    index = {panel.name: k for k, panel in enumerate(layout.panels)}
    pairs = {}
    for seam, members in layout.seams.items():
        first, second = (outlines[index[p]].edges[e] + start[index[p]] for p, e in members)
        if len(first) != len(second):
            raise ValueError(f"the edges of seam {seam!r} have {len(first)} and {len(second)} samples")
        pairs[seam] = np.stack([first, second], axis=1)
    return pairs


def _weld(seam_uv: Mapping[str, np.ndarray], total: int) -> Int[np.ndarray, " U"]:
    """Label that is shared by all samples which seams make one."""
    pairs = np.concatenate(list(seam_uv.values()))
    graph = sp.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (total, total))
    return connected_components(graph, directed=False)[1]


def count_outline_vertices(layout: Layout, outlines: Sequence[SampledOutline]) -> int:
    """Number of vertices that the outlines of all panels have once they are sewn."""
    start = np.concatenate([[0], np.cumsum([len(o.points) for o in outlines])])
    return len(np.unique(_weld(seam_samples(layout, outlines, start), int(start[-1]))))


def sew(
    layout: Layout,
    design: Design,
    outlines: Sequence[SampledOutline],
    points: Sequence[Float[np.ndarray, "_ 2"]],
    faces: Sequence[Int[np.ndarray, "_ 3"]],
) -> SewnMesh:
    """Sew triangulated panels: the two samples at each place of a seam become one vertex.

    Args:
        layout: says what is sewn to what.
        design: recorded in the mesh.
        outlines: samples of each panel's outline.
        points: points of each panel, outline first, metres.
        faces: counter-clockwise triangles of each panel.

    Raises:
        ValueError: where the seams have different numbers of samples, or the sewn surface is no manifold (a chord
            between the same two seam vertices in both panels would be an edge of four faces).
    """
    start = np.concatenate([[0], np.cumsum([len(p) for p in points])])
    seam_uv = seam_samples(layout, outlines, start)
    label = _weld(seam_uv, int(start[-1]))
    # Vertices in the order of their first uv, whatever labels the search gave.
    _, vertex_uv, inverse = np.unique(label, return_index=True, return_inverse=True)
    order = np.argsort(vertex_uv)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    uv_vertex = rank[inverse]

    faces_uv = []
    for k, panel in enumerate(layout.panels):
        turned = faces[k] if panel.side == "front" else faces[k][:, [0, 2, 1]]
        faces_uv.append(turned + start[k])
    all_faces_uv = np.concatenate(faces_uv)
    index = {panel.name: k for k, panel in enumerate(layout.panels)}

    def samples(panel: str, edge: str) -> np.ndarray:
        return outlines[index[panel]].edges[edge] + start[index[panel]]

    mesh = SewnMesh(
        faces=uv_vertex[all_faces_uv],
        uv=np.concatenate(points),
        faces_uv=all_faces_uv,
        panels=np.repeat(np.arange(len(faces)), [len(f) for f in faces]),
        uv_panels=np.repeat(np.arange(len(points)), [len(p) for p in points]),
        panel_names=tuple(p.name for p in layout.panels),
        panel_sides=tuple(p.side for p in layout.panels),
        loops={n: _loop([uv_vertex[samples(*m)] for m in members]) for n, members in layout.loops.items()},
        seams={n: uv_vertex[pair[:, 0]] for n, pair in seam_uv.items()},
        seam_uv=seam_uv,
        outlines=tuple(np.arange(len(o.points)) + s for o, s in zip(outlines, start[:-1], strict=True)),
        vertex_uv=vertex_uv[order],
        uv_vertex=uv_vertex,
        design=design,
    )
    report = inspect_topology(mesh.faces, mesh.num_vertices)
    if not report.is_manifold or report.components != 1 or report.loops != len(mesh.loops):
        raise ValueError(f"layout {layout.name!r} does not sew to one clean surface at {design}: {report}")
    return mesh


def _loop(chains: list[np.ndarray]) -> Int[np.ndarray, " L"]:
    """One closed loop from chains that meet at their ends, in any order and direction."""
    loop, rest = chains[0], list(chains[1:])
    while rest:
        for k, chain in enumerate(rest):
            if chain[-1] == loop[-1]:
                chain = chain[::-1]
            if chain[0] == loop[-1]:
                loop = np.concatenate([loop, chain[1:]])
                rest.pop(k)
                break
        else:
            raise ValueError("the edges of a loop do not meet")
    if loop[0] != loop[-1]:
        raise ValueError("the edges of a loop do not close")
    return loop[:-1]
