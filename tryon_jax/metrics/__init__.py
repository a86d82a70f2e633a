"""What experiments and users measure on drapes (host side): distances, strain, wrinkles.

Lengths are metres unless a name says otherwise; nothing here is trained on.
"""

from tryon_jax.metrics.distance import (
    angle_between_normals,
    directed_distances,
    hausdorff_distance,
    sample_surface,
    vertex_distances,
)
from tryon_jax.metrics.strain import area_strain, edge_strain
from tryon_jax.metrics.wrinkles import (
    FoldStatistics,
    WrinkleComparison,
    compare_wrinkles,
    fine_part,
    fold_angles,
    fold_statistics,
    self_intersecting_share,
)

__all__ = [
    "FoldStatistics",
    "WrinkleComparison",
    "angle_between_normals",
    "area_strain",
    "compare_wrinkles",
    "directed_distances",
    "edge_strain",
    "fine_part",
    "fold_angles",
    "fold_statistics",
    "hausdorff_distance",
    "sample_surface",
    "self_intersecting_share",
    "vertex_distances",
]
