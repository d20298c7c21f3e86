"""The recursion of slow noise: one result, whichever way it is computed."""

import numpy as np
import pytest

from dut_emulator.effects import first_order as module
from dut_emulator.effects.first_order import first_order


def test_short_and_long_chunks_agree_to_the_last_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = np.random.default_rng(5).standard_normal((3000, 3))
    memory = np.array([0.3, -1.2, 4.0])
    short = first_order(drive, 0.9993, memory)
    monkeypatch.setattr(module, "SHORT_CHUNK", 0)
    assert np.array_equal(short, first_order(drive, 0.9993, memory))


def test_the_recursion_is_the_one_that_is_written_down() -> None:
    response = first_order(np.array([[1.0], [0.0], [0.0], [2.0]]), 0.5, np.array([0.25]))
    assert response[:, 0].tolist() == [1.25, 0.625, 0.3125, 2.15625]
    assert first_order(np.empty((0, 3)), 0.5, np.zeros(3)).shape == (0, 3)


def test_two_feeds_agree_to_the_last_bit_and_are_the_ones_written_down(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drive = np.random.default_rng(6).standard_normal((3000, 2))
    memory, feed = np.array([0.3, -1.2]), (0.3, 0.1)
    short = first_order(drive, 0.6, memory, feed)
    monkeypatch.setattr(module, "SHORT_CHUNK", 0)
    assert np.array_equal(short, first_order(drive, 0.6, memory, feed))
    response = first_order(np.array([[1.0], [0.0], [0.0]]), 0.5, np.zeros(1), (2.0, 4.0))
    assert response[:, 0].tolist() == [2.0, 5.0, 2.5]
