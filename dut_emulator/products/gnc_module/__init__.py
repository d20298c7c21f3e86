"""The GNC module of paper 1: power, firmware, self-tests, inertial sensors, on its own crystal's time.

Pure: bench time comes in with every call. `make_unit` is what a server calls.
"""

from dut_emulator.products.gnc_module.unit import GncModule, make_unit

__all__ = ["GncModule", "make_unit"]
