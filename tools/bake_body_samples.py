"""Draw adult bodies and bring each into T-pose: the sample behind the shape directions.

The distributions are assumptions about adults (stature normal, body mass index lognormal, see `POPULATION`), not a
survey. MakeHuman's height and weight sliders are solved for each draw, because their scales are far from those of
people: its height slider alone spans 1.2 to 2.3 m.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from tqdm import tqdm

from tools.bake_body_makehuman import (
    BODY_VERTICES,
    Archive,
    BaseMesh,
    MacroTargets,
    Rig,
    read_macro_targets,
    read_target,
)
from tools.bake_body_tpose import pose_bones, skin

DENSITY = 985.0
"""kg per cubic metre of a body, to turn volume into mass."""


@dataclass(frozen=True)
class Population:
    """Adult statistics of one sex."""

    stature_mean: float
    stature_deviation: float
    bmi_median: float
    bmi_log_deviation: float


POPULATION = {"female": Population(1.63, 0.066, 23.8, 0.16), "male": Population(1.765, 0.072, 24.8, 0.14)}
BMI_RANGE = (17.0, 38.0)

LOCAL = {
    "torso/measure-bust-circ": 0.25,
    "torso/measure-waist-circ": 0.25,
    "torso/measure-hips-circ": 0.25,
    "torso/measure-shoulder-dist": 0.3,
    "torso/torso-scale-vert": 0.2,
    "torso/torso-scale-depth": 0.2,
    "hip/hip-scale-horiz": 0.25,
    "stomach/stomach-tone": 0.3,
    "buttocks/buttocks-volume": 0.3,
    "legs/upperlegs-height": 0.2,
    "legs/lowerlegs-height": 0.2,
    "legs/measure-thigh-circ": 0.25,
    "arms/measure-upperarm-circ": 0.25,
    "arms/measure-upperarm-length": 0.3,
    "arms/measure-lowerarm-length": 0.3,
    "neck/measure-neck-circ": 0.2,
}
"""Symmetric local targets and the standard deviation of each, so that people of one stature and mass still differ."""


@dataclass(frozen=True)
class Samples:
    """Bodies of one sex in T-pose, feet on y = 0, hip joints at z = 0."""

    vertices: np.ndarray
    """[N, BODY_VERTICES, 3] metres, float32."""
    heads: np.ndarray
    """[N, B, 3] heads of the rig's bones, metres."""


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Volume inside a closed surface, cubic metres."""
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    return float(np.einsum("nd,nd->", np.cross(a, b), c) / 6)


@dataclass(frozen=True)
class Sampler:
    """Everything that a draw needs, with vertices restricted to the skin and the joint cubes."""

    base: np.ndarray
    triangles: np.ndarray
    mirror: np.ndarray
    macro: MacroTargets
    local: np.ndarray
    """[16, 2, N, 3] the increasing and the decreasing target."""
    rig: Rig
    heads: sparse.csr_array
    """[B, N] averages that give the bone heads."""

    @staticmethod
    def build(archive: Archive, base: BaseMesh, rig: Rig, gender: str) -> "Sampler":
        """Read what bodies of `gender` need."""
        used = np.unique(np.concatenate([np.arange(BODY_VERTICES), *rig.heads]))
        used = np.union1d(used, base.mirror[used])
        place = np.full(len(base.vertices), -1)
        place[used] = np.arange(len(used))
        rows = np.repeat(np.arange(len(rig.heads)), [len(ids) for ids in rig.heads])
        shares = np.concatenate([np.full(len(ids), 1 / len(ids)) for ids in rig.heads])
        total = len(base.vertices)
        return Sampler(
            base=base.vertices[used],
            triangles=base.triangles,
            mirror=place[base.mirror[used]],
            macro=read_macro_targets(archive, total, gender, used),
            local=np.stack(
                [[read_target(archive, f"{name}-{way}", total)[used] for way in ("incr", "decr")] for name in LOCAL]
            ),
            rig=rig,
            heads=sparse.csr_array(
                (shares, (rows, place[np.concatenate(rig.heads)])), shape=(len(rig.heads), len(used))
            ),
        )

    def stature(self, vertices: np.ndarray) -> float:
        """Height of the standing body, metres."""
        return float(np.ptp(vertices[:BODY_VERTICES, 1]))

    def bmi(self, vertices: np.ndarray) -> float:
        """Body mass index, kg per square metre."""
        return DENSITY * volume(vertices, self.triangles) / self.stature(vertices) ** 2

    def solve(self, base: np.ndarray, sliders: dict[str, float], stature: float, bmi: float) -> np.ndarray:
        """The body with this stature and body mass index; changes `sliders` (height, weight, muscle) on the way."""

        def shape(**change: float) -> np.ndarray:
            sliders.update(change)
            return base + self.macro.apply(sliders)

        low, high = self.stature(shape(height=0.0)), self.stature(shape(height=1.0))
        shape(height=float(np.clip((stature - low) / (high - low), 0, 1)))
        # Muscle and weight interact: a muscular body never gets heavy, so muscle gives way until the mass is in reach.
        for muscle in np.linspace(sliders["muscle"], 0, 8):
            if self.bmi(shape(muscle=float(muscle), weight=1.0)) >= bmi:
                break
        low, high = 0.0, 1.0
        for _ in range(9):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.bmi(shape(weight=middle)) < bmi else (low, middle)
        return shape()

    def to_tpose(self, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Left-right symmetric T-pose on the ground: skin [BODY_VERTICES, 3] and bone heads [B, 3]."""
        vertices = 0.5 * (vertices + vertices[self.mirror] * np.array([-1, 1, 1]))
        heads = self.heads @ vertices
        rotations, posed = pose_bones(self.rig, heads)
        skinned = skin(vertices[:BODY_VERTICES], self.rig.weights, rotations, heads, posed)
        hips = [self.rig.names.index(f"upperleg01.{side}") for side in "LR"]
        origin = np.array([0.0, skinned[:, 1].min(), posed[hips, 2].mean()])
        return skinned - origin, posed - origin

    def draw(self, count: int, population: Population, rng: np.random.Generator, gender: str) -> Samples:
        """`count` bodies of `population`."""
        stature = rng.normal(population.stature_mean, population.stature_deviation, count)
        bmi = np.exp(rng.normal(np.log(population.bmi_median), population.bmi_log_deviation, count)).clip(*BMI_RANGE)
        drawn = {
            "age": rng.uniform(0, 0.5, count),
            "muscle": 0.8 * rng.beta(3, 4, count),
            "proportions": rng.beta(4, 4, count),
            "cupsize": rng.beta(3, 4, count),
            "firmness": rng.beta(4, 3, count),
        }
        local = rng.normal(0, 1, (count, len(LOCAL))).clip(-2.2, 2.2) * np.array(list(LOCAL.values()))
        start = {"gender": float(gender == "female"), "weight": 0.5, "height": 0.4}
        bodies = []
        for i in tqdm(range(count), desc=gender):
            amount = np.stack([local[i].clip(0), (-local[i]).clip(0)], axis=1)
            base = self.base + np.einsum("kw,kwnd->nd", amount, self.local)
            sliders = start | {name: float(values[i]) for name, values in drawn.items()}
            bodies.append(self.to_tpose(self.solve(base, sliders, stature[i], bmi[i])))
        return Samples(
            vertices=np.stack([skin for skin, _ in bodies]).astype(np.float32),
            heads=np.stack([heads for _, heads in bodies]).astype(np.float32),
        )


def draw_samples(archive: Archive, base: BaseMesh, rig: Rig, count: int, seed: int = 0) -> dict[str, Samples]:
    """`count` women and `count` men, drawn from one generator in this order."""
    rng = np.random.default_rng(seed)
    return {
        gender: Sampler.build(archive, base, rig, gender).draw(count, POPULATION[gender], rng, gender)
        for gender in ("female", "male")
    }
