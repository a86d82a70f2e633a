"""Light that reaches points of the scene: a soft sky with everything in the way, and lamps with soft shadows.

What a direction's light reaches is found with a depth map: the scene is rasterised along the direction, and a point
is lit when nothing nearer lies on its pixel (Williams 1978). The sky is a sum over directions (ambient occlusion), and
a lamp of some size a mean over directions near its own.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from tryon_jax.render.raster import nearest_depth

# Receivers are lifted by this much along their normal, metres, so that a surface does not shade itself.
_LIFT = 0.006


def frame_along(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Orthonormal rows: two across `direction`, and `direction` itself."""
    x, y, z = direction
    across = np.array([z, 0.0, -x] if abs(y) < 0.9 else [0.0, -z, y])
    across = across / np.linalg.norm(across)
    a, b, c = across
    return np.array([across, [y * c - z * b, z * a - x * c, x * b - y * a], direction])


def spiral(count: int) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Fractions (k + ½)/count and golden angles: even samples of a disc or, with them as heights, of a sphere."""
    k = np.arange(count) + 0.5
    return k / count, np.pi * (1 + 5**0.5) * k


@dataclass(frozen=True)
class Casters:
    """Triangles that stand in the light's way."""

    vertices: Float[np.ndarray, "V 3"]
    """Metres."""
    faces: Int[np.ndarray, "F 3"]
    normals: Float[np.ndarray, "F 3"]
    """Of any length, outwards; zero for faces that are seen from both sides."""

    @classmethod
    def of(
        cls, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], closed: Bool[np.ndarray, " F"]
    ) -> "Casters":
        """Casters of a scene.

        Args:
            vertices: Of the scene, metres.
            faces: Triangles.
            closed: Those of closed surfaces, counter-clockwise from outside: what light meets first faces it.
        """
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        return cls(vertices, faces, np.where(closed[:, None], np.cross(b - a, c - a), 0.0))

    def towards(self, direction: Float[np.ndarray, "3"]) -> Int[np.ndarray, "G 3"]:
        """The faces that light from `direction` may meet first."""
        return self.faces[self.normals @ direction >= 0]


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
        casters: Casters,
        direction: Float[np.ndarray, "3"],
        resolution: int,
    ) -> "DepthMap":
        """Rasterise the scene as seen from far away in `direction` (a unit vector towards the light).

        Args:
            casters: What stands in the way.
            direction: Unit vector towards the light.
            resolution: Pixels along each side.
        """
        axes = frame_along(direction) * np.array([[1.0], [1.0], [-1.0]])
        local = axes @ casters.vertices.T
        low, high = local.min(axis=1), local.max(axis=1)
        scale = (resolution - 4) / (high - low)[:2].max()
        to_pixels = axes * scale
        shift = np.append((resolution - (low + high)[:2] * scale) / 2, 0.0)[:, None]
        depth = nearest_depth((local * scale + shift).T, casters.towards(direction), resolution, resolution)
        return cls(to_pixels.astype(np.float32), shift.astype(np.float32), depth)

    def lit(self, points: Float[np.ndarray, "3 N"]) -> Bool[np.ndarray, " N"]:
        """True where nothing is between a point (a column, float32) and the light."""
        column, row, depth = self.to_pixels @ points + self.shift
        size = len(self.depth)
        # Points beside the map land on its border, which is empty.
        x, y = (np.clip(part.astype(np.int32), 0, size - 1) for part in (column, row))
        # A surface at 45 degrees to the light changes its depth by one pixel per pixel.
        return depth <= self.depth.ravel()[y * size + x] + np.float32(1.0)

    def softly_lit(self, points: Float[np.ndarray, "3 N"]) -> Float[np.ndarray, " N"]:
        """The same between 0 and 1: bilinear over the four nearest pixels, so that no shadow has the map's steps."""
        column, row, depth = self.to_pixels @ points + self.shift
        column, row = column - np.float32(0.5), row - np.float32(0.5)
        left, above = np.floor(column), np.floor(row)
        x, y = left.astype(np.int32), above.astype(np.int32)
        right, lower = column - left, row - above
        size = len(self.depth)
        # Points beside the map land on its border, which is empty.
        pixel = np.clip(y, 0, size - 2) * size + np.clip(x, 0, size - 2)
        # A surface at 45 degrees to the light changes its depth by one pixel per pixel.
        depth = depth - np.float32(1.0)
        flat = self.depth.ravel()
        a, b, c, d = ((depth <= flat[pixel + step]).astype(np.float32) for step in (0, 1, size, size + 1))
        upper = a + (b - a) * right
        return upper + (c + (d - c) * right - upper) * lower


def _lifted(points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "3 N"]:
    return np.ascontiguousarray((points + _LIFT * normals).T, np.float32)


def sky_light(
    casters: Casters,
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    directions: int = 40,
    resolution: int = 192,
) -> Float[np.ndarray, " N"]:
    """Light from the sky on `points`, about 1 on a level surface under the open sky.

    The sky is bright above, darker at the sides, and pale below, as light reflected by a floor. The scene's own
    triangles shade it.

    Args:
        casters: What stands in the way.
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
        lit = DepthMap.of(casters, direction, resolution).lit(lifted[:, facing])
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
        casters: Casters,
        direction: Float[np.ndarray, "3"],
        radius: float,
        samples: int,
        resolution: int = 512,
    ) -> "Lamp":
        """Light the scene from `direction`; `radius` is the lamp's half-angle in radians.

        Args:
            casters: What stands in the way.
            direction: Unit vector towards the lamp.
            radius: Half the angle that the lamp covers, radians.
            samples: Points of the lamp that are sampled.
            resolution: Pixels along each side of a depth map.
        """
        fraction, angle = spiral(samples)
        disc = radius * np.sqrt(fraction)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rays = direction + disc @ frame_along(direction)[:2]
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return cls(direction, tuple(DepthMap.of(casters, ray, resolution) for ray in rays))

    def lit(self, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, " N"]:
        """The part of the lamp that a point sees, 0 to 1."""
        lifted = _lifted(points, normals)
        total = np.zeros(lifted.shape[1], np.float32)
        for depth_map in self.maps:
            total += depth_map.softly_lit(lifted)
        return total / np.float32(len(self.maps))
