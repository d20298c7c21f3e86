# pyright: strict
"""Which test would tell the remaining candidates apart: the expected information of each, per minute.

    I = −Σ_i p_i ln Σ_j p_j exp(−δ²_ij / 8),    δ²_ij = min ‖W(r_i − r_j(θ_j))‖² over the rival's parameters

r_i is what candidate i, as it was fitted, would add to the outputs under a test's excitation; W whitens by
the channel's noise (white and Gauss–Markov), and what every mount is recalibrated for (bias, a matrix's rows)
is projected out. exp(−δ²/8) is the Bhattacharyya coefficient of two Gaussian predictions of one covariance
(Kailath, IEEE Trans. Communication Technology 15, 1967). Candidates that differ in their noise add the same
coefficient of their variances at each octave of averaging time. A rival's parameters are free, or held by
what is known of them where standard uncertainties are given. Bits: I / ln 2.

Out of scope: the time for mounting, and new candidates that a test might bring up.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from dut_emulator.effects.effect import FloatArray
from gap_diagnosis.observation import Channel
from gap_diagnosis.planned_tests import PlannedTest, planned_tests
from gap_diagnosis.predicted_columns import Hypothesis, OutputNoise, PredictedColumns, noise_distance
from protocol.errors import Fault, TestloomError

LEAST_BITS = 0.005
"""A test that says less says nothing."""
_RANK = 1e-9


@dataclass(frozen=True)
class TestWorth:
    """What one test is expected to say. `distances`: δ²_ij, (k, k)."""

    __test__ = False  # pytest: not a test class, in spite of its name

    test: PlannedTest
    expected_bits: float
    distances: FloatArray

    @property
    def bits_per_minute(self) -> float:
        """Of the run."""
        return self.expected_bits / self.test.minutes


@dataclass(frozen=True)
class NextTest:
    """The test with the most expected information per minute, and all others after it."""

    profile: str
    values: Mapping[str, float]
    minutes: float
    expected_bits: float
    bits_per_minute: float
    separates: tuple[str, ...]
    all_ranked: tuple[TestWorth, ...]

    def as_document(self) -> dict[str, Any]:
        """'next_test' of report.json."""
        return {
            **_ranked_entry(self.all_ranked[0]),
            "separates": list(self.separates),
            "ranked": [_ranked_entry(worth) for worth in self.all_ranked],
        }


def next_test(
    product: str,
    hypotheses: Sequence[Hypothesis],
    noise: Mapping[Channel, OutputNoise],
    stand_kind: str = "",
    progress: Callable[[float], None] | None = None,
) -> NextTest | None:
    """The test of this product that tells the hypotheses apart best; None if none tells anything.

    Args:
        product: in the catalogue.
        hypotheses: with probabilities, which are made to sum to 1.
        noise: of the channels that the unit has; others are not looked at.
        stand_kind: where the data came from. Its errors do not act on another kind of stand.
        progress: told the share that is done.

    Raises:
        TestloomError: no such product, or a channel without white noise.
    """
    total = sum(one.probability for one in hypotheses)
    if len(hypotheses) < 2 or not total > 0:
        return None
    for channel, of_channel in noise.items():
        if not of_channel.white_si_per_sqrt_hz > 0:
            raise TestloomError(
                f"The white noise of {channel.name} is not known: no test can be weighed.",
                where="believed noise",
                fault=Fault.DATA,
                remedy="state it in the recording's 'believed'.",
            )
    chances = np.array([one.probability / total for one in hypotheses])
    tests = planned_tests(product)
    found: list[TestWorth] = []
    for done, test in enumerate(tests, start=1):
        distances = _distances(test, hypotheses, noise, stand_kind)
        found.append(TestWorth(test, _expected_bits(chances, distances), distances))
        if progress is not None:
            progress(done / len(tests))
    ranked = sorted(found, key=lambda worth: -worth.bits_per_minute)
    best = ranked[0]
    if best.expected_bits < LEAST_BITS:
        return None
    return NextTest(
        best.test.profile,
        dict(best.test.values),
        best.test.minutes,
        best.expected_bits,
        best.bits_per_minute,
        _separated(hypotheses, chances, best.distances),
        tuple(ranked),
    )


def _expected_bits(chances: FloatArray, distances: FloatArray) -> float:
    overlap = np.exp(-distances / 8.0) @ chances
    return max(float(-(chances * np.log2(overlap)).sum()), 0.0) + 0.0  # a zero has no sign


def _separated(
    hypotheses: Sequence[Hypothesis], chances: FloatArray, distances: FloatArray
) -> tuple[str, ...]:
    """The pair that gains most, whichever of the two is right."""
    seen = -np.expm1(-distances / 8.0)
    gain = np.outer(chances, chances) * (seen + seen.T)
    gain[np.tril_indices(len(gain))] = -1.0
    row, column = np.unravel_index(int(np.argmax(gain)), gain.shape)
    return hypotheses[int(row)].name, hypotheses[int(column)].name


def _distances(
    test: PlannedTest,
    hypotheses: Sequence[Hypothesis],
    noise: Mapping[Channel, OutputNoise],
    stand_kind: str,
) -> FloatArray:
    """(k, k) δ²_ij: i is true, j the rival whose parameters are free."""
    fine = any(one.acts_in_milliseconds for one in hypotheses)
    elsewhere = stand_kind not in ("", test.stand)
    columns = PredictedColumns(test.stimulus(fine=fine), elsewhere=elsewhere)
    totals = [columns.total(one) for one in hypotheses]
    tangents = [columns.tangents(one) for one in hypotheses]
    gram = np.zeros((len(columns), len(columns)))
    for channel, of_channel in noise.items():
        gram += columns.gram(channel, of_channel)
    count = len(hypotheses)
    distances = np.zeros((count, count))
    for j, (places, precision) in enumerate(tangents):
        inner = gram[np.ix_(places, places)] + np.diag(precision)
        scale = np.sqrt(np.diag(inner))
        scale[scale == 0] = 1.0
        inverse = cast(
            "FloatArray", np.linalg.pinv(inner / np.outer(scale, scale), rcond=_RANK, hermitian=True)
        )
        for i in range(count):
            if i == j:
                continue
            apart = np.zeros(len(columns))
            apart[totals[i]] += 1.0
            apart[totals[j]] -= 1.0
            along = (gram[places] @ apart) / scale
            left = float(apart @ gram @ apart - along @ inverse @ along)
            distances[i, j] = max(left, 0.0) + noise_distance(test, hypotheses[i], hypotheses[j], noise)
    return distances


def _ranked_entry(worth: TestWorth) -> dict[str, Any]:
    return {
        "profile": worth.test.profile,
        "values": dict(worth.test.values),
        "minutes": round(worth.test.minutes, 3),
        "expected_bits": round(worth.expected_bits, 4),
    }
