"""A run's curve as a picture, beside its curve.csv."""

import csv
from pathlib import Path

from tryon_jax.files.atomic import atomic_path


def draw_curve(folder: Path, measure: str) -> None:
    """FOLDER/curve.png: training loss and the validation measure over steps, both logarithmic."""
    from matplotlib.figure import Figure

    with (folder / "curve.csv").open(encoding="utf-8") as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    steps = [row["step"] for row in rows]
    figure = Figure(figsize=(7, 3.2), dpi=110, layout="constrained")
    for axis, key, label in zip(figure.subplots(1, 2), ("loss", "validation"), ("training loss", measure), strict=True):
        axis.plot(steps, [row[key] for row in rows], marker=".")
        axis.set_xlabel("step")
        axis.set_ylabel(label)
        if all(row[key] > 0 for row in rows):
            axis.set_yscale("log")
        axis.spines[["top", "right"]].set_visible(False)
    with atomic_path(folder / "curve.png") as temporary:
        figure.savefig(temporary)
