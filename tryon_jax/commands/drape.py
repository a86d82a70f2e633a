"""Drape a garment on a body: a mesh, a picture, and a report of the fit.

tryon drape --design dress --betas 1.5 -0.5 --out dress.glb --picture dress.png
tryon drape --design tshirt --stature 1.72 --chest 0.96 --sleeve-length 0.2 --picture fit.png --map ease
tryon drape --design dress --out dress.glb --morph-targets
tryon drape --batch orders.csv --out results --format obj
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from tryon_jax.body import load_smpl
from tryon_jax.body.stance import LOWEST
from tryon_jax.checks import check_file, check_range
from tryon_jax.commands._answer import Treatment, answer, pictured
from tryon_jax.commands._batch import Batch
from tryon_jax.commands._clock import Clock
from tryon_jax.commands._output import OutputOptions, Target
from tryon_jax.commands._quick import compiled_quickly
from tryon_jax.commands._report import report_lines
from tryon_jax.commands._request import BodyShape, Cut, Request, read_requests
from tryon_jax.commands._say import say
from tryon_jax.commands._table import TABLE
from tryon_jax.files.atomic import check_target
from tryon_jax.files.export import WRITERS
from tryon_jax.tryon import TryOnModel, load_model
from tryon_jax.wear.morph_targets import fit_morph_targets
from tryon_jax.wear.own import OwnOptions
from tryon_jax.wear.posing import read_pose
from tryon_jax.wear.session import Session


@dataclass(frozen=True)
class Config:
    """Options of `tryon drape`."""

    cut: Cut = field(default_factory=Cut)
    shape: BodyShape = field(default_factory=BodyShape)
    garment: Path | None = None
    """Mesh of your own garment in place of a design: .obj, .glb, .gltf or .ply; its place on the body is found."""
    own: OwnOptions = field(default_factory=OwnOptions)
    pose: Path | None = None
    """NPZ file with `pose`: an axis-angle vector for each joint, radians. Mesh and picture are posed by skinning."""
    arms: float | None = None
    """Degrees below the horizontal that the arms are lowered, 0 to 45; with --refine or --simulate the simulator hangs
    the cloth there. By default mesh and fit are of the T-pose, and the picture of a learned drape shows 45 degrees."""
    smpl: Path | None = None
    """File of SMPL, SMPL-H or SMPL-X (.npz or .pkl) to dress in place of the networks' body: an approximation."""
    fabric: str | None = None
    """Fabric by name, see `tryon list`, or a fabric file (.toml); the model's first when not given."""
    refine: tuple[int, ...] | None = None
    """Bring the learned drape to rest by simulation, or only as many steps as given."""
    simulate: bool = False
    """Drape by simulation alone, without the networks."""
    gate: bool = True
    """Refuse a drape that is torn or lies in the body; with --no-gate it is written, and what is wrong is said."""
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
    map: str | None = None
    """Colour the cloth by distance from the body (ease), its stretch (tension) or its depth inside (penetration)."""
    parts: Literal["both", "garment", "body"] = "both"
    """What the mesh file holds."""
    morph_targets: bool = False
    """Give the GLB file sliders that change the body's shape and the garment with it, in any viewer or game engine."""
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


def main(config: Config) -> None:
    """Drape what is asked for, write the files, and print the fit and where the time went."""
    clock = Clock()
    output = OutputOptions(config.views, config.height, config.map, config.parts)
    requests, targets = _plan(config, output)
    with clock.stage("weights"):
        model = _load(config.weights)
    with clock.stage("body"):
        body = None if config.smpl is None else load_smpl(config.smpl)
        session = Session(model, body=body, triangle_area=_area(config))
    pose = None if config.pose is None else read_pose(config.pose, len(model.body.parents))
    treatment = Treatment(
        push_out=config.push_out,
        refine=config.refine is not None,
        steps=sum(config.refine or ()) or None,
        simulate=config.simulate,
        gate=config.gate,
        arms=config.arms,
        own=config.own,
        seed=config.seed,
    )
    if config.batch is not None:
        folder = Path(str(config.out))
        _drape_batch(session, Batch(folder, requests, targets, treatment, output, pose, _options(config)), clock)
        return
    (request,), (target,) = requests, targets
    # A single drape is evaluated once; the solver of a simulation runs long, and sliders drape many bodies.
    once = not (treatment.simulates or config.garment is not None or config.morph_targets)
    with compiled_quickly(once):
        dressed, remarks = answer(session, request, treatment, clock, pose)
        shown = None if target.picture is None else pictured(session, dressed, treatment, clock, pose)
    morphs = None
    if config.morph_targets:
        with clock.stage("morph targets"):
            progress = clock.counter("morph targets")
            morphs = fit_morph_targets(
                session, dressed.garment, dressed.fabric, outside=config.push_out, progress=progress
            )
    written = target.write(dressed, request.name, output, clock, morphs, shown)
    lines = [] if morphs is None else morphs.lines()
    say(*report_lines(dressed, remarks), *lines, *(f"wrote    {path}" for path in written), clock)


def _drape_batch(session: Session, batch: Batch, clock: Clock) -> None:
    """All rows; raises where one failed, after the others are done."""
    batch.check(session)
    failed = batch.run(session, clock)
    say(f"wrote    {batch.folder / TABLE}", clock)
    if failed:
        raise ValueError(f"{len(failed)} of {len(batch.requests)} rows failed: {', '.join(failed)}; see {TABLE}")


def _area(config: Config) -> float | None:
    """Mean area of the cloth's triangles, square metres."""
    if config.triangle_area is None:
        return None
    return 1e-4 * check_range("triangle area", config.triangle_area, 0.1, 30.0, "cm^2")


def _options(config: Config) -> str:
    """What the results of a batch depend on besides its rows; not where they are written."""
    return repr(replace(config, out=None, batch=None))


def _plan(config: Config, output: OutputOptions) -> tuple[list[Request], list[Target]]:
    """What to drape and where to write it; everything that can be refused is refused before anything is computed."""
    output.check()
    config.own.placing.check()
    if config.refine is not None and len(config.refine) > 1:
        raise ValueError(f"--refine takes one number of steps or none, got {' '.join(map(str, config.refine))}")
    if config.refine:
        check_range("--refine", config.refine[0], 1, 10_000, "steps")
    if config.refine is not None and config.simulate:
        raise ValueError("give either --refine or --simulate: one starts from the learned drape, the other without")
    _area(config)
    if config.arms is not None:
        check_range("--arms", config.arms, 0.0, LOWEST, "degrees below the horizontal")
    if config.arms and config.pose is not None:
        raise ValueError("give either --arms or --pose: a pose has its own")
    for name, given in (("pose", config.pose is not None), ("arms", bool(config.arms))):
        if config.smpl is not None and given:
            raise ValueError(f"--{name} is for the networks' body; leave it out with --smpl")
    if config.morph_targets:
        _check_morph_targets(config)
    planned = _plan_one(config) if config.batch is None else _plan_batch(config, config.batch)
    for name in ("garment", "pose", "smpl", "weights", "batch"):
        if getattr(config, name) is not None:
            check_file(f"--{name}", getattr(config, name))
    return planned


def _check_morph_targets(config: Config) -> None:
    """Raise `ValueError` for what cannot have sliders."""
    if config.batch is not None or config.out is None or config.out.suffix.lower() != ".glb":
        raise ValueError("--morph-targets needs --out with a .glb file, of one garment")
    if config.parts != "both":
        raise ValueError(f"--morph-targets writes body and garment together; leave out --parts {config.parts}")
    for name, given in (
        ("pose", config.pose is not None),
        ("arms", bool(config.arms)),
        ("smpl", config.smpl is not None),
        ("refine", config.refine is not None),
        ("simulate", config.simulate),
    ):
        if given:
            raise ValueError(f"--morph-targets are of the learned drape on the networks' own body; leave out --{name}")


def _plan_one(config: Config) -> tuple[list[Request], list[Target]]:
    if config.garment is None and config.own != OwnOptions():
        raise ValueError("unit, up, turn, offset, pose, piece and settle describe a mesh of your own: give --garment")
    if config.garment is not None:
        if config.cut != Cut():
            raise ValueError("give either a design or --garment, not both")
        for name, given in (("triangle-area", config.triangle_area is not None), ("seed", config.seed != 0)):
            if given:
                raise ValueError(f"--{name} makes the mesh of a design; --garment brings its own: leave it out")
    target = Target(config.out, config.picture, config.report)
    target.check()
    return [Request("garment", config.cut, config.shape, config.fabric, config.garment)], [target]


def _plan_batch(config: Config, batch: Path) -> tuple[list[Request], list[Target]]:
    for name in ("picture", "report"):
        if getattr(config, name) is not None:
            raise ValueError(f"--{name} is for one garment; with --batch use --out DIRECTORY and --pictures")
    if config.cut != Cut() or config.shape != BodyShape() or config.garment is not None:
        raise ValueError("with --batch, garment and body shape are columns of the CSV file and no options")
    if config.out is None:
        raise ValueError("--batch needs --out DIRECTORY for its results")
    if config.out.suffix.lower() in WRITERS or config.out.is_file():
        raise ValueError(f"with --batch, --out must be a directory, got {str(config.out)!r}")
    check_target(config.out / TABLE)
    requests = [replace(r, fabric=r.fabric or config.fabric) for r in read_requests(batch)]
    targets = []
    for request in requests:
        picture = config.out / f"{request.name}.png" if config.pictures else None
        targets.append(Target(config.out / f"{request.name}.{config.format}", picture))
        targets[-1].check()
    return requests, targets
