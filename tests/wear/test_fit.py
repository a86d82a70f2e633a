import jax.numpy as jnp
import numpy as np
import pytest

from tryon_jax.body import load_body, shape_body
from tryon_jax.body.landmarks import load_landmarks
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.physics.stretch import stiffness, tension_along
from tryon_jax.wear.fit import EASE_AT, girth_round, measure_fit, pattern_of, stretches, tape_place


def cylinder(radius, low, high, rows=9, columns=240, around=(0.0, 0.0)):
    """An open tube of cloth with its rest pattern: a rectangle that is sewn along one edge."""
    angle = np.linspace(0, 2 * np.pi, columns + 1)
    height = np.linspace(low, high, rows)
    a, h = np.meshgrid(angle, height)
    uv = np.stack([a.ravel() * radius, h.ravel()], axis=1)
    a, h = np.meshgrid(angle[:-1], height)
    points = np.stack(
        [around[0] + radius * np.sin(a).ravel(), h.ravel(), around[1] + radius * np.cos(a).ravel()], axis=1
    )
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")

    def index(row, column, width):
        return (row * width + column % width).ravel()

    def grid(width):
        p, q = index(i, j, width), index(i, j + 1, width)
        r, s = index(i + 1, j, width), index(i + 1, j + 1, width)
        return np.concatenate([np.stack([p, q, s], 1), np.stack([p, s, r], 1)])

    return points, grid(columns), uv, grid(columns + 1)


UP = np.array([0.0, 1.0, 0.0])


def skin(body, vertices) -> ClosedSurface:
    return ClosedSurface(vertices, np.asarray(body.faces))


def test_girth_of_a_tube_is_its_circumference():
    points, faces, _, _ = cylinder(0.2, -0.5, 0.5)
    assert girth_round(points, faces, np.array([0.01, 0.03, 0.0]), UP) == pytest.approx(2 * np.pi * 0.2, rel=1e-3)


def test_girth_counts_folds():
    points, faces, _, _ = cylinder(0.2, -0.5, 0.5, columns=720)
    angle = np.arctan2(points[:, 0], points[:, 2])
    folded = points * (1 + 0.1 * np.sin(12 * angle))[:, None] * [1, 0, 1] + points * [0, 1, 0]
    fine = np.linspace(0, 2 * np.pi, 20001)
    radius = 0.2 * (1 + 0.1 * np.sin(12 * fine))
    curve = np.stack([radius * np.sin(fine), radius * np.cos(fine)], axis=1)
    expected = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    assert expected > 1.1 * 2 * np.pi * 0.2
    assert girth_round(folded, faces, np.array([0.0, 0.1, 0.0]), UP) == pytest.approx(expected, rel=3e-3)


def test_cloth_that_does_not_go_round_has_no_girth():
    points, faces, _, _ = cylinder(0.2, -0.5, 0.5)
    assert girth_round(points, faces, np.array([0.0, 0.7, 0.0]), UP) is None, "above the hem"
    assert girth_round(points, faces, np.array([0.5, 0.0, 0.0]), UP) is None, "beside the tube"
    opened = faces[~(np.abs(points[faces][:, :, 0]).max(axis=1) < 0.02)]
    assert girth_round(points, opened, np.array([0.0, 0.03, 0.0]), UP) is None, "slit open"


def test_stretch_is_what_was_done_to_the_pattern():
    points, faces, uv, faces_uv = cylinder(0.2, -0.5, 0.5)
    np.testing.assert_allclose(stretches(points, faces, uv, faces_uv), 1, atol=2e-4)
    longer = stretches(points * [1, 1.1, 1], faces, uv, faces_uv)
    np.testing.assert_allclose(longer[:, 0], 1.1, atol=2e-4)
    np.testing.assert_allclose(longer[:, 1], 1.0, atol=2e-4)


def test_stretches_are_singular_values():
    random = np.random.default_rng(0)
    uv, points, faces = random.normal(size=(90, 2)), random.normal(size=(90, 3)), np.arange(90).reshape(-1, 3)
    points[:3] = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    sides, drape = uv[faces], points[faces]
    rest = np.stack([sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]], axis=2)
    now = np.stack([drape[:, 1] - drape[:, 0], drape[:, 2] - drape[:, 0]], axis=2)
    expected = np.linalg.svd(now @ np.linalg.inv(rest), compute_uv=False)
    np.testing.assert_allclose(stretches(points, faces, uv, faces), expected, rtol=1e-9, atol=1e-9)


def test_cloth_round_a_tube_pulls_as_its_fabric_does():
    body = load_body("female")
    fabric = load_fabric("white-dots-on-blk")
    vertices, landmarks = np.asarray(body.v_template), load_landmarks(body)
    middle, _ = tape_place(landmarks, "waist", vertices.astype(float))
    points, faces, uv, faces_uv = cylinder(0.2, middle[1] - 0.05, middle[1] + 0.05, around=(0.0, middle[2]))
    for share, pulls in ((1.0, False), (0.98, True), (1.02, False)):
        fit = measure_fit(skin(body, vertices), landmarks, points, faces, uv * [share, 1], faces_uv, fabric)
        stretch = fit.girth_stretch["waist"]
        assert stretch == pytest.approx(1 / share, rel=1e-3)
        # Green strain along the warp times the stiffness that the table has there.
        green = 0.5 * (stretch**2 - 1)
        expected = green * float(stiffness(jnp.array([[green, 0.0, 0.0]]), fabric)[0, 0]) if pulls else 0.0
        assert fit.pull["waist"] == pytest.approx(expected, rel=0.02, abs=1e-6)
    tight = measure_fit(skin(body, vertices), landmarks, points, faces, uv * [0.7, 1], faces_uv, fabric)
    assert tight.too_tight == ["waist"]
    assert "hardly be put on at the waist" in "\n".join(tight.lines())
    assert tight.as_dict()["too_tight"] == ["waist"]


def test_tension_does_not_depend_on_how_the_strain_is_written():
    """Along a diagonal: strain, shear and stress in the rotated frame, by hand."""
    fabric = load_fabric("gray-interlock")
    green = 0.5 * (1.1**2 - 1)
    k = stiffness(jnp.array([[green / 2, green / 2, green]]), fabric)[0]
    stress = np.array([k[0] + k[1], k[1] + k[2]]) * green / 2
    expected = 0.5 * stress.sum() + 0.5 * float(k[3]) * green
    found = tension_along(1.1, np.array([1, 1]) / np.sqrt(2), fabric)
    assert float(found) == pytest.approx(expected, rel=1e-4)


def test_a_pattern_in_true_size_is_kept_and_a_texture_atlas_is_not():
    points, faces, uv, faces_uv = cylinder(0.2, -0.5, 0.5)
    assert pattern_of(points, faces, uv, faces_uv) == (uv, faces_uv)
    for given in ((uv / 3, faces_uv), (None, None)):
        laid, corners = pattern_of(points, faces, *given)
        np.testing.assert_allclose(stretches(points, faces, laid, corners), 1, atol=1e-9)
        np.testing.assert_allclose(stretches(2 * points, faces, laid, corners), 2, atol=1e-9)


@pytest.fixture(scope="module")
def fitted():
    body = load_body("female")
    vertices = np.asarray(shape_body(body, np.zeros(10))[0])
    landmarks = load_landmarks(body)
    hip, waist = (tape_place(landmarks, name, vertices)[0] for name in ("hip", "waist"))
    tube = cylinder(0.26, hip[1] - 0.1, waist[1] - 0.03, around=(hip[0], hip[2]))
    return measure_fit(skin(body, vertices), landmarks, *tube), tube


def test_ease_is_the_cloths_girth_minus_the_bodys(fitted):
    fit, _ = fitted
    assert set(fit.ease) == set(EASE_AT)
    assert fit.ease["chest"] is None
    assert fit.ease["hip"] == pytest.approx(2 * np.pi * 0.26 - fit.body_girth["hip"], abs=2e-3)
    assert 0.8 < fit.body_girth["hip"] < 1.2


def test_a_tube_around_the_body_is_clear_of_it_and_a_tight_one_is_not(fitted):
    fit, (points, *rest) = fitted
    assert fit.inside == 0
    assert fit.deepest == 0
    body = load_body("female")
    vertices = np.asarray(shape_body(body, np.zeros(10))[0])
    tight = points * [0.4, 1, 0.4]
    fit = measure_fit(skin(body, vertices), load_landmarks(body), tight, *rest)
    assert 0.2 < fit.inside < 1
    assert 0.01 < fit.deepest < 0.2
    assert fit.ease["hip"] < 0


def test_the_report_is_in_centimetres_and_percent(fitted):
    lines = fitted[0].lines()
    assert "garment not covered" in lines[0]
    assert f"ease {100 * fitted[0].ease['hip']:+.1f} cm" in lines[2]
    assert lines[4] == "inside   0.00 % of the vertices, 0.0 mm at most"
    assert fitted[0].as_dict()["ease"]["chest"] is None
