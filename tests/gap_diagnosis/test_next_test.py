"""The next test: closed forms for its distances, and choices that reason alone makes."""

import numpy as np
import pytest

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.effects.effect import Stimulus
from gap_diagnosis.fitting import FittedEffect, FittedScalar
from gap_diagnosis.next_test import NextTest, next_test
from gap_diagnosis.observation import Channel, NoiseBelief, Observation, SensorOutput
from gap_diagnosis.planned_tests import planned_tests
from gap_diagnosis.predicted_columns import Hypothesis, OutputNoise
from gap_diagnosis.proposal import hypothesis_of, noise_of
from protocol.errors import TestloomError

DEG, G = np.pi / 180, 9.80665
WHITE = 0.2 * DEG / 60
SLOW = 5 * DEG / 3600
GYROS = {Channel("gyro", axis): OutputNoise(WHITE, SLOW, 300.0) for axis in range(3)}
FOG = {Channel("gyro", 2): OutputNoise(0.01 * DEG / 60, 0.3 * DEG / 3600, 300.0)}


def candidate(name, sensor="gyro", chance=0.5, known=None, **parameters):
    known = ({} if known is None else known,)
    return Hypothesis((effect_named(name, sensor, **parameters),), chance, known)


def chosen(product, *hypotheses, noise=GYROS, stand="") -> NextTest:
    found = next_test(product, hypotheses, noise, stand)
    assert found is not None
    return found


@pytest.fixture
def only(monkeypatch):
    """Weigh only these profiles: others take time and say nothing here."""

    def choose(*profiles):
        monkeypatch.setattr(
            "gap_diagnosis.next_test.planned_tests",
            lambda product: [one for one in planned_tests(product) if one.profile in profiles],
        )

    return choose


def distance(found, profile, i=0, j=1):
    return max(worth.distances[i, j] for worth in found.all_ranked if worth.test.profile == profile)


def test_distance_of_a_shape_from_nothing_is_its_energy_over_the_noise_after_recalibration():
    """Against the same sum done sample by sample, with least squares for bias and scale."""
    square = 3e-6
    found = chosen(
        "mems_ahrs",
        candidate("gyro.even_nonlinearity", square=(square, 0.0, 0.0)),
        Hypothesis((), 0.5),
        noise={Channel("gyro", 0): OutputNoise(WHITE)},
    )
    (worth,) = [one for one in found.all_ranked if one.test.profile == "rate_staircase"]
    times = np.arange(0.0, worth.test.duration_s, 1 / 50)
    rate = worth.test.run.stimulus(times).rate_rad_s
    design = np.column_stack([np.ones(len(times)), rate])
    shape = square * rate[:, 0] ** 2
    left = shape - design @ np.linalg.lstsq(design, shape, rcond=None)[0]
    assert worth.distances[0, 1] == pytest.approx(left @ left / 50 / WHITE**2, rel=0.02)
    assert worth.distances[1, 0] == pytest.approx(
        0.0, abs=1e-6
    )  # with its amplitude free, nothing is that too


def test_slow_noise_hides_a_slow_shape_as_much_as_its_covariance_says():
    """A warm-up at rest: against the whole covariance matrix of white and Gauss–Markov noise."""
    slow = 20 * SLOW
    found = chosen(
        "rate_gyro_triad",
        candidate("gyro.warm_up", amplitude_si=(0.02 * DEG, 0, 0), time_constant_s=40.0),
        Hypothesis((), 0.5),
        noise={Channel("gyro", 0): OutputNoise(WHITE, slow, 100.0)},
    )
    worth = next(
        one for one in found.all_ranked if one.test.profile == "static" and one.test.duration_s == 200.0
    )
    step = 0.5
    times = (np.arange(400) + 0.5) * step
    covariance = slow**2 * np.exp(-np.abs(times[:, None] - times) / 100.0) + np.eye(400) * WHITE**2 / step
    shape, one = 0.02 * DEG * np.exp(-times / 40.0), np.ones(400)
    inverse = np.linalg.inv(covariance)
    expected = shape @ inverse @ shape - (shape @ inverse @ one) ** 2 / (one @ inverse @ one)
    assert worth.distances[0, 1] == pytest.approx(expected, rel=0.03)


def test_bits_are_those_of_a_choice_between_two(only):
    """Nothing is learnt where both say the same, and no more than the question holds."""
    only("static", "tumble", "multi_position")
    loud = chosen(
        "mems_ahrs",
        candidate("gyro.g_sensitivity", chance=0.2, acc=((0, 0.1 * DEG, 0),) * 3),
        Hypothesis((), 0.8),
        noise=GYROS,
    )
    overlap = np.exp(-loud.all_ranked[0].distances / 8)
    by_hand = -0.2 * np.log2(0.2 + 0.8 * overlap[0, 1]) - 0.8 * np.log2(0.8 + 0.2 * overlap[1, 0])
    assert loud.expected_bits == pytest.approx(by_hand)
    entropy = -0.2 * np.log2(0.2) - 0.8 * np.log2(0.8)
    assert all(worth.expected_bits <= entropy + 1e-12 for worth in loud.all_ranked)
    assert next_test("mems_ahrs", [Hypothesis((), 1.0)], GYROS) is None
    same = candidate("gyro.g_sensitivity", acc=((0, 1e-5, 0),) * 3)
    assert next_test("mems_ahrs", [same, same], GYROS) is None


def test_two_levels_of_white_noise_are_told_by_the_number_of_samples():
    """Bhattacharyya of two variances, n/2 ln((1 + q) / (2 √q)), q their ratio."""
    more = 0.5 * WHITE
    found = chosen(
        "fog",
        candidate("gyro.angle_random_walk", density_si_per_sqrt_hz=(0.0, 0.0, more)),
        Hypothesis((), 0.5),
        noise={Channel("gyro", 2): OutputNoise(WHITE)},
    )
    worth = next(
        one for one in found.all_ranked if one.test.profile == "static" and one.test.duration_s == 200.0
    )
    ratio = 1.25
    samples = worth.test.duration_s / worth.test.sample_period_s
    expected = 8 * samples / 2 * np.log((1 + ratio) / (2 * np.sqrt(ratio)))
    assert worth.distances[0, 1] == pytest.approx(expected, rel=0.01)


def test_gravity_has_to_turn_to_show_g_sensitivity():
    """Against an even non-linearity of the same size at 100 °/s, g-sensitivity is shown by a tumble alone."""
    found = chosen(
        "mems_ahrs",
        candidate("gyro.g_sensitivity", acc=((0, 0.002 * DEG / G, 0), (0, 0, 0), (0, 0, 0))),
        candidate("gyro.even_nonlinearity", square=(0.002 * DEG / (100 * DEG) ** 2, 0.0, 0.0)),
    )
    assert distance(found, "tumble") > 5.0
    for blind in ("swing", "static"):  # turned about the vertical, or at rest
        assert distance(found, blind) < 0.05 * distance(found, "tumble"), blind
    small = chosen(
        "mems_ahrs",
        candidate("gyro.g_sensitivity", acc=((0, 0.002 * DEG / G, 0), (0, 0, 0), (0, 0, 0))),
        Hypothesis((), 0.5),
    )
    assert small.profile in ("tumble", "multi_position", "rate_staircase")
    assert small.separates == ("gyro.g_sensitivity", "")


def test_a_ramp_up_and_down_tells_thermal_hysteresis_from_the_rate_of_temperature():
    found = chosen(
        "fog",
        candidate("gyro.thermal_hysteresis", amplitude_si=(0, 0, 0.2 * DEG / 3600), half_width_c=10.0),
        candidate("gyro.temperature_rate", coefficient_rad_per_c=(0, 0, 2.0 * DEG / 3600)),
        noise=FOG,
    )
    assert found.profile == "temperature_ramp"
    assert found.values  # the short ramp up and down, not the one with long soaks
    others = [one for one in found.all_ranked if one.test.profile != "temperature_ramp"]
    assert others
    assert max(one.expected_bits for one in others) < 0.01 * found.expected_bits


def test_a_sweep_tells_a_lag_from_a_delay(only):
    only("sweep", "swing", "static")
    found = chosen(
        "mems_ahrs",
        candidate("gyro.bandwidth", time_constant_s=5e-4),
        candidate("link.fixed_delay", "gyro", delay_s=5e-4),
    )
    assert found.profile == "sweep"
    assert distance(found, "sweep") > 3 * distance(found, "swing") > 0


def test_a_stands_error_stays_on_its_stand(only):
    """On another kind of stand a wobble would be gone, and what stays is the unit's."""
    only("spin", "rotation")
    wobble = candidate("stand.wobble", cosine_rad=(2e-4, 2e-4, 2e-4), axis="middle")
    unit = candidate("gyro.g_sensitivity", acc=((0, 0.002 * DEG / G, 0),) * 3)
    here = chosen("gnc_module", wobble, unit, stand="three_axis_turntable")
    anywhere = chosen("gnc_module", wobble, unit)
    assert distance(anywhere, "spin") > 100.0
    assert distance(here, "spin") == pytest.approx(0.0, abs=1e-9)
    assert distance(here, "rotation") == pytest.approx(distance(anywhere, "rotation"))


def test_every_test_of_every_product_can_be_weighed():
    tumbling = candidate("gyro.g_sensitivity", acc=((1e-5,) * 3,) * 3)
    for product in ("gnc_module", "fog", "rate_gyro_triad", "pulse_imu"):
        found = next_test(product, [tumbling, Hypothesis((), 0.5)], FOG)
        names = {one.profile for one in planned_tests(product)}
        assert found is None or {one.test.profile for one in found.all_ranked} == names
    document = chosen("gnc_module", tumbling, Hypothesis((), 0.5)).as_document()
    assert document["ranked"][0]["profile"] == document["profile"]


def test_what_was_not_seen_predicts_nothing(only):
    """A lever arm's x that no motion showed (3 ± 4 m) is no reason to expect anything of a test."""
    only("swing")
    arm = effect_named("stand.lever_arm", "acc", arm_m=(3.0, 5e-4, 0.0))
    scalars = (FittedScalar("arm_m_x", 3.0, 4.0, "m"), FittedScalar("arm_m_y", 5e-4, 1e-4, "m"))
    fitted = FittedEffect(arm, "stand.lever_arm", (Channel("acc", 1),), scalars, 5.0, {})
    made = hypothesis_of([fitted], 0.4)
    assert made.effects[0].arm_m == (0.0, 5e-4, 0.0)
    assert made.standard_uncertainties == ({"arm_m_x": 4.0, "arm_m_y": 1e-4},)
    found = chosen("mems_ahrs", made, Hypothesis((), 0.6), noise={Channel("acc", 1): OutputNoise(0.3 / 60)})
    seen = {one.test.profile: one.distances for one in found.all_ranked}["swing"]
    assert seen[0, 1] > 0.0
    assert seen[1, 0] < seen[0, 1]  # as the rival its arm may be a little smaller


def test_believed_noise_of_channels_with_samples():
    values = np.zeros((5, 3))
    values[:, 2] = np.nan
    output = SensorOutput(
        values, np.zeros((5, 3)), NoiseBelief(WHITE, slow_coefficient_si=SLOW), range_si=4.0
    )
    stimulus = Stimulus(np.arange(5.0), np.full(5, 25.0), 1.0)
    usable, piece = np.ones(5, dtype=bool), np.zeros(5, dtype=np.int64)
    texts = ("r", "U-1", "mems_ahrs", "swing", "1", "m1", "s", "two_axis_turntable")
    one = Observation(*texts, stimulus, False, {"gyro": output}, usable, piece, 1.0)
    found = noise_of([one])
    assert [channel.name for channel in found] == ["gyro_x", "gyro_y"]
    assert found[Channel("gyro", 0)].range_si == 4.0
    floor = np.sqrt(found[Channel("gyro", 0)].allan_variance(np.geomspace(1, 1e4, 400)) - WHITE**2
                    / np.geomspace(1, 1e4, 400)).max()  # fmt: skip
    assert floor == pytest.approx(0.664 * SLOW, rel=0.01)


def test_a_channel_without_known_noise_is_refused():
    with pytest.raises(TestloomError, match="gyro_x"):
        next_test(
            "fog",
            [Hypothesis((), 0.5), candidate("gyro.warm_up", amplitude_si=(0, 0, 1e-5))],
            {Channel("gyro", 0): OutputNoise(0.0)},
        )
