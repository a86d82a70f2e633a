"""The whole method: `prepare` a garment on the host, `drape` it on the device (section 4 of the paper)."""

from tryon_jax.contact.penetration import BodyContact, PenetrationReport, body_contact, report_penetration
from tryon_jax.tryon.carrying import move_with_graph
from tryon_jax.tryon.corrections import Corrections, correct, measure_corrections
from tryon_jax.tryon.draping import (
    DrapeFields,
    DrapeStages,
    StageFields,
    apply_fields,
    drape,
    drape_fields,
    drape_stages,
    field_stages,
    fine_of,
    stages_of,
    with_design,
)
from tryon_jax.tryon.features import fine_features, smooth_features
from tryon_jax.tryon.garment import CarriedMesh, Garment, array_shapes, stack_garments
from tryon_jax.tryon.mean_drape import mean_drape
from tryon_jax.tryon.model import (
    ALL_FABRICS,
    Stage,
    TryOnModel,
    config_space,
    init_model,
    model_parameters,
    of_fabric,
    with_parameters,
)
from tryon_jax.tryon.model_file import load_model, load_pretrained, save_model
from tryon_jax.tryon.preparation import design_of, padded_edges, prepare, prepare_mesh
from tryon_jax.tryon.stages import apply_stage, base_and_detail, fine_base, fine_stage, smooth_stage

__all__ = [
    "ALL_FABRICS",
    "BodyContact",
    "CarriedMesh",
    "Corrections",
    "DrapeFields",
    "DrapeStages",
    "Garment",
    "PenetrationReport",
    "Stage",
    "StageFields",
    "TryOnModel",
    "apply_fields",
    "apply_stage",
    "array_shapes",
    "base_and_detail",
    "body_contact",
    "config_space",
    "correct",
    "design_of",
    "drape",
    "drape_fields",
    "drape_stages",
    "field_stages",
    "fine_base",
    "fine_features",
    "fine_of",
    "fine_stage",
    "init_model",
    "load_model",
    "load_pretrained",
    "mean_drape",
    "measure_corrections",
    "model_parameters",
    "move_with_graph",
    "of_fabric",
    "padded_edges",
    "prepare",
    "prepare_mesh",
    "report_penetration",
    "save_model",
    "smooth_features",
    "smooth_stage",
    "stack_garments",
    "stages_of",
    "with_design",
    "with_parameters",
]
