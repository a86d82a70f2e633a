"""Counts of the dataset's report, on samples whose counts are known."""

from pathlib import Path

from experiments.data.dataset_report import count_parts, count_rules, markdown
from tryon_jax.garment.manifest import load_manifest
from tryon_jax.training.dataset import RULES
from tryon_jax.training.samples import Sample


def sample(garment: str, ray: int | None, test: bool = False, broken: str = "") -> Sample:
    name = f"{garment}_knit" if ray is None else f"{garment}_knit_{ray:02d}"
    statistics = dict.fromkeys(RULES, 0.0)
    if broken:
        statistics[broken] = 2 * RULES[broken] + 1
    return Sample(Path(f"{name}.npz"), None if ray is None else 0, garment, "knit", (0.0, 0.0), test, statistics, {})


def test_parts_count_garments_and_whole_directions():
    manifest = load_manifest()
    samples = [sample("tank-0", None), sample("tank-0", 3, test=True), sample("tank-0", 4, broken="depth")]
    samples += [sample("tank-1", 3, test=True, broken="tension"), sample("vest-0", 3), sample("vest-0", 7)]
    samples += [sample("additional-0-0", None), sample("unseen-tank-0", 1), sample("tshirt-100", 2)]
    rows = {row["part"]: row for row in count_parts(samples, manifest)}
    assert list(rows) == ["training designs", "additional designs", "unseen designs", "unseen topologies"]
    base = rows["training designs"]
    assert (base["designs"], base["garments"], base["whole directions"]) == (2, 3, 1)
    assert (base["drapes"], base["kept"], base["for tests, of the kept"]) == (6, 4, 1)
    assert rows["additional designs"]["whole directions"] == 0
    assert rows["unseen topologies"]["garments"] == 1


def test_the_section_names_what_is_kept_alone():
    samples = [sample("tank-0", 3), sample("tank-0", 4, broken="depth")]
    [row] = count_rules(samples)
    assert (row["drapes"], row["kept"], row["depth"]) == (2, 1, 1)
    statistics = [{"fabric": "knit", "of": of, "statistic": "steps", "50 %": 1.0} for of in ("all", "kept")]
    results = {"samples": 2, "kept": 1, "parts": count_parts(samples, load_manifest())}
    text = "\n".join(markdown(results | {"percentiles": statistics, "along_rays": []}))
    assert "2 drapes, 50.0 % kept" in text
    assert text.count("| knit |") == 1
