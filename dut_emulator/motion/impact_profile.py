# pyright: strict
"""Impacts that set a free table turning."""

from dut_emulator.motion.profile import ProfileKind

KINDS: tuple[ProfileKind, ...] = ()
