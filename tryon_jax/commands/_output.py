"""The files of one draped garment: mesh, picture and report, all of them or none."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tryon_jax.checks import check_choice
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._report import record
from tryon_jax.files.atomic import check_target, together, write_text
from tryon_jax.files.export import check_suffix
from tryon_jax.render import render_picture
from tryon_jax.render.camera import view_angle
from tryon_jax.render.fit_maps import MAPS, map_colors
from tryon_jax.render.image import check_picture_path
from tryon_jax.render.mannequin import mannequin_colors
from tryon_jax.render.picture import check_height
from tryon_jax.wear.dressed import PARTS, DressedBody
from tryon_jax.wear.morph_targets import MorphTargets, write_morphs

_PARTS = {"both": PARTS, "garment": ("garment",), "body": ("body",)}


@dataclass(frozen=True)
class OutputOptions:
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
        check_choice("parts", self.parts, _PARTS)
        if self.map is not None:
            check_choice("map", self.map, MAPS)


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

    def write(
        self,
        dressed: DressedBody,
        name: str,
        output: OutputOptions,
        clock: Clock,
        morphs: MorphTargets | None = None,
        shown: DressedBody | None = None,
    ) -> Sequence[Path]:
        """Write all of them, then put all in their places.

        Args:
            dressed: What is written.
            name: Of it.
            output: How it is drawn, and what the mesh holds.
            clock: Takes the time.
            morphs: Targets of body and garment, which the mesh then has; they stand at the dressed body's betas.
            shown: What the picture shows, in another stance; `dressed` when None.

        Returns:
            Their paths.
        """
        colors = None if output.map is None or dressed.fit is None else map_colors(dressed.fit, output.map)
        shown = shown or dressed
        with together():
            if self.mesh is not None:
                with clock.stage("mesh file"):
                    if morphs is not None:
                        write_morphs(self.mesh, morphs, dressed.body.betas)
                    else:
                        dressed.write(self.mesh, colors, parts=_PARTS[output.parts], gate=False)
            if self.picture is not None:
                with clock.stage("picture"):
                    options = {} if colors is None else {"garment_colors": colors, "scale": MAPS[str(output.map)]}
                    render_picture(
                        self.picture,
                        (shown.body.vertices, shown.body.faces),
                        (shown.vertices, shown.faces),
                        views=output.views,
                        height=output.height,
                        body_colors=mannequin_colors(dressed.body.body),
                        **options,
                    )
            if self.report is not None:
                write_text(self.report, json.dumps(record(dressed, name), indent=2) + "\n")
        return self.paths
