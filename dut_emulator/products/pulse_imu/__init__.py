"""The pulse IMU of paper 5: three accelerometers, three gyros, each with positive and negative pulses.

Pure: bench time comes in with every call. `make_unit` is what a server calls.
"""

from dut_emulator.products.pulse_imu.unit import PulseImu, make_unit

__all__ = ["PulseImu", "make_unit"]
