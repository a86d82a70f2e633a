"""Garments × bodies, as independent blocks that any number of processes may work on.

    FOLDER/catalogue.json              what was asked for: the bodies and options of a folder are of one catalogue
    FOLDER/<garment>/<block>.npz       the drapes of a block of bodies, or FOLDER/<garment>/<body>.glb
    FOLDER/<garment>/<block>.csv       their fits; written last, so that a block with a table is done

A block of a garment is done again where the garment's row has changed, a drape of it failed, or a file is gone.
"""

import csv
import functools
import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tryon_jax.commands._answer import Treatment, check
from tryon_jax.commands._report import record
from tryon_jax.commands._request import Cut, Request, resolve_betas, resolve_design
from tryon_jax.commands._table import FAILED, TABLE, cell, columns, csv_text, flatten
from tryon_jax.contact.push_out import CLEARANCE
from tryon_jax.files.atomic import atomic_path, write_text
from tryon_jax.tryon import load_model, load_pretrained
from tryon_jax.wear.dressed import PARTS, DressedBody
from tryon_jax.wear.prepared import PreparedGarment
from tryon_jax.wear.session import Session

MOST_KEPT = 128
"""Bodies that a process keeps with their surfaces, 7 MB each, at most."""
NOT_JUDGED = "not judged"
"""Outcome of a drape whose fit was not asked for."""


@dataclass(frozen=True)
class Options:
    """What is done to every drape of a catalogue, and how it is written."""

    fabric: str
    """Of the garments whose row names none."""
    weights: str = ""
    """File of learned parameters; "" for those that come with the package."""
    triangle_area: float | None = None
    """Mean area of the cloth's triangles, square metres; what the networks were trained on when None."""
    seed: int = 0
    push_out: bool = True
    fit: bool = True
    """Measure and judge every drape."""
    gate: bool = True
    """Leave out drapes that are torn or lie in the body."""
    format: str = "npz"
    body_mesh: bool = False
    """Whether a GLB file has the body too."""
    block: int = 64
    """Bodies of a block."""


@dataclass(frozen=True, eq=False)
class Catalogue:
    """What is asked for, checked."""

    garments: Sequence[Request]
    bodies: Sequence[str]
    """Names."""
    betas: Float[np.ndarray, "B b"]
    options: Options

    @property
    def blocks(self) -> int:
        """Blocks of each garment."""
        return -(-len(self.bodies) // self.options.block)

    def order(self, garment: int) -> str:
        """A fingerprint of a garment's row."""
        return hashlib.sha256(repr(self.garments[garment]).encode()).hexdigest()[:12]

    def table(self, root: Path, garment: int, block: int) -> Path:
        """File of the fits of one block."""
        return root / self.garments[garment].name / f"{block:05d}.csv"

    def is_done(self, root: Path, garment: int, block: int) -> bool:
        """Whether all files of a block are there, and of this garment."""
        table = self.table(root, garment, block)
        if not table.is_file():
            return False
        with table.open(newline="", encoding="utf-8") as stream:
            rows = csv.DictReader(stream)
            first = next(rows, None)
            if first is None or first.get("order") != self.order(garment):
                return False
            if self.options.format == "npz":
                return table.with_suffix(".npz").is_file()
            written = [row["body"] for row in (first, *rows) if row["outcome"] != "refused"]
        return all((table.parent / f"{name}.glb").is_file() for name in written)

    def as_text(self) -> str:
        """For the catalogue's file."""
        garments = [{"name": g.name, "cut": asdict(g.cut), "fabric": g.fabric, "mesh": g.mesh} for g in self.garments]
        bodies = {name: [float(b) for b in row] for name, row in zip(self.bodies, self.betas, strict=True)}
        whole = {"options": asdict(self.options), "bodies": bodies, "garments": garments}
        return json.dumps(whole, indent=1, default=str) + "\n"


def make_catalogue(
    session: Session, garments: Sequence[Request], bodies: Sequence[Request], options: Options
) -> Catalogue:
    """Look at every garment and every body before any is draped.

    Args:
        session: Of the networks.
        garments: Rows of designs or meshes.
        bodies: Rows of body shapes.
        options: What is done to each.

    Raises:
        ValueError: A row cannot be draped; all such rows of both files are named.
    """
    treatment = Treatment(push_out=options.push_out, gate=options.gate)
    bad, shapes = [], []
    for garment in garments:
        try:
            check(session, replace(garment, fabric=garment.fabric or options.fabric), treatment)
        except (ValueError, OSError) as error:
            bad.append(f"garment {garment.name}: {error}")
    for body in bodies:
        try:
            check(session, body, treatment)
            shapes.append(resolve_betas(session.body, body.shape, session.num_betas)[0])
        except ValueError as error:
            bad.append(f"body {body.name}: {error}")
    if bad:
        raise ValueError(f"{len(bad)} of {len(garments) + len(bodies)} rows cannot be draped: {'; '.join(bad)}")
    return Catalogue(garments, [body.name for body in bodies], np.stack(shapes).astype(np.float32), options)


def open_catalogue(root: Path, catalogue: Catalogue) -> list[tuple[str, int, int]]:
    """Create the folder, or check that it belongs to the same bodies and options, and list the blocks that are missing.

    Returns:
        Arguments of `drape_block` for each. Garments cut from designs come block by block, so that a process makes its
        bodies once for many of them; meshes, which are dear to prepare, come mesh by mesh.

    Raises:
        ValueError: The folder belongs to another catalogue, or has a file of this name that is none.
    """
    path, text = root / "catalogue.json", catalogue.as_text()
    if path.exists():
        found, wanted = (json.loads(t) for t in (path.read_text(encoding="utf-8"), text))
        options = {**wanted["options"], "bodies": wanted["bodies"]}
        before = {**found["options"], "bodies": found["bodies"]}
        different = [
            "other bodies" if key == "bodies" else f"{key} = {before.get(key)!r} (asked for {value!r})"
            for key, value in options.items()
            if before.get(key) != value
        ]
        if different:
            raise ValueError(f"{str(root)!r} holds another catalogue: {', '.join(different)}; choose another folder")
    write_text(path, text)
    meshes = [k for k, garment in enumerate(catalogue.garments) if garment.mesh is not None]
    designs = [k for k, garment in enumerate(catalogue.garments) if garment.mesh is None]
    tasks = [(g, b) for g in meshes for b in range(catalogue.blocks)]
    tasks += [(g, b) for b in range(catalogue.blocks) for g in designs]
    return [(str(root), g, b) for g, b in tasks if not catalogue.is_done(root, g, b)]


def drape_block(root: str, garment: int, block: int) -> str:
    """Drape one garment on one block of bodies unless that is done.

    Args:
        root: Folder of the catalogue.
        garment: Number of the garment.
        block: Number of the block.

    Returns:
        A line for the log, "" if there was nothing to do.
    """
    folder = Path(root)
    catalogue = _read(root, (folder / "catalogue.json").stat().st_mtime_ns)
    if catalogue.is_done(folder, garment, block):
        return ""
    options, request = catalogue.options, catalogue.garments[garment]
    session = open_session(options.weights, options.triangle_area, options.block)
    design = None if request.mesh is not None else resolve_design(session.space, request.cut)
    prepared = session.prepare(design, mesh=request.mesh, seed=options.seed)
    fabric = request.fabric or options.fabric
    first = block * options.block
    names, betas = catalogue.bodies[first:][: options.block], catalogue.betas[first:][: options.block]
    drapes = session.drape_many(prepared, list(betas), fabric=fabric)
    rows, done = [], []
    for name, shape, dressed in zip(names, betas, drapes, strict=True):
        row: dict[str, Any] = {"betas": shape.tolist(), "fabric": fabric}
        try:
            dressed = _finish(session, dressed, options)
            row = {"outcome": NOT_JUDGED} | flatten(record(dressed, request.name))
            if not (options.gate and row["outcome"] == "refused"):
                done.append((name, dressed, row))
        except (ValueError, FloatingPointError) as error:
            row |= {"outcome": FAILED, "error": str(error)}
        rows.append(row | {"name": request.name, "body": name})
    table = catalogue.table(folder, garment, block)
    if options.format == "npz":
        rounding = _write_drapes(table.with_suffix(".npz"), prepared, done)
        rows = [row | {"rounding": rounding.get(row["body"])} for row in rows]
    else:
        for name, dressed, _ in done:
            parts = PARTS if options.body_mesh else ("garment",)
            dressed.write(table.parent / f"{name}.glb", parts=parts, gate=False)
    failed = sum(row["outcome"] == FAILED for row in rows)
    order = "" if failed else catalogue.order(garment)
    header = table_columns(session.space.names)
    write_text(table, csv_text(header, [{k: cell((row | {"order": order}).get(k)) for k in header} for row in rows]))
    return f"{request.name}, block {block}: {len(done)} of {len(rows)} bodies"


def _finish(session: Session, dressed: DressedBody, options: Options) -> DressedBody:
    if options.push_out:
        dressed = session.push_out(dressed, CLEARANCE)
    return session.judge(dressed) if options.fit else dressed


def _write_drapes(
    path: Path, prepared: PreparedGarment, done: Sequence[tuple[str, DressedBody, Any]]
) -> dict[str, float]:
    """Write the drapes of one garment with half of the bytes; the largest error of a vertex of each, metres.

    Half precision has eleven binary digits. Spent on the distance from the bodies' mean drape, which is centimetres,
    they are hundredths of a millimetre; spent on positions of a metre they would be quarters of one.
    """
    count = len(prepared.garment.mean_vertices)
    drapes = np.array([dressed.vertices for _, dressed, _ in done], np.float32).reshape(-1, count, 3)
    mean = drapes.mean(axis=0) if len(drapes) else prepared.garment.mean_vertices.astype(np.float32)
    offsets = (drapes - mean).astype(np.float16)
    errors = np.linalg.norm(mean + offsets.astype(np.float32) - drapes, axis=2).max(axis=1, initial=0.0)
    with atomic_path(path) as temporary:
        np.savez(
            temporary,
            names=np.array([name for name, _, _ in done], str),
            betas=np.array([dressed.body.betas for _, dressed, _ in done], np.float32),
            mean=mean,
            offsets=offsets,
            faces=prepared.faces.astype(np.int32),
            uv=prepared.uv.astype(np.float32),
            faces_uv=prepared.faces_uv.astype(np.int32),
        )
    return {name: float(error) for (name, _, _), error in zip(done, errors, strict=True)}


def table_columns(parameters: Sequence[str]) -> list[str]:
    """Columns of the table: those of a batch, with the body and the rounding of the written drape, metres."""
    name, *others, order = columns(parameters)
    return [name, "body", *others, "rounding", order]


@dataclass(frozen=True)
class Summary:
    """What a catalogue has come to."""

    outcomes: Counter[str]
    rounding: float
    """Largest rounding of a vertex, metres."""


def join_tables(root: Path, catalogue: Catalogue) -> Summary:
    """Write one table of the fits of all blocks that are done, `fit.csv`; line by line, however many there are."""
    outcomes: Counter[str] = Counter()
    rounding, writer = 0.0, None
    with atomic_path(root / TABLE) as temporary, temporary.open("w", newline="", encoding="utf-8") as target:
        for garment in range(len(catalogue.garments)):
            for block in range(catalogue.blocks):
                path = catalogue.table(root, garment, block)
                if not path.is_file():
                    continue
                with path.open(newline="", encoding="utf-8") as source:
                    rows = csv.DictReader(source)
                    if writer is None:
                        writer = csv.DictWriter(target, list(rows.fieldnames or ()), lineterminator="\n")
                        writer.writeheader()
                    for row in rows:
                        outcomes[row["outcome"]] += 1
                        rounding = max(rounding, float(row["rounding"] or 0))
                        writer.writerow(row)
    return Summary(outcomes, rounding)


@functools.lru_cache(maxsize=1)
def open_session(weights: str, triangle_area: float | None, block: int) -> Session:
    """The session of a process, which keeps the bodies of a block; the rest as in `Options`."""
    model = load_model(weights) if weights else load_pretrained()
    return Session(model, triangle_area=triangle_area, bodies_kept=min(block, MOST_KEPT))


@functools.lru_cache(maxsize=1)
def _read(root: str, _changed: int) -> Catalogue:
    """The catalogue of a folder; `_changed` is the time of its file."""
    found = json.loads((Path(root) / "catalogue.json").read_text(encoding="utf-8"))
    garments = [
        Request(
            row["name"],
            Cut(**row["cut"] | {"set": tuple(row["cut"]["set"])}),
            fabric=row["fabric"],
            mesh=None if row["mesh"] is None else Path(row["mesh"]),
        )
        for row in found["garments"]
    ]
    betas = np.array(list(found["bodies"].values()), np.float32)
    return Catalogue(garments, list(found["bodies"]), betas, Options(**found["options"]))
