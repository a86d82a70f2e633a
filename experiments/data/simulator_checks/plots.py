"""Plots of the checks of the simulator."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tryon_jax.files.atomic import atomic_path


def save_figure(path: Path, figure: Any) -> None:
    """Write and close a figure in one step."""
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=100)
    plt.close(figure)


def save_drapes(path: Path, drapes: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Settled samples (vertices, faces) as seen from above at an angle, lit from the left."""
    import matplotlib.pyplot as plt
    from matplotlib.colors import LightSource

    look = {"color": (0.45, 0.57, 0.72), "lightsource": LightSource(315, 35), "linewidth": 0, "antialiased": False}
    columns = min(5, len(drapes))
    rows = -(-len(drapes) // columns)
    figure = plt.figure(figsize=(3.4 * columns, 3.0 * rows), constrained_layout=True)
    for k, (title, (vertices, faces)) in enumerate(drapes.items()):
        axis: Any = figure.add_subplot(rows, columns, k + 1, projection="3d")
        x, z, y = vertices[:, 0], -vertices[:, 2], vertices[:, 1]
        axis.plot_trisurf(x, z, y, triangles=faces, **look)
        axis.set(xlim=(-0.12, 0.12), ylim=(-0.12, 0.12), zlim=(-0.13, 0.01))
        axis.set_box_aspect((0.24, 0.24, 0.14), zoom=1.2)
        axis.view_init(elev=38, azim=-60)
        axis.set_axis_off()
        axis.set_title(title, fontsize=9)
    save_figure(path, figure)


def plot_checks(path: Path, results: Mapping[str, Mapping[str, Any]]) -> None:
    """One panel for each check that the record holds."""
    import matplotlib.pyplot as plt

    panels = {name: panel for name, panel in PANELS.items() if results.get(name, {}).get("rows")}
    if not panels:
        return
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(5.4 * columns, 3.9 * rows), constrained_layout=True)
    flat = np.atleast_1d(axes).ravel()
    for axis, (name, panel) in zip(flat, panels.items(), strict=False):
        panel(axis, results[name])
    for axis in flat[len(panels) :]:
        axis.set_axis_off()
    save_figure(path, figure)


def _uniaxial(axis: Any, found: Mapping[str, Any]) -> None:
    for name, curve in found["curves"].items():
        axis.plot(100 * np.array(curve["strain"]), curve["warp"], label=name)
    axis.set(title="pull along the warp", xlabel="strain, %", ylabel="tension, N/m", yscale="symlog")
    axis.legend(fontsize=6)


def _elastica(axis: Any, found: Mapping[str, Any]) -> None:
    load = [row["w L³ / D"] for row in found["rows"]]
    axis.plot(load, [row["elastica"] for row in found["rows"]], "k-", label="heavy elastica")
    axis.plot(load, [row["drop / L"] for row in found["rows"]], "o", label="simulator's energies")
    axis.set(
        title="overhanging strip, linear fabric", xlabel="w L³ / D", ylabel="drop of the tip / length", xscale="log"
    )
    axis.legend()


def _drape(axis: Any, found: Mapping[str, Any]) -> None:
    names = [row["fabric"] for row in found["rows"]]
    columns = [name for name in found["rows"][0] if "vertices" in name]
    for k, column in enumerate(columns):
        values = [row[column] for row in found["rows"]]
        axis.barh(np.arange(len(names)) + 0.27 * k, values, 0.27, label=column.removesuffix(", %"))
    axis.set_yticks(np.arange(len(names)) + 0.27, names, fontsize=7)
    axis.set(title="drape coefficient (ISO 9073-9)", xlabel="%")
    axis.legend(fontsize=7)


def _cantilever(axis: Any, found: Mapping[str, Any]) -> None:
    for k, label in enumerate(("warp", "weft")):
        height = [row[f"{label}: bending length, mm"] for row in found["rows"]]
        axis.barh(np.arange(len(height)) + 0.4 * k, height, 0.4, label=label)
    axis.set_yticks(np.arange(len(found["rows"])) + 0.2, [row["fabric"] for row in found["rows"]], fontsize=7)
    axis.set(title="Peirce's cantilever", xlabel="bending length, mm")
    axis.legend()


def _incline(axis: Any, found: Mapping[str, Any]) -> None:
    for row in found["rows"]:
        off = [float(key.split("°")[0].split()[-1]) for key in row if key.startswith("speed")]
        axis.plot(
            off, [row[key] for key in row if key.startswith("speed")], "o-", label=f"friction {row['friction']:g}"
        )
    axis.axvline(0, color="k", linestyle="--", linewidth=1)
    axis.set(title="tilted plate, after 2 s", xlabel="tilt beyond arctan(friction), degrees", ylabel="speed, mm/s")
    axis.legend()


def _energy(axis: Any, found: Mapping[str, Any]) -> None:
    for label, curve in found["curves"].items():
        axis.plot(curve["time"], 1e3 * np.array(curve["energy"]), label=f"step {label}")
    axis.set(title="undamped swing", xlabel="time, s", ylabel="mechanical energy, mJ")
    axis.legend()


def _convergence(axis: Any, found: Mapping[str, Any]) -> None:
    names = [f"{row['run']} ({row['vertices']})" for row in found["rows"]]
    axis.barh(range(len(names)), [row["drape coefficient, %"] for row in found["rows"]])
    axis.set_yticks(range(len(names)), names, fontsize=7)
    axis.set(title="other meshes and time steps", xlabel="drape coefficient of gray-interlock, %")


def _hysteresis(axis: Any, found: Mapping[str, Any]) -> None:
    for fabric in dict.fromkeys(row["fabric"] for row in found["rows"]):
        mine = [row for row in found["rows"] if row["fabric"] == fabric]
        axis.plot([row["stature"] for row in mine], [row["mean, mm"] for row in mine], "o-", label=f"{fabric}, mean")
        axis.plot([row["stature"] for row in mine], [row["95 %, mm"] for row in mine], "o:", label=f"{fabric}, 95 %")
    axis.set(title="T-shirt, up to stature +3 and back", xlabel="stature (β1)", ylabel="distance, mm", ylim=(0, None))
    axis.legend(fontsize=7)


def _rounding(axis: Any, found: Mapping[str, Any]) -> None:
    names = [f"{row['design']}, {row['fabric']}, stature {row['stature']:+.0f}" for row in found["rows"]]
    axis.barh(range(len(names)), [row["mean, mm"] for row in found["rows"]])
    axis.set_yticks(range(len(names)), names, fontsize=6)
    axis.set(title="starts 1 µm apart", xlabel="mean distance of the drapes, mm")


PANELS: dict[str, Callable[[Any, Mapping[str, Any]], None]] = {
    "uniaxial": _uniaxial,
    "elastica": _elastica,
    "cantilever": _cantilever,
    "drape": _drape,
    "incline": _incline,
    "energy": _energy,
    "convergence": _convergence,
    "hysteresis": _hysteresis,
    "rounding": _rounding,
}
