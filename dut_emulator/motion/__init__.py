"""What a unit goes through, exactly: axes, poses, profiles, flights. Pure functions of time.

May import `protocol` and `dut_emulator.effects` only.
"""
