import numpy as np
import pytest
import trimesh
from PIL import Image

from tryon_jax.render import ColorScale, SheetItem, contact_sheet, draw, render_picture
from tryon_jax.render.camera import VIEWS, Camera
from tryon_jax.render.light import Casters, DepthMap, sky_light
from tryon_jax.render.raster import nearest_depth, rasterize
from tryon_jax.render.scene import build_scene


def ball(radius=0.4, center=(0.0, 0.0, 0.0), subdivisions=3):
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(sphere.vertices) + center, np.asarray(sphere.faces)


def tube(radius=0.5, height=0.5):
    """An open sleeve around the ball."""
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    ring = np.stack([radius * np.cos(angle), np.zeros(48), radius * np.sin(angle)], axis=1)
    vertices = np.concatenate([ring + [0, y, 0] for y in (-height / 2, height / 2)])
    a = np.arange(48)
    b = (a + 1) % 48
    return vertices, np.concatenate([np.stack([a, a + 48, b], 1), np.stack([b, a + 48, b + 48], 1)])


# Rasteriser


def test_a_triangle_covers_its_area_and_the_nearer_one_wins():
    points = np.array([[10, 10, 5], [90, 10, 5], [10, 90, 5], [0, 0, 2], [40, 0, 2], [0, 40, 2]], float)
    fragments = rasterize(points, np.array([[0, 1, 2], [3, 5, 4]]), 100, 100)
    assert (fragments.face == 1).sum() == pytest.approx(800, rel=0.05)
    assert fragments.face[12, 12] == 1
    assert fragments.face[30, 30] == 0
    assert fragments.face[80, 80] == -1
    covered_first = 3200 - (15 * 15 + 0)  # the second hides the corner below the diagonal x + y = 40
    assert (fragments.face == 0).sum() == pytest.approx(covered_first, rel=0.05)


def test_a_closed_mesh_has_no_holes():
    vertices, faces = ball(0.45, subdivisions=4)
    fragments = rasterize(vertices * [200, 200, 1] + [100, 100, 0], faces, 200, 200)
    y, x = np.mgrid[:200, :200] + 0.5
    inside = np.hypot(x - 100, y - 100) < 0.44 * 200
    assert (fragments.face[inside] >= 0).all()
    np.testing.assert_allclose(
        fragments.depth[inside], -np.sqrt(0.45**2 - ((x - 100) ** 2 + (y - 100) ** 2)[inside] / 200**2), atol=0.01
    )


@pytest.mark.parametrize("shifts", [(0.0,), (-0.125, 0.375, -0.375)])
def test_corner_weights_give_the_sampled_point_back(shifts):
    vertices, faces = ball()
    points = vertices * [100, 100, 1] + [50, 50, 0]
    fragments = rasterize(points, faces, 100, 100, shifts)
    if shifts == (0.0,):
        np.testing.assert_array_equal(nearest_depth(points, faces, 100, 100), fragments.depth)
    row, column = np.nonzero(fragments.face >= 0)
    weights = fragments.corner_weights(faces, row, column)
    back = np.einsum("nk,nkd->nd", weights, points[faces[fragments.face[row, column]]])
    at = np.stack([column + 0.5 + np.take(shifts, row % len(shifts)), row + 0.5], 1)
    np.testing.assert_allclose(back[:, :2], at, atol=1e-6)
    np.testing.assert_allclose(back[:, 2], fragments.depth[row, column], atol=1e-5)


def test_triangles_beyond_the_picture_are_cut_off():
    points = np.array([[-500, -500, 1], [1000, -500, 1], [-500, 1000, 1]], float)
    assert (rasterize(points, np.array([[0, 1, 2]]), 20, 30).face == 0).all()
    assert (rasterize(points + [0, 2000, 0], np.array([[0, 1, 2]]), 20, 30).face == -1).all()


# Camera and light


@pytest.mark.parametrize(("view", "seen_right"), [("front", [1, 0, 0]), ("side", [0, 0, -1]), ("back", [-1, 0, 0])])
def test_views_show_the_side_they_name(view, seen_right):
    camera = Camera(np.zeros(3), VIEWS[view], elevation=0.0)
    np.testing.assert_allclose(camera.axes[0], seen_right, atol=1e-12)
    np.testing.assert_allclose(np.cross(camera.axes[0], camera.axes[1]), camera.axes[2], atol=1e-12)


def test_rays_pass_through_what_was_projected():
    camera = Camera(np.array([0.1, 0.2, 0.3]), 35.0)
    points = np.random.default_rng(0).normal(size=(20, 3))
    rays = camera.rays(camera.project(points)[:, :2])
    away = points - camera.position
    cosine = np.sum(rays * away, axis=1) / np.linalg.norm(rays, axis=1) / np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(cosine, 1, atol=1e-12)


@pytest.mark.parametrize("closed", [False, True])
def test_the_sky_is_hidden_inside_a_closed_ball_and_open_outside(closed):
    vertices, faces = ball(0.5)
    points = np.array([[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    casters = Casters.of(vertices, faces, np.full(len(faces), closed))
    light = sky_light(casters, points, np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]))
    assert light[0] == 0
    assert light[1] == pytest.approx(1.12, rel=0.05)  # integral of cos (0.62 + 0.75 cos) over the hemisphere, over pi


def test_light_meets_the_front_of_closed_surfaces_first():
    vertices, faces = ball()
    both, front = (Casters.of(vertices, faces, np.full(len(faces), closed)) for closed in (False, True))
    for direction in np.eye(3):
        assert len(both.towards(direction)) == len(faces)
        assert len(front.towards(direction)) < 0.6 * len(faces)
        whole, half = (DepthMap.of(casters, direction, 64).depth for casters in (both, front))
        np.testing.assert_array_equal(whole, half)


def test_only_closed_bodies_lose_their_backs():
    vertices, faces = ball()
    colors = np.array([0.5, 0.5, 0.5])
    for mesh, closed in (
        ((vertices, faces), True),
        ((vertices, faces[:, ::-1]), False),
        ((vertices, faces[1:]), False),
    ):
        assert (build_scene(mesh, None, colors, colors).face_is_closed == closed).all()


# Pictures


def test_picture_shows_skin_cloth_and_the_dark_inside_of_cloth():
    picture = draw(ball(), tube(), views=("front",), height=120, garment_colors=(0.1, 0.2, 0.9))
    assert picture.min() >= 0
    assert picture.max() <= 1
    middle = picture[60, picture.shape[1] // 2]
    top = picture[18, picture.shape[1] // 2]
    assert middle[2] > middle[0] + 0.2, "cloth is blue"
    assert top[0] > top[2], "skin is warm"


def test_the_inside_of_cloth_is_darker_than_its_outside():
    body = ball(0.05, (0.0, -0.4, 0.0))
    vertices, faces = tube()
    outside = draw(body, (vertices, faces), views=("front",), height=120, crop="garment")
    inside = draw(body, (vertices, faces[:, ::-1]), views=("front",), height=120, crop="garment")
    assert inside[60, 60].sum() < 0.8 * outside[60, 60].sum()


def test_hems_are_stitched_beside_open_borders_and_not_on_maps():
    rod = trimesh.creation.cylinder(0.3, 0.4, sections=48).subdivide().subdivide()
    sleeve = rod.submesh([np.abs(rod.face_normals[:, 2]) < 0.5], append=True)
    points, faces = np.asarray(sleeve.vertices)[:, [0, 2, 1]], np.asarray(sleeve.faces)[:, ::-1]
    plain, mapped = (
        draw(ball(0.2), (points, faces), views=("front",), height=800, garment_colors=colors, crop="garment")
        for colors in ((0.5, 0.5, 0.5), np.full((len(points), 3), 0.5))
    )
    middle = plain.shape[1] // 2
    ratio = (plain / mapped)[:, middle - 20 : middle + 20].mean(axis=(1, 2))
    hem = np.flatnonzero(ratio < 0.995)
    pixel = (0.4 + 2 * 0.09) / 800
    # Above the lower and below the upper border lies one hem each, 16 mm wide, darkest at its stitches.
    assert 2 * 0.014 < len(hem) * pixel < 2 * 0.022
    assert ratio[hem].min() < 0.97
    assert (ratio[hem[0] - 20 : hem[0] - 5] == 1).all()


def test_left_and_right_views_differ_for_an_asymmetric_body():
    vertices, faces = ball()
    vertices = vertices * [1, 1, 0.4] + np.array([0.2, 0, 0]) * (vertices[:, 1:2] > 0)
    picture = draw((vertices, faces), views=("side",), height=60)
    assert picture.shape[1] < 60, "a view is as wide as what it shows"


def test_pictures_are_the_same_every_time():
    np.testing.assert_array_equal(draw(ball(), height=40), draw(ball(), height=40))


def test_render_picture_writes_views_side_by_side_with_a_scale(tmp_path):
    scale = ColorScale("height, m", -0.4, 0.4)
    mesh = ball()
    colors = scale.colors(mesh[0][:, 1])
    for suffix in ("png", "jpg", "webp"):
        path = tmp_path / f"picture.{suffix}"
        render_picture(path, mesh, height=150, body_colors=colors, scale=scale, views=("front", "back"))
        with Image.open(path) as image:
            assert image.height == 150
            # The scale has a band of its own below the views.
            assert 200 < image.width < 300


def test_contact_sheet_is_a_grid(tmp_path):
    items = [SheetItem(ball(r), title=f"radius {r}") for r in (0.2, 0.3, 0.4)]
    contact_sheet(tmp_path / "sheet.png", items, columns=2, height=60)
    with Image.open(tmp_path / "sheet.png") as image:
        assert image.height == 2 * 90
        cell = image.width // 2
        pixels = np.asarray(image.convert("RGB")).astype(float)
    widths = []
    for row, column in ((0, 0), (0, 1), (1, 0)):
        tile = pixels[row * 90 : row * 90 + 60, column * cell : (column + 1) * cell]
        # Skin is redder than the studio.
        widths.append(((tile[..., 0] - tile[..., 2]) > 10).any(axis=0).sum())
    assert widths[0] < widths[1] < widths[2], "all cells have one scale"


def test_color_scale_is_linear_between_its_ends_and_constant_beyond():
    scale = ColorScale("ease, cm", 0, 10, "diverging")
    colors = scale.colors(np.array([-5.0, 0.0, 5.0, 10.0, 50.0]))
    np.testing.assert_array_equal(colors[0], colors[1])
    np.testing.assert_array_equal(colors[3], colors[4])
    np.testing.assert_allclose(colors[2], [0.95, 0.95, 0.94])


@pytest.mark.parametrize(
    ("path", "options", "message"),
    [
        ("a.bmp", {}, r"suffix must be one of \.png"),
        ("a.png", {"views": ("frnt",)}, r"unknown view 'frnt' \(did you mean 'front'\?\)"),
        ("a.png", {"views": ()}, "at least one view"),
        ("a.png", {"crop": "head"}, "unknown crop 'head'"),
        ("a.png", {"height": 3}, "picture height = 3 pixels is outside its range"),
        ("a.png", {"garment": (np.full((3, 3), np.nan), np.array([[0, 1, 2]]))}, "garment vertices must be finite"),
        ("a.png", {"garment": (np.zeros((3, 3)), np.array([[0, 1, 7]]))}, "garment faces must be indices in 0 to 2"),
    ],
)
def test_bad_requests_are_named_and_leave_nothing(tmp_path, path, options, message):
    with pytest.raises(ValueError, match=message):
        render_picture(tmp_path / path, ball(), **options)
    assert list(tmp_path.iterdir()) == []
