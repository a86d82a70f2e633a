"""Checks of the simulator with the tests of a textile laboratory: pull, drape on a pedestal, overhanging strip."""

from collections.abc import Sequence
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq, minimize
from scipy.stats import spearmanr

from experiments.data.simulator_checks.options import STATIC, Config, Found
from experiments.data.simulator_checks.plots import save_drapes
from measuring.textiles import Result, disc, linear_fabric, pedestal, sample_fabric, settle, shadow_area, strip
from tryon_jax.physics.bending import CURVATURE_STEP, dihedral_angles, hinge_stiffness
from tryon_jax.physics.cloth import Cloth, build_cloth
from tryon_jax.physics.fabrics import Fabric
from tryon_jax.physics.state import GRAVITY, SolverSettings
from tryon_jax.physics.stretch import stiffness, stress, stretch_energy

MOST_STEPS = 1500
SAMPLE_RADIUS, PEDESTAL_RADIUS = 0.15, 0.09
"""Drape test of ISO 9073-9, metres."""
DIRECTIONS = {"warp": 0.0, "bias": np.pi / 4, "weft": np.pi / 2}
"""Radians from the warp."""
DENSITIES = (2.0, 2**0.5, 1.0)
"""Lengths of edges in the drape test, in those of the finest mesh: the vertices double each time."""
FIRST, LAST = (0, 1), (4,)
TABLE_COLUMNS = {"at its small curvatures": FIRST, "at its end": LAST}
"""Columns of the measured bending table."""
ROWS = {"warp": 2, "weft": 0}
"""Row of the bending table by which a strip bends: hinges lie across it."""
MOST_ACROSS = 0.2
"""Largest contraction across that the search for a pull without tension across allows."""
_stress, _stiffness = jax.jit(stress), jax.jit(stiffness)


def check_uniaxial(config: Config) -> Found:
    """Tension against strain along warp, weft and bias, free to contract sideways."""
    strains = np.linspace(0, 0.25, 26)
    rows, curves = [], {}
    for name in config.fabric_names():
        fabric = sample_fabric(name)
        row: dict[str, float | str | None] = {"fabric": name}
        curves[name] = {"strain": strains.tolist()}
        for label, angle in DIRECTIONS.items():
            pull = np.array([uniaxial_tension(fabric, e, angle) for e in strains])
            curves[name][label] = pull.tolist()
            row |= {f"{label} at {e} %, N/m": float(np.interp(e / 100, strains, pull)) for e in (2, 10, 20)}
            if label != "bias":
                expected = _tension_by_table(fabric, 0.2, label)
                row[f"{label} at 20 % ÷ table"] = expected and float(np.interp(0.2, strains, pull)) / expected
        rows.append(row)
    about = "Tension of a narrow sample, sideways free. The measured tables end at a strain of 1/6, so that at 20 % "
    return {
        "about": about + "the pull along warp and weft follows from their last rows.",
        "rows": rows,
        "curves": curves,
    }


def _second_stress(fabric: Fabric, green: np.ndarray) -> np.ndarray:
    strain = jnp.asarray([[green[0, 0], green[1, 1], 2 * green[0, 1]]], jnp.float32)
    s = np.asarray(_stress(strain, fabric))[0]
    return np.array([[s[0], s[2]], [s[2], s[1]]])


def uniaxial_tension(fabric: Fabric, strain: float, angle: float) -> float:
    """Nominal tension along `angle` from the warp at a stretch of 1 + strain, without tension across."""
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin], [sin, cos]])

    def turned_stress(across: float) -> np.ndarray:
        # No shear against the pulling direction: clamps of a narrow sample.
        stretch = np.diag([(1 + strain) ** 2, (1 + across) ** 2])
        return turn.T @ _second_stress(fabric, turn @ (0.5 * (stretch - np.eye(2))) @ turn.T) @ turn

    low, high = -MOST_ACROSS, 0.1
    across = 0.0
    if turned_stress(low)[1, 1] * turned_stress(high)[1, 1] < 0:
        across = float(brentq(lambda e: turned_stress(e)[1, 1], low, high, xtol=1e-6))
    return float((1 + strain) * turned_stress(across)[0, 0])


def _tension_by_table(fabric: Fabric, strain: float, label: str) -> float | None:
    """The same at strains beyond the table, where its last row holds: (k_along − k_coupling² / k_across) G (1 + e).

    None where the measured coupling would contract the sample by more than `MOST_ACROSS`: such an entry is noise.
    """
    green = 0.5 * ((1 + strain) ** 2 - 1)
    # Wide of the resting strain: beyond the table its entries do not change.
    ends = {"warp": [[0.6, 0.0, 0.0]], "weft": [[0.0, 0.6, 0.0]]}
    k0, k1, k2, _ = np.asarray(_stiffness(jnp.asarray(ends[label], jnp.float32), fabric), float)[0]
    along, across = (k0, k2) if label == "warp" else (k2, k0)
    contraction = k1 / across * green if across > 0 else 0.0
    if 1 - 2 * contraction < (1 - MOST_ACROSS) ** 2:
        return None
    return float((1 + strain) * (along * green - k1 * contraction))


def drape_coefficient(
    fabric: Fabric, edge: float, settings: SolverSettings, seed: int = 0
) -> tuple[float, Result, np.ndarray]:
    """Drape coefficient of a round sample in percent, with the settled sample and its faces."""
    faces, uv = disc(SAMPLE_RADIUS, edge, seed)
    rng = np.random.default_rng(seed)
    # A flat round sample is in unstable equilibrium: a tenth of a millimetre decides where its folds form.
    height = float(fabric.thickness) + 1e-4 * rng.normal(size=len(uv))
    points = np.stack([uv[:, 0], height, -uv[:, 1]], axis=1)
    result = settle(faces, uv, points, fabric, pedestal(PEDESTAL_RADIUS), settings, tolerance=3e-3, most=MOST_STEPS)
    table_area = np.pi * PEDESTAL_RADIUS**2
    area = shadow_area(result.vertices, faces)
    return 100 * (area - table_area) / (np.pi * SAMPLE_RADIUS**2 - table_area), result, faces


def check_drape(config: Config) -> Found:
    """Fabric drape tester: the softer the fabric, the smaller its shadow; on meshes of three densities."""
    rows, pictures = [], {}
    for name in config.fabric_names():
        fabric = sample_fabric(name)
        row: dict[str, float | str] = {"fabric": name}
        drapes = [drape_coefficient(fabric, longer * config.edge, STATIC) for longer in DENSITIES]
        row |= {f"{len(result.vertices)} vertices, %": coefficient for coefficient, result, _ in drapes}
        coefficient, result, faces = drapes[-1]
        row |= {"bending length at the end of the table, mm": 1e3 * _table_length(fabric, (0, 1, 2), LAST)}
        row |= {"density, kg/m²": float(fabric.density), "steps": result.steps}
        rows.append(row | {"residual": float(result.report.residual)})
        pictures[f"{name}: {coefficient:.0f} %"] = (result.vertices, faces)
    save_drapes(config.out.expanduser() / "validate_simulator_drape.png", pictures)
    columns = [name for name in rows[0] if "vertices" in name]
    rows.sort(key=lambda row: row[columns[-1]])
    about = "Drape coefficient of a sample of 30 cm on a pedestal of 18 cm (ISO 9073-9), with edges "
    about += ", ".join(f"{1e3 * longer * config.edge:.1f}" for longer in DENSITIES) + " mm long."
    if len(rows) < 3:
        return {"about": about, "rows": rows}
    values = {name: [row[name] for row in rows] for name in columns}
    finest = values[columns[-1]]
    changes = [np.abs(np.subtract(values[a], values[b])) for a, b in pairwise(columns)]
    fabrics = [sample_fabric(row["fabric"]) for row in rows]
    lengths = {where: [_table_length(f, (0, 1, 2), c) for f in fabrics] for where, c in TABLE_COLUMNS.items()}
    by_mesh = {name: _rank(values[name], finest) for name in columns[:-1]}
    by_table = {where: _rank(length, finest) for where, length in lengths.items()}
    note = "From one mesh to the next the coefficient changes by "
    note += ", then ".join(
        f"{change.mean():.1f} points on average and {change.max():.1f} at most" for change in changes
    )
    note += ". Rank correlation of the fabrics with their order on the finest mesh: "
    note += ", ".join(f"{rank:.2f} on {name.removesuffix(', %')}" for name, rank in by_mesh.items())
    note += "; with the bending length from the measured table, mean of all directions: "
    note += ", ".join(f"{rank:.2f} {where}" for where, rank in by_table.items()) + "."
    return {"about": about, "rows": rows, "note": note, "rank_by_mesh": by_mesh, "rank_by_table": by_table}


def check_cantilever(config: Config) -> Found:
    """Peirce's cantilever: overhanging strips along warp and weft."""
    rows = []
    for name in config.fabric_names():
        with jax.enable_x64(True):
            fabric = sample_fabric(name)
            length = _table_length(fabric, (0, 1, 2), FIRST)
            row: dict[str, float | str] = {"fabric": name, "(k/4ρg)^(1/3), mm": 1e3 * length}
            for label in ROWS:
                angle = _overhang_angle(fabric, 2 * length, label)
                # Peirce: c = L (cos(θ/2) / 8 tan θ)^(1/3)
                found = 2 * length * (np.cos(angle / 2) / (8 * np.tan(angle))) ** (1 / 3)
                row |= {
                    f"{label}: angle, degrees": float(np.rad2deg(angle)),
                    f"{label}: bending length, mm": 1e3 * found,
                }
        rows.append(row)
    about = (
        "Bending length (Peirce 1930) of strips that overhang twice the length in the second column, where a fabric "
    )
    about += "of one stiffness would hang at 41.5°; by minimising the energies in double precision."
    if len(rows) < 3:
        return {"about": about, "rows": rows}
    ranks, parts = {}, []
    for label, direction in ROWS.items():
        found = [row[f"{label}: bending length, mm"] for row in rows]
        for where, columns in TABLE_COLUMNS.items():
            table = [_table_length(sample_fabric(str(row["fabric"])), (direction,), columns) for row in rows]
            ranks[f"{label} {where}"] = _rank(table, found)
            parts.append(f"{ranks[f'{label} {where}']:.2f} ({label}, {where})")
    note = "Rank correlation with the bending length from the measured table's row of the same direction: "
    note += ", ".join(parts) + ". The strips are bent more than the table's last column was measured at "
    note += f"({CURVATURE_STEP * LAST[0]:g} per metre), so that it decides."
    return {"about": about, "rows": rows, "note": note, "rank_by_table": ranks}


def _table_length(fabric: Fabric, directions: Sequence[int], columns: Sequence[int]) -> float:
    """Bending length by the measured stiffness, mean of these rows (directions) and columns (curvatures), metres."""
    bending = np.asarray(fabric.bending)[np.ix_(directions, columns)].mean()
    return float((bending / 4 / (float(fabric.density) * GRAVITY)) ** (1 / 3))


def _rank(one: Sequence[float], other: Sequence[float]) -> float:
    """Spearman's rank correlation."""
    return float(spearmanr(one, other).statistic)


def _strip_energy(free: jax.Array, stiffness: jax.Array, cloth: Cloth, fabric: Fabric, x: jax.Array) -> jax.Array:
    """Energy of a strip whose two rows of vertices move alike, at given stiffnesses of its hinges (N·m), joules."""
    x = x.at[4 : 4 + len(free), :2].set(jnp.repeat(free.reshape(-1, 2), 2, axis=0))
    theta, _ = dihedral_angles(x, cloth)
    weight = (jnp.asarray(cloth.vertex_areas) * fabric.density * GRAVITY * x[:, 1]).sum()
    return stretch_energy(x, cloth, fabric) + 0.5 * (stiffness * cloth.hinge_shape * theta**2).sum() + weight


_energy, _slope = jax.jit(_strip_energy), jax.jit(jax.grad(_strip_energy))
_curvature = jax.jit(jax.hessian(_strip_energy))


def _overhang_angle(fabric: Fabric, overhang: float, label: str, columns: int = 20) -> float:
    """Angle below the horizontal of the chord of a strip at rest, radians.

    The measured stiffness depends on the curvature: minimise with it held, read it anew, and so on until it stays.
    """
    edge = overhang / columns
    faces, uv = strip(columns + 1, 1, overhang + edge, edge)
    # Turning the pattern, not the strip: u is the warp.
    grain = uv if label == "warp" else uv[:, ::-1] * [1, -1]
    cloth = build_cloth(faces, grain, faces, len(uv), bucket=64, dtype=np.float64)
    hardly_stretching = linear_fabric(warp=200.0, shear=80.0, bending=0.0, density=float(fabric.density))
    x = jnp.full((64, 3), 5.0).at[: len(uv)].set(np.stack([uv[:, 0] - edge, 0 * uv[:, 0], -uv[:, 1]], axis=1))
    free = np.asarray(x[4 : 4 + 2 * columns : 2, :2]).ravel()
    stiffness = hinge_stiffness(jnp.zeros(len(cloth.hinges)), cloth, fabric)
    for _ in range(60):
        arguments = (stiffness, cloth, hardly_stretching, x)
        options = {"gtol": 1e-9}
        free = minimize(_energy, free, arguments, "trust-exact", _slope, _curvature, options=options).x
        now = x.at[4 : 4 + len(free), :2].set(np.repeat(free.reshape(-1, 2), 2, axis=0))
        found = hinge_stiffness(dihedral_angles(now, cloth)[0], cloth, fabric)
        if float(jnp.abs(found - stiffness).max()) < 1e-4 * float(stiffness.max()):
            break
        stiffness = 0.5 * (stiffness + found)
    else:
        raise RuntimeError("the stiffness of an overhanging strip did not settle")
    return float(np.arctan2(-free[-1], free[-2]))
