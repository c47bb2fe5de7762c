"""Maps of samples: those that were drawn, on one scale, without uniform ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from reports import sampling_maps
from reports.sampling_maps import draw_sampling, find_samples
from rlbench.benchmark.results import MissingRowsError

ADAPTIVE = "accumulate/contrast"


@pytest.fixture(scope="module")
def frames(kept):
    return [find_samples(clip) for clip in kept.clips]


def test_methods_that_sample_uniformly_are_left_out(frames):
    assert [list(frame.counts) for frame in frames] == [[ADAPTIVE]] * 2


def test_uniform_rows_alone_are_refused(kept):
    clip = replace(kept.clips[0], images=tuple(kept.clips[0].images[1:]))
    with pytest.raises(MissingRowsError, match="sample uniformly .eaw, mean."):
        find_samples(clip)


def test_named_rows_are_shown_even_if_they_sample_uniformly(kept):
    assert list(find_samples(kept.clips[0], ["mean", ADAPTIVE]).counts) == ["mean", ADAPTIVE]


def test_the_samples_are_those_that_were_drawn(kept, tmp_path):
    table = pd.read_csv(sampling_maps.write(kept.rows, tmp_path, kept.clips)[-1])
    # the density of the first frame, which knows no image, is uniform and costs the same
    assert table["mean_spp"].tolist() == pytest.approx([1.0, 1.0], abs=0.01)
    assert (table["most"] > 1).all()
    for row in table.to_dict("records"):
        stored = kept.psnr(row["method"], row["clip"], row["frame"])
        assert row["psnr"] == pytest.approx(stored, abs=0.01)


def test_all_maps_of_samples_share_one_scale_and_so_do_errors(frames):
    figure = draw_sampling(frames, "2 clips")
    for name in ("viridis", "magma"):
        images = [im for axes in figure.axes for im in axes.images if im.get_array().ndim == 2]
        limits = [image.get_clim() for image in images if image.get_cmap().name == name]
        assert len(limits) == 2
        assert len(set(limits)) == 1


def test_samples_that_follow_the_error_are_correlated(frames):
    error = np.random.default_rng(0).random((48, 48))
    follows = replace(frames[0], counts={"a": error * 4}, errors={"a": error})
    assert follows.rank_correlation("a") == pytest.approx(1)
    uniform = replace(frames[0], counts={"a": np.ones((48, 48))}, errors={"a": error})
    assert np.isnan(uniform.rank_correlation("a"))
