"""The committed list of training and test designs and topologies."""

import functools
import tomllib
from dataclasses import dataclass
from importlib import resources

import numpy as np

from tryon_jax.checks import check_choice
from tryon_jax.garment.design import Design, DesignSpace, load_design_space


@dataclass(frozen=True, eq=False)
class Manifest:
    """Designs and topologies of the experiments with their splits (section "Dataset and Implementation Details")."""

    space: DesignSpace
    """The space that all designs belong to."""
    training: tuple[Design, ...]
    """The 19 designs of the paper's training set."""
    additional: tuple[Design, ...]
    """Training designs beyond them, each in the first training topology alone."""
    validation: tuple[str, ...]
    """Labels of those among them that only choose the weights: how well a design is guessed that is not fitted."""
    unseen: tuple[Design, ...]
    """6 designs for tests only."""
    training_seeds: tuple[int, ...]
    """Seeds of `remesh` for the 2 topologies of each design that are trained on."""
    test_seeds: tuple[int, ...]
    """Seeds of 7 topologies for tests only."""
    target_area: float
    """T_area of every mesh, square metres."""

    @property
    def designs(self) -> tuple[Design, ...]:
        """All designs, those for training first."""
        return self.training + self.additional + self.unseen

    def training_garments(self, additional: bool = True) -> list[str]:
        """Names, <label>-<topology seed>, of all garments that may be trained on."""
        names = [f"{design.label}-{seed}" for design in self.training for seed in self.training_seeds]
        if additional:
            names += [f"{design.label}-{self.training_seeds[0]}" for design in self.additional]
        return names

    def design(self, label: str) -> Design:
        """A design by its label, from either split."""
        check_choice("design", label, [d.label for d in self.designs])
        return next(d for d in self.designs if d.label == label)

    def first_topology(self, garment: str) -> str:
        """The garment of the same design in its first topology, whose drapes those of the others start from."""
        return f"{garment.rsplit('-', 1)[0]}-{self.training_seeds[0]}"

    def split(self, label: str, seed: int) -> str:
        """ "training" for garments that may be trained on, otherwise "test".

        Raises:
            ValueError: for a design or a seed that is not in the manifest.
        """
        seeds = self.training_seeds + self.test_seeds
        if seed not in seeds:
            raise ValueError(f"seed {seed} is in no split; known: {', '.join(map(str, seeds))}")
        return "training" if f"{self.design(label).label}-{seed}" in self.training_garments() else "test"


@functools.cache
def load_manifest() -> Manifest:
    """Read the manifest that comes with the library (data/designs.toml)."""
    file = resources.files("tryon_jax") / "data" / "designs.toml"
    data = tomllib.loads(file.read_text(encoding="utf-8"))
    space = load_design_space(data["layout"])
    unseen = tuple(space.design(label, **values) for label, values in data["unseen"].items())
    additional = _spread(space, unseen, **data["additional"])
    every = data["validation_every"]
    return Manifest(
        space,
        tuple(space.design(label, **values) for label, values in data["training"].items()),
        additional,
        tuple(design.label for design in additional[every - 1 :: every]),
        unseen,
        tuple(data["topologies"]["training"]),
        tuple(data["topologies"]["test"]),
        float(data["target_area"]),
    )


def _spread(space: DesignSpace, unseen: tuple[Design, ...], count: int, clearance: float) -> tuple[Design, ...]:
    """Designs evenly over a space, in whole centimetres, none within `clearance` metres of an unseen one."""
    # Imported where it is needed: it takes longer to load than everything else here.
    from scipy.stats import qmc

    far = np.stack([design.values for design in unseen])
    designs: list[Design] = []
    for point in qmc.Sobol(len(space.names), scramble=False).random_base2(int(np.ceil(np.log2(4 * count)))):
        values = np.round(space.minimum + point * (space.maximum - space.minimum), 2)
        if len(designs) < count and np.linalg.norm(far - values, axis=1).min() > clearance:
            designs.append(space.from_values(values, f"additional-{len(designs)}"))
    return tuple(designs)
