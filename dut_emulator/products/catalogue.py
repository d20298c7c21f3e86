# pyright: strict
"""Every product there is, by its name. A product is imported when it is asked for."""

from importlib import import_module
from typing import Any

from dut_emulator.interfaces import EmulatedUnit
from dut_emulator.products.product import Product
from dut_emulator.twin import Twin
from protocol.errors import Fault, TestloomError

PRODUCTS: tuple[str, ...] = ("gnc_module", "mems_ahrs", "fog", "rate_gyro_triad", "pulse_imu")
"""Each a folder beside this file, whose `product.py` has `PRODUCT` and whose package has `make_unit`."""


def product_named(name: str) -> Product:
    """A product by its name.

    Raises:
        TestloomError: there is none of this name.
    """
    _check(name)
    product: Product = import_module(f"dut_emulator.products.{name}.product").PRODUCT
    return product


def make_unit(
    name: str, seed: int, serial: str, flash: dict[str, Any] | None = None, twin: Twin | None = None
) -> EmulatedUnit:
    """A unit for a bench: the one of this serial number in the lot of this seed.

    Args:
        flash: what it kept without power; None: as it left the factory.
        twin: its effects; None: as the lot draws them.

    Raises:
        TestloomError: there is no such product, or the twin is another product's.
    """
    _check(name)
    unit: EmulatedUnit = import_module(f"dut_emulator.products.{name}").make_unit(seed, serial, flash, twin)
    return unit


def _check(name: str) -> None:
    if name not in PRODUCTS:
        raise TestloomError(
            f"There is no product '{name}'.",
            where="products",
            fault=Fault.OPERATOR,
            remedy=f"use one of: {', '.join(PRODUCTS)}.",
        )
