# pyright: strict
"""Every product there is, by its name. A product is imported when it is asked for."""

from importlib import import_module

from dut_emulator.products.product import Product
from protocol.errors import Fault, TestloomError

PRODUCTS: tuple[str, ...] = ("gnc_module", "mems_ahrs", "fog", "rate_gyro_triad", "pulse_imu")
"""Each a folder beside this file, whose `product.py` has `PRODUCT` and whose package has `make_unit`."""


def product_named(name: str) -> Product:
    """A product by its name.

    Raises:
        TestloomError: there is none of this name.
    """
    if name not in PRODUCTS:
        raise TestloomError(
            f"There is no product '{name}'.",
            where="products",
            fault=Fault.OPERATOR,
            remedy=f"use one of: {', '.join(PRODUCTS)}.",
        )
    product: Product = import_module(f"dut_emulator.products.{name}.product").PRODUCT
    return product
