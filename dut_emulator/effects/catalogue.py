# pyright: strict
"""Every effect there is, by its name. The conformance suite and the document run over this table."""

from typing import Any

from dut_emulator.effects import (
    couplings,
    deterministic,
    dynamics,
    fields_and_tones,
    link,
    nonlinearity,
    slow_noise,
    stand,
    stand_surroundings,
    stochastic,
    thermal,
)
from dut_emulator.effects.catalogue_effect import CatalogueEffect
from dut_emulator.effects.effect import SensorName, name_of
from protocol.errors import Fault, TestloomError

KINDS: tuple[type[CatalogueEffect], ...] = (
    deterministic.Misalignment,
    deterministic.ScaleFactorError,
    deterministic.Bias,
    deterministic.BiasTemperature,
    thermal.ScaleFactorTemperature,
    thermal.MisalignmentTemperature,
    thermal.TemperatureRate,
    thermal.ThermalHysteresis,
    thermal.WarmUp,
    nonlinearity.ScaleFactorAsymmetry,
    nonlinearity.ScaleFactorNonlinearity,
    nonlinearity.EvenNonlinearity,
    nonlinearity.QuadraticNonlinearity,
    nonlinearity.OddQuadraticNonlinearity,
    nonlinearity.CubicNonlinearity,
    nonlinearity.DeadBand,
    nonlinearity.RateHysteresis,
    couplings.GSensitivity,
    couplings.G2Sensitivity,
    couplings.SupplySensitivity,
    couplings.MagneticSensitivity,
    couplings.CrossAxisSensitivity,
    couplings.VibrationRectification,
    couplings.SizeEffect,
    couplings.ShockBiasShift,
    dynamics.Bandwidth,
    stochastic.WhiteNoise,
    stochastic.BiasInstability,
    slow_noise.FlickerNoise,
    slow_noise.RateRandomWalk,
    deterministic.Saturation,
    deterministic.Quantisation,
    fields_and_tones.HardIron,
    fields_and_tones.SoftIron,
    fields_and_tones.CurrentCoupling,
    fields_and_tones.MainsInterference,
    dynamics.GnssLatency,
    dynamics.GnssClockStep,
    fields_and_tones.AntennaLeverArm,
    slow_noise.Multipath,
    dynamics.FixedDelay,
    dynamics.ClockDrift,
    link.TimestampJitter,
    link.FrameLoss,
    link.DuplicateFrames,
    link.CounterWrap,
    fields_and_tones.Aliasing,
    stand.Wobble,
    stand.RateRipple,
    stand.EncoderEccentricity,
    stand.RemountMisalignment,
    stand_surroundings.EarthRate,
    stand.LeverArm,
    stand_surroundings.MotorField,
    stand_surroundings.ChamberGradient,
    dynamics.ChamberLag,
    stand.LevelDrift,
    stand.NonOrthogonality,
    stand.RateScaleFactor,
    stand_surroundings.CrankGeometry,
)
"""In the order of the document: what a triad does, then magnetometer, GNSS, link and stand."""


def _names() -> dict[str, tuple[type[CatalogueEffect], tuple[SensorName, ...]]]:
    found: dict[str, tuple[type[CatalogueEffect], tuple[SensorName, ...]]] = {}
    for kind in KINDS:
        for sensor in kind.sensors:
            name = name_of(kind(sensor))
            found[name] = (kind, (*found.get(name, (kind, ()))[1], sensor))
    return found


CATALOGUE: dict[str, tuple[type[CatalogueEffect], tuple[SensorName, ...]]] = _names()
"""Name → class and the triads that it may act on: one for 'gyro.bias', several for 'stand.wobble'."""


def effect_named(name: str, sensor: SensorName | None = None, **parameters: Any) -> CatalogueEffect:
    """An effect by its name, such as 'gyro.g_sensitivity', with fields as parameters; neutral without any.

    Raises:
        TestloomError: no such effect, or it is not said (or wrongly said) which triad it acts on.
    """
    if name not in CATALOGUE:
        raise TestloomError(
            f"There is no effect '{name}'.",
            where="catalogue of effects",
            fault=Fault.DATA,
            remedy=f"use one of: {', '.join(CATALOGUE)}.",
        )
    kind, sensors = CATALOGUE[name]
    chosen = sensors[0] if sensor is None and len(sensors) == 1 else sensor
    if chosen is None or chosen not in sensors:
        raise TestloomError(
            f"The effect '{name}' acts on {' or '.join(sensors)}, not on {chosen or 'a triad left open'}.",
            where="catalogue of effects",
            fault=Fault.DATA,
            remedy=f"name its sensor: {' or '.join(sensors)}.",
        )
    return kind(chosen, **parameters)


def candidate(name: str, sensor: SensorName | None = None) -> CatalogueEffect:
    """The effect with the parameters that a fit begins with."""
    kind = effect_named(name, sensor)
    return type(kind)(kind.sensor, **kind.start)
