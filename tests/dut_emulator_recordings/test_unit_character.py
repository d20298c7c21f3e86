"""A unit's curves against closed form: white noise falls with the root of time, a ramp of bias is a line."""

import math

import numpy as np
import pytest

from dut_emulator.effects.catalogue import effect_named
from dut_emulator.products.catalogue import product_named
from dut_emulator.recording import unit_character
from dut_emulator.twin import Twin

ONE = (1.0, 1.0, 1.0)


def test_the_noise_at_rest_is_that_of_the_density() -> None:
    density = 2e-4
    twin = Twin("", (effect_named("gyro.angle_random_walk", density_si_per_sqrt_hz=(density,) * 3),))
    rest = unit_character.at_rest(twin, "gyro", rate_hz=100.0, samples=40_000)
    assert np.std(rest) == pytest.approx(density * math.sqrt(100.0), rel=0.01)
    again = unit_character.at_rest(twin, "gyro", rate_hz=100.0, samples=40_000)
    np.testing.assert_array_equal(rest, again)


def test_a_cycle_of_temperature_shows_slopes_and_the_sign_of_warming() -> None:
    twin = Twin(
        "",
        (
            effect_named("gyro.angle_random_walk", density_si_per_sqrt_hz=(1.0,) * 3),
            effect_named("gyro.bias_temperature", coefficients_si_per_c=((1e-5, 0.0, 0.0),)),
            effect_named("gyro.temperature_rate", coefficient_rad_per_c=(0.0, 6e-3, 0.0)),
            effect_named("gyro.scale_factor_error", scale_factor_error=(0.0, 0.0, 2e-3)),
        ),
    )
    twin = Twin("", tuple(sorted(twin.effects, key=lambda effect: effect.stage)))
    curve = unit_character.over_temperature(twin, "gyro")
    assert (curve.temperature_c.min(), curve.temperature_c.max()) == pytest.approx((-40.0, 80.0), abs=0.04)
    slope = np.polynomial.polynomial.polyfit(curve.temperature_c, curve.error[:, 0], 1)[1]
    assert slope == pytest.approx(1e-5, rel=1e-9)  # noise of 1 rad/s/√Hz is left out
    warming = np.gradient(curve.temperature_c) > 0.02
    cooling = np.gradient(curve.temperature_c) < -0.02
    # 6e-3 rad/°C at 1 °C a minute: ±1e-4 rad/s
    assert np.median(curve.error[warming, 1]) == pytest.approx(1e-4, rel=1e-6)
    assert np.median(curve.error[cooling, 1]) == pytest.approx(-1e-4, rel=1e-6)
    np.testing.assert_allclose(curve.scale_factor_error[:, 2], 2e-3, rtol=1e-9)


@pytest.mark.parametrize("sensor", ["gyro", "acc"])
def test_a_step_comes_after_the_delay_and_rises_with_the_time_constant(sensor: str) -> None:
    tau_s, delay_s = 4e-3, 1.6e-3
    twin = Twin(
        "",
        (
            effect_named(f"{sensor}.bandwidth", time_constant_s=tau_s),
            effect_named("link.fixed_delay", sensor, delay_s=delay_s),
            effect_named("link.clock_drift", sensor, relative_rate=1e-5),  # of a unit long powered: left out
        ),
    )
    times_s, answer = unit_character.step_response(twin, sensor)
    since_s = np.maximum(times_s - delay_s, 0.0)
    closed = np.repeat((1 - np.exp(-since_s / tau_s))[:, np.newaxis], 3, axis=1)
    np.testing.assert_allclose(answer, closed, atol=0.01)  # one sample of 20 µs is 0.005 of a time constant


def test_a_unit_without_bandwidth_answers_a_step_with_a_step() -> None:
    twin = product_named("gnc_module").twin(1, "U-0001")
    for sensor in unit_character.triads(twin):
        times_s, answer = unit_character.step_response(twin, sensor)
        late, early = answer[times_s >= 0.0], answer[times_s < -1e-9]
        np.testing.assert_array_equal(early, 0.0)
        np.testing.assert_allclose(late, np.broadcast_to(late[-1], late.shape), rtol=1e-12)
        np.testing.assert_allclose(late[-1], 1.0, atol=0.02)  # scale factor


def test_the_triads_are_those_that_have_effects() -> None:
    twin = Twin("", (effect_named("acc.bias", bias_si=ONE),))
    assert unit_character.triads(twin) == ("acc",)
