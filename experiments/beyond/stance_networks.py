"""R_stance: learned drapes of lowered arms on designs that no training has seen, beside simpler ways."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from tqdm import tqdm

from experiments.shared.figures import dressed_cell
from experiments.shared.neighbours import DESIGN_SCALE, NEIGHBOURS
from experiments.shared.record import RESULTS, publish
from tryon_jax.body import pose_body
from tryon_jax.body.stance import arms_pose
from tryon_jax.contact.push_out import push_out
from tryon_jax.contact.signed_distance import ClosedSurface
from tryon_jax.contact.skin import Skin
from tryon_jax.garment.manifest import Manifest, load_manifest
from tryon_jax.garment.pattern_map import map_patterns
from tryon_jax.graph.skinning import garment_skinning
from tryon_jax.mesh.intersections import self_intersecting_faces
from tryon_jax.physics.fabric_numbers import fabric_numbers
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.render import SheetItem, contact_sheet
from tryon_jax.training.dataset import default_root
from tryon_jax.training.descents import Descent, descent_files, load_descents
from tryon_jax.training.drapes import load_mesh
from tryon_jax.training.garments import prepare_simulated
from tryon_jax.training.plan import split_name
from tryon_jax.training.stance_network import HELD_OUT, carry_back
from tryon_jax.tryon import Garment, TryOnModel, drape, load_model, load_pretrained
from tryon_jax.tryon.model_file import STANCE, pretrained_path
from tryon_jax.tryon.stance import StanceFields, stance_fields, stand
from tryon_jax.tryon.stance_file import add_stance

STANCES = (15.0, HELD_OUT, 30.0, 45.0)
"""Degrees that errors are told for."""
WAYS = ("skinned", "kNN", "R_stance", "networks")
COUNTED = ("skinned", "networks", "simulated")
"""Whose vertices inside the body and triangles through each other are counted."""
_pose, _stand, _fields = jax.jit(pose_body), jax.jit(stand), jax.jit(stance_fields)
_drape_known, _drape_any = jax.jit(drape, static_argnames="fabric"), jax.jit(drape)


@dataclass(frozen=True)
class Config:
    """What to compare."""

    data: Path = field(default_factory=default_root)
    """Folder of a dataset with descents of training and of unseen designs."""
    fabric_data: Path | None = None
    """Folder of a dataset of more fabrics, some of which R_stance was not trained on."""
    model: Path | None = None
    """Model to measure; the weights that come with the package when left out."""
    stance: Path | None = None
    """Its R_stance; the one that comes with the package when left out."""
    out: Path = RESULTS
    """Folder for the record and the picture."""
    picture: tuple[str, str] = ("unseen-tshirt-0", "unseen-dress-0")
    """Garments of the picture."""


@dataclass(frozen=True, eq=False)
class Case:
    """One garment in one fabric on one body."""

    name: str
    garment: Garment
    fabric: str
    descent: Descent
    skinning: Float[np.ndarray, "V J"]


def main(config: Config) -> None:
    """Measure every descent of unseen designs, and draw some."""
    model = load_model(config.model) if config.model else load_pretrained()
    path = config.stance
    model = add_stance(model, path or pretrained_path("small" + STANCE))
    manifest = load_manifest()
    cases = load_cases(model, config.data, manifest)
    if config.fabric_data is not None:
        cases += load_cases(model, config.fabric_data, manifest)
    neighbours = StanceNeighbours(model, config.data, manifest)
    rows = [row for case in tqdm(cases, desc="descents", mininterval=2) for row in measure(model, case, neighbours)]
    assert model.stance is not None
    results = {
        "rows": rows,
        "trained": list(model.stance.config.shared_fabrics),
        "cases": len(cases),
        "spread": spread(config.data, cases),
    }
    publish(config, "stance_networks", results, markdown, weights=path or pretrained_path("small" + STANCE))
    draw(config, model, cases)


def load_cases(model: TryOnModel, root: Path, manifest: Manifest) -> list[Case]:
    """The descents of garments whose designs no training sees.

    Args:
        model: Its body and its graphs.
        root: Folder of the dataset.
        manifest: Splits of designs and topologies.
    """
    found = []
    pairs = sorted({tuple(path.stem.split("_")[:2]) for path in descent_files(root)})
    for name, fabric in pairs:
        if manifest.split(*split_name(name)) == "training":
            continue
        garment = prepare_simulated(model, root, name)
        skinning = garment_skinning(garment.mean_vertices, garment.faces, model.body)
        found += [Case(name, garment, fabric, d, skinning) for d in load_descents(root, name, fabric)]
    return found


def spread(root: Path, cases: Sequence[Case]) -> dict[str, dict[str, float]]:
    """How far simulations of two topologies of a design are apart on the mean body, mm, by fabric and stance.

    Args:
        root: Folder of the dataset.
        cases: Descents of garments that no training sees, some of which are other topologies of trained designs.
    """
    found: dict[str, dict[str, list[float]]] = {}
    for case in cases:
        label, _ = split_name(case.name)
        others = [d for d in load_descents(root, f"{label}-0", case.fabric) if not d.betas.any()]
        if case.name == f"{label}-0" or case.descent.betas.any() or not others:
            continue
        carry = map_patterns(load_mesh(root, case.name), load_mesh(root, f"{label}-0"))
        mine = dict(zip(map(float, case.descent.degrees), case.descent.vertices, strict=True))
        theirs = dict(zip(map(float, others[0].degrees), others[0].vertices, strict=True))
        for degrees in set(STANCES) & set(mine) & set(theirs):
            apart = np.linalg.norm(mine[degrees] - carry(theirs[degrees][None])[0], axis=1).mean()
            found.setdefault(case.fabric, {}).setdefault(f"{degrees:g}", []).append(1e3 * float(apart))
    return {fabric: {k: float(np.mean(v)) for k, v in table.items()} for fabric, table in found.items()}


class StanceNeighbours:
    """The change of the nearest training garments, by position on the mean body and by design; no learning."""

    def __init__(self, model: TryOnModel, root: Path, manifest: Manifest) -> None:
        """Read the descents of the training garments of a dataset.

        Args:
            model: Its body and its graphs.
            root: Folder of the dataset.
            manifest: Splits of designs and topologies.
        """
        self._center, self._half = manifest.space.mean, 0.5 * (manifest.space.maximum - manifest.space.minimum)
        self._extent = np.array(model.config.beta_ranges)
        self._known: dict[str, list[tuple[np.ndarray, list[tuple[np.ndarray, dict[float, np.ndarray]]]]]] = {}
        for name, fabric in sorted({tuple(path.stem.split("_")[:2]) for path in descent_files(root)}):
            if manifest.split(*split_name(name)) != "training":
                continue
            garment = prepare_simulated(model, root, name)
            skinning = garment_skinning(garment.mean_vertices, garment.faces, model.body)
            bodies = []
            for descent in load_descents(root, name, fabric):
                table = {
                    float(degrees): carry_back(model.body, descent.betas, float(degrees), vertices, skinning)
                    - descent.start
                    for degrees, vertices, at_rest in zip(
                        descent.degrees, descent.vertices, descent.at_rest, strict=True
                    )
                    if at_rest and float(degrees) in STANCES
                }
                bodies.append((descent.betas, table))
            self._known.setdefault(fabric, []).append((self._key(garment), bodies))

    def __call__(self, case: Case, degrees: float) -> Float[np.ndarray, "V 3"] | None:
        """The change of the drape, metres, in T-pose; None where nothing is known of the fabric."""
        keys, changes = [], []
        for key, bodies in self._known.get(case.fabric, []):
            there = [(betas, table[degrees]) for betas, table in bodies if degrees in table]
            if there:
                # Of each garment its body that is most like.
                apart = [np.linalg.norm((betas - case.descent.betas) / self._extent) for betas, _ in there]
                keys.append(key)
                changes.append(there[int(np.argmin(apart))][1])
        if not keys:
            return None
        distance, index = cKDTree(np.concatenate(keys)).query(self._key(case.garment), k=NEIGHBOURS)
        weights = 1.0 / (distance**2 + 4e-6)
        weights /= weights.sum(axis=1, keepdims=True)
        return np.einsum("vk,vkc->vc", weights, np.concatenate(changes)[index])

    def _key(self, garment: Garment) -> Float[np.ndarray, "V D"]:
        mean = garment.mean_vertices
        design = DESIGN_SCALE * (np.asarray(garment.design) - self._center) / self._half
        return np.concatenate([mean, np.broadcast_to(design, (len(mean), len(design)))], axis=1)


def measure(model: TryOnModel, case: Case, neighbours: StanceNeighbours) -> list[dict[str, Any]]:
    """Errors in each of `STANCES`, and what is inside the body or through itself.

    Args:
        model: With R_stance.
        case: A descent.
        neighbours: Of the training garments.
    """
    known, rows = dict(zip(map(float, case.descent.degrees), range(len(case.descent.degrees)), strict=True)), []
    drapes = Drapes(model, case)
    learned_error = float(1e3 * np.linalg.norm(drapes.learned - case.descent.start, axis=1).mean())
    for degrees in STANCES:
        if degrees not in known or not case.descent.at_rest[known[degrees]]:
            continue
        simulated = case.descent.vertices[known[degrees]]
        found = {
            "skinned": drapes.skinned(degrees),
            "R_stance": drapes.standing(degrees),
            "networks": drapes.networks(degrees),
            "simulated": simulated,
        }
        if (change := neighbours(case, degrees)) is not None:
            found["kNN"] = drapes.skinned(degrees, change)
        errors = {
            way: 1e3 * float(np.linalg.norm(found[way] - simulated, axis=1).mean()) for way in WAYS if way in found
        }
        surface = drapes.surface(degrees)
        skin = Skin(model.body, surface)
        inside = {way: skin.penetration(found[way], case.garment.faces).surface for way in COUNTED}
        crossed = {way: float(self_intersecting_faces(found[way], case.garment.faces).mean()) for way in COUNTED}
        row = {"garment": case.name, "fabric": case.fabric, "degrees": degrees, "t_pose": learned_error}
        rows.append(row | {"errors": errors, "inside": inside, "crossed": crossed})
    return rows


class Drapes:
    """What there is of one descent in each way, metres."""

    def __init__(self, model: TryOnModel, case: Case) -> None:
        """Drape the garment in T-pose.

        Args:
            model: With R_stance.
            case: The descent.
        """
        self.model, self.case = model, case
        self.numbers = np.asarray(fabric_numbers(load_fabric(case.fabric)))
        self.fields: StanceFields = _fields(model, case.garment, self.numbers)
        self.betas = case.descent.betas.astype(np.float32)
        if case.fabric in model.config.fabrics:
            learned = _drape_known(model, case.garment, self.betas, fabric=case.fabric)
        else:
            learned = _drape_any(model, case.garment, self.betas, self.numbers)
        self.learned = case.garment.unpad(learned)

    def skinned(self, degrees: float, change: np.ndarray | None = None) -> Float[np.ndarray, "V 3"]:
        """The simulated drape in T-pose with a change, skinned."""
        still = replace(self.fields, fields=np.zeros_like(self.fields.fields))
        return self._stand(still, self.case.descent.start + (0.0 if change is None else change), degrees)

    def standing(self, degrees: float) -> Float[np.ndarray, "V 3"]:
        """The simulated drape in T-pose with the learned change, skinned."""
        return self._stand(self.fields, self.case.descent.start, degrees)

    def networks(self, degrees: float) -> Float[np.ndarray, "V 3"]:
        """The learned drape with the learned change, skinned."""
        return self._stand(self.fields, self.learned, degrees)

    def skin(self, degrees: float) -> Float[np.ndarray, "B 3"]:
        """The body."""
        return np.asarray(_pose(self.model.body, self.betas, arms_pose(self.model.body, degrees).astype(np.float32))[0])

    def surface(self, degrees: float) -> ClosedSurface:
        """Of the body."""
        return ClosedSurface(self.skin(degrees), np.asarray(self.model.body.faces))

    def _stand(self, fields: StanceFields, vertices: np.ndarray, degrees: float) -> Float[np.ndarray, "V 3"]:
        rows = self.fields.fields.shape[0]
        padded, skinning = (
            np.pad(np.asarray(a, np.float32), ((0, rows - len(a)), (0, 0))) for a in (vertices, self.case.skinning)
        )
        found = _stand(fields, self.model.body, self.betas, np.float32(degrees), padded, skinning)
        return np.asarray(found)[: len(vertices)]


def draw(config: Config, model: TryOnModel, cases: Sequence[Case]) -> None:
    """Some garments in each fabric, all the way down: by the networks and pushed out above, simulated below.

    Args:
        config: Which garments, and where to.
        model: With R_stance.
        cases: All descents.
    """
    above: list[SheetItem] = []
    below: list[SheetItem] = []
    for name in config.picture:
        of_garment = [case for case in cases if case.name == name and case.descent.betas.any()]
        for case in {case.fabric: case for case in reversed(of_garment)}.values():
            if 45.0 not in case.descent.degrees:
                continue
            drapes, faces = Drapes(model, case), case.garment.faces
            skin = drapes.skin(45.0)
            pushed = push_out(drapes.networks(45.0).astype(np.float32), faces, drapes.surface(45.0)).vertices
            last = case.descent.vertices[list(case.descent.degrees).index(45.0)]
            above.append(dressed_cell(model.body, skin, (pushed, faces), f"{case.fabric}: networks"))
            below.append(dressed_cell(model.body, skin, (last, faces), "simulated"))
    contact_sheet(config.out / "stance_networks.jpg", [*above, *below], columns=len(above), crop="garment", height=300)
    print(f"wrote {config.out / 'stance_networks.jpg'}")


def markdown(results: Mapping[str, Any]) -> list[str]:
    """One row for each stance and kind of fabric."""
    trained = set(results["trained"])
    lines = [
        f"{results['cases']} descents that no training saw, mean distance from the simulation, mm. "
        "*Skinned*: the simulated T-pose drape, moved with the nearest skin. *kNN*: the change of the nearest training "
        "garments, by place and design. *R_stance*: the learned change on the simulated T-pose drape. *Networks*: the "
        "learned change on the learned drape, whose own error in T-pose is in brackets. "
        f"No training saw the stance of {HELD_OUT:g}°. Inside: share of the cloth inside the body before any push-out; "
        "crossed: share of triangles that pass through others.",
        "",
        "| garments and fabrics | arms below the horizontal | skinned | kNN | R_stance | networks (in T-pose) | "
        "inside: skinned · networks · simulated, % | crossed: the same, % |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for title, belongs in _groups(trained).items():
        for degrees in STANCES:
            rows = [r for r in results["rows"] if r["degrees"] == degrees and belongs(r)]
            if not rows:
                continue
            means = {way: np.mean([r["errors"][way] for r in rows if way in r["errors"]] or [np.nan]) for way in WAYS}
            cells = [f"{means[way]:.2f}" if np.isfinite(means[way]) else "–" for way in WAYS]
            cells[-1] += f" ({np.mean([r['t_pose'] for r in rows]):.2f})"
            shares = [
                " · ".join(f"{100 * np.mean([r[kind][way] for r in rows]):.2f}" for way in COUNTED)
                for kind in ("inside", "crossed")
            ]
            lines.append(f"| {title} | {degrees:g}° | {' | '.join([*cells, *shares])} |")
    for fabric, table in results["spread"].items():
        apart = ", ".join(f"{value:.2f} at {degrees}°" for degrees, value in sorted(table.items(), key=_angle))
        lines += ["", f"Simulations of two topologies of one design in {fabric} are apart by, mm: {apart}."]
    return lines


def _angle(item: tuple[str, float]) -> float:
    return float(item[0])


def _groups(trained: set[str]) -> dict[str, Callable[[Mapping[str, Any]], bool]]:
    """Which rows belong to which group."""
    unseen = {design.label for design in load_manifest().unseen}

    def new_design(row: Mapping[str, Any]) -> bool:
        return split_name(row["garment"])[0] in unseen

    return {
        "unseen designs on test bodies": lambda row: new_design(row) and row["fabric"] in trained,
        "the same in fabrics not trained on": lambda row: new_design(row) and row["fabric"] not in trained,
        "unseen topologies of a trained design on the mean body": lambda row: not new_design(row),
    }
