"""Pure functions over arrays: coefficients with standard uncertainty and covariance.

May import `protocol` only. Shares names, units and shapes with `dut_emulator`, never code:
a shared model would cancel its own sign error in a round trip.
"""
