"""Design spaces and designs: the parameters, in metres, that a garment is cut from."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice, check_finite, check_range
from tryon_jax.garment.layout import Layout
from tryon_jax.garment.layout_file import load_layout


@dataclass(frozen=True, eq=False)
class Design:
    """One garment of a design space: a value for each active parameter. Made by `DesignSpace.design`."""

    names: tuple[str, ...]
    values: Float[np.ndarray, " P"]
    """Metres, in the order of `names`."""
    label: str = ""
    """Name of the preset or of the manifest entry, where there is one."""

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(check_choice("parameter", name, self.names))])

    def as_dict(self) -> dict[str, float]:
        """Parameter values by name, metres."""
        return {n: float(v) for n, v in zip(self.names, self.values, strict=True)}

    def __str__(self) -> str:
        text = ", ".join(f"{n} {v:.3f} m" for n, v in self.as_dict().items())
        return f"{self.label} ({text})" if self.label else text


@dataclass(frozen=True, eq=False)
class DesignSpace:
    """The garments that one layout can draw: named parameters with their ranges.

    Parameters of the layout that are not active stay at their means.
    """

    layout: Layout
    names: tuple[str, ...]
    minimum: Float[np.ndarray, " P"]
    mean: Float[np.ndarray, " P"]
    maximum: Float[np.ndarray, " P"]

    @property
    def presets(self) -> tuple[str, ...]:
        """Names of the designs that the layout comes with."""
        return tuple(self.layout.presets)

    @property
    def middle(self) -> Float[np.ndarray, " P"]:
        """The middle of each parameter's range, metres."""
        return 0.5 * (self.maximum + self.minimum)

    @property
    def mean_design(self) -> Design:
        """The design with every parameter at its mean."""
        return Design(self.names, self.mean.copy(), "mean")

    def design(self, label: str = "", **values: float) -> Design:
        """A design by named values in metres; parameters that are not named take their means.

        Raises:
            ValueError: for an unknown parameter, a value outside its range, NaN or infinity.
        """
        for name in values:
            check_choice("parameter", name, self.names)
        numbers = [
            check_range(n, values[n] if n in values else float(self.mean[i]), self.minimum[i], self.maximum[i], "m")
            for i, n in enumerate(self.names)
        ]
        return Design(self.names, np.array(numbers), label)

    def from_values(self, values: Sequence[float] | Float[np.ndarray, " P"], label: str = "") -> Design:
        """A design from numbers in the order of `names`; checked as in `design`."""
        array = check_finite("design", np.asarray(values, dtype=float))
        if array.shape != self.mean.shape:
            raise ValueError(f"a design needs {len(self.names)} numbers ({', '.join(self.names)}), got {array.shape}")
        return self.design(label, **{n: float(v) for n, v in zip(self.names, array, strict=True)})

    def preset(self, name: str) -> Design:
        """One of the layout's named designs, such as "tshirt"."""
        values = self.layout.presets[check_choice("design", name, self.presets)]
        return self.design(name, **{k: v for k, v in values.items() if k in self.names})

    def layout_values(self, design: Design) -> dict[str, float]:
        """Values of all the layout's parameters: the design's, and means for those that are not active."""
        return {p.name: p.mean for p in self.layout.parameters} | design.as_dict()

    def draw(self, design: Design) -> dict[str, Float[np.ndarray, "_ 2"]]:
        """Every edge of the design as a dense polyline in metres (see `Layout.draw`)."""
        return self.layout.draw(self.layout_values(design))

    def grid(self, counts: int | Mapping[str, int]) -> list[Design]:
        """Designs on a regular grid, ends included; a count of 1 keeps a parameter at its mean."""
        steps = {n: counts if isinstance(counts, int) else counts.get(n, 1) for n in self.names}
        if isinstance(counts, Mapping):
            for name in counts:
                check_choice("parameter", name, self.names)
        axes = []
        for i, name in enumerate(self.names):
            check_range(f"number of grid steps of {name}", steps[name], 1, 1000)
            axes.append(
                self.mean[i : i + 1] if steps[name] == 1 else np.linspace(self.minimum[i], self.maximum[i], steps[name])
            )
        table = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)
        return [Design(self.names, row) for row in table]

    def sample(self, count: int, seed: int) -> list[Design]:
        """`count` designs spread evenly over the space: a Sobol sequence scrambled by `seed`."""
        check_range("number of designs", count, 1, 2**20)
        # Imported where it is needed: it takes longer to load than everything else here.
        from scipy.stats import qmc

        unit = qmc.Sobol(len(self.names), rng=np.random.default_rng(seed)).random_base2(int(np.ceil(np.log2(count))))
        table = qmc.scale(unit[:count], self.minimum, self.maximum)
        return [Design(self.names, row) for row in table]


@functools.cache
def _default_space(layout: Layout | str | Path, parameters: tuple[str, ...] | None) -> DesignSpace:
    drawn = layout if isinstance(layout, Layout) else load_layout(layout)
    names = parameters or tuple(p.name for p in drawn.parameters if p.active)
    active = [drawn.parameter(n) for n in names]
    return DesignSpace(
        drawn,
        names,
        np.array([p.minimum for p in active]),
        np.array([p.mean for p in active]),
        np.array([p.maximum for p in active]),
    )


def load_design_space(layout: Layout | str | Path = "kimono", parameters: Sequence[str] | None = None) -> DesignSpace:
    """The design space of a layout.

    Args:
        layout: a layout, the name of one that comes with the library, or the path of a layout file.
        parameters: names of the active parameters; by default those that the layout marks as active.

    Raises:
        ValueError: for an unknown layout or parameter, or a layout with faults (see `load_layout`).
    """
    if parameters is not None and len(set(parameters)) < max(len(parameters), 1):
        raise ValueError(f"active parameters must be different and at least one, got {list(parameters)}")
    if isinstance(layout, str) and not layout.endswith(".toml"):
        return _default_space(layout, None if parameters is None else tuple(parameters))
    return _default_space.__wrapped__(layout, None if parameters is None else tuple(parameters))
