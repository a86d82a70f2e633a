"""φ: counts, quality, sewing, topologies, and the map onto the template."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tryon_jax.garment import (
    Design,
    build_template,
    load_design_space,
    load_manifest,
    place_on_template,
    placement,
    remesh,
)
from tryon_jax.garment.curves import point_at
from tryon_jax.garment.mesh import GarmentMesh
from tryon_jax.garment.sewing import count_outline_vertices, edge_counts, sample_outline
from tryon_jax.garment.triangulate import edge_length, interior_count
from tryon_jax.mesh.quality import signed_areas
from tryon_jax.mesh.topology import border_loops, edge_keys, inspect_topology, unique_edges

SPACE = load_design_space()
DRESS = remesh(SPACE, SPACE.preset("dress"))

shares = st.tuples(*[st.floats(0, 1)] * 3)
"""Where a design lies between the minimum and the maximum of each parameter."""


def between(share: tuple[float, ...]) -> Design:
    return SPACE.from_values(SPACE.minimum + np.array(share) * (SPACE.maximum - SPACE.minimum))


def check_garment(garment: GarmentMesh) -> None:
    report = inspect_topology(garment.faces, garment.num_vertices)
    assert report.is_manifold
    assert (report.euler, report.loops, report.components) == (-2, 4, 1)
    assert abs(garment.quality.mean_area / garment.target_area - 1) < 0.005
    assert garment.quality.min_angle > 20
    assert garment.quality.max_distortion < 2.5
    assert garment.template_weights.min() >= 0
    np.testing.assert_allclose(garment.template_weights.sum(axis=1), 1.0, atol=1e-12)
    assert 0 <= garment.template_vertices.min() <= garment.template_vertices.max() < 403


@settings(max_examples=8)
@given(shares, st.integers(0, 1000))
def test_every_design_gives_a_clean_garment(share: tuple[float, ...], seed: int) -> None:
    check_garment(remesh(SPACE, between(share), target_area=6e-4, seed=seed))


@pytest.mark.parametrize("corner", range(8))
def test_corners_of_the_space(corner: int) -> None:
    bits = np.array([corner & 1, corner >> 1 & 1, corner >> 2 & 1], bool)
    design = SPACE.from_values(np.where(bits, SPACE.maximum, SPACE.minimum))
    check_garment(remesh(SPACE, design, target_area=8e-4))


def test_the_training_set_has_the_papers_sizes() -> None:
    """1,414 to 3,581 vertices at one T_area (section "Dataset and Implementation Details")."""
    manifest = load_manifest()
    sizes = {}
    for design in manifest.training:
        drawn = SPACE.draw(design)
        counts = edge_counts(SPACE.layout, drawn, edge_length(manifest.target_area))
        outlines = [sample_outline(panel, drawn, counts) for panel in SPACE.layout.panels]
        inner = sum(interior_count(o.points, manifest.target_area) for o in outlines)
        sizes[design.label] = count_outline_vertices(SPACE.layout, outlines) + inner
    assert sizes["dress"] == DRESS.num_vertices
    assert min(sizes.values()) == sizes["tank"] >= 1414
    assert max(sizes.values()) == sizes["maxi-dress"] <= 3581


@pytest.mark.parametrize("factor", [0.25, 4.0, 16.0])
def test_other_densities(factor: float) -> None:
    garment = remesh(SPACE, SPACE.preset("tank"), target_area=1.78e-4 * factor)
    check_garment(garment)
    triangles = remesh(SPACE, SPACE.preset("tank")).quality.num_faces
    assert garment.quality.num_faces == pytest.approx(triangles / factor, rel=0.02)


def test_faces_look_outwards_and_panels_are_seen_from_the_front() -> None:
    area = signed_areas(DRESS.uv, DRESS.faces_uv)
    assert (area[DRESS.panels == 0] > 0).all()
    assert (area[DRESS.panels == 1] < 0).all()
    assert DRESS.panel_names == ("front", "back")
    start = placement(DRESS)
    volume = np.einsum("fi,fi->f", start[DRESS.faces[:, 0]], np.cross(*start[DRESS.faces[:, 1:]].swapaxes(0, 1))).sum()
    assert volume > 0


def test_indices_agree() -> None:
    np.testing.assert_array_equal(DRESS.uv_vertex[DRESS.faces_uv], DRESS.faces)
    np.testing.assert_array_equal(DRESS.uv_vertex[DRESS.vertex_uv], np.arange(DRESS.num_vertices))
    np.testing.assert_array_equal(DRESS.uv_panels[DRESS.faces_uv], np.repeat(DRESS.panels[:, None], 3, axis=1))
    for seam, pair in DRESS.seam_uv.items():
        np.testing.assert_array_equal(DRESS.uv_vertex[pair[:, 0]], DRESS.seams[seam])
        np.testing.assert_array_equal(DRESS.uv_vertex[pair[:, 1]], DRESS.seams[seam])
        np.testing.assert_array_equal(DRESS.uv_panels[pair], [[0, 1]] * len(pair))
    for k, outline in enumerate(DRESS.outlines):
        assert (DRESS.uv_panels[outline] == k).all()


def test_loops_are_the_borders() -> None:
    assert set(DRESS.loops) == {"neck", "hem", "cuff_left", "cuff_right"}
    borders = {frozenset(loop.tolist()) for loop in border_loops(DRESS.faces, DRESS.num_vertices)}
    assert {frozenset(loop.tolist()) for loop in DRESS.loops.values()} == borders
    edges, counts = unique_edges(DRESS.faces, DRESS.num_vertices)
    border_keys = edge_keys(edges[counts == 1], DRESS.num_vertices)
    for loop in DRESS.loops.values():
        steps = np.stack([loop, np.roll(loop, -1)], axis=1)
        assert np.isin(edge_keys(steps, DRESS.num_vertices), border_keys).all()
    uv = DRESS.uv[DRESS.vertex_uv]
    assert uv[DRESS.loops["cuff_left"], 0].min() > 0 > uv[DRESS.loops["cuff_right"], 0].max()
    assert uv[DRESS.loops["neck"], 1].min() > uv[DRESS.loops["hem"], 1].max()


def test_seams_run_along_edges_of_the_mesh_and_ends_meet_loops() -> None:
    edges, counts = unique_edges(DRESS.faces, DRESS.num_vertices)
    inner = edge_keys(edges[counts == 2], DRESS.num_vertices)
    for seam in DRESS.seams.values():
        assert np.isin(edge_keys(np.stack([seam[:-1], seam[1:]], axis=1), DRESS.num_vertices), inner).all()
    np.testing.assert_array_equal(
        DRESS.uv[DRESS.seam_uv["side_left"][:, 0]], DRESS.uv[DRESS.seam_uv["side_left"][:, 1]]
    )


def test_uv_lie_on_the_drawn_outline() -> None:
    side = SPACE.draw(SPACE.preset("dress"))["side_left"]
    samples = DRESS.uv[DRESS.seam_uv["side_left"][:, 0]]
    np.testing.assert_allclose(samples, point_at(side, np.linspace(0, 1, len(samples))), atol=1e-12)


def test_seeds_give_other_topologies_of_the_same_area() -> None:
    garments = [remesh(SPACE, SPACE.preset("tank"), target_area=5e-4, seed=seed) for seed in range(4)]
    assert len({g.num_vertices for g in garments}) == 1
    assert len({round(g.quality.mean_area, 15) for g in garments}) == 1
    degrees = []
    for garment in garments:
        edges, _ = unique_edges(garment.faces, garment.num_vertices)
        degrees.append(np.bincount(edges.ravel()))
        uv = garment.uv[garment.vertex_uv]
        inner = ~np.isin(np.arange(len(uv)), np.concatenate([*garment.loops.values(), *garment.seams.values()]))
        other = garments[0].uv[garments[0].vertex_uv]
        if garment is not garments[0]:
            gap = np.linalg.norm(uv[inner][:, None] - other[None], axis=2).min(axis=1)
            assert (gap > 0.005).mean() > 0.7
    assert len({tuple(np.bincount(d)) for d in degrees}) == 4


def test_a_seed_repeats_itself() -> None:
    again = remesh(SPACE, SPACE.preset("dress"))
    np.testing.assert_array_equal(again.faces, DRESS.faces)
    np.testing.assert_array_equal(again.uv, DRESS.uv)


def test_positions_follow_the_template_linearly() -> None:
    """M̄ = W T̄ reproduces every affine function of UV, up to where the template cuts curves."""
    template = build_template(SPACE, SPACE.preset("dress"))
    uv = template.uv[template.vertex_uv]
    field = np.stack([uv[:, 0], uv[:, 1], 2 * uv[:, 0] - uv[:, 1] + 3], axis=1)
    there = place_on_template(DRESS, field)
    own = DRESS.uv[DRESS.vertex_uv]
    error = np.linalg.norm(there[:, :2] - own, axis=1)
    assert error.max() < 0.01
    assert np.median(error) < 1e-9
    np.testing.assert_allclose(there[:, 2], 2 * there[:, 0] - there[:, 1] + 3, atol=1e-9)


def test_seam_vertices_are_tied_to_the_templates_seams() -> None:
    template = build_template(SPACE, SPACE.preset("dress"))
    for name, seam in DRESS.seams.items():
        weights = DRESS.template_weights[seam]
        used = DRESS.template_vertices[seam][weights > 0]
        assert np.isin(used, template.seams[name]).all()
    for name, loop in DRESS.loops.items():
        used = DRESS.template_vertices[loop][DRESS.template_weights[loop] > 0]
        assert np.isin(used, template.loops[name]).all()


def test_placement_is_a_pillow_on_the_arms() -> None:
    start = placement(DRESS)
    uv = DRESS.uv[DRESS.vertex_uv]
    np.testing.assert_array_equal(start[:, 0], uv[:, 0])
    np.testing.assert_allclose(start[:, 1] - uv[:, 1], start[0, 1] - uv[0, 1])
    sewn = np.unique(np.concatenate(list(DRESS.seams.values())))
    np.testing.assert_allclose(start[sewn, 2], 0.0, atol=1e-12)
    assert start[:, 2].max() == pytest.approx(0.06)
    assert start[:, 2].min() == pytest.approx(-0.06)
    free = np.setdiff1d(np.arange(DRESS.num_vertices), sewn)
    assert (np.sign(start[free, 2]) == np.where(DRESS.uv_panels[DRESS.vertex_uv[free]] == 0, 1, -1)).all()
    assert placement(DRESS, height=1.0)[0, 1] - start[0, 1] == pytest.approx(0.46)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target_area": 0.0}, "target_area = 0 m"),
        ({"target_area": -1e-4}, "target_area = -0.0001 m"),
        ({"target_area": 1.0}, "target_area = 1 m.* is outside its range"),
        ({"target_area": 1e-9}, "outside its range"),
        ({"target_area": float("nan")}, "target_area must be finite"),
        ({"max_distortion": 1.0}, r"max_distortion = 1 is outside its range 1\.2"),
        ({"seed": -1}, "seed = -1 is outside its range 0"),
    ],
)
def test_bad_requests(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        remesh(SPACE, SPACE.preset("tank"), **options)  # pyright: ignore[reportArgumentType]


def test_a_bound_that_cannot_be_met_is_said() -> None:
    with pytest.raises(ValueError, match=r"max_distortion = 1\.2 was not reached for panel front of tank.*best 1\."):
        remesh(SPACE, SPACE.preset("tank"), max_distortion=1.2, target_area=1e-3)
