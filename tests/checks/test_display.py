import pytest
import torch

from metrics.catalog import PSNR
from metrics.metric import Comparison
from rlbench.checks.display import largest_difference, psnr, to_display


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_psnr_equals_the_metric(scale):
    generator = torch.Generator().manual_seed(1)
    image, reference = scale * torch.randn(2, 3, 3, 9, 11, generator=generator)
    image[1, 0, 2, 3], image[2, 1, 4, 5] = torch.nan, torch.inf
    expected = PSNR.score(Comparison.of(image, reference, reference))
    assert torch.equal(psnr(image, reference), expected)
    assert psnr(reference, reference).tolist() == [100.0] * 3


def test_the_largest_difference_is_that_of_display_values():
    image = torch.rand(1, 3, 5, 6)
    other = image.clone()
    other[0, 1, 2, 3] = 30.0
    expected = 1.0 - float(to_display(image)[0, 1, 2, 3])
    assert largest_difference([image, image], [image, other]) == pytest.approx(expected, abs=1e-6)
    assert largest_difference([image], [image * torch.nan]) == 1.0  # the whole range
