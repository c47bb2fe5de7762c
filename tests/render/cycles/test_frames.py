"""The images that make up the frames of a clip."""

import pytest

from rlbench.render.cycles.frames import reference_images
from rlbench.render.cycles.process import image_seed


@pytest.mark.parametrize("total", [1, 31, 32, 33, 100])
def test_the_images_of_a_half_contain_each_sample_once(total, tmp_path):
    parts = reference_images(tmp_path, "referenceA", 3, 0, total)
    numbers = [n for part in parts for n in range(part.first, part.first + part.spp)]
    assert numbers == list(range(1, total + 1))
    assert {(part.seed, part.total) for part in parts} == {(image_seed(3, "referenceA", 0), total)}
