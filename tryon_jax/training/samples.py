"""Every sample of a dataset with its split, its statistics and what the rules say of it; the dataset's manifest."""

import csv
import io
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tryon_jax.garment.manifest import Manifest
from tryon_jax.training.dataset import RULES, STATISTICS, load_arrays, read_config


@dataclass(frozen=True, eq=False)
class Sample:
    """One drape of a dataset."""

    path: Path
    row: int | None
    """Row in a file of rays; None for a drape on the mean body."""
    garment: str
    """<design label>-<topology seed>."""
    fabric: str
    betas: tuple[float, ...]
    test: bool
    """True for body shapes that are only for testing."""
    statistics: dict[str, float]
    versions: dict[str, str]
    """Of the libraries that simulated it."""

    @property
    def design(self) -> str:
        """The design's label."""
        return self.garment.rsplit("-", 1)[0]

    @property
    def seed(self) -> int:
        """The topology's seed."""
        return int(self.garment.rsplit("-", 1)[1])

    def broken_rules(self) -> list[str]:
        """Names of the rules that exclude it, none for a kept one."""
        return [key for key, limit in RULES.items() if not self.statistics[key] <= limit]

    def vertices(self) -> np.ndarray:
        """Positions, metres."""
        vertices = load_arrays(self.path)["vertices"]
        return vertices if self.row is None else vertices[self.row]


def read_samples(root: Path) -> list[Sample]:
    """Every drape of a dataset, sorted by file; positions stay on disk.

    Raises:
        FileNotFoundError: there is no dataset in the folder.
        ValueError: one of its files is damaged.
    """
    mean_body = (0.0,) * read_config(root).num_betas
    samples = []
    for path in sorted((root / "mean").glob("[!.]*.npz")) + sorted((root / "rays").glob("[!.]*.npz")):
        arrays = load_arrays(path)
        garment, fabric = path.stem.split("_")[:2]
        versions = json.loads(str(arrays["versions"]))
        if path.parent.name == "mean":
            statistics = {key: float(arrays[key]) for key in STATISTICS}
            samples.append(Sample(path, None, garment, fabric, mean_body, False, statistics, versions))
            continue
        for row, betas in enumerate(arrays["betas"]):
            statistics = {key: float(arrays[key][row]) for key in STATISTICS}
            shape, test = tuple(map(float, betas)), bool(arrays["test"][row])
            samples.append(Sample(path, row, garment, fabric, shape, test, statistics, versions))
    return samples


def manifest_table(root: Path, samples: Iterable[Sample], manifest: Manifest) -> str:
    """One line of CSV for each sample: where it lies, what it is, which split it is in, whether it is kept, and why.

    `split` is "training" where the garment and the body shape may be trained on; `broken_rules` is empty for kept
    samples. With the checksums beside it, it says exactly what a dataset holds.

    Args:
        root: Folder of the dataset.
        samples: From `read_samples`.
        manifest: Splits of designs and topologies.

    Returns:
        The text of the CSV file.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    head = ["file", "row", "design", "topology_seed", "fabric", "betas", "split", "kept", "broken_rules"]
    writer.writerow([*head, *STATISTICS, "versions"])
    for sample in samples:
        broken = sample.broken_rules()
        training = manifest.split(sample.design, sample.seed) == "training" and not sample.test
        what = [sample.path.relative_to(root).as_posix(), "" if sample.row is None else sample.row]
        what += [sample.design, sample.seed, sample.fabric, " ".join(f"{beta:.6g}" for beta in sample.betas)]
        what += ["training" if training else "test", "no" if broken else "yes", " ".join(broken)]
        values = [f"{sample.statistics[key]:.6g}" for key in STATISTICS]
        writer.writerow([*what, *values, " ".join(f"{k}={v}" for k, v in sorted(sample.versions.items()))])
    return text.getvalue()
