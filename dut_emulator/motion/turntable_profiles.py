# pyright: strict
"""What the axes of a turntable are told."""

from dut_emulator.motion.profile import ProfileKind

KINDS: tuple[ProfileKind, ...] = ()
