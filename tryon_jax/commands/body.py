"""Shape a body from betas or from measurements: a mesh, a picture, and its measurements.

tryon body --betas 1 -0.5 --out body.glb --picture body.png
tryon body --stature 1.72 --chest 0.96
tryon body --body male --stature 1.85 --waist 0.84 --report body.json
"""

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tryon_jax.body import check_betas, load_body, load_smpl, shape_body
from tryon_jax.body.landmarks import load_landmarks
from tryon_jax.body.measurements import MEASUREMENTS, measure_vertices
from tryon_jax.commands._output import OutputOptions, Target
from tryon_jax.commands._request import BodyShape, resolve_betas
from tryon_jax.commands._say import say
from tryon_jax.files.atomic import together, write_text
from tryon_jax.files.export import SKIN, mesh_part, write_mesh
from tryon_jax.render import render_picture
from tryon_jax.render.mannequin import mannequin_colors
from tryon_jax.types import Body


@dataclass(frozen=True)
class Config:
    """Options of `tryon body`."""

    shape: BodyShape = field(default_factory=BodyShape)
    body: str = "female"
    """Embedded body: female, male or neutral."""
    smpl: Path | None = None
    """File of SMPL, SMPL-H or SMPL-X (.npz or .pkl) to take in place of an embedded body."""
    out: Path | None = None
    """Mesh file to write: .glb, .obj, .ply or .npz."""
    picture: Path | None = None
    """Picture to write: .png, .jpg or .webp."""
    views: tuple[str, ...] = ("front", "side", "back")
    """Views of the picture: front, three-quarter, side, back, or degrees."""
    height: int = 900
    """Height of the picture, pixels."""
    report: Path | None = None
    """JSON file for betas and measurements."""


def main(config: Config) -> None:
    """Shape the body, write the files, and print its measurements."""
    target = Target(config.out, config.picture, config.report)
    target.check()
    OutputOptions(config.views, config.height).check()
    body = load_body(config.body) if config.smpl is None else load_smpl(config.smpl)
    check_betas(body, np.asarray(config.shape.betas, float))
    betas, remarks = resolve_betas(body, config.shape, body.num_betas)
    vertices = np.asarray(shape_body(body, betas)[0])
    measured = {key: float(value) for key, value in measure_vertices(vertices, load_landmarks(body)).items()}
    faces = np.asarray(body.faces)
    with together():
        if config.out is not None:
            write_mesh(config.out, [mesh_part("body", vertices, faces, material=SKIN)])
        if config.picture is not None:
            render_picture(
                config.picture,
                (vertices, faces),
                views=config.views,
                height=config.height,
                body_colors=mannequin_colors(body),
            )
        if config.report is not None:
            record = {"body": body.name, "betas": [float(beta) for beta in betas], "measurements": measured}
            write_text(config.report, json.dumps(record, indent=2) + "\n")
    lines = describe(body, betas, remarks, measured, config.shape.measurements())
    say(*lines, *(f"wrote    {path}" for path in target.paths))


def describe(
    body: Body, betas: np.ndarray, remarks: list[str], measured: dict[str, float], asked: dict[str, float]
) -> list[str]:
    """The body in words: its size, its betas, each measurement and how far it is from the one asked for.

    Args:
        body: The body.
        betas: Its shape, standard deviations.
        remarks: How the betas were found, one line each.
        measured: Its measurements by name, metres.
        asked: Those that were asked for, metres.
    """
    lines = [f"body     {body.name}; {len(body.v_template)} vertices, {len(body.faces)} faces"]
    lines += remarks or ["betas    " + " ".join(f"{beta:+.2f}" for beta in betas)]
    for name in MEASUREMENTS:
        miss = (
            f"  (asked {asked[name]:.3f} m, off {1e3 * (measured[name] - asked[name]):+.1f} mm)"
            if name in asked
            else ""
        )
        lines.append(f"         {name:<14} {measured[name]:.3f} m{miss}")
    return lines
