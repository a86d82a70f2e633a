"""Which of several sizes fits a body, and how each would sit.

tryon size --sizes sizes.csv --stature 1.68 --chest 0.92 --ease-chest 0.08
tryon size --sizes sizes.csv --betas 1 -0.5 --picture sizes.png
"""

from dataclasses import dataclass, field
from pathlib import Path

from tryon_jax.checks import check_file
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._request import SIZE_COLUMNS, BodyShape, Request, read_requests, resolve_betas, resolve_design
from tryon_jax.commands._say import say
from tryon_jax.commands.tailor import Asked
from tryon_jax.files.atomic import check_target
from tryon_jax.render import SheetItem, contact_sheet
from tryon_jax.render.image import check_picture_path
from tryon_jax.render.mannequin import mannequin_colors
from tryon_jax.render.picture import check_height
from tryon_jax.tryon import load_model, load_pretrained
from tryon_jax.wear.gate import judge_betas
from tryon_jax.wear.session import Session
from tryon_jax.wear.sizes import best_size, try_size


@dataclass(frozen=True)
class Config:
    """Options of `tryon size`."""

    sizes: Path
    """CSV file with one size per row: `name`, and the design's options as columns (design, garment_chest, ...)."""
    shape: BodyShape = field(default_factory=BodyShape)
    asked: Asked = field(default_factory=lambda: Asked(ease_chest=0.08))
    """What a size is chosen by; 8 cm of ease at the chest when not given."""
    fabric: str | None = None
    """Fabric, such as gray-interlock; the model's first when not given."""
    picture: Path | None = None
    """Picture of every size on the body: .png, .jpg or .webp."""
    height: int = 420
    """Height of one body in the picture, pixels."""
    weights: Path | None = None
    """File of learned parameters in place of those that come with the package."""


def main(config: Config) -> None:
    """Drape every size, say how each sits, and which one it should be and why."""
    clock, target = Clock(), config.asked.target()
    requests = read_requests(config.sizes, SIZE_COLUMNS)
    if config.picture is not None:
        check_picture_path(config.picture)
        check_height(config.height)
        check_target(config.picture)
    with clock.stage("weights"):
        model = load_pretrained() if config.weights is None else load_model(check_file("--weights", config.weights))
    session = Session(model, one_size=True)
    fabric = session.check_fabric(config.fabric)
    designs = _designs(session, requests, config.sizes.name)
    with clock.stage("body"):
        betas, remarks = resolve_betas(session.body, config.shape, session.num_betas)
        judge_betas(betas, model.config.beta_ranges).check("this body")
    sizes = [
        try_size(session, name, design, betas, target, fabric=fabric, stopwatch=clock)
        for name, design in designs.items()
    ]
    best = best_size(sizes)
    lines = [*remarks, *(f"size     {size.words()}" for size in sizes)]
    if best is None:
        lines.append("answer   none of them can be worn: each is too tight or torn on this body")
    else:
        lines.append(f"answer   {best.name}: {best.reason(sizes)}")
    if config.picture is not None:
        with clock.stage("picture"):
            body, skin = session.shape(betas), mannequin_colors(session.body)
            items = [
                SheetItem(
                    (body.vertices, body.faces),
                    (size.dressed.vertices, size.dressed.faces),
                    size.caption(),
                    body_colors=skin,
                )
                for size in sizes
            ]
            contact_sheet(config.picture, items, columns=len(items), height=config.height)
        lines.append(f"wrote    {config.picture}")
    say(*lines, clock)


def _designs(session: Session, requests: list[Request], name: str) -> dict:
    designs, bad = {}, []
    for request in requests:
        try:
            designs[request.name] = resolve_design(session.space, request.cut)
        except ValueError as error:
            bad.append(f"size {request.name!r} of {name}: {error}")
    if bad:
        raise ValueError("; ".join(bad))
    return designs
