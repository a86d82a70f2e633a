"""Drape a garment on a body: a mesh, a picture, and a report of the fit.

tryon drape --design dress --betas 1.5 -0.5 --out dress.glb --picture dress.png
tryon drape --design tshirt --stature 1.72 --chest 0.96 --sleeve-length 0.2 --picture fit.png --map ease
tryon drape --batch orders.csv --out results --format obj
"""

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tryon_jax.body import load_smpl
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._request import BodyShape, Cut, Request, read_requests
from tryon_jax.commands._studio import Draped, Studio
from tryon_jax.contact.push_out import CLEARANCE
from tryon_jax.files.atomic import write_text
from tryon_jax.files.export import CLOTH, SKIN, WRITERS, check_suffix, mesh_part, write_mesh
from tryon_jax.render import ColorScale, render_picture
from tryon_jax.render.image import check_picture_path
from tryon_jax.tryon import TryOnModel, load_model
from tryon_jax.wear.fit import Fit
from tryon_jax.wear.other_body import meet
from tryon_jax.wear.posing import read_pose


@dataclass(frozen=True)
class Config:
    """Options of `tryon drape`."""

    cut: Cut = field(default_factory=Cut)
    shape: BodyShape = field(default_factory=BodyShape)
    garment: Path | None = None
    """Mesh of your own garment in place of a design: .obj, .glb, .gltf or .ply, worn by the mean body in T-pose."""
    pose: Path | None = None
    """NPZ file with `pose`: an axis-angle vector for each joint, radians. Mesh and picture are posed by skinning."""
    smpl: Path | None = None
    """File of SMPL, SMPL-H or SMPL-X (.npz or .pkl) to dress in place of the networks' body: an approximation."""
    fabric: str | None = None
    """Fabric, such as gray-interlock; the model's first when not given."""
    push_out: bool = True
    """Push cloth that lies inside the body out of it, by the least displacement, checked by exact distances."""
    out: Path | None = None
    """Mesh file to write: .glb, .obj, .ply or .npz. With a batch the directory of the results."""
    picture: Path | None = None
    """Picture to write: .png, .jpg or .webp. With a batch give `--pictures` instead."""
    views: tuple[str, ...] = ("front", "side", "back")
    """Views of the picture: front, three-quarter, side, back, or degrees."""
    height: int = 900
    """Height of the picture, pixels."""
    map: Literal["ease", "tension", "penetration"] | None = None
    """Colour the cloth by its distance from the body, its stretch, or how far it lies inside the body."""
    report: Path | None = None
    """JSON file for the report of the fit."""
    batch: Path | None = None
    """CSV file with one garment per row; its columns are the options of design, body shape and fabric, and `name`."""
    format: Literal["glb", "obj", "ply", "npz"] = "glb"
    """Mesh format of a batch."""
    pictures: bool = False
    """Write a picture of each garment of a batch."""
    seed: int = 0
    """Another seed gives another mesh of the same garment."""
    triangle_area: float | None = None
    """Mean area of the cloth's triangles, square centimetres; what the networks were trained on when not given."""
    weights: Path | None = None
    """File of learned parameters in place of those that come with the package."""


def _load(weights: Path | None) -> TryOnModel:
    if weights is not None:
        return load_model(weights)
    from tryon_jax.tryon import load_pretrained

    return load_pretrained()


_SCALES = {
    "ease": ColorScale("distance from the body, cm", 0, 8),
    "tension": ColorScale("stretch of the cloth, %", -10, 10, "diverging"),
    "penetration": ColorScale("depth inside the body, mm", 0, 10),
}


def main(config: Config) -> None:
    """Drape what is asked for, write the files, and print the fit and where the time went."""
    clock = Clock()
    requests, targets = _plan(config)
    with clock.stage("weights"):
        model = _load(config.weights)
    with clock.stage("body"):
        known = model.body, model.config.num_betas
        other_body = None if config.smpl is None else meet(load_smpl(config.smpl), *known)
    studio = Studio(
        model,
        clock,
        clearance=CLEARANCE if config.push_out else None,
        other_body=other_body,
        triangle_area=config.triangle_area,
        seed=config.seed,
    )
    pose = None if config.pose is None else read_pose(config.pose, len(model.body.parents))
    rows = []
    for request, target in zip(requests, targets, strict=True):
        draped = studio.drape(request)
        if pose is not None:
            draped = studio.pose(draped, pose)
        if config.batch is not None:
            print(f"-- {request.name}")
        for line in draped.lines:
            print(line)
        for path in target.write(draped, config, clock):
            print(f"wrote    {path}")
        rows.append(draped.record(request))
    if config.batch is not None and config.out is not None:
        _write_table(config.out / "fit.csv", rows)
        print(f"wrote    {config.out / 'fit.csv'}")
    print(clock)


@dataclass(frozen=True)
class Target:
    """The files of one garment."""

    mesh: Path | None = None
    picture: Path | None = None
    report: Path | None = None

    def write(self, draped: Draped, config: Config, clock: Clock) -> list[Path]:
        """Write them and return their paths."""
        colors = None if config.map is None else _SCALES[config.map].colors(_map_values(config.map, draped.fit))
        if self.mesh is not None:
            with clock.stage("mesh file"):
                mesh = draped.prepared
                body = mesh_part("body", *draped.body, material=SKIN)
                garment = mesh_part(
                    "garment",
                    draped.vertices,
                    mesh.faces,
                    material=CLOTH,
                    uv=mesh.uv,
                    faces_uv=mesh.faces_uv,
                    colors=colors,
                )
                write_mesh(self.mesh, [body, garment])
        if self.picture is not None:
            with clock.stage("picture"):
                options = {} if colors is None else {"garment_colors": colors, "scale": _SCALES[str(config.map)]}
                render_picture(
                    self.picture,
                    draped.body,
                    (draped.vertices, draped.prepared.faces),
                    views=[float(v) if v.lstrip("-").isdigit() else v for v in config.views],
                    height=config.height,
                    **options,
                )
        if self.report is not None:
            write_text(self.report, json.dumps(draped.record(Request()), indent=2) + "\n")
        return [path for path in (self.mesh, self.picture, self.report) if path is not None]


def _map_values(name: str, fit: Fit) -> np.ndarray:
    values = {
        "ease": 100 * fit.clearance,
        "tension": 100 * fit.tension,
        "penetration": 1000 * np.maximum(-fit.clearance, 0),
    }
    return values[name]


def _plan(config: Config) -> tuple[list[Request], list[Target]]:
    """What to drape and where to write it; everything that can be refused is refused before anything is computed."""
    if config.batch is None:
        if config.out is not None:
            check_suffix(config.out)
        if config.picture is not None:
            check_picture_path(config.picture)
        if config.smpl is not None and config.pose is not None:
            raise ValueError("--pose is for the networks' body; leave it out with --smpl")
        if config.garment is not None and config.cut != Cut():
            raise ValueError("give either a design or --garment, not both")
        request = Request("garment", config.cut, config.shape, config.fabric, config.garment)
        return [request], [Target(config.out, config.picture, config.report)]
    for name in ("picture", "report"):
        if getattr(config, name) is not None:
            raise ValueError(f"--{name} is for one garment; with --batch use --out DIRECTORY and --pictures")
    if config.cut != Cut() or config.shape != BodyShape() or config.garment is not None:
        raise ValueError("with --batch, garment and body shape are columns of the CSV file and no options")
    if config.out is None:
        raise ValueError("--batch needs --out DIRECTORY for its results")
    if config.out.suffix.lower() in WRITERS or config.out.is_file():
        raise ValueError(f"with --batch, --out must be a directory, got {str(config.out)!r}")
    requests = [replace(r, fabric=r.fabric or config.fabric) for r in read_requests(config.batch)]
    targets = [
        Target(
            config.out / f"{r.name}.{config.format}", config.out / f"{r.name}.png" if config.pictures else None, None
        )
        for r in requests
    ]
    return requests, targets


def _write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    flat = [_flatten(row) for row in rows]
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(flat[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    write_text(path, text.getvalue())


def _flatten(row: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}_{inner}": number for inner, number in value.items()}
        elif isinstance(value, list):
            flat[key] = " ".join(f"{number:g}" for number in value)
        else:
            flat[key] = value
    return flat
