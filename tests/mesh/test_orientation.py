"""Faces that disagree are found, turned, and told from those that look inwards."""

import numpy as np
import pytest

from tryon_jax.mesh.orientation import closed_volume, find_flips, turn_faces

VERTICES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
"""A tetrahedron that looks outwards."""


@pytest.mark.parametrize("wrong", [[], [0], [3]])
def test_the_faces_that_disagree_are_turned(wrong: list[int]) -> None:
    flip = np.isin(np.arange(4), wrong)
    found = find_flips(turn_faces(FACES, flip), 4, "mesh")
    np.testing.assert_array_equal(found, flip)
    np.testing.assert_array_equal(turn_faces(turn_faces(FACES, flip), found), FACES)


def test_volume_has_the_sign_of_the_side_that_faces_look_to() -> None:
    inwards = turn_faces(FACES, np.ones(4, bool))
    assert closed_volume(VERTICES, FACES, []) == pytest.approx(1 / 6)
    assert closed_volume(VERTICES, inwards, []) == pytest.approx(-1 / 6)


def test_an_open_border_is_closed_by_a_fan() -> None:
    # The border runs as the faces beside it do.
    assert closed_volume(VERTICES, FACES[1:], [np.array([0, 1, 2])]) == pytest.approx(1 / 6)
