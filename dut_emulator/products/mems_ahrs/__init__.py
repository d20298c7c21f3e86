"""The MEMS attitude unit of paper 2: heat, sensors over temperature, correction, attitude, RS-422.

Pure: bench time comes in with every call. `make_unit` is what a server calls.
"""

from dut_emulator.products.mems_ahrs.unit import MemsAhrsUnit, make_unit

__all__ = ["MemsAhrsUnit", "make_unit"]
