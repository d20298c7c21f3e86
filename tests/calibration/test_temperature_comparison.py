"""Paper 2's comparison on an emulated unit: 30 mg re-mounted at every temperature, 5 mg compensated."""

import pytest

from benchmarks.bench_temperature_compensation import errors_mg


@pytest.mark.slow
def test_a_badly_mounted_unit_shows_the_paper_s_two_figures() -> None:
    remounted, frozen = errors_mg(seed=1, remounted_rad=20e-3)
    assert 10.0 < remounted < 90.0
    assert frozen < 5.0
    assert remounted > 4.0 * frozen
