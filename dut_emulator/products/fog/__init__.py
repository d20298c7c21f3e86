"""The fibre-optic gyro of paper 3: one axis (body z), digital output, a pure lag of its own.

Pure: bench time comes in with every call. `make_unit` is what a server calls, `product.PRODUCT` a recorder.
"""

from dut_emulator.products.fog.unit import FogUnit, make_unit

__all__ = ["FogUnit", "make_unit"]
