"""The files of one draped garment: mesh, picture and report, all of them or none."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tryon_jax.checks import check_choice
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._request import Request
from tryon_jax.commands._studio import Draped
from tryon_jax.files.atomic import check_target, together, write_text
from tryon_jax.files.export import CLOTH, SKIN, check_suffix, mesh_part, write_mesh
from tryon_jax.render import ColorScale, render_picture
from tryon_jax.render.camera import view_angle
from tryon_jax.render.image import check_picture_path
from tryon_jax.render.picture import check_height
from tryon_jax.wear.fit import Fit

SCALES = {
    "ease": ColorScale("distance from the body, cm", 0, 8),
    "tension": ColorScale("stretch of the cloth, %", -10, 10, "diverging"),
    "penetration": ColorScale("depth inside the body, mm", 0, 10),
}
"""Maps of the fit, by name."""
PARTS = ("both", "garment", "body")
"""What a mesh file may hold."""


@dataclass(frozen=True)
class Look:
    """How results are drawn and what a mesh file holds."""

    views: tuple[str, ...] = ("front", "side", "back")
    height: int = 900
    map: str | None = None
    parts: str = "both"

    def check(self) -> None:
        """Raise `ValueError` for what cannot be drawn or written."""
        if not self.views:
            raise ValueError("views must name at least one view")
        for view in self.views:
            view_angle(view)
        check_height(self.height)
        check_choice("parts", self.parts, PARTS)
        if self.map is not None:
            check_choice("map", self.map, SCALES)


@dataclass(frozen=True)
class Target:
    """The files of one garment."""

    mesh: Path | None = None
    picture: Path | None = None
    report: Path | None = None

    @property
    def paths(self) -> list[Path]:
        """Those that are wanted."""
        return [path for path in (self.mesh, self.picture, self.report) if path is not None]

    def check(self) -> None:
        """Raise where a file cannot be written, before any work is done."""
        if self.mesh is not None:
            check_suffix(self.mesh)
        if self.picture is not None:
            check_picture_path(self.picture)
        real = [check_target(path) for path in self.paths]
        if len(set(real)) != len(real):
            raise ValueError(f"each output needs a path of its own, got {', '.join(map(str, self.paths))}")

    def write(self, draped: Draped, request: Request, look: Look, clock: Clock) -> Sequence[Path]:
        """Write all of them, then put all in their places; returns their paths."""
        colors = None if look.map is None else SCALES[look.map].colors(_map_values(look.map, draped.fit))
        with together():
            if self.mesh is not None:
                with clock.stage("mesh file"):
                    self._write_mesh(self.mesh, draped, look, colors)
            if self.picture is not None:
                with clock.stage("picture"):
                    options = {} if colors is None else {"garment_colors": colors, "scale": SCALES[str(look.map)]}
                    garment = draped.vertices, draped.prepared.faces
                    render_picture(self.picture, draped.body, garment, views=look.views, height=look.height, **options)
            if self.report is not None:
                write_text(self.report, json.dumps(draped.record(request), indent=2) + "\n")
        return self.paths

    @staticmethod
    def _write_mesh(path: Path, draped: Draped, look: Look, colors: np.ndarray | None) -> None:
        mesh, parts = draped.prepared, []
        if look.parts != "garment":
            parts.append(mesh_part("body", *draped.body, material=SKIN))
        if look.parts != "body":
            texture = {"uv": mesh.uv, "faces_uv": mesh.faces_uv}
            parts.append(mesh_part("garment", draped.vertices, mesh.faces, material=CLOTH, colors=colors, **texture))
        write_mesh(path, parts)


def _map_values(name: str, fit: Fit) -> np.ndarray:
    values = {
        "ease": 100 * fit.clearance,
        "tension": 100 * fit.tension,
        "penetration": 1000 * np.maximum(-fit.clearance, 0),
    }
    return values[name]
