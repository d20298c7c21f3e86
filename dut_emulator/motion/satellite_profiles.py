# pyright: strict
"""What a satellite simulator plays."""

from dut_emulator.motion.profile import ProfileKind

KINDS: tuple[ProfileKind, ...] = ()
