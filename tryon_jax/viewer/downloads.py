"""What can be downloaded from the page: meshes, pattern, picture, and the command line that makes the same."""

import shlex
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tryon_jax.checks import check_choice
from tryon_jax.garment import DesignSpace
from tryon_jax.garment.svg import pattern_svg
from tryon_jax.render import render_picture
from tryon_jax.render.fit_maps import MAPS, map_colors
from tryon_jax.render.mannequin import mannequin_colors
from tryon_jax.viewer.page_model import Settings
from tryon_jax.wear.dressed import DressedBody


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


def mesh_file(dressed: DressedBody, suffix: str) -> bytes:
    """Body and garment as the bytes of a GLB, OBJ, PLY or NPZ file."""
    data = through_file(suffix, dressed.write)
    if suffix == ".obj":
        # One file is downloaded: it must not ask for another one with the materials.
        lines = data.splitlines(keepends=True)
        data = b"".join(line for line in lines if not line.startswith((b"mtllib", b"usemtl")))
    return data


def picture_file(dressed: DressedBody, colors: str | None = None) -> bytes:
    """A PNG of the garment from three sides, coloured by the map of that name."""
    options: dict[str, Any] = {"body_colors": mannequin_colors(dressed.body.body)}
    if colors is not None and dressed.fit is not None:
        options |= {"garment_colors": map_colors(dressed.fit, colors), "scale": MAPS[colors]}
    body, garment = (dressed.body.vertices, dressed.body.faces), (dressed.vertices, dressed.faces)
    return through_file(".png", lambda path: render_picture(path, body, garment, **options))


def pattern_file(dressed: DressedBody, space: DesignSpace) -> bytes:
    """The pattern as an SVG that prints at true size; raises `ValueError` for a garment that was not cut from one."""
    if dressed.garment.design is None:
        raise ValueError("a mesh of your own has no pattern that could be printed")
    return pattern_svg(space, dressed.garment.design).encode()


def command_line(settings: Settings, space: DesignSpace, source: tuple[str, ...] = ()) -> str:
    """The command that makes the same garment on the same body; `source` are options for model and body.

    Args:
        settings: What the page shows.
        space: The design's space.
        source: Options for model and body.
    """
    words = ["tryon", "drape"]
    if settings.own is None:
        words += ["--set", *(f"{name}={value:.4f}" for name, value in zip(space.names, settings.design, strict=True))]
    else:
        words += ["--garment", settings.own.name]
    words += ["--betas", *(f"{beta:.3f}" for beta in settings.betas), "--fabric", settings.fabric]
    if settings.seed and settings.own is None:
        words += ["--seed", str(settings.seed)]
    words += ["--arms", f"{settings.arms:g}"]
    if not settings.push_out:
        words += ["--no-push-out"]
    words += [*source, "--out", "garment.glb", "--picture", "garment.png"]
    return " ".join(shlex.quote(word) for word in words)


def through_file(suffix: str, write: Callable[[Path], None]) -> bytes:
    """The bytes of the file that `write` writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"garment{suffix}"
        write(path)
        return path.read_bytes()
