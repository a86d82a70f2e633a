"""A garment and its body as one mesh with sliders for the betas, for programs that know nothing of this library.

The drape is a nonlinear function of the betas, morph targets are linear in their weights. So each beta gets two
targets, one for each side of 0, and each pair of betas one for their product; a weight of 1 is the end of the range
that the networks know. The body is linear in the betas, so its targets are exact. The garment's are fitted by least
squares to drapes all over the range, and corrected until what they give there is outside the body, or nearly so.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tryon_jax.contact.push_out import CLEARANCE, push_out
from tryon_jax.files.export import SKIN, mesh_part
from tryon_jax.files.morph_glb import MorphedPart, Morphs, write_morph_glb
from tryon_jax.wear.dressed import ShapedBody
from tryon_jax.wear.prepared import PreparedGarment
from tryon_jax.wear.session import Session

_STEPS = 5
"""Bodies along each beta that the targets are fitted to, where there are two; random ones where there are more."""
_TESTED = 32
"""Random bodies on which they are measured."""
_ROUNDS = 3
"""How often what the targets give is pushed out of the bodies, and the targets fitted again."""
_AIM = CLEARANCE + 0.002
"""Metres from the body that the targets aim at: between the fitted bodies they are off by millimetres."""


@dataclass(frozen=True)
class MorphError:
    """How far a drape from the targets is from the drape itself, on bodies that were not fitted."""

    mean: float
    """Of all vertices, metres."""
    largest: float
    """Metres."""
    inside: float
    """Share of the vertices that lie inside the body."""
    deepest: float
    """Depth of the deepest, metres; 0 when none is inside."""


@dataclass(frozen=True, eq=False)
class MorphTargets:
    """The mean body and its garment, and what each target adds."""

    garment: PreparedGarment
    body: ShapedBody
    """The mean body."""
    fabric: str
    extent: Float[np.ndarray, " b"]
    """Betas of weight 1."""
    base: Float[np.ndarray, "V 3"]
    """The garment where all weights are 0, metres."""
    moves: Float[np.ndarray, "T V 3"]
    """What each target adds to the garment at weight 1, metres."""
    body_moves: Float[np.ndarray, "T B 3"]
    """What it adds to the body, metres; zero for products."""
    error: MorphError
    sliders: MorphError
    """With the weights of the products left at 0."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of the targets: "beta1+", "beta1-", …, "beta1*beta2"."""
        return target_names(len(self.extent))

    def weights(self, betas: Float[np.ndarray, "*n b"]) -> Float[np.ndarray, "*n T"]:
        """Weights of the targets for bodies of these betas."""
        return target_weights(betas / self.extent)

    def apply(self, betas: Float[np.ndarray, "*n b"]) -> Float[np.ndarray, "*n V 3"]:
        """The garment on bodies of these betas, metres."""
        return self.base + np.tensordot(self.weights(betas), self.moves, 1)

    def lines(self) -> list[str]:
        """What they are worth, in words."""
        error, alone = self.error, self.sliders
        extent = ", ".join(f"beta{k} = ±{value:g}" for k, value in enumerate(self.extent, start=1))
        return [
            f"morphs   {len(self.moves)} targets ({', '.join(self.names)}); weight 1 is {extent}",
            f"morphs   {1e3 * error.mean:.1f} mm from the drape on average, {1e3 * error.largest:.0f} mm at most, on "
            f"{_TESTED} random bodies; {1e3 * alone.mean:.1f} and {1e3 * alone.largest:.0f} mm without the products",
            f"morphs   {100 * error.inside:.2f} % of the vertices in the body, {1e3 * error.deepest:.1f} mm at most",
        ]


def target_names(num_betas: int) -> tuple[str, ...]:
    """Names of the targets of so many betas."""
    numbers = range(1, num_betas + 1)
    halves = [f"beta{k}{sign}" for k in numbers for sign in "+-"]
    return (*halves, *(f"beta{a}*beta{b}" for a, b in combinations(numbers, 2)))


def target_weights(shares: Float[np.ndarray, "*n b"]) -> Float[np.ndarray, "*n T"]:
    """Weights of the targets where each beta is a share of its range, -1 to 1."""
    halves = np.stack([np.maximum(shares, 0), np.maximum(-shares, 0)], axis=-1).reshape(*shares.shape[:-1], -1)
    products = [shares[..., a] * shares[..., b] for a, b in combinations(range(shares.shape[-1]), 2)]
    return np.concatenate([halves, *(product[..., None] for product in products)], axis=-1)


def fit_morph_targets(
    session: Session,
    garment: PreparedGarment,
    fabric: str,
    *,
    outside: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> MorphTargets:
    """Fit targets to a garment's drapes on bodies all over the range that the networks know.

    Args:
        session: Of the networks' own body.
        garment: From `session.prepare`.
        fabric: One of `session.fabrics`.
        outside: Fit drapes that are pushed out of their bodies.
        progress: Told how many drapes are done, and of how many.

    Raises:
        ValueError: The session dresses another body, or an unknown fabric.
    """
    if session.other is not None:
        raise ValueError("morph targets are for the networks' own body")
    extent = np.array(session.model.config.beta_ranges, float)
    shares, tested = fitted_shares(len(extent)), np.random.default_rng(1).uniform(-1, 1, (_TESTED, len(extent)))
    rounds = _ROUNDS if outside else 0
    total, done = len(shares) * (1 + rounds) + len(tested), 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    def draped(share: np.ndarray, clearance: float) -> tuple[ShapedBody, np.ndarray]:
        dressed = session.drape(garment, share * extent, fabric=fabric)
        if outside:
            dressed = session.push_out(dressed, clearance)
        step()
        return dressed.body, dressed.vertices.astype(np.float64)

    bodies, drapes = zip(*(draped(share, _AIM) for share in shares), strict=True)
    known = np.column_stack([np.ones(len(shares)), target_weights(shares)])
    solve = np.linalg.pinv(known)
    wanted = np.stack(drapes)
    fitted = np.tensordot(solve, wanted, 1)
    for _ in range(rounds):
        made = np.tensordot(known, fitted, 1)
        for k, body in enumerate(bodies):
            # What the fit takes back of a push is asked for again, on top of what was asked before.
            wanted[k] += push_out(made[k], garment.faces, body.surface, _AIM, max_rounds=5).vertices - made[k]
            step()
        fitted = np.tensordot(solve, wanted, 1)

    weights = target_weights(tested)
    without = weights.copy()
    without[:, 2 * len(extent) :] = 0
    truth = [draped(share, CLEARANCE) for share in tested]
    directions = np.moveaxis(np.asarray(session.body.shapedirs)[..., : len(extent)], -1, 0)
    ends = extent[:, None, None] * directions
    halves = np.stack([ends, -ends], axis=1).reshape(-1, *ends.shape[1:])
    products = np.zeros((weights.shape[1] - len(halves), *ends.shape[1:]))
    return MorphTargets(
        garment=garment,
        body=session.shape(()),
        fabric=fabric,
        extent=extent,
        base=fitted[0],
        moves=fitted[1:],
        body_moves=np.concatenate([halves, products]),
        error=_error(fitted, weights, truth),
        sliders=_error(fitted, without, truth),
    )


def fitted_shares(num_betas: int) -> Float[np.ndarray, "n b"]:
    """Bodies that targets are fitted to, as shares of the range of each beta, -1 to 1."""
    if num_betas > 2:
        return np.random.default_rng(0).uniform(-1, 1, (_STEPS**2 * num_betas, num_betas))
    ticks = [np.linspace(-1, 1, _STEPS)] * num_betas
    return np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, num_betas)


def _error(
    fitted: Float[np.ndarray, "T1 V 3"],
    weights: Float[np.ndarray, "n T"],
    truth: list[tuple[ShapedBody, Float[np.ndarray, "V 3"]]],
) -> MorphError:
    distances, depths = [], []
    for row, (body, vertices) in zip(weights, truth, strict=True):
        made = fitted[0] + np.tensordot(row, fitted[1:], 1)
        distances.append(np.linalg.norm(made - vertices, axis=1))
        depths.append(-body.surface.closest(made, exact_below=0.03).distance)
    distance, depth = np.concatenate(distances), np.concatenate(depths)
    return MorphError(
        mean=float(distance.mean()),
        largest=float(distance.max()),
        inside=float((depth > 0).mean()),
        deepest=float(max(depth.max(), 0.0)),
    )


def write_morphs(path: str | Path, morphs: MorphTargets, betas: Float[np.ndarray, " b"]) -> None:
    """Write body and garment as a GLB file with sliders, and an animation that moves each beta through its range.

    Args:
        path: The file.
        morphs: From `fit_morph_targets`.
        betas: Where the sliders stand at first.
    """
    garment, body = morphs.garment, morphs.body
    parts = [
        MorphedPart(mesh_part("body", body.vertices, body.faces, material=SKIN), morphs.body_moves),
        MorphedPart(
            mesh_part("garment", morphs.base, garment.faces, uv=garment.uv, faces_uv=garment.faces_uv), morphs.moves
        ),
    ]
    numbers = range(len(morphs.extent))
    still = np.zeros(len(morphs.extent))
    frames = [still]
    for k in numbers:
        end = np.eye(len(still))[k]
        frames += [end, still, -end, still]
    about = {
        "garment": garment.label,
        "fabric": morphs.fabric,
        "betas_at_weight_1": [float(value) for value in morphs.extent],
        "weights": "with b = beta / betas_at_weight_1: beta+ is max(b, 0), beta- is max(-b, 0), beta1*beta2 is b1 * b2",
        "error_m": asdict(morphs.error),
        "error_without_products_m": asdict(morphs.sliders),
    }
    write_morph_glb(
        path,
        garment.label,
        parts,
        Morphs(
            names=morphs.names,
            weights=morphs.weights(np.asarray(betas, float)[: len(morphs.extent)]),
            frames=target_weights(np.array(frames)),
            seconds=1.0,
            extras={"tryon_jax": about},
        ),
    )
