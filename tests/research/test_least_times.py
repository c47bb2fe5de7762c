"""Bytes behind the fusion of torch.compile, and the times that they take at least."""

from __future__ import annotations

import pytest
import torch

from research.least_times import H100, FrameWork, count_fused_bytes, main


def test_fused_operations_move_what_they_read_and_write():
    a, b = torch.zeros(2, 30, 40)
    assert count_fused_bytes(lambda: (a + b).exp() * b - a) == 3 * 4 * 1200


def test_a_window_that_is_summed_takes_no_memory_of_its_own():
    image = torch.zeros(1, 1, 64, 64)

    def blur():
        return (2 * image.unfold(2, 5, 1).unfold(3, 5, 1)).sum((-2, -1))

    assert count_fused_bytes(blur) == 4 * (64**2 + 60**2)


def test_what_is_not_one_graph_is_an_error():
    with pytest.raises(RuntimeError):
        count_fused_bytes(lambda: torch.zeros(1) if torch.ones(1).item() else None)


def test_the_least_time_is_bytes_by_bandwidth():
    work = FrameWork(multiply_adds=0, bytes_apart=H100.bandwidth / 1e6, bytes_fused=0)
    assert work.least_ms(H100, pixels=1000) == (pytest.approx(1.0), 0, 0)


@pytest.mark.slow
def test_the_table_has_a_line_for_each_row(capsys):
    """Fused loops of the filters move less than half of what their operations move apart."""
    main(["mean,eaw"])
    *_, mean, eaw = capsys.readouterr().out.splitlines()
    apart, fused = (float(cell) for cell in eaw.split("|")[2:4])
    assert mean.startswith("| `mean` |")
    assert 0 < fused < apart / 2
