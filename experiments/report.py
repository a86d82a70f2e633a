"""Collect the records of the experiments into docs/RESULTS.md, the paper's claims beside our numbers."""

import functools
import hashlib
import importlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.shared.record import RESULTS, read_result
from tryon_jax.cli import find_commands
from tryon_jax.files.atomic import write_text
from tryon_jax.training.run_folder import chain
from tryon_jax.tryon.model_file import SHARED, pretrained_path

SECTIONS = {
    "dataset_report": (
        "Simulated ground truth",
        "What the networks learn from and are measured against: 201 body shapes along 25 directions of two betas, "
        "half of them for tests, as in the paper; designs beyond its 19 are extra.",
    ),
    "bodies": (
        "How many bodies a design needs",
        "Beyond the paper: drapes of one garment over bodies are nearly a linear space, so few bodies of many designs "
        "say more than many bodies of few.",
    ),
    "accuracy": (
        "Accuracy",
        "Distance of each garment vertex from the simulation, on body shapes that no training has seen. Every table "
        "has the rows of what is simpler than learning.",
    ),
    "new_topologies": (
        "Generalisation to new topologies",
        "Claim of the paper: errors on topologies unseen in training are on par with those trained on. "
        "Hausdorff distance between surfaces, each topology against its own simulation.",
    ),
    "fully_connected": (
        "A fully connected network on one dense mesh",
        "Claim of the paper: on designs unseen in training its errors are consistently larger than those of the "
        "convolutional network. Hausdorff distance between surfaces; both networks keep to the same splits.",
    ),
    "memory": (
        "Memory",
        "Claim of the paper: 71 MB of weights against 167 MB of a fully connected network for one dense mesh of all "
        "garments.",
    ),
    "single_garment": (
        "A model of a single garment",
        "Claim of the paper: on par with a single-garment, fixed-topology model on that garment, and able to drape "
        "many more. The model has a fit and a wrinkle regressor on the betas (Santesteban et al. 2019, in T-pose).",
    ),
    "materials": (
        "Materials",
        "Claim of the paper: predictions have folds of their material. Here in numbers, on unseen designs and shapes.",
    ),
    "collisions": (
        "Collisions",
        "Claim of the paper: self-supervised fine-tuning removes 70 % of the collisions in training and 20 % on "
        "unseen garments. Signed distance from the skin; hands and feet are left out.",
    ),
    "tightness": (
        "Garments too tight",
        "What `tryon drape` says of a garment that could hardly be put on, against what the simulator found. The paper "
        "has no such report.",
    ),
    "qualitative": (
        "Unseen garments on unseen bodies",
        "Designs, topologies and body shapes that no training has seen, drawn as predicted, without push-out.",
    ),
    "density": (
        "Mesh density",
        "The paper keeps the mean triangle area of its meshes constant. Here it varies sixteenfold.",
    ),
    "refine": (
        "Learned drapes refined by the simulator",
        "`tryon drape --refine`: the learned drape as the start of the solver. The paper has no such step.",
    ),
    "ablation": (
        "Ablation",
        "What the paper's parts and this library's choices are worth. The paper has no such table.",
    ),
    "sweep": (
        "Choice of network and optimiser",
        "The paper does not give them. Short trainings of R_smooth that see equally many samples, judged on validation "
        "shapes and designs alone.",
    ),
    "kernels": (
        "Choice of the kernel",
        "Kriged drapes of designs, which the paper does not have, judged on validation shapes and designs alone.",
    ),
    "speed": (
        "Speed",
        "Claim of the paper: interactive rates. Here beside the simulator that made the data and beside what one "
        "would write in an afternoon.",
    ),
    "fabrics": (
        "Any fabric",
        "One R_fine that is told a fabric's measured numbers, in place of one for each fabric as in the paper.",
    ),
    "stance": (
        "Arms down",
        "Nobody stands in a T-pose, in which the paper drapes. The arms come down by simulation.",
    ),
    "stance_networks": (
        "Arms down, learned",
        "R_stance adds to a drape what lowered arms change in it. The paper has no such network.",
    ),
    "made_to_measure": (
        "Made to measure",
        "A pattern for one body, from the ease and the hem that are asked for. The paper has no such experiment.",
    ),
    "inverse": (
        "Inverse problems",
        "The drape is differentiable in design and body: both can be solved for. The paper has no such experiment.",
    ),
}
"""Title and claim of each experiment."""


@dataclass(frozen=True)
class Config:
    """Where from and where to."""

    results: Path = RESULTS
    """Folder of the records and pictures."""
    out: Path = Path("docs/RESULTS.md")
    """Page to write."""


def main(config: Config) -> None:
    """Write the page from the records that are there; what is missing is said to be missing."""
    lines = [
        "# Results",
        "",
        "Made by `python -m experiments report` from the records in "
        f"`{config.results.as_posix() if not config.results.is_absolute() else config.results.name}`; nothing on this "
        "page is typed in by hand. Each section says on what hardware and from which weights and data it was measured. "
        "Networks see training shapes, designs and topologies alone; weights are chosen on every sixteenth training "
        "shape and on designs that are never fitted; the test samples that are measured here choose nothing.",
        "",
    ]
    missing = []
    for name, (title, about) in SECTIONS.items():
        record = read_result(config.results, name)
        if record is None:
            missing.append(f"{title} (`{name}`)")
        else:
            lines += section(name, title, about, record, config)
    if missing:
        lines += ["## Not measured yet", "", *(f"- {entry}" for entry in missing), ""]
    write_text(config.out, "\n".join(lines))
    print(f"wrote {config.out}; {len(missing)} experiments not measured yet")


def section(name: str, title: str, about: str, record: dict[str, Any], config: Config) -> list[str]:
    """One experiment: what is claimed, numbers, picture, where they come from."""
    module = importlib.import_module(find_commands("experiments")[name].module)
    lines = [f"## {title}", "", about, "", *module.markdown(record["results"])]
    for suffix in (".png", ".jpg"):
        picture = config.results / f"{name}{suffix}"
        if not picture.exists():
            continue
        link = Path(os.path.relpath(picture, config.out.parent)).as_posix()
        lines += ["", f"![{title}]({link})"]
    if "model" in record and record["model"]["sha256"] not in shipped_checksums():
        lines += ["", "*Measured with other weights than those that come with the package now.*"]
    return [*lines, "", f"<sub>{provenance(record)}</sub>", ""]


@functools.cache
def shipped_checksums() -> tuple[str, ...]:
    """SHA-256 of the weights in the package: of single fabrics, and of all."""
    return tuple(hashlib.sha256(pretrained_path(name).read_bytes()).hexdigest() for name in ("small", f"small{SHARED}"))


def provenance(record: dict[str, Any]) -> str:
    """Hardware, versions, options, weights and data of a record in one line."""
    place = record["environment"]
    options = ", ".join(f"{key} = {value}" for key, value in record["config"].items())
    parts = [
        f"{place['date']}, {place['device']} ({place['cpu_cores']} cores), jax {place['jax']}, "
        f"tryon_jax {place['tryon_jax']}"
    ]
    if options:
        parts.append(f"options: {options}")
    if "model" in record:
        stages = [_stage(stage, entry) for stage, entry in record["model"]["training"].items() if stage != "platform"]
        parts.append(f"weights {record['model']['sha256'][:12]} ({', '.join(stages) or 'untrained'})")
    if "commit" in place:
        parts.append(f"commit {place['commit'][:12]}{'' if place['clean'] else ', with changes'}")
    if "dataset" in record:
        parts.append(f"dataset {record['dataset']['checksum'][:12]}, {record['dataset']['garments']} garments read")
    return "; ".join(parts)


def _stage(name: str, entry: Any) -> str:
    """A stage with the steps of all its trainings."""
    if not isinstance(entry, dict) or "steps" not in entry:
        return name
    return f"{name} {' + '.join(str(part['steps']) for part in chain(entry))} steps"
