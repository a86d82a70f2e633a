"""The template, the dense mesh, and the layouts that people write."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tryon_jax.garment import Design, build_template, dense_template, load_design_space, load_layout, remesh
from tryon_jax.garment.locate import barycentric, locate, on_edges
from tryon_jax.garment.morph import mean_value_laplacian, morph, spread, untangle
from tryon_jax.garment.pattern_place import pattern_places
from tryon_jax.garment.sewing import edge_counts, sample_outline, sew
from tryon_jax.garment.template import load_reference, make_reference, save_reference
from tryon_jax.garment.triangulate import delaunay_inside
from tryon_jax.mesh.quality import angles, signed_areas
from tryon_jax.mesh.topology import inspect_topology

SPACE = load_design_space()
MEAN = build_template(SPACE, SPACE.mean_design)

shares = st.tuples(*[st.floats(0, 1)] * 3)
"""Where a design lies between the minimum and the maximum of each parameter."""


def between(share: tuple[float, ...]) -> Design:
    return SPACE.from_values(SPACE.minimum + np.array(share) * (SPACE.maximum - SPACE.minimum))


def test_403_vertices_and_four_loops() -> None:
    assert MEAN.num_vertices == 403
    report = inspect_topology(MEAN.faces, 403)
    assert report.is_manifold
    assert (report.euler, report.loops, report.components) == (-2, 4, 1)


def test_the_stored_template_belongs_to_the_layout() -> None:
    """Trained networks rely on it: a change of the layout's outlines needs a new one (tools/bake_template.py)."""
    layout = SPACE.layout
    reference = load_reference(layout)
    assert reference.values == {p.name: p.mean for p in layout.parameters}
    drawn = layout.draw(reference.values)
    for panel, points in zip(layout.panels, reference.points, strict=True):
        outline = sample_outline(panel, drawn, reference.counts).points
        np.testing.assert_allclose(points[: len(outline)], outline, atol=1e-9)


@settings(max_examples=12)
@given(shares)
def test_no_triangle_turns_over_and_few_are_thin(share: tuple[float, ...]) -> None:
    template = build_template(SPACE, between(share))
    np.testing.assert_array_equal(template.faces, MEAN.faces)
    area = signed_areas(template.uv, template.faces_uv) * np.where(template.panels == 0, 1, -1)
    assert area.min() > 0
    smallest = np.degrees(angles(template.uv, template.faces_uv).min(axis=1))
    assert (smallest < 10).mean() < 0.02
    assert smallest.min() > 3


@pytest.mark.parametrize("corner", range(8))
def test_corners_of_the_space(corner: int) -> None:
    bits = np.array([corner & 1, corner >> 1 & 1, corner >> 2 & 1], bool)
    template = build_template(SPACE, SPACE.from_values(np.where(bits, SPACE.maximum, SPACE.minimum)))
    area = signed_areas(template.uv, template.faces_uv) * np.where(template.panels == 0, 1, -1)
    assert area.min() > 0
    assert (np.degrees(angles(template.uv, template.faces_uv).min(axis=1)) < 10).mean() < 0.01


def test_one_harmonic_step_turns_triangles_over_and_ours_do_not() -> None:
    """The reason for the steps: from the mean to a sleeveless design, one mean-value map folds the underarm."""
    layout, reference = SPACE.layout, load_reference(SPACE.layout)
    goal = SPACE.layout_values(SPACE.design(sleeve_length=0.0, chest=0.88, length=1.2))
    outline = sample_outline(layout.panels[0], layout.draw(goal), reference.counts).points
    points, faces, fixed = reference.points[0], reference.faces[0], len(outline)
    laplacian = mean_value_laplacian(points, faces).toarray()
    once = points.copy()
    once[:fixed] = outline
    once[fixed:] = np.linalg.solve(laplacian[fixed:, fixed:], -laplacian[fixed:, :fixed] @ outline)
    assert signed_areas(once, faces).min() < 0

    def outline_at(t: float) -> np.ndarray:
        values = {n: (1 - t) * reference.values[n] + t * goal[n] for n in goal}
        return sample_outline(layout.panels[0], layout.draw(values), reference.counts).points

    assert signed_areas(morph(points, faces, outline_at), faces).min() > 0


def test_uv_follow_the_design_smoothly() -> None:
    step = [build_template(SPACE, SPACE.design(length=length)).uv for length in (0.9, 0.9001, 0.9002)]
    assert np.abs(step[1] - step[0]).max() < 1e-3
    assert np.abs(step[2] - 2 * step[1] + step[0]).max() < 1e-4


def test_references_are_stored_exactly(tmp_path: Path) -> None:
    reference = make_reference(SPACE.layout, 120)
    save_reference(reference, tmp_path / "small.npz")
    with np.load(tmp_path / "small.npz", allow_pickle=False) as data:
        np.testing.assert_array_equal(data["points_0"], reference.points[0])
        np.testing.assert_array_equal(data["faces_1"], reference.faces[1])
    assert build_template(SPACE, SPACE.mean_design, num_vertices=120).num_vertices == 120
    with pytest.raises(ValueError, match="no template of 4 vertices"):
        make_reference(SPACE.layout, 4)


@pytest.fixture(scope="module")
def dense():
    return dense_template(SPACE, SPACE.preset("tank"), num_vertices=3000)


def test_the_dense_mesh_shares_the_templates_parametrisation(dense) -> None:
    assert dense.mesh.num_vertices == 3000
    uv = dense.mesh.uv[dense.mesh.vertex_uv]
    coarse = dense.template.uv[dense.template.vertex_uv]
    flat = np.concatenate([uv, np.zeros((3000, 1))], axis=1)
    np.testing.assert_allclose(dense.downsample(flat)[:, :2], coarse, atol=1e-9)
    sewn = np.unique(np.concatenate([*dense.template.seams.values(), *dense.template.loops.values()]))
    np.testing.assert_allclose(dense.weights[sewn].max(axis=1), 1.0, atol=1e-9)
    assert dense.weights.min() >= 0
    area = signed_areas(dense.mesh.uv, dense.mesh.faces_uv) * np.where(dense.mesh.panels == 0, 1, -1)
    assert area.min() > 0


def test_the_dense_connectivity_is_fixed(dense) -> None:
    other = dense_template(SPACE, SPACE.preset("sweater"), num_vertices=3000)
    np.testing.assert_array_equal(other.mesh.faces, dense.mesh.faces)
    area = signed_areas(other.mesh.uv, other.mesh.faces_uv) * np.where(other.mesh.panels == 0, 1, -1)
    assert area.min() > 0
    with pytest.raises(ValueError, match="dense template of 60 vertices is too small"):
        dense_template(SPACE, SPACE.preset("tank"), num_vertices=60)


SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def test_barycentric_weights_reproduce_points() -> None:
    points = np.random.default_rng(0).random((50, 2))
    face, weights = locate(points, SQUARE, HALVES)
    np.testing.assert_allclose((weights[:, :, None] * SQUARE[HALVES[face]]).sum(axis=1), points, atol=1e-12)
    np.testing.assert_allclose(barycentric(SQUARE[HALVES[0]], np.array([1.0, 0.0])), [0, 1, 0], atol=1e-12)


def test_points_outside_are_clamped() -> None:
    face, weights = locate(np.array([[1.1, 0.5], [-0.2, -0.2]]), SQUARE, HALVES)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert weights.min() >= 0
    assert face[0] == 0
    np.testing.assert_allclose((weights[1][:, None] * SQUARE[HALVES[face[1]]]).sum(axis=0), [0, 0], atol=0.2)


def test_a_far_triangle_is_found_though_its_centroid_is_far() -> None:
    """A long thin triangle holds the point; many small ones have nearer centroids."""
    rng = np.random.default_rng(0)
    small = rng.uniform(-0.3, 0.3, (40, 1, 2)) + [0.5, 0.32] + rng.uniform(0, 0.02, (40, 3, 2))
    long = np.array([[[0, 0], [10, 0], [10, 0.01]]])
    corners = np.concatenate([small, long]).reshape(-1, 2)
    faces = np.arange(len(corners)).reshape(-1, 3)
    face, _ = locate(np.array([[0.5, 0.0002]]), corners, faces)
    assert face[0] == 40


def test_fractions_of_edges() -> None:
    samples, ends, weights = on_edges({"a": np.arange(5)}, {"a": np.array([10, 11, 12])})
    np.testing.assert_array_equal(samples, np.arange(5))
    np.testing.assert_allclose((weights * ends).sum(axis=1), [10, 10.5, 11, 11.5, 12])


def test_untangling_turns_triangles_back() -> None:
    points = np.concatenate([SQUARE, [[0.5, 0.5], [0.3, 0.2]]])
    faces = delaunay_inside(points, 4)
    tangled = points.copy()
    tangled[5] = [0.3, -0.05]
    assert signed_areas(tangled, faces).min() < 0
    np.testing.assert_array_equal(spread(tangled, faces, 4), tangled)
    mended = untangle(tangled, faces, 4)
    assert signed_areas(mended, faces).min() > 0
    np.testing.assert_array_equal(mended[:4], SQUARE)


def test_spreading_finds_the_middle() -> None:
    points = np.concatenate([SQUARE, [[0.2, 0.9]]])
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    np.testing.assert_allclose(spread(points, faces, 4, iterations=200)[4], [0.5, 0.5], atol=1e-4)


def test_a_chord_in_both_panels_is_refused() -> None:
    """Between the same two seam vertices it would be an edge of four faces."""
    from test_garment_layout import TUBE, parse_layout, tomllib

    layout = parse_layout(tomllib.loads(TUBE), "tube")
    drawn = layout.draw({"width": 0.4})
    counts = {"left": 1, "right": 1, "top": 2, "bottom": 2}
    outlines = [sample_outline(p, drawn, counts) for p in layout.panels]
    points = [o.points for o in outlines]
    design = Design(("width",), np.array([0.4]))
    chord = np.array([[0, 1, 3], [1, 2, 3], [0, 3, 4], [0, 4, 5]])
    with pytest.raises(ValueError, match=r"does not sew to one clean surface.*non_manifold_edges=1"):
        sew(layout, design, outlines, points, [chord, chord])
    other = np.array([[0, 1, 5], [1, 4, 5], [1, 2, 4], [2, 3, 4]])
    mesh = sew(layout, design, outlines, points, [chord, other])
    report = inspect_topology(mesh.faces, mesh.num_vertices)
    assert report.is_manifold
    assert (report.euler, report.loops) == (0, 2)


def test_seams_that_do_not_match_are_refused() -> None:
    layout = SPACE.layout
    drawn = SPACE.draw(SPACE.mean_design)
    counts = edge_counts(layout, drawn, 0.05)
    for first, second in layout.seams.values():
        assert counts[first[1]] == counts[second[1]]
    front = sample_outline(layout.panels[0], drawn, counts)
    back = sample_outline(layout.panels[1], drawn, counts | {"side_left": counts["side_left"] + 1})
    points = [front.points, back.points]
    faces = [delaunay_inside(p, len(p)) for p in points]
    with pytest.raises(ValueError, match="the edges of seam 'side_left' have"):
        sew(layout, SPACE.mean_design, [front, back], points, faces)


def test_another_layout_needs_no_code(tmp_path: Path) -> None:
    """A skirt: two panels, two seams, two loops, from its file to a garment on a template."""
    from test_garment_layout import TUBE

    (tmp_path / "tube.toml").write_text(TUBE)
    space = load_design_space(load_layout(tmp_path / "tube.toml"))
    garment = remesh(space, space.design(width=0.45), target_area=5e-4)
    assert set(garment.loops) == {"top", "bottom"}
    report = inspect_topology(garment.faces, garment.num_vertices)
    assert report.is_manifold
    assert (report.euler, report.loops, report.components) == (0, 2, 1)
    assert garment.quality.min_angle > 20


def test_places_on_the_pattern_are_those_of_the_panels() -> None:
    places = pattern_places(MEAN)
    front_or_back = np.abs(places[:, 2]) == 1
    alone = MEAN.vertex_uv[front_or_back]
    np.testing.assert_allclose(places[front_or_back, :2], MEAN.uv[alone])
    seams = np.unique(np.concatenate(list(MEAN.seams.values())))
    np.testing.assert_allclose(places[seams, 2], 0.0)
    # The two sides of a seam of this layout lie at one place.
    np.testing.assert_allclose(places[seams, :2], MEAN.uv[MEAN.vertex_uv[seams]], atol=0.01)
    sides = np.array([MEAN.panel_sides[k] for k in MEAN.panels])
    for side, sign in (("front", 1.0), ("back", -1.0)):
        assert (places[MEAN.faces[sides == side], 2] * sign >= 0).all()
