"""R_stance as a session uses it: compiled once for a size of garment, its fields kept for the last garments."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tryon_jax.body.pose import pose_body
from tryon_jax.body.stance import arms_turns
from tryon_jax.physics.fabric_numbers import host_fabric_numbers
from tryon_jax.physics.fabrics import load_fabric
from tryon_jax.tryon import TryOnModel
from tryon_jax.tryon.stance import StanceFields, stance_fields, stand
from tryon_jax.types import ArrayLike, Body
from tryon_jax.wear.dressed import DressedBody
from tryon_jax.wear.last_used import LastUsed

_KEPT = 16


def _cloth_and_skin(
    fields: StanceFields,
    body: Body,
    betas: Float[ArrayLike, " b"],
    degrees: Float[ArrayLike, ""],
    vertices: Float[ArrayLike, "M 3"],
    skinning: Float[ArrayLike, "M J"],
) -> tuple[Float[Array, "M 3"], Float[Array, "B 3"]]:
    """Both in one program: two would take longer to compile."""
    pose = jnp.deg2rad(degrees) * jnp.asarray(arms_turns(body), jnp.asarray(vertices).dtype)
    return stand(fields, body, betas, degrees, vertices, skinning), pose_body(body, betas, pose)[0]


class Standing:
    """Dressed bodies of one model with their arms lowered."""

    def __init__(self, model: TryOnModel) -> None:
        """Get ready; nothing is compiled before it is needed."""
        self._model = model
        self._make_fields, self._stand = jax.jit(stance_fields), jax.jit(_cloth_and_skin)
        self._fields: LastUsed[StanceFields] = LastUsed(_KEPT)

    def __call__(
        self, dressed: DressedBody, degrees: float, skinning: Float[np.ndarray, "V J"]
    ) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "B 3"]]:
        """Garment and body, metres.

        Args:
            dressed: In T-pose, on the networks' body.
            degrees: Of the arms below the horizontal, within the range of `arms_pose`.
            skinning: Skinning weights of the garment.

        Raises:
            ValueError: The model has no R_stance.
        """
        garment, body = dressed.garment.garment, self._model.body
        numbers = host_fabric_numbers(load_fabric(dressed.fabric))
        fields = self._fields.get(
            (dressed.garment, numbers.tobytes()), lambda: self._make_fields(self._model, garment, numbers)
        )
        # Padded as the fields are, so that another garment of the size compiles nothing.
        rows = np.shape(fields.fields)[0]
        vertices, weights = (
            np.pad(np.asarray(a, np.float32), ((0, rows - len(a)), (0, 0))) for a in (dressed.vertices, skinning)
        )
        betas = np.asarray(dressed.body.betas, np.float32)
        standing, skin = self._stand(fields, body, betas, np.float32(degrees), vertices, weights)
        return np.asarray(standing)[: len(dressed.vertices)], np.asarray(skin)
