# pyright: strict
"""Rates on a single-axis table."""

from dut_emulator.motion.profile import ProfileKind

KINDS: tuple[ProfileKind, ...] = ()
