"""Sizes and conventions of a try-on model: those with a name, or one's own."""

from dataclasses import dataclass, replace
from typing import Any, Literal

from tryon_jax.checks import check_choice
from tryon_jax.graph.build import NUM_LEVELS
from tryon_jax.graph.laplacian import Normalisation
from tryon_jax.graph.pooling import Pooling
from tryon_jax.nets.fabric_functions import field_pairs
from tryon_jax.nets.kriging import KrigingConfig
from tryon_jax.nets.unet import UNetConfig

Reference = Literal["smoothed", "paper"]
Conditioning = Literal["fields", "node"]
STANCE_EXTENT = 2.0
"""What the lowest stance of the arms counts as, beside betas of about this size."""

ADDED_LATER: dict[str, Any] = {"stance": False, "pattern_features": False}
"""Entries of a configuration that older files do not name, as they were then."""

KRIGED_NET = UNetConfig(widths=(48, 64, 96, 128))
"""An R_fine that starts from kriged drapes, which leave less to learn."""


@dataclass(frozen=True)
class TryOnConfig:
    """Everything about a model that is not an array; stored with its parameters."""

    smooth: UNetConfig
    fine: UNetConfig
    body: str = "female"
    """Name of the body."""
    layout: str = "kimono"
    """Name of the pattern's layout."""
    parameters: tuple[str, ...] | None = None
    """Active design parameters; by default those that the layout marks."""
    template_vertices: int = 403
    """Vertices T of the template."""
    target_area: float = 1.78e-4
    """Mean area of the garments' triangles, square metres."""
    mean_hidden: int = 10
    """Hidden neurons of R_mean."""
    num_betas: int = 2
    """Shape coefficients that the networks see."""
    beta_extent: tuple[float, ...] = (3.0, 2.0)
    """Half axes of the ellipse of betas that the networks were trained on: on the embedded body stature and build."""
    num_joints: int = 24
    """Skinning weights per node."""
    fabrics: tuple[str, ...] = ("gray-interlock",)
    """One R_fine each, as in the paper."""
    shared_fabrics: tuple[str, ...] = ()
    """Fabrics that a further R_fine was trained on, which serves every fabric by its numbers (needs
    `conditioning="fields"`); none: there is no such R_fine."""
    fabric_functions: int = 6
    """Functions J of a fabric's numbers that weight its fields."""
    fabric_numbers: int = 4
    """Numbers F of a fabric that those functions see."""
    stance: bool = False
    """The last of the betas is the stance of the arms, as `STANCE_EXTENT` scales it, and the fields' weights vanish in
    T-pose: of R_stance (see `tryon.stance`)."""
    conditioning: Conditioning = "fields"
    """How the body's shape enters. fields: the networks see the garment alone and predict displacement fields; a
    perceptron of the betas weights their sum, so that a new body costs one product. node: the betas are features of
    every node, and each body costs a pass of the networks (section 4 of the paper)."""
    fields: int = 24
    """Displacement fields K of each network, with `conditioning="fields"`."""
    kriging: KrigingConfig | None = None
    """Of the kriged drapes that the R_fine of each single fabric starts from; None: it starts from M_smooth."""
    kriged_fine: UNetConfig = KRIGED_NET
    """Of an R_fine that starts from kriged drapes, in place of `fine`."""
    coefficient_widths: tuple[int, ...] = (64, 64)
    """Hidden layers of the perceptron from betas to coefficients."""
    beta_periods: tuple[float, ...] = (8.0, 4.0, 2.0)
    """Periods of sines and cosines of the betas that it sees beside them."""
    wavelengths: tuple[float, ...] = (0.8, 0.4, 0.2, 0.1, 0.05)
    """Wavelengths, metres, of sines and cosines of the mean drape's positions among the node features."""
    design_features: bool = True
    """The design's parameters are features of every node; zeros, the middle of the space, for a mesh without one."""
    pattern_features: bool = False
    """The place on the mean design's flat pattern, its sines and cosines, and the side are features of every node;
    zeros for a mesh without a design."""
    num_parameters: int = 3
    """Active design parameters."""
    reference: Reference = "smoothed"
    """What R_smooth's displacement is added to: "paper": M̄ (section 4.2); "smoothed": the smoothed M̄, whose detail
    is added back before R_fine's displacement, so that neither network has to learn the smoothing."""
    fine_betas: bool = True
    """With `conditioning="node"`, R_fine sees the betas too, not only positions and skinning weights."""
    fine_detail: bool = True
    """R_fine sees the detail of the mean drape, M̄ − smooth(M̄)."""
    smoothing_length: float = 0.02
    """Length of the Laplacian smoothing that separates smooth from fine, metres."""
    pooling: Pooling = "average"
    laplacian: Normalisation = "random-walk"
    num_levels: int = NUM_LEVELS
    """Resolutions of a graph; at least as many as the deeper network has."""
    position_scale: float = 0.3
    """Node positions are divided by this, metres."""
    weight_scale: float = 0.5
    """Skinning weights are divided by this."""
    beta_scale: float = 2.0
    """Betas are divided by this."""
    detail_scale: float = 0.01
    """Detail is divided by this, metres."""

    @property
    def beta_ranges(self) -> tuple[float, ...]:
        """Largest magnitude of each beta that the networks were trained on; betas beyond `beta_extent` as its last."""
        shapes = self.num_betas - self.stance
        known = tuple(self.beta_extent[min(k, len(self.beta_extent) - 1)] for k in range(shapes))
        return (*known, STANCE_EXTENT) if self.stance else known

    @property
    def position_features(self) -> int:
        """Node features of both networks that do not depend on the body: position, its waves, skinning, design, place
        on the pattern."""
        waves = len(self.wavelengths)
        pattern = (3 + 4 * waves) * self.pattern_features
        return 3 + self.num_joints + 6 * waves + self.num_parameters * self.design_features + pattern

    @property
    def smooth_features(self) -> int:
        """Node features of R_smooth."""
        return self.position_features + self.num_betas * (self.conditioning == "node")

    @property
    def fine_features(self) -> int:
        """Node features of R_fine."""
        betas = self.num_betas * (self.fine_betas and self.conditioning == "node")
        return self.position_features + betas + 3 * self.fine_detail

    @property
    def outputs(self) -> int:
        """What R_smooth and the R_fine of one fabric predict at a node: a displacement, or one for each field."""
        return 3 * (self.fields if self.conditioning == "fields" else 1)

    @property
    def shared_outputs(self) -> int:
        """What the R_fine of all fabrics predicts at a node: a displacement for each of `field_pairs`."""
        return 3 * len(self.field_pairs)

    @property
    def field_pairs(self) -> tuple[tuple[int, int], ...]:
        """Body coefficient and fabric function of each field of the R_fine of all fabrics."""
        return field_pairs(self.fields, self.fabric_functions)

    @property
    def known_fabrics(self) -> tuple[str, ...]:
        """Names of the fabrics that the networks were trained on."""
        return tuple(dict.fromkeys((*self.fabrics, *self.shared_fabrics)))


STANCE_NET = UNetConfig(widths=(64, 96, 128, 160))
"""R_stance."""


def stance_config(config: TryOnConfig, fabrics: tuple[str, ...], **changes: Any) -> TryOnConfig:
    """Sizes of the R_stance that goes with a model.

    Args:
        config: Of the model.
        fabrics: Fabrics that it is trained on.
        changes: Fields that differ from the default sizes.
    """
    sizes = {
        "fine": STANCE_NET,
        "fields": 16,
        "fabric_functions": 3,
        "shared_fabrics": fabrics,
        "fabrics": (),
        "num_betas": config.num_betas + 1,
        "stance": True,
        "kriging": None,
        # What it adds is added to a whole drape.
        "reference": "paper",
        "conditioning": "fields",
    }
    return replace(config, **(sizes | changes))


def paper_form(config: TryOnConfig) -> TryOnConfig:
    """The same sizes in the paper's form: betas at each node, no waves and no design among the features, symmetric
    Laplacians."""
    return replace(config, conditioning="node", wavelengths=(), design_features=False, laplacian="symmetric")


SMALL = TryOnConfig(
    smooth=UNetConfig(widths=(64, 96, 128, 160, 192)),
    fine=UNetConfig(widths=(96, 144, 192, 256)),
)
"""Trains and runs on a CPU."""

PAPER = TryOnConfig(
    smooth=UNetConfig(widths=(84, 168, 336, 672, 1088), order=3),
    fine=UNetConfig(widths=(84, 168, 336, 672), order=3),
)
"""R_smooth and one R_fine together weigh at most the paper's 71 MB in float32."""

_CONFIGS = {
    "small": SMALL,
    "paper": PAPER,
    # Each body costs a pass here: a narrower network learns more in the same time.
    "small-node": paper_form(
        replace(SMALL, smooth=UNetConfig(widths=(32, 48, 64, 96)), fine=UNetConfig(widths=(32, 48, 64)))
    ),
    "paper-node": paper_form(PAPER),
}
"""With fields, and in the paper's form, betas at each node."""
Size = Literal["small", "paper", "small-node", "paper-node"]
"""Names of the configurations."""


def load_config(name: str, **changes: object) -> TryOnConfig:
    """A named configuration (see `Size`) with fields changed as given.

    Raises:
        ValueError: for an unknown name; TypeError for an unknown field.
    """
    return replace(_CONFIGS[check_choice("configuration", name, _CONFIGS)], **changes)
