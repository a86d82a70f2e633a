"""Checks of the simulator against ARCSim, the reference implementation that the fabrics' model comes from."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from experiments.data.simulator_checks.options import STATIC, Config, Found
from measuring.textiles import sample_fabric, settle
from tryon_jax.checks import check_file
from tryon_jax.contact.surface import build_surface
from tryon_jax.physics.bending import bending_force, dihedral_angles
from tryon_jax.physics.cloth import build_cloth
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.physics.stretch import stiffness, stretch_force

LEFT_OUT = "Left out: no `--reference` folder was given. Its data is ARCSim's output and not part of this project."


def check_forces(config: Config) -> Found:
    """Forces on the vertices of a strained and of a noisy patch, in double precision."""
    about = "Nodal forces on patches of 36 vertices in gray-interlock, float64, against ARCSim 0.2.1."
    if config.reference is None:
        return {"about": about, "note": LEFT_OUT}
    rows = []
    for patch in ("stretch", "noise"):
        data = np.load(check_file("reference", config.reference / f"forces_gray-interlock_{patch}.npz"))
        with jax.enable_x64(True):
            fabric = load_fabric("gray-interlock")
            faces, count = data["faces"].astype(int), len(data["vertices"])
            cloth = build_cloth(faces, data["uv"], faces, count, bucket=64, dtype=np.float64)
            x = jnp.zeros((64, 3)).at[:count].set(data["vertices"])
            stretch = np.asarray(stretch_force(x, cloth, fabric))[:count]
            bend = np.asarray(bending_force(x, cloth, fabric))[:count]
            theta = np.asarray(dihedral_angles(x, cloth)[0])
            strain = jnp.asarray(data["k_of_G"][:, :3] * [1, 1, 2])
            k = np.asarray(stiffness(strain, fabric))
        # Where the cloth folds the other way, ARCSim extrapolates its bending table without a cap.
        used = np.asarray(cloth.hinge_shape) > 0
        other = np.unique(np.asarray(cloth.hinges)[used & (theta > 0)])
        agreeing = np.setdiff1d(np.unique(np.asarray(cloth.hinges)[used]), other)
        row = {
            "patch": patch,
            "stiffness k(G)": _difference(k, data["k_of_G"][:, 3:]),
            "stretch force": _difference(stretch, data["force_stretch"]),
            "bending force": _difference(bend[agreeing], data["force_bend"][agreeing]),
            "vertices compared in bending": len(agreeing),
        }
        rows.append(row)
    note = "Largest difference relative to the largest value; bending where all folds of a vertex go to the side on "
    return {"about": about, "rows": rows, "note": note + "which both models agree (`docs/simulator.md`)."}


def _difference(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max()) if expected.size else float("nan")


def check_tube(config: Config) -> Found:
    """A tube hung by its top ring around an ellipsoid: one equilibrium, compared vertex by vertex."""
    about = "Tube of 2,016 vertices in gray-interlock, top ring pinned, against ARCSim 0.2.1 after 5 s."
    if config.reference is None:
        return {"about": about, "note": LEFT_OUT}
    files = {
        name: np.load(check_file("reference", config.reference / f"{name}.npz"))
        for name in ("tube2016", "torso", "tubepin_gi_t5")
    }

    def upright(points: np.ndarray) -> np.ndarray:
        # The reference has z up.
        return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)

    tube = files["tube2016"]
    start = upright(tube["vertices"] - [0, 0, 0.3])
    goal = upright(files["tubepin_gi_t5"]["vertices"])
    surface = build_surface(upright(files["torso"]["vertices"]).astype(np.float32), files["torso"]["faces"].astype(int))
    cloth = build_cloth(tube["faces"].astype(int), tube["uv"], tube["faces_uv"].astype(int), len(start))
    result = settle(
        tube["faces"],
        tube["uv"],
        start,
        sample_fabric("gray-interlock"),
        surface,
        dataclasses.replace(STATIC, gravity=9.8),
        pinned=np.arange(1944, 2016),
        cloth=cloth,
        tolerance=1e-3,
        most=400,
    )
    apart = 1e3 * np.linalg.norm(result.vertices - goal, axis=1)
    row = {"mean, mm": float(apart.mean()), "95 %, mm": float(np.percentile(apart, 95)), "max, mm": float(apart.max())}
    row |= {"steps": result.steps, "residual": float(result.report.residual)}
    return {"about": about, "rows": [row], "note": "ARCSim's own steps of 5 and 2.5 ms differ by 1.1 mm on average."}
