# pyright: strict
"""What a pulse is, and what a triad's converter can do. The product's own figures, paper 5's names.

K1 = 10 000 pulses per (g s), E1 = 3600 pulses per degree: one pulse is 0.1 mg s, or one second of arc. One
accelerometer axis then puts out up to 200 kHz, one gyro axis up to 360 kHz.
"""

from dut_emulator.effects.effect import SensorName
from protocol.units_of_measure import factor_to_si

ACC_PULSES_PER_G_S = 10_000.0
GYRO_PULSES_PER_DEG = 3600.0
ACC_RANGE_G = 20.0
GYRO_RANGE_DEG_S = 100.0

TRIADS: tuple[SensorName, ...] = ("acc", "gyro")
CHANNELS: tuple[str, ...] = tuple(f"{triad}_{axis}" for triad in TRIADS for axis in "xyz")
"""The order of counters and columns."""

PULSES_PER_SI: dict[str, float] = {
    "acc": ACC_PULSES_PER_G_S / factor_to_si("g"),
    "gyro": GYRO_PULSES_PER_DEG / factor_to_si("deg/s"),
}
"""Pulses per (m/s² s), per (rad/s s)."""
