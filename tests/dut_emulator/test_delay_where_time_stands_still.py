"""A copied frame has the time of its original: a delay reads on between the instants there are."""

import dataclasses

import numpy as np
import pytest

from tests.dut_emulator.effect_examples import EXAMPLES, PERIOD_S, applied, motion

COPIED = np.sort(np.append(np.arange(60), [7, 7, 23, 59]))


@pytest.mark.parametrize("delay_s", [0.4 * PERIOD_S, 1.0 * PERIOD_S, 3.3 * PERIOD_S])
def test_a_delay_over_copied_frames_is_interpolation_over_the_others(delay_s: float) -> None:
    whole = motion(60)
    rates = whole.rate_rad_s
    assert rates is not None
    stimulus = dataclasses.replace(
        whole,
        time_s=whole.time_s[COPIED],
        temperature_c=whole.temperature_c[COPIED],
        rate_rad_s=rates[COPIED],
    )
    effect = dataclasses.replace(EXAMPLES["link.fixed_delay on gyro"], delay_s=delay_s)
    wanted_s = stimulus.time_s - delay_s
    expected = np.stack([np.interp(wanted_s, whole.time_s, rates[:, axis]) for axis in range(3)], axis=1)
    np.testing.assert_allclose(applied(effect, rates[COPIED], stimulus), expected, atol=1e-9)
    assert np.isfinite(effect.basis(stimulus)["delay_s"]).all()
    ahead = dataclasses.replace(effect, delay_s=-delay_s)  # of the newest sample, whose copy tells no slope
    assert np.isfinite(applied(ahead, rates[COPIED], stimulus)).all()
