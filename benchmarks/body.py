"""Bodies per second: shaping and posing in JAX beside plain NumPy and, where it is installed, PyTorch's smplx.

python -m benchmarks body
python -m benchmarks body --batches 1 64 --repeats 5
"""

import importlib.util
import pickle
import tempfile
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.record import write_record
from measuring.records import table
from measuring.timing import measure
from tryon_jax.body import betas_from_measurements, load_body, load_smpl, pose_body, shape_body
from tryon_jax.types import Body


@dataclass(frozen=True)
class Config:
    """Options of `python -m benchmarks body`."""

    batches: tuple[int, ...] = (1, 64, 1024)
    """Bodies in one call."""
    chunk: int = 64
    """Bodies that are worked on at once within a call: skinning holds a 3 by 3 matrix for each vertex of each body."""
    repeats: int = 10
    """Timed calls of each kind."""
    max_seconds: float = 10.0
    """Longest time for one row of the table."""
    pose_blend_shapes: bool = True
    """Pose blend shapes, which files of SMPL have and the embedded bodies have not: random ones are added."""
    save: bool = True
    """Keep the result under `benchmarks/results/`."""


def write_smpl_file(path: Path, body: Body, pose_blend_shapes: bool) -> None:
    """Write `body` as a pickle with the fields of an SMPL file, for every library to read."""
    joints = len(body.parents)
    bends = 1e-3 * np.random.default_rng(0).normal(size=(*body.v_template.shape, 9 * (joints - 1)))
    fields = {
        "v_template": np.asarray(body.v_template),
        "shapedirs": np.asarray(body.shapedirs),
        "J_regressor": np.asarray(body.J_regressor),
        "weights": np.asarray(body.lbs_weights),
        "kintree_table": np.stack([np.array(body.parents), np.arange(joints)]),
        "f": np.asarray(body.faces),
        "posedirs": bends.astype(np.float32) * pose_blend_shapes,
    }
    path.write_bytes(pickle.dumps(fields))


def numpy_shape(body: dict[str, np.ndarray], betas: np.ndarray) -> np.ndarray:
    """Shaped vertices [N, V, 3] by one product for the whole batch."""
    return body["v_template"] + np.tensordot(betas, body["directions"], 1)


def numpy_pose(body: dict[str, np.ndarray], betas: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Posed vertices [N, V, 3], step by step as SMPL's own code goes: dense weights, 4 by 4 matrices per vertex."""
    vertices = numpy_shape(body, betas)
    joints = np.matmul(body["J_regressor"], vertices)
    angle = np.linalg.norm(pose + 1e-8, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(pose / angle, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    sine, cosine = np.sin(angle)[..., None], np.cos(angle)[..., None]
    turns = np.eye(3, dtype=pose.dtype) + sine * cross + (1 - cosine) * np.matmul(cross, cross)
    bend = (turns[:, 1:] - np.eye(3, dtype=pose.dtype)).reshape(len(pose), -1)
    vertices = vertices + np.tensordot(bend, body["posedirs"], 1)
    local = np.zeros((*x.shape, 4, 4), pose.dtype)
    local[..., :3, :3], local[..., 3, 3] = turns, 1
    local[:, :, :3, 3] = joints
    local[:, 1:, :3, 3] -= joints[:, body["parents"][1:]]
    world = [local[:, 0]]
    for joint in range(1, local.shape[1]):
        world.append(np.matmul(world[body["parents"][joint]], local[:, joint]))
    moved = np.stack(world, axis=1)
    moved[..., :3, 3] -= np.einsum("njab,njb->nja", moved[..., :3, :3], joints)
    matrices = np.matmul(body["weights"], moved.reshape(*x.shape, 16)).reshape(len(pose), -1, 4, 4)
    return np.einsum("nvab,nvb->nva", matrices[..., :3, :3], vertices) + matrices[..., :3, 3]


def _in_chunks(function: Callable[..., Any], chunk: int, *arguments: np.ndarray) -> list[Any]:
    return [function(*(a[start : start + chunk] for a in arguments)) for start in range(0, len(arguments[0]), chunk)]


def _jax_rows(body: Body, config: Config) -> dict[str, Callable[..., Any]]:
    @jax.jit
    def shape(body: Body, betas: jax.Array) -> jax.Array:
        return jax.lax.map(lambda b: shape_body(body, b)[0], betas, batch_size=config.chunk)

    @jax.jit
    def pose(body: Body, betas: jax.Array, poses: jax.Array) -> jax.Array:
        return jax.lax.map(lambda bp: pose_body(body, *bp)[0], (betas, poses), batch_size=config.chunk)

    return {"shape": partial(shape, body), "pose": partial(pose, body)}


def _numpy_rows(body: Body, config: Config) -> dict[str, Callable[..., Any]]:
    arrays = {
        "v_template": np.asarray(body.v_template),
        "directions": np.ascontiguousarray(np.moveaxis(np.asarray(body.shapedirs), 2, 0)),
        "J_regressor": np.asarray(body.J_regressor),
        "weights": np.asarray(body.lbs_weights),
        "posedirs": np.asarray(body.posedirs),
        "parents": np.array(body.parents),
    }
    return {
        "shape": partial(_in_chunks, partial(numpy_shape, arrays), config.chunk),
        "pose": partial(_in_chunks, partial(numpy_pose, arrays), config.chunk),
    }


def _smplx_rows(file: Path, config: Config) -> dict[str, Callable[..., Any]]:
    import smplx  # pyright: ignore[reportMissingImports]
    import torch  # pyright: ignore[reportMissingImports]

    # smplx looks up face and finger vertices by numbers of SMPL's own mesh, which ours lacks.
    model = smplx.SMPL(str(file), vertex_ids=defaultdict(int), create_body_pose=False)

    def pose(betas: np.ndarray, poses: np.ndarray) -> Any:
        with torch.no_grad():
            b, p = torch.from_numpy(np.asarray(betas)), torch.from_numpy(np.asarray(poses))
            return model(
                betas=b, global_orient=p[:, :1].reshape(-1, 3), body_pose=p[:, 1:].reshape(len(p), -1)
            ).vertices

    return {"pose": partial(_in_chunks, pose, config.chunk)}


def main(config: Config) -> None:
    """Time every library at every batch size, print the table, and keep it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "body.pkl"
        write_smpl_file(file, load_body("female"), config.pose_blend_shapes)
        body = load_smpl(file)
        libraries = {"tryon_jax": _jax_rows(body, config), "numpy": _numpy_rows(body, config)}
        if importlib.util.find_spec("smplx") is not None and importlib.util.find_spec("torch") is not None:
            libraries["smplx"] = _smplx_rows(file, config)
        _check_agreement(libraries)
        rows = [
            _row(library, kind, function, batch, config)
            for batch in config.batches
            for kind in ("shape", "pose")
            for library, functions in libraries.items()
            if (function := functions.get(kind)) is not None
        ]
    rows.append(_fit_row(config))
    print(table([{key: str(value) if key == "time" else value for key, value in row.items()} for row in rows]))
    if config.save:
        missing = "" if "smplx" in libraries else " PyTorch's smplx was not installed."
        print(f"wrote {write_record('body', config, rows, note=f'6,774 vertices, 24 joints, 10 betas.{missing}')}")


def _inputs(batch: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(batch)
    return rng.normal(size=(batch, 10)).astype(np.float32), 0.3 * rng.normal(size=(batch, 24, 3)).astype(np.float32)


def _check_agreement(libraries: dict[str, dict[str, Callable[..., Any]]]) -> None:
    """Nobody is timed for another result: vertices agree to 0.02 mm."""
    betas, poses = _inputs(3)
    for kind, arguments in (("shape", (betas,)), ("pose", (betas, poses))):
        ours = np.asarray(libraries["tryon_jax"][kind](*arguments))
        for name, functions in libraries.items():
            if kind in functions and name != "tryon_jax":
                theirs = np.concatenate([np.asarray(part) for part in functions[kind](*arguments)])
                worst = np.abs(theirs - ours).max()
                if worst > 2e-5:
                    raise ValueError(f"{name} and tryon_jax differ by {1e3 * worst:.3g} mm in {kind}")


def _row(library: str, kind: str, function: Callable[..., Any], batch: int, config: Config) -> dict[str, Any]:
    betas, poses = _inputs(batch)
    arguments = (betas,) if kind == "shape" else (betas, poses)
    if library == "tryon_jax":
        arguments = tuple(jnp.asarray(argument) for argument in arguments)
    timing = measure(function, *arguments, repeats=config.repeats, warmup=1, max_seconds=config.max_seconds)
    return {
        "what": kind,
        "library": library,
        "batch": batch,
        "time": timing,
        "bodies per second": batch / timing.median,
    }


def _fit_row(config: Config) -> dict[str, Any]:
    body, asked = load_body("female"), {"stature": 1.72, "chest": 0.96, "waist": 0.78}
    timing = measure(betas_from_measurements, body, asked, repeats=config.repeats, max_seconds=config.max_seconds)
    return {
        "what": "fit 3 measurements",
        "library": "tryon_jax",
        "batch": 1,
        "time": timing,
        "bodies per second": 1 / timing.median,
    }
