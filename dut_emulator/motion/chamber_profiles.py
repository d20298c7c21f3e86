# pyright: strict
"""What a chamber is told: temperature ramps and soaks."""

from dut_emulator.motion.profile import ProfileKind

KINDS: tuple[ProfileKind, ...] = ()
