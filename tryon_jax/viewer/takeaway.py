"""What can be downloaded from the page: meshes, pattern, picture, and the command line that makes the same."""

import shlex
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tryon_jax.checks import check_choice
from tryon_jax.files.export import CLOTH, SKIN, mesh_part, write_mesh
from tryon_jax.garment import DesignSpace
from tryon_jax.garment.svg import pattern_svg
from tryon_jax.render import ColorScale, render_picture
from tryon_jax.viewer.wardrobe import Look, Wish
from tryon_jax.wear.fit import Fit

MAPS = {
    "ease": ColorScale("distance from the body, cm", 0, 8),
    "tension": ColorScale("stretch of the cloth, %", -10, 10, "diverging"),
    "penetration": ColorScale("depth inside the body, mm", 0, 10),
}
"""Quantities that can colour the cloth."""


def map_colors(fit: Fit, name: str) -> np.ndarray:
    """sRGB colour of each vertex of the drape that was measured."""
    values = {
        "ease": 100 * fit.clearance,
        "tension": 100 * fit.tension,
        "penetration": 1000 * np.maximum(-fit.clearance, 0),
    }
    return MAPS[check_choice("map", name, MAPS)].colors(values[name])


def legend(name: str) -> str:
    """The colour bar of a map as HTML."""
    scale = MAPS[check_choice("map", name, MAPS)]
    ticks = np.linspace(scale.low, scale.high, 9)
    stops = ", ".join("rgb({}, {}, {})".format(*np.round(255 * color).astype(int)) for color in scale.colors(ticks))
    numbers = "".join(f"<span>{value:g}</span>" for value in (scale.low, (scale.low + scale.high) / 2, scale.high))
    return (
        '<div style="margin: 0 1em 0.5em; font-size: 0.8em">'
        f"{scale.label}"
        f'<div style="height: 0.8em; border-radius: 2px; background: linear-gradient(to right, {stops})"></div>'
        f'<div style="display: flex; justify-content: space-between">{numbers}</div></div>'
    )


def mesh_file(look: Look, suffix: str) -> bytes:
    """Body and drape as the bytes of a GLB, OBJ, PLY or NPZ file."""
    drape, cloth = look.layers["drape"], look.cloth
    parts = [
        mesh_part("body", look.body.vertices, look.body.faces, material=SKIN),
        mesh_part("garment", drape.vertices, drape.faces, material=CLOTH, uv=cloth.uv, faces_uv=cloth.faces_uv),
    ]
    data = through_file(suffix, lambda path: write_mesh(path, parts))
    if suffix == ".obj":
        # One file is downloaded: it must not ask for another one with the materials.
        lines = data.splitlines(keepends=True)
        data = b"".join(line for line in lines if not line.startswith((b"mtllib", b"usemtl")))
    return data


def picture_file(look: Look, colors: str | None = None) -> bytes:
    """A PNG of the drape from three sides, coloured by the map of that name."""
    drape = look.layers["drape"]
    mesh = (drape.vertices, drape.faces)
    options = {} if colors is None or look.fit is None else _painted(look.fit, colors)
    body = (look.body.vertices, look.body.faces)
    return through_file(".png", lambda path: render_picture(path, body, mesh, **options))


def _painted(fit: Fit, name: str) -> dict:
    return {"garment_colors": map_colors(fit, name), "scale": MAPS[name]}


def pattern_file(look: Look, space: DesignSpace) -> bytes:
    """The pattern as an SVG that prints at true size; raises `ValueError` for a garment that was not cut from one."""
    if look.cloth.design is None:
        raise ValueError("a mesh of your own has no pattern that could be printed")
    return pattern_svg(space, look.cloth.design).encode()


def command_line(wish: Wish, space: DesignSpace, source: tuple[str, ...] = ()) -> str:
    """The command that makes the same garment on the same body; `source` are options for model and body."""
    words = ["tryon", "drape"]
    if wish.own is None:
        words += ["--set", *(f"{name}={value:.4f}" for name, value in zip(space.names, wish.design, strict=True))]
    else:
        words += ["--garment", wish.own.name]
    words += ["--betas", *(f"{beta:.3f}" for beta in wish.betas), "--fabric", wish.fabric]
    if wish.seed and wish.own is None:
        words += ["--seed", str(wish.seed)]
    if not wish.push_out:
        words += ["--no-push-out"]
    words += [*source, "--out", "garment.glb", "--picture", "garment.png"]
    return " ".join(shlex.quote(word) for word in words)


def through_file(suffix: str, write: Callable[[Path], None]) -> bytes:
    """The bytes of the file that `write` writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"garment{suffix}"
        write(path)
        return path.read_bytes()
