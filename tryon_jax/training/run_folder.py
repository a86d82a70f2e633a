"""The folder of a training run: its model, and the record of its trainings.

RUN/model.safetensors     the model so far: R_mean, then R_smooth, then one R_fine after the other
RUN/mean/, RUN/smooth/, RUN/fine-<fabric>/      curve.csv, checkpoint.npz, record.json of each stage
"""

import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax

from tryon_jax.nets import store
from tryon_jax.tryon import TryOnModel, save_model


def model_path(run: Path) -> Path:
    """Where a run keeps its model."""
    return run / "model.safetensors"


def save_stage(run: Path, model: TryOnModel, name: str, result: dict[str, Any]) -> None:
    """Write the run's model, the record of its newest training after those that it continues.

    Args:
        run: Folder of the run.
        model: With the trained stage.
        name: Of the training: "smooth", "fine-<fabric>" or "collisions-<fabric>".
        result: Its record.
    """
    record = store.read_record(model_path(run)).get("training", {})
    earlier = record.get(name)
    record[name] = dict(result)
    if earlier is not None and "continues" not in result:
        again = all(earlier.get(key) == result.get(key) for key in ("options", "dataset"))
        before = earlier.get("continues") if again else earlier
        record[name] |= {"continues": before} if before else {}
    if name.startswith("fine-"):
        # These weights have not been through a collision step.
        record.pop(name.replace("fine-", "collisions-"), None)
    save_model(model_path(run), model, record)


def chain(record: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """A stage's trainings in their order: those that its record continues, then its own."""
    earlier = record.get("continues")
    return [*chain(earlier), record] if earlier else [record]


def platform_record() -> dict[str, str]:
    """What a model is trained on."""
    return {"machine": platform.machine(), "python": platform.python_version(), "device": jax.devices()[0].device_kind}
