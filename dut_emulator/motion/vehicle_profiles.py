# pyright: strict
"""Drives and flights."""

from dut_emulator.motion.profile import ProfileKind

KINDS: tuple[ProfileKind, ...] = ()
