"""The products: each a folder with its sensors, its firmware and its population. Pure: bench time comes in.

`catalogue.py` lists them. May import `protocol`, `dut_emulator.effects` and `dut_emulator.motion`.
"""
