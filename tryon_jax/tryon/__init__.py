"""The method put together: `prepare` a garment on the host, `drape` it on the device (section 4 of the paper)."""

from tryon_jax.contact.penetration import BodyContact, PenetrationReport, body_contact, report_penetration
from tryon_jax.tryon.garment import Garment, OwnMesh, stack_garments
from tryon_jax.tryon.model import (
    Stage,
    TryOnModel,
    config_space,
    init_model,
    model_parameters,
    with_parameters,
)
from tryon_jax.tryon.model_file import load_model, load_pretrained, save_model
from tryon_jax.tryon.preparation import prepare, prepare_mesh
from tryon_jax.tryon.stages import (
    DrapeStages,
    apply_stage,
    base_and_detail,
    carry,
    drape,
    drape_stages,
    fine_features,
    mean_drape,
    smooth_features,
)

__all__ = [
    "BodyContact",
    "DrapeStages",
    "Garment",
    "OwnMesh",
    "PenetrationReport",
    "Stage",
    "TryOnModel",
    "apply_stage",
    "base_and_detail",
    "body_contact",
    "carry",
    "config_space",
    "drape",
    "drape_stages",
    "fine_features",
    "init_model",
    "load_model",
    "load_pretrained",
    "mean_drape",
    "model_parameters",
    "prepare",
    "prepare_mesh",
    "report_penetration",
    "save_model",
    "smooth_features",
    "stack_garments",
    "with_parameters",
]
