# pyright: strict
"""Motions that show an effect, for its picture. Each gives a stimulus of a few hundred samples."""

from collections.abc import Callable
from typing import Any

import numpy as np

from dut_emulator.effects.effect import FloatArray, Stimulus
from dut_emulator.gimbal_geometry import EARTH_RATE_RAD_S, body_rate_rad_s, into_body

DEG = np.pi / 180
G = 9.80665
_FIELD_T = np.array([-1.5e-6, 27e-6, -45e-6])
_LATITUDE_RAD = 34.2 * DEG
_EARTH = EARTH_RATE_RAD_S * np.array([0.0, np.cos(_LATITUDE_RAD), np.sin(_LATITUDE_RAD)])


def _scene(time_s: FloatArray, **channels: Any) -> Stimulus:
    """At rest at room temperature, but for what is given."""
    n = len(time_s)
    given: dict[str, Any] = {
        "temperature_c": np.full(n, 25.0),
        "rate_rad_s": np.zeros((n, 3)),
        "specific_force_m_s2": np.tile([0.0, 0.0, G], (n, 1)),
        "angles_rad": np.zeros((n, 3)),
        **channels,
    }
    return Stimulus(time_s=time_s, sample_period_s=float(time_s[1] - time_s[0]), **given)


def sweep(span: float, *, only_x: bool = False) -> Callable[[], Stimulus]:
    """Rate and force go up to `span`, down to −span, and back."""

    def made() -> Stimulus:
        time_s = np.linspace(0.0, 4.0, 401)
        values = np.interp(time_s, [0, 1, 3, 4], [0, span, -span, 0])[:, np.newaxis]
        inputs = values * np.array([1.0, 0.0, 0.0] if only_x else [1.0, 1.0, 1.0])
        return _scene(time_s, rate_rad_s=inputs, specific_force_m_s2=inputs)

    made.__doc__ = (
        f"The input of {'x alone' if only_x else 'every axis'} goes up, down to below zero, and back."
    )
    return made


def soak() -> Stimulus:
    """A chamber goes from −40 to 80 °C and back while the unit turns at 100 °/s about its axes."""
    time_s = np.arange(0.0, 7201.0, 20.0)
    temperature = np.interp(time_s, [0, 600, 3300, 3900, 6600, 7200], [-40, -40, 80, 80, -40, -40])
    return _scene(time_s, temperature_c=temperature, rate_rad_s=np.full((len(time_s), 3), 100 * DEG))


def rest() -> Stimulus:
    """Ten minutes from power-on."""
    return _scene(np.arange(0.0, 601.0, 2.0))


def sag() -> Stimulus:
    """The supply falls from 5.5 to 4.5 V as the current rises to 1 A."""
    time_s = np.linspace(0.0, 10.0, 101)
    return _scene(
        time_s,
        supply_v=5.5 - 0.1 * time_s,
        supply_current_a=0.1 * time_s,
        field_t=np.tile(_FIELD_T, (101, 1)),
    )


def turn() -> Stimulus:
    """One turn about the inner axis, which is horizontal, at 30 °/s."""
    time_s = np.linspace(0.0, 12.0, 361)
    return _on_gimbals(time_s, np.zeros(361), np.zeros(361), 30 * DEG * time_s, rates=(0.0, 0.0, 30 * DEG))


def tilting() -> Stimulus:
    """The middle axis goes from −90 to 90°."""
    time_s = np.linspace(0.0, 6.0, 181)
    return _on_gimbals(
        time_s,
        np.zeros(181),
        (-90 + 30 * time_s) * DEG,
        np.full(181, 30 * DEG),
        rates=(0.0, 30 * DEG, 0.0),
    )


def compass() -> Stimulus:
    """One turn about the vertical."""
    time_s = np.linspace(0.0, 12.0, 361)
    return _on_gimbals(time_s, 30 * DEG * time_s, np.zeros(361), np.zeros(361), rates=(30 * DEG, 0.0, 0.0))


def _on_gimbals(
    time_s: FloatArray,
    outer: FloatArray,
    middle: FloatArray,
    inner: FloatArray,
    rates: tuple[float, float, float],
) -> Stimulus:
    angles = np.stack([outer, middle, inner], axis=1)
    return _scene(
        time_s,
        angles_rad=angles,
        rate_rad_s=body_rate_rad_s(angles, np.tile(rates, (len(time_s), 1))),
        specific_force_m_s2=into_body(np.array([0.0, 0.0, G]), angles),
        field_t=into_body(_FIELD_T, angles),
        earth_rate_rad_s=into_body(_EARTH, angles),
    )


def spin() -> Stimulus:
    """The rate about z goes slowly from −400 to 400 °/s."""
    time_s = np.linspace(0.0, 80.0, 401)
    rate = np.zeros((401, 3))
    rate[:, 2] = (-400 + 10 * time_s) * DEG
    return _scene(time_s, rate_rad_s=rate)


def shaken() -> Stimulus:
    """5 g at 20 Hz along all axes for two seconds."""
    time_s = np.arange(0.0, 5.0, 2e-3)
    burst = np.where((time_s >= 1) & (time_s < 3), 5 * G * np.sin(2 * np.pi * 20 * time_s), 0.0)
    force = np.repeat(burst[:, np.newaxis], 3, axis=1) + np.array([0.0, 0.0, G])
    return _scene(time_s, specific_force_m_s2=force)


def shock() -> Stimulus:
    """A half sine of 80 g and 10 ms."""
    time_s = np.arange(0.0, 0.2, 5e-4)
    since = time_s - 0.08
    pulse = np.where((since >= 0) & (since < 0.01), 80 * G * np.sin(np.pi * since / 0.01), 0.0)
    return _scene(time_s, specific_force_m_s2=np.repeat(pulse[:, np.newaxis], 3, axis=1))


def start() -> Stimulus:
    """From rest to 100 °/s within 20 ms, sampled at 1 kHz."""
    time_s = np.arange(0.0, 0.2, 1e-3)
    rate = np.interp(time_s, [0.04, 0.06], [0.0, 100 * DEG])
    return _scene(time_s, rate_rad_s=np.repeat(rate[:, np.newaxis], 3, axis=1))


def swing() -> Stimulus:
    """±100 °/s at 0.5 Hz, sampled at 50 Hz, from ten seconds after power-on."""
    time_s = 10.0 + np.arange(0.0, 4.0, 0.02)
    rate = 100 * DEG * np.sin(np.pi * time_s)
    return _scene(time_s, rate_rad_s=np.repeat(rate[:, np.newaxis], 3, axis=1))


def swing_slowly() -> Stimulus:
    """±100 °/s at 0.5 Hz, sampled at 12.5 Hz."""
    time_s = np.arange(0.0, 4.0, 0.08)
    rate = 100 * DEG * np.sin(np.pi * time_s)
    return _scene(time_s, rate_rad_s=np.repeat(rate[:, np.newaxis], 3, axis=1))


def sampled_slowly() -> Stimulus:
    """A magnetometer at rest, read at 47 Hz."""
    time_s = np.arange(0.0, 95.0) / 47.0
    return _scene(time_s, field_t=np.tile(_FIELD_T, (95, 1)))


def drive_round() -> Stimulus:
    """One round of 20 m radius in 12 s, read at 10 Hz."""
    time_s = np.linspace(0.0, 12.0, 121)
    heading = 2 * np.pi * time_s / 12.0
    sine, cosine, none = np.sin(heading), np.cos(heading), np.zeros(121)
    axes = [[sine, -cosine, none], [cosine, sine, none], [none, none, none + 1.0]]
    return _scene(
        time_s,
        position_m=20.0 * np.stack([1.0 - cosine, sine, none], axis=1),
        dcm_local_from_body=np.moveaxis(np.array(axes), 2, 0),
    )


def night() -> Stimulus:
    """Eight hours at rest, at 5 Hz; the first axis is drawn."""
    return _scene(np.linspace(0.0, 28_799.8, 144_000), position_m=np.zeros((144_000, 3)))


def crank() -> Stimulus:
    """A crank of 0.15 m at two turns a second: r ω² cos θ along x."""
    time_s = np.linspace(0.0, 0.5, 181)
    angles = np.zeros((181, 3))
    angles[:, 2] = 4 * np.pi * time_s
    force = np.zeros((181, 3))
    force[:, 0] = -0.15 * (4 * np.pi) ** 2 * np.cos(angles[:, 2])
    return _scene(time_s, angles_rad=angles, specific_force_m_s2=force)
