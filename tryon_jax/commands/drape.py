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
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import jax
import numpy as np

from tryon_jax.atomic import write_text
from tryon_jax.body import shape_body
from tryon_jax.body.landmarks import load_landmarks
from tryon_jax.checks import check_choice, check_range
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._request import BodyShape, Cut, Request, read_requests, resolve_betas, resolve_design
from tryon_jax.export import CLOTH, SKIN, WRITERS, check_suffix, mesh_part, write_mesh
from tryon_jax.fit import Fit, measure_fit
from tryon_jax.garment import GarmentMesh, remesh
from tryon_jax.render import ColorScale, render_picture
from tryon_jax.render.image import check_picture_path
from tryon_jax.tryon import Garment, TryOnModel, config_space, drape, load_model, prepare_mesh


@dataclass(frozen=True)
class Config:
    """Options of `tryon drape`."""

    cut: Cut = field(default_factory=Cut)
    shape: BodyShape = field(default_factory=BodyShape)
    fabric: str | None = None
    """Fabric, such as gray-interlock; the model's first when not given."""
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
    studio = Studio(model, config, clock)
    rows = []
    for request, target in zip(requests, targets, strict=True):
        draped = studio.drape(request)
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
class Draped:
    """A garment on a body, with what is said about it."""

    body: tuple[np.ndarray, np.ndarray]
    vertices: np.ndarray
    mesh: GarmentMesh
    betas: np.ndarray
    fit: Fit
    fabric: str
    lines: list[str]

    def record(self, request: Request) -> dict[str, Any]:
        """Everything of the report, for JSON and CSV."""
        return {
            "name": request.name,
            "design": self.mesh.design.as_dict(),
            "betas": [float(b) for b in self.betas],
            "fabric": self.fabric,
            "vertices": len(self.vertices),
            **self.fit.as_dict(),
        }


class Studio:
    """A model with the garments that it has prepared; one compiled drape serves all of one size."""

    def __init__(self, model: TryOnModel, config: Config, clock: Clock) -> None:
        self.model = model
        self.config = config
        self.clock = clock
        self.space = config_space(model.config)
        self._prepared: dict[tuple[float, ...], tuple[GarmentMesh, Garment]] = {}
        self._drape = jax.jit(drape, static_argnames="fabric")

    @cached_property
    def landmarks(self):
        """Where tapes are laid on the model's body."""
        return load_landmarks(self.model.body)

    def drape(self, request: Request) -> Draped:
        """Carry out one request; raises `ValueError` where it makes no sense."""
        model = self.model
        fabric = check_choice("fabric", request.fabric or model.config.fabrics[0], model.config.fabrics)
        with self.clock.stage("body"):
            betas, remarks = resolve_betas(model.body, request.shape, model.config.num_betas)
            body_vertices, _ = shape_body(model.body, betas)
        mesh, garment = self._prepare(request.cut)
        with self.clock.stage("drape"):
            padded = self._drape(model, garment, betas, fabric=fabric)
            vertices = garment.unpad(padded)
        with self.clock.stage("fit"):
            faces = np.asarray(model.body.faces)
            fit = measure_fit(body_vertices, faces, self.landmarks, vertices, mesh.faces, mesh.uv, mesh.faces_uv)
        lines = [
            f"design   {mesh.design}",
            f"fabric   {fabric}; {len(vertices)} vertices, {len(mesh.faces)} faces",
            *remarks,
            *fit.lines(),
        ]
        return Draped((np.asarray(body_vertices), faces), vertices, mesh, betas, fit, fabric, lines)

    def _prepare(self, cut: Cut) -> tuple[GarmentMesh, Garment]:
        design = resolve_design(self.space, cut)
        key = tuple(float(v) for v in design.values)
        if key not in self._prepared:
            area = self.model.config.target_area
            if self.config.triangle_area is not None:
                area = 1e-4 * check_range("triangle area", self.config.triangle_area, 0.1, 30.0, "cm^2")
            with self.clock.stage("pattern and mesh"):
                mesh = remesh(self.space, design, area, seed=self.config.seed)
            with self.clock.stage("graph"):
                self._prepared[key] = mesh, prepare_mesh(self.model, mesh)
        mesh, garment = self._prepared[key]
        return replace(mesh, design=design), garment


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
                mesh = draped.mesh
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
                    (draped.vertices, draped.mesh.faces),
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
        request = Request("garment", config.cut, config.shape, config.fabric)
        return [request], [Target(config.out, config.picture, config.report)]
    for name in ("picture", "report"):
        if getattr(config, name) is not None:
            raise ValueError(f"--{name} is for one garment; with --batch use --out DIRECTORY and --pictures")
    if config.cut != Cut() or config.shape != BodyShape():
        raise ValueError("with --batch, design and body shape are columns of the CSV file and no options")
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
