"""Distances of one kind of prediction from the simulation, collected over garments and body shapes."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from tryon_jax.metrics import WrinkleComparison

_BIN, _BINS = 0.1, 4000


@dataclass(eq=False)
class Errors:
    """Running sums: every sample counts alike in the mean, every vertex alike in the percentile."""

    means: list[float] = field(default_factory=list)
    """Mean distance of each sample, millimetres."""
    ends: list[float] = field(default_factory=list)
    """The same of the samples at the ends of rays."""
    histogram: Int[np.ndarray, " B"] = field(default_factory=lambda: np.zeros(_BINS, np.int64))
    """Vertices by distance."""
    wrinkles: list[WrinkleComparison] = field(default_factory=list)
    """One for each garment."""
    inside: list[float] = field(default_factory=list)
    """Share of vertices inside the body."""

    def add(self, metres: Float[np.ndarray, "S V"], ends: Bool[np.ndarray, " S"]) -> None:
        """Distances at the vertices of some samples of one garment; `ends` marks samples at the end of a ray."""
        millimetres = 1e3 * metres
        per_sample = millimetres.mean(axis=1)
        self.means += per_sample.tolist()
        self.ends += per_sample[ends].tolist()
        bins = np.minimum(millimetres / _BIN, _BINS - 1).astype(int)
        self.histogram += np.bincount(bins.ravel(), minlength=_BINS)

    def update(self, other: "Errors") -> None:
        """Add what another one has collected."""
        self.means += other.means
        self.ends += other.ends
        self.histogram = self.histogram + other.histogram
        self.wrinkles += other.wrinkles
        self.inside += other.inside

    def summary(self) -> dict[str, Any]:
        """Numbers for a record; what was not measured is None."""
        cumulative = np.cumsum(self.histogram)
        reached = np.searchsorted(cumulative, 0.95 * cumulative[-1])
        return {
            "samples": len(self.means),
            "mean_mm": _mean(self.means),
            "p95_mm": _BIN * float(reached + 1) if self.means else None,
            "ends_mm": _mean(self.ends),
            "wrinkles_total": _mean([w.total for w in self.wrinkles]),
            "wrinkles_varying": _mean([w.varying for w in self.wrinkles]),
            "wrinkle_correlation": _mean([w.correlation for w in self.wrinkles]),
            "inside_percent": None if not self.inside else 100 * float(np.mean(self.inside)),
        }


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None
