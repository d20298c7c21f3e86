"""An effect that says it remembers nothing needs no row but a stretch's own and the one before it."""

import dataclasses

import numpy as np
import pytest

from tests.dut_emulator.effect_examples import DETERMINISTIC, EXAMPLES, applied, motion

WHOLE = motion()
ROWS = np.zeros(len(WHOLE.time_s), dtype=bool)
for first, last in ((0, 20), (63, 64), (150, 201), (333, 400)):
    ROWS[first:last] = True
WITH_THE_ROW_BEFORE = ROWS | np.append(ROWS[1:], False)
CUT = dataclasses.replace(
    WHOLE,
    **{
        field.name: getattr(WHOLE, field.name)[WITH_THE_ROW_BEFORE]
        for field in dataclasses.fields(WHOLE)
        if isinstance(getattr(WHOLE, field.name), np.ndarray)
    },
)
REMEMBERING = {name for name in DETERMINISTIC if EXAMPLES[name].remembers}


def of_stretches(name):
    effect = EXAMPLES[name]
    return applied(effect, CUT.true_input(effect.sensor), CUT)[ROWS[WITH_THE_ROW_BEFORE]]


def of_the_whole(name):
    effect = EXAMPLES[name]
    return applied(effect, WHOLE.true_input(effect.sensor), WHOLE)[ROWS]


@pytest.mark.parametrize("name", sorted(set(DETERMINISTIC) - REMEMBERING))
def test_stretches_alone_give_what_the_whole_record_gives(name):
    np.testing.assert_allclose(of_stretches(name), of_the_whole(name), rtol=1e-12, atol=1e-15)


def test_a_lag_a_play_and_a_delay_remember():
    """They say so, and stretches alone would give something else."""
    for name in ("gyro.bandwidth on gyro", "gyro.rate_hysteresis on gyro", "link.fixed_delay on gyro"):
        assert EXAMPLES[name].remembers
        assert not np.allclose(of_stretches(name), of_the_whole(name), rtol=1e-6, atol=0)
