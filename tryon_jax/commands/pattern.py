"""Draw the sewing pattern of a design: for paper (SVG, true size), as flat meshes (OBJ), as a picture.

tryon pattern --design dress --out dress.svg --picture dress.png
tryon pattern --design tshirt --sleeve-length 0.2 --out tshirt.obj
tryon pattern
"""

from dataclasses import dataclass, field
from pathlib import Path

from tryon_jax.checks import check_choice
from tryon_jax.commands._request import Cut, resolve_design
from tryon_jax.commands._say import say
from tryon_jax.files.atomic import check_target, together
from tryon_jax.garment import TARGET_AREA, GarmentMesh, load_design_space, remesh
from tryon_jax.garment.curves import length
from tryon_jax.garment.design import Design, DesignSpace
from tryon_jax.garment.panels import picture_pattern, write_panels_obj
from tryon_jax.garment.svg import HEM_ALLOWANCE, SEAM_ALLOWANCE, write_svg


@dataclass(frozen=True)
class Config:
    """Options of `tryon pattern`."""

    cut: Cut = field(default_factory=Cut)
    out: Path | None = None
    """File to write: .svg (true size, with seam allowance) or .obj (flat panels)."""
    picture: Path | None = None
    """Picture of the panels and their triangles: .png, .jpg, .pdf or .svg."""
    layout: str = "kimono"
    """Name of a layout, or the path of a layout file (.toml)."""
    parameters: tuple[str, ...] = ()
    """Design parameters that may be set; those that the layout marks as active when not given."""
    seam_allowance: float = SEAM_ALLOWANCE
    """Fabric outside sewn edges, metres."""
    hem_allowance: float = HEM_ALLOWANCE
    """Fabric outside hem and cuffs, metres; necklines and armholes get the seam's."""
    target_area: float = TARGET_AREA
    """Mean triangle area of the mesh, square metres."""
    seed: int = 0
    """Another seed gives another triangulation."""


def main(config: Config) -> None:
    """Write what is asked for and print the pattern's measures."""
    if config.out is not None:
        check_choice("format of --out", config.out.suffix.lower(), (".svg", ".obj"))
        check_target(config.out)
    if config.picture is not None:
        check_choice("format of --picture", config.picture.suffix.lower(), (".png", ".jpg", ".pdf", ".svg"))
        check_target(config.picture)
    space = load_design_space(config.layout, config.parameters or None)
    design = resolve_design(space, config.cut)
    garment = remesh(space, design, target_area=config.target_area, seed=config.seed)
    with together():
        if config.out is not None and config.out.suffix.lower() == ".svg":
            write_svg(config.out, space, design, config.seam_allowance, config.hem_allowance)
        elif config.out is not None:
            write_panels_obj(config.out, garment)
        if config.picture is not None:
            picture_pattern(config.picture, space, garment)
    written = [path for path in (config.out, config.picture) if path is not None]
    say(*describe(space, design, garment), *(f"wrote    {path}" for path in written))


def describe(space: DesignSpace, design: Design, garment: GarmentMesh) -> list[str]:
    """What one says about a pattern: its parameters with their ranges, its edges, its fabric, its mesh.

    Args:
        space: The design's space.
        design: The design.
        garment: Its mesh.
    """
    lines = [f"design   {design.label or 'your own'}; presets: {', '.join(space.presets)}"]
    for k, name in enumerate(space.names):
        lines.append(
            f"         {name} {design[name]:.3f} m ({space.minimum[k]:.2f} to {space.maximum[k]:.2f}), "
            f"{space.layout.parameter(name).meaning}"
        )
    drawn = space.draw(design)
    shown = [edge for edge in space.layout.edges.values() if edge.mirror_of is None]
    lines.append("edges    " + ", ".join(f"{e.name} {100 * length(drawn[e.name]):.1f} cm" for e in shown))
    quality = garment.quality
    lines.append(f"fabric   {quality.total_area:.3f} m² without allowances")
    size = f"{garment.num_vertices} vertices, {quality.num_faces} triangles of {1e4 * quality.mean_area:.3f} cm²"
    lines.append(
        f"mesh     {size}; smallest angle {quality.min_angle:.1f}°; distortion {quality.mean_distortion:.3f} mean, "
        f"{quality.max_distortion:.2f} worst"
    )
    return lines
