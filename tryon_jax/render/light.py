"""Light that reaches points of the scene: a soft sky with everything in the way, and lamps with soft shadows.

What a direction's light reaches is found with a depth map: the scene is rasterised along the direction, and a point
is lit when nothing nearer lies on its pixel (Williams 1978). The sky is a sum over directions (ambient occlusion), and
a lamp of some size a mean over directions near its own.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tryon_jax.render.raster import rasterize

# Receivers are lifted by this much along their normal, metres, so that a surface does not shade itself.
_LIFT = 0.006


def frame_along(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Orthonormal rows: two across `direction`, and `direction` itself."""
    helper = np.array([0.0, 1.0, 0.0]) if abs(direction[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    across = np.cross(helper, direction)
    across = across / np.linalg.norm(across)
    return np.stack([across, np.cross(direction, across), direction])


def spiral(count: int) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Fractions (k + ½)/count and golden angles: even samples of a disc or, with them as heights, of a sphere."""
    k = np.arange(count) + 0.5
    return k / count, np.pi * (1 + 5**0.5) * k


@dataclass(frozen=True)
class DepthMap:
    """What light from one far direction meets first."""

    to_pixels: Float[np.ndarray, "3 3"]
    """Rows that take a point to column, row and depth in pixels, before `shift`."""
    shift: Float[np.ndarray, "3 1"]
    depth: Float[np.ndarray, "R R"]
    """Depth along the light, pixels; infinite where there is nothing, as on the whole border."""

    @classmethod
    def of(
        cls,
        vertices: Float[np.ndarray, "V 3"],
        faces: Int[np.ndarray, "F 3"],
        direction: Float[np.ndarray, "3"],
        resolution: int,
    ) -> "DepthMap":
        """Rasterise the scene as seen from far away in `direction` (a unit vector towards the light).

        Args:
            vertices: Of the scene, metres.
            faces: Triangles.
            direction: Unit vector towards the light.
            resolution: Pixels along each side.
        """
        axes = frame_along(direction) * np.array([[1.0], [1.0], [-1.0]])
        local = axes @ vertices.T
        low, high = local.min(axis=1), local.max(axis=1)
        scale = (resolution - 4) / (high - low)[:2].max()
        to_pixels = axes * scale
        shift = np.append((resolution - (low + high)[:2] * scale) / 2, 0.0)[:, None]
        depth = rasterize((to_pixels @ vertices.T + shift).T, faces, resolution, resolution).depth
        return cls(to_pixels.astype(np.float32), shift.astype(np.float32), depth)

    def lit(self, points: Float[np.ndarray, "3 N"]) -> Bool[np.ndarray, " N"]:
        """True where nothing is between a point (a column, float32) and the light."""
        column, row, depth = self.to_pixels @ points + self.shift
        return self._beyond(column.astype(np.int32), row.astype(np.int32), depth)

    def softly_lit(self, points: Float[np.ndarray, "3 N"]) -> Float[np.ndarray, " N"]:
        """The same between 0 and 1: bilinear over the four nearest pixels, so that no shadow has the map's steps."""
        column, row, depth = self.to_pixels @ points + self.shift
        left, above = np.floor(column - np.float32(0.5)), np.floor(row - np.float32(0.5))
        right_share, lower_share = column - np.float32(0.5) - left, row - np.float32(0.5) - above
        x, y = left.astype(np.int32), above.astype(np.int32)
        upper = self._beyond(x, y, depth) * (1 - right_share) + self._beyond(x + 1, y, depth) * right_share
        lower = self._beyond(x, y + 1, depth) * (1 - right_share) + self._beyond(x + 1, y + 1, depth) * right_share
        return upper * (1 - lower_share) + lower * lower_share

    def _beyond(
        self, column: Int[np.ndarray, " N"], row: Int[np.ndarray, " N"], depth: Float[np.ndarray, " N"]
    ) -> Bool[np.ndarray, " N"]:
        size = len(self.depth)
        # Points beside the map land on its border, which is empty.
        pixel = np.clip(row, 0, size - 1) * size + np.clip(column, 0, size - 1)
        # A surface at 45 degrees to the light changes its depth by one pixel per pixel.
        return depth <= self.depth.ravel()[pixel] + np.float32(1.0)


def _lifted(points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "3 N"]:
    return np.ascontiguousarray((points + _LIFT * normals).T, np.float32)


def sky_light(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    directions: int = 40,
    resolution: int = 192,
) -> Float[np.ndarray, " N"]:
    """Light from the sky on `points`, about 1 on a level surface under the open sky.

    The sky is bright above, darker at the sides, and pale below, as light reflected by a floor. The scene's own
    triangles shade it.

    Args:
        vertices: Of the scene, metres.
        faces: Triangles.
        points: Where the light is asked for, metres.
        normals: Unit normal at each point.
        directions: Number of directions that are sampled.
        resolution: Pixels along each side of a depth map.
    """
    fraction, angle = spiral(directions)
    y = 1 - 2 * fraction
    ring = np.sqrt(1 - y**2)
    towards = np.stack([ring * np.cos(angle), y, ring * np.sin(angle)], axis=1)
    radiance = np.where(y > 0, 0.62 + 0.75 * y, 0.42 + 0.2 * y)
    lifted = _lifted(points, normals)
    cosines = np.maximum(towards @ normals.T, 0) * radiance[:, None]
    total = np.zeros(len(points))
    for direction, cosine in zip(towards, cosines, strict=True):
        facing = np.flatnonzero(cosine)
        lit = DepthMap.of(vertices, faces, direction, resolution).lit(lifted[:, facing])
        total[facing] += cosine[facing] * lit
    return total * 4 / directions


@dataclass(frozen=True)
class Lamp:
    """A round soft box far away."""

    direction: Float[np.ndarray, "3"]
    """Unit vector towards it."""
    maps: tuple[DepthMap, ...]
    """One for each point of its face; their mean is the soft shadow."""

    @classmethod
    def of(
        cls,
        vertices: Float[np.ndarray, "V 3"],
        faces: Int[np.ndarray, "F 3"],
        direction: Float[np.ndarray, "3"],
        radius: float,
        samples: int,
        resolution: int = 512,
    ) -> "Lamp":
        """Light the scene from `direction`; `radius` is the lamp's half-angle in radians.

        Args:
            vertices: Of the scene, metres.
            faces: Triangles.
            direction: Unit vector towards the lamp.
            radius: Half the angle that the lamp covers, radians.
            samples: Points of the lamp that are sampled.
            resolution: Pixels along each side of a depth map.
        """
        fraction, angle = spiral(samples)
        disc = radius * np.sqrt(fraction)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rays = direction + disc @ frame_along(direction)[:2]
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return cls(direction, tuple(DepthMap.of(vertices, faces, ray, resolution) for ray in rays))

    def lit(self, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
        """The part of the lamp that a point sees, 0 to 1."""
        lifted = _lifted(points, normals)
        return np.mean([depth_map.softly_lit(lifted) for depth_map in self.maps], axis=0)
