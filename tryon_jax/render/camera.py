"""Where a picture is taken from."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tryon_jax.checks import check_choice, check_finite

VIEWS = {"front": 0.0, "three-quarter": 35.0, "side": 90.0, "back": 180.0}
"""Angle of each named view, degrees that the camera goes round the subject towards its left."""


def view_angle(view: str | float) -> float:
    """Degrees of a view: one of `VIEWS` by its name, or a number, also as text.

    Raises:
        ValueError: another name, or a number that is not finite.
    """
    if isinstance(view, str) and view not in VIEWS:
        try:
            view = float(view)
        except ValueError:
            check_choice("view", view, (*VIEWS, "degrees"))
    angle = VIEWS[view] if isinstance(view, str) else float(view)
    return float(check_finite("view", angle))


@dataclass(frozen=True)
class Camera:
    """A pinhole camera that looks slightly down at the subject from far away, as for fashion pictures."""

    target: Float[np.ndarray, "3"]
    """What is in the middle of the picture, metres."""
    azimuth: float
    """Degrees from the front (+z) towards the body's left (+x)."""
    elevation: float = 5.0
    """Degrees above the horizon."""
    distance: float = 7.0
    """Metres from the target."""

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Rows: right, up and backward (from the target to the camera) in world coordinates."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        backward = np.array(
            [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)]
        )
        right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
        return np.stack([right, np.cross(backward, right), backward])

    @property
    def position(self) -> Float[np.ndarray, "3"]:
        """Where the camera stands, metres."""
        return self.target + self.distance * self.axes[2]

    def project(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Right and up on the plane through the target, metres there, and the distance along the view, metres."""
        local = (points - self.position) @ self.axes.T
        depth = -local[:, 2:]
        return np.concatenate([local[:, :2] * self.distance / depth, depth], axis=1)

    def rays(self, screen: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N 3"]:
        """Directions (not of unit length) from the camera through points of the plane through the target."""
        on_plane = self.target + screen[:, :1] * self.axes[0] + screen[:, 1:] * self.axes[1]
        return on_plane - self.position
