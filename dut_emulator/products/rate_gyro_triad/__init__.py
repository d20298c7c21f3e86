"""The three-axis rate gyro of paper 4 (TSZ-12AA): three analogue outputs, calibrated on a rate table.

Pure: bench time comes in with every call. `make_unit` is what a server calls.
"""

from dut_emulator.products.rate_gyro_triad.unit import RateGyroUnit, make_unit

__all__ = ["RateGyroUnit", "make_unit"]
