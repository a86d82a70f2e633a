"""Which cells a short run on a GPU measures, the most telling first."""

from collections.abc import Sequence

from benchmarks._machine import PRECISIONS
from benchmarks._subjects import Cell

THROUGHPUT: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("drape with fields", ("float32", "tf32")),
    ("drape", ("float32", "tf32")),
    ("Chebyshev layer", ("float32", "tf32")),
    ("Laplacian product", ("float32",)),
    ("training step", ("float32",)),
    ("collision loss", ("float32",)),
    ("push-out", ("float32",)),
)
"""Subjects with the precisions that they are measured in."""
LARGEST_PUSHED = 14_000
"""Garments with more vertices are not pushed out of a body: that runs on the host and takes minutes."""


def throughput_cells(
    configs: Sequence[str], vertices: Sequence[int], batches: Sequence[int], at_vertices: int, at_batch: int
) -> list[Cell]:
    """Every subject at one size and batch, then at the other batches, then at the other sizes, the largest last."""
    assert all(name in PRECISIONS for _, names in THROUGHPUT for name in names)
    sizes = [at_vertices, *(v for v in sorted(vertices) if v != at_vertices)]
    lengths = [at_batch, *(b for b in sorted(batches, reverse=True) if b != at_batch)]
    cells: dict[Cell, None] = {}
    for v in sizes:
        for b in lengths:
            for subject, precisions in THROUGHPUT:
                if subject == "push-out" and v > LARGEST_PUSHED:
                    continue
                alone = subject in ("collision loss", "push-out")
                for precision in precisions:
                    for name in ("",) if alone else configs:
                        cells.setdefault(Cell(subject, name, v, 1 if subject == "push-out" else b, precision))
    return list(cells)


def simulator_cells(vertices: int, lanes: Sequence[int]) -> list[Cell]:
    """One step, then whole drapes, for more and more lanes."""
    return [
        Cell(subject, "", vertices, count) for count in sorted(lanes) for subject in ("solver step", "side by side")
    ]
