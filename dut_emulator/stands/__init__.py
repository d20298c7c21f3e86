"""The stands: limits, errors, state machines over bench time, command ports. Pure: bench time comes in.

`catalogue.py` lists them. May import `protocol`, `dut_emulator.effects` and `dut_emulator.motion`.
"""
