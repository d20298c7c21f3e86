# pyright: strict
"""Sinusoidal linear acceleration on a crank."""

from dut_emulator.motion.profile import ProfileKind

KINDS: tuple[ProfileKind, ...] = ()
