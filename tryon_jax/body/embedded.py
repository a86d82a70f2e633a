"""The bodies inside the package: female, male and neutral, one topology, CC0 (made by `tools/bake_body.py`)."""

from collections.abc import Iterable
from importlib import resources

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice
from tryon_jax.types import Body

NAMES = ("female", "male", "neutral")
"""Names of the embedded bodies."""
NUM_VERTICES = 6774
"""Vertices of each embedded body."""


def read_asset(name: str, keys: Iterable[str] | None = None) -> dict[str, np.ndarray]:
    """Arrays of one embedded file, `topology` or the name of a body; all, or only `keys`."""
    source = resources.files("tryon_jax").joinpath("data", "body", f"{name}.npz")
    with source.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
        return {key: archive[key] for key in (archive.files if keys is None else keys)}


def expand_shapedirs(arrays: dict[str, np.ndarray]) -> Float[np.ndarray, "V 3 B"]:
    """Shape directions in metres, float64, from the 16-bit steps that the file holds.

    Each component has its own step, so the error stays below 0.01 mm at |betas| = 3 in every component at once. The
    pelvis is put back exactly on the origin, from which rounding had moved it by some thousandths of a millimetre.
    """
    steps = arrays["shapedirs"].astype(np.float64)
    directions = np.moveaxis(steps * arrays["shapedirs_scale"][:, None, None], 0, 2)
    return directions - np.einsum("v,vdb->db", arrays["J_regressor"][0].astype(np.float64), directions)


def load_body(name: str = "female") -> Body:
    """The embedded body `name`: "female", "male" or "neutral" (float32, 6,774 vertices, 24 joints, 10 betas).

    betas are in standard deviations of adult bodies; beta 1 > 0 is taller. Beta 2 > 0 is leaner for the female body,
    the male body spreads weight over betas 2 and 3. The neutral body joins two clusters and turns into a caricature
    beyond |beta 1| of about 2. The origin is the pelvis joint for every betas.

    Bodies are closed and face outward for every betas. Stature alone (beta 1 from -3 to 3) makes no female or male body
    cross itself. Heavy female bodies do, where the inner thighs meet (beta 2 of -2.5 and below), and very lean ones in
    the groin (2.5 and above); so does the neutral body behind the thighs at beta 1 = -3. With all ten betas uniform in
    -2 to 2, far wilder than people are, 11 of 200 female, 4 of 200 male and 20 of 200 neutral bodies cross themselves
    by 8 to 60 faces: thighs, groin and buttocks, in one neutral body also the armpits.

    Raises `ValueError` for another name.
    """
    check_choice("body", name, NAMES)
    shared, own = read_asset("topology"), read_asset(name)
    template = own["v_template"].astype(np.float64)
    template -= own["J_regressor"][0].astype(np.float64) @ template
    return Body(
        v_template=jnp.asarray(template, jnp.float32),
        shapedirs=jnp.asarray(expand_shapedirs(own), jnp.float32),
        J_regressor=jnp.asarray(own["J_regressor"], jnp.float32),
        lbs_weights=jnp.asarray(shared["lbs_weights"], jnp.float32),
        faces=jnp.asarray(shared["faces"], jnp.int32),
        parents=tuple(int(parent) for parent in shared["parents"]),
        joint_names=tuple(str(joint) for joint in shared["joint_names"]),
        name=name,
    )
