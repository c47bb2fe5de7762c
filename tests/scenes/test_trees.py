"""Leaves stay near their tree and above the ground."""

from __future__ import annotations

import numpy as np

from rlbench.scenes.city import trees


def test_leaves_keep_to_their_tree_and_off_the_ground():
    tree = trees.Tree(3.0, -2.0)
    shape = trees.build_leaves([tree], 6)
    assert len(shape.faces) == 2 * tree.leaf_count
    away = np.hypot(shape.vertices[:, 0] - tree.x, shape.vertices[:, 1] - tree.y)
    assert away.max() < 2 * tree.crown_radius
    assert 1.2 < shape.vertices[:, 2].min() < shape.vertices[:, 2].max() < 1.3 * tree.height
