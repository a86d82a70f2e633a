"""What can be downloaded from the page: meshes, pattern, picture, and the command line that makes the same."""

import shlex
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tryon_jax.checks import check_choice
from tryon_jax.export import CLOTH, SKIN, mesh_part, write_mesh
from tryon_jax.garment import DesignSpace
from tryon_jax.garment.svg import pattern_svg
from tryon_jax.render import ColorScale, render_picture
from tryon_jax.viewer.wardrobe import Look, Wish

MAPS = {
    "ease": ColorScale("distance from the body, cm", 0, 8),
    "tension": ColorScale("stretch of the cloth, %", -10, 10, "diverging"),
    "penetration": ColorScale("depth inside the body, mm", 0, 10),
}
"""Quantities that can colour the cloth."""


def map_colors(look: Look, name: str) -> np.ndarray:
    """sRGB colour of each vertex of the drape."""
    values = {
        "ease": 100 * look.fit.clearance,
        "tension": 100 * look.fit.tension,
        "penetration": 1000 * np.maximum(-look.fit.clearance, 0),
    }
    return MAPS[check_choice("map", name, MAPS)].colors(values[name])


def mesh_file(look: Look, suffix: str) -> bytes:
    """Body and drape as the bytes of a GLB, OBJ, PLY or NPZ file."""
    drape = look.layers["drape"]
    parts = [
        mesh_part("body", look.body.vertices, look.body.faces, material=SKIN),
        mesh_part("garment", drape.vertices, drape.faces, material=CLOTH, uv=look.mesh.uv, faces_uv=look.mesh.faces_uv),
    ]
    return through_file(suffix, lambda path: write_mesh(path, parts))


def picture_file(look: Look) -> bytes:
    """A PNG of the drape from three sides."""
    drape = look.layers["drape"]
    mesh = (drape.vertices, drape.faces)
    return through_file(".png", lambda path: render_picture(path, (look.body.vertices, look.body.faces), mesh))


def pattern_file(look: Look, space: DesignSpace) -> bytes:
    """The pattern as an SVG that prints at true size."""
    return pattern_svg(space, look.mesh.design).encode()


def command_line(wish: Wish, space: DesignSpace) -> str:
    """The command that makes the same garment on the same body."""
    words = ["tryon", "drape", "--set"]
    words += [f"{name}={value:.4f}" for name, value in zip(space.names, wish.design, strict=True)]
    words += ["--betas", *(f"{beta:.3f}" for beta in wish.betas), "--fabric", wish.fabric]
    if wish.seed:
        words += ["--seed", str(wish.seed)]
    return " ".join(shlex.quote(word) for word in [*words, "--out", "garment.glb", "--picture", "garment.png"])


def through_file(suffix: str, write: Callable[[Path], None]) -> bytes:
    """The bytes of the file that `write` writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"garment{suffix}"
        write(path)
        return path.read_bytes()
